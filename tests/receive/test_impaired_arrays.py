"""Soft receiver with impaired arrays: tilt, occlusion, failed LEDs, low light, sunlight, pauses, several arrays."""

from typing import Any

import numpy as np
import pytest
from recorder import Recorder
from scenes import film, link

from heliograph.link.settings import LinkSettings
from heliograph.measure.bench import run_block
from heliograph.measure.counts import BlockCounts
from heliograph.receive import Packet, receive_frames

QUARTER = {"hidden": (0.0, 0.0, 0.5, 0.5)}
SIDE = {"hidden": (0.0, 0.0, 0.25, 1.0)}
POST = {"hidden": (0.375, 0.0, 0.625, 1.0)}
SUN = {"emitter": {"all_on": 0.33, "panel_level": 0.47}, "background": {"level": 0.4}}
NIGHT = {"emitter": {"all_on": 0.08, "panel_level": 0.0}, "background": {"level": 0.0}}


def soft(distance_m: float, place: dict[str, Any] | None = None, **channel: Any) -> LinkSettings:
    arrays = [{"x_m": 0.0, "y_m": 0.0, **(place or {})}]
    return link("receive.receiver=soft", distance_m=distance_m, arrays=arrays, **channel)


def wrong(counts: BlockCounts) -> list[int]:
    """Return codeword errors in the high, middle and low layer; no codeword may be false."""
    assert counts.false_codewords == 0
    return [layer.codeword_errors for layer in counts.layers.values()]


@pytest.mark.parametrize(
    ("distance_m", "place", "channel"),
    [
        (80.0, {"yaw_deg": 10.0}, {}),
        (80.0, {"yaw_deg": 30.0}, {}),
        (50.0, {"yaw_deg": -40.0}, {}),
        (50.0, {"yaw_deg": 25.0, "pitch_deg": 15.0, "roll_deg": 5.0}, {}),
        (80.0, QUARTER, {}),
        (50.0, SIDE, {}),
        (50.0, {**SIDE, "hidden_level": 0.5}, {}),
        (50.0, POST, {}),
        (80.0, {"dead": 0.025, "stuck": 0.025}, {}),
        (50.0, {}, NIGHT),
        (80.0, {}, SUN),
        (50.0, {}, {"emitter": {"all_on": 2.0}}),
        (20.0, {}, {}),
    ],
)
@pytest.mark.slow
def test_every_codeword_is_read(distance_m: float, place: dict[str, Any], channel: dict[str, Any]) -> None:
    assert wrong(run_block(soft(distance_m, place, **channel), 1)) == [0, 0, 0]


@pytest.mark.parametrize("distance_m", [50.0, 80.0])
@pytest.mark.slow
def test_hidden_leds_are_known_out_of_step_too(distance_m: float) -> None:
    assert wrong(run_block(soft(distance_m, {**QUARTER, "start_s": 0.00015}), 1)) == [0, 0, 0]


def test_half_an_array_gives_no_wrong_codeword() -> None:
    counts = run_block(soft(60.0, {"hidden": (0.0, 0.0, 0.5, 1.0)}), 1)
    assert counts.false_codewords == 0
    assert wrong(counts)[2] == 1


@pytest.mark.slow
def test_lost_while_off_and_found_by_the_next_header() -> None:
    settings = soft(50.0, {"off_s": [(0.13, 0.43)]})
    packets = list(receive_frames(film(settings, 600), settings.signal, settings.receive))
    right = [p for p in packets if p.status == "ok"]
    assert [round(p.start_time_s, 3) for p in right] == [0.0, 0.5]
    assert all(p.status != "ok" or p.identity == 0 for p in packets)


@pytest.mark.parametrize("distance_m", [80.0, 110.0])
@pytest.mark.slow
def test_noise_is_no_dim_array(distance_m: float) -> None:
    """A dim array switches off: tracking ends within the coasting time, and noise yields no packet."""
    night = {"emitter": {"all_on": 0.08, "panel_level": 0.0}, "background": {"level": 0.1}}
    settings, recorder = soft(distance_m, {"off_s": [(0.103, 0.403)]}, **night), Recorder()
    packets = list(receive_frames(film(settings, 410), settings.signal, settings.receive, recorder))
    assert len(recorder.lost_s) == 1
    assert recorder.lost_s[0] < 0.103 + 0.07
    assert [p.start_time_s < 0.05 for p in packets if p.pairs_seen > 0.3] == [True]


@pytest.mark.parametrize("off_s", [0.101, 0.103])
@pytest.mark.parametrize("distance_m", [50.0, 80.0])
@pytest.mark.slow
def test_an_array_switched_off_amid_its_header(off_s: float, distance_m: float) -> None:
    settings = soft(distance_m, {"off_s": [(off_s, 0.35)]})
    packets = list(receive_frames(film(settings, 620), settings.signal, settings.receive))
    read = [p for p in packets if p.status == "ok"]
    assert [round(p.start_time_s, 3) for p in read] == [0.0, 0.4, 0.5]


@pytest.mark.slow
def test_an_array_passes_before_another() -> None:
    # at 0.25 s the nearer array occludes the other
    near = {"x_m": -0.6, "y_m": 0.0, "z_offset_m": -15.0, "vx_m_s": 2.4}
    settings = link(
        "receive.receiver=soft",
        "transmit.identities=[7, 3]",
        distance_m=50.0,
        arrays=[near, {"x_m": 0.0, "y_m": 0.0}],
    )
    packets = list(receive_frames(film(settings, 600), settings.signal, settings.receive))
    assert starts(packets, 7) == [0.0, 0.1, 0.2, 0.3, 0.4, 0.5]
    assert {0.0, 0.5} <= set(starts(packets, 3)) < {0.0, 0.1, 0.2, 0.3, 0.4, 0.5}


@pytest.mark.slow
def test_six_arrays_begin_at_once() -> None:
    places = [{"x_m": x, "y_m": y} for y in (-0.4, 0.4) for x in (-0.8, 0.0, 0.8)]
    settings = link("receive.receiver=soft", "transmit.identities=[0, 7, 12, 3, 20, 9]", distance_m=50.0, arrays=places)
    packets = list(receive_frames(film(settings, 102), settings.signal, settings.receive))
    assert sorted(p.identity for p in packets if p.status == "ok") == [0, 3, 7, 9, 12, 20]


def test_the_tilt_is_found_and_does_not_change_the_distance() -> None:
    settings = soft(40.0, {"yaw_deg": 30.0})
    packet = next(iter(receive_frames(film(settings, 101), settings.signal, settings.receive)))
    # pitch ratio 1 : cos 30 degrees
    assert (1 + packet.pose.stretch) / (1 - packet.pose.stretch) == pytest.approx(np.cos(np.radians(30)), abs=0.005)
    assert packet.distance_m == pytest.approx(40.0, rel=0.005)


def starts(packets: list[Packet], identity: int) -> list[float]:
    """Return start times of decoded packets from an array."""
    return [round(p.start_time_s, 3) for p in packets if p.identity == identity and p.status == "ok"]
