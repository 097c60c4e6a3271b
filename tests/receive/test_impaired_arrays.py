"""Soft receiver with impaired arrays: tilt, occlusion, failed LEDs, low light, sunlight, pauses, several arrays."""

from typing import Any

import numpy as np
import pytest
from recorder import Recorder
from scenes import codewords, film, link, received

from heliograph.link.settings import LinkSettings
from heliograph.receive import Packet

SUN = {"emitter": {"all_on": 0.33, "panel_level": 0.47}, "background": {"level": 0.4}}
NIGHT = {"emitter": {"all_on": 0.08, "panel_level": 0.0}, "background": {"level": 0.0}}


def soft(distance_m: float, place: dict[str, Any] | None = None, **channel: Any) -> LinkSettings:
    arrays = [{"x_m": 0.0, "y_m": 0.0, **(place or {})}]
    return link("receive.receiver=soft", "signal.data_pairs=24", distance_m=distance_m, arrays=arrays, **channel)


def lost(settings: LinkSettings) -> list[int]:
    """Return the lost codewords of a packet in the high, middle and low layer."""
    return [errors for _, errors in codewords(settings)]


@pytest.mark.parametrize(("distance_m", "place", "channel"), [
    (80.0, {"yaw_deg": 30.0}, {}),
    (50.0, {"yaw_deg": 25.0, "pitch_deg": 15.0, "roll_deg": 5.0}, {}),
    (80.0, {"hidden": (0.0, 0.0, 0.5, 0.5), "start_s": 0.00015}, {}),
    (50.0, {"hidden": (0.0, 0.0, 0.25, 1.0), "hidden_level": 0.5}, {}),
    (50.0, {"hidden": (0.375, 0.0, 0.625, 1.0)}, {}), (80.0, {"dead": 0.025, "stuck": 0.025}, {}),
    (50.0, {}, NIGHT), (80.0, {}, SUN), (50.0, {}, {"emitter": {"all_on": 2.0}}), (20.0, {}, {}),
])  # fmt: skip
@pytest.mark.slow
def test_impaired_array_is_read_completely(distance_m: float, place: dict[str, Any], channel: dict[str, Any]) -> None:
    assert lost(soft(distance_m, place, **channel)) == [0, 0, 0]


@pytest.mark.slow
def test_half_hidden_array_gives_no_false_codeword() -> None:
    assert lost(soft(60.0, {"hidden": (0.0, 0.0, 0.5, 1.0)}))[2] == 1


def starts_ms(packets: list[Packet], identity: int = 0) -> list[int]:
    """Return start times of decoded packets from an array."""
    return [round(1e3 * p.start_time_s) for p in packets if p.identity == identity and p.status == "ok"]


@pytest.mark.parametrize(
    ("distance_m", "off_s", "expected"),
    # within a header at 80 m
    [(50.0, (0.07, 0.25), [0, 260]), (80.0, (0.055, 0.18), [0, 208])],
)
@pytest.mark.slow
def test_array_is_lost_while_off_and_found_by_the_next_header(
    distance_m: float, off_s: tuple[float, float], expected: list[int]
) -> None:
    settings = soft(distance_m, {"off_s": [off_s]})
    packets = received(film(settings, expected[-1] + 56, roi_margin_px=30), settings)
    assert starts_ms(packets) == expected
    assert all(p.status != "ok" or p.identity == 0 for p in packets)


@pytest.mark.slow
def test_noise_is_not_tracked_as_a_dim_array() -> None:
    """A dim array switches off: tracking ends within the coasting time, and noise yields no packet."""
    night = {"emitter": {"all_on": 0.08, "panel_level": 0.0}, "background": {"level": 0.1}}
    settings, recorder = soft(110.0, {"off_s": [(0.055, 0.403)]}, **night), Recorder()
    packets = received(film(settings, 250), settings, recorder)
    assert len(recorder.lost_s) == 1
    assert recorder.lost_s[0] < 0.055 + 0.07
    assert [p.start_time_s < 0.03 for p in packets if p.pairs_seen > 0.3] == [True]


@pytest.mark.slow
def test_array_passing_before_another_loses_no_packet() -> None:
    # at 0.13 s the nearer array occludes the other
    near = {"x_m": -0.6, "y_m": 0.0, "z_offset_m": -15.0, "vx_m_s": 4.6}
    settings = link(
        "receive.receiver=soft",
        "signal.data_pairs=24",
        "transmit.identities=[7, 3]",
        distance_m=50.0,
        arrays=[near, {"x_m": 0.0, "y_m": 0.0}],
    )
    packets = received(film(settings, 260), settings)
    assert starts_ms(packets, 7) == [0, 52, 104, 156, 208]
    assert {0, 208} <= set(starts_ms(packets, 3)) < {0, 52, 104, 156, 208}


@pytest.mark.slow
def test_six_arrays_that_begin_at_once_are_read() -> None:
    places = [{"x_m": x, "y_m": y} for y in (-0.4, 0.4) for x in (-0.8, 0.0, 0.8)]
    changes = "receive.receiver=soft", "signal.data_pairs=16", "transmit.identities=[0, 7, 12, 3, 20, 9]"
    settings = link(*changes, distance_m=50.0, arrays=places)
    packets = received(film(settings, 38), settings)
    assert sorted(p.identity for p in packets if p.status == "ok") == [0, 3, 7, 9, 12, 20]


def test_tilt_is_estimated_and_does_not_change_the_distance() -> None:
    settings = soft(40.0, {"yaw_deg": 30.0})
    (packet,) = received(film(settings, 53, roi_margin_px=30), settings)
    # pitch ratio 1 : cos 30 degrees
    assert (1 + packet.pose.stretch) / (1 - packet.pose.stretch) == pytest.approx(np.cos(np.radians(30)), abs=0.005)
    assert packet.distance_m == pytest.approx(40.0, rel=0.005)
