"""Impaired arrays: tilt, occlusion, failed LEDs, low light, sunlight, pauses, posts, fast motion, several arrays."""

import math
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from benchmarks.scenarios import draw_passage
from recorder import Recorder
from scenes import SIDE, codewords, draw, film, frame_of, link, received, statuses

from heliograph.base.frames import Frame
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import default_messages, simulate
from heliograph.receive.api import make_receiver
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.packet import Packet
from heliograph.receive.sync.light_clock import measure_amplitudes
from heliograph.signal.header import header_levels

SUN = {"emitter": {"all_on": 0.33, "panel_level": 0.47}, "background": {"level": 0.4}}
NIGHT = {"emitter": {"all_on": 0.08, "panel_level": 0.0}, "background": {"level": 0.0}}


def soft(distance_m: float, place: dict[str, Any] | None = None, **channel: Any) -> LinkSettings:
    arrays = [{"x_m": 0.0, "y_m": 0.0, **(place or {})}]
    return link("receive.receiver=soft", "signal.data_pairs=24", distance_m=distance_m, arrays=arrays, **channel)


@pytest.mark.parametrize(("distance_m", "place", "channel", "low_lost"), [
    (80.0, {"yaw_deg": 30.0}, {}, 0),
    (50.0, {"yaw_deg": 25.0, "pitch_deg": 15.0, "roll_deg": 5.0}, {}, 0),
    (80.0, {"hidden": (0.0, 0.0, 0.5, 0.5), "start_s": 0.00015}, {}, 0),
    (50.0, {"hidden": (0.0, 0.0, 0.25, 1.0), "hidden_level": 0.5}, {}, 0),
    (50.0, {"hidden": (0.375, 0.0, 0.625, 1.0)}, {}, 0), (80.0, {"dead": 0.025, "stuck": 0.025}, {}, 0),
    (50.0, {}, NIGHT, 0), (80.0, {}, SUN, 0), (50.0, {}, {"emitter": {"all_on": 2.0}}, 0), (20.0, {}, {}, 0),
    # half hidden, but with no false codeword
    (60.0, {"hidden": (0.0, 0.0, 0.5, 1.0)}, {}, 1),
])  # fmt: skip
@pytest.mark.slow
def test_impaired_array_is_read(distance_m: float, place: dict[str, Any], channel: Any, low_lost: int) -> None:
    errors = [lost for _, lost in codewords(soft(distance_m, place, **channel))]
    assert errors[2] == low_lost
    assert low_lost or errors == [0, 0, 0]


def starts_ms(packets: list[Packet], identity: int = 0) -> list[int]:
    return [round(1e3 * p.start_time_s) for p in packets if p.identity == identity and p.status == "ok"]


# within a header at 80 m
@pytest.mark.parametrize(
    ("distance_m", "off_s", "expected"), [(50.0, (0.07, 0.25), [0, 260]), (80.0, (0.055, 0.18), [0, 208])]
)
@pytest.mark.slow
def test_array_is_found_again_after_a_pause(distance_m: float, off_s: tuple[float, float], expected: list[int]) -> None:
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
    changes = "receive.receiver=soft", "signal.data_pairs=24", "transmit.identities=[7, 3]"
    settings = link(*changes, distance_m=50.0, arrays=[near, {"x_m": 0.0, "y_m": 0.0}])
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


def passing(receiver: str, distance_m: float, speed_m_s: float, yaw_deg: float) -> LinkSettings:
    """Return settings for three packets during a pass across the sensor centre."""
    half_m = 0.5 * speed_m_s * 0.161
    array = {"x_m": -half_m, "y_m": 0.2, "vx_m_s": speed_m_s, "yaw_deg": yaw_deg}
    received_by = {"receive": {"receiver": receiver}, "signal": {"data_pairs": 24}}
    channel = {"distance_m": distance_m, "duration_s": 0.161, "arrays": [array]}
    return load_settings("crossing", {**received_by, "channel": channel})


@pytest.mark.parametrize(
    ("receiver", "distance_m", "speed_m_s", "yaw_deg"),
    [("soft", 30.0, 16.0, 22.0), ("soft", 18.0, 12.0, -20.0), ("soft", 38.0, 8.0, 5.0), ("plain", 18.0, 12.0, -20.0)],
)
@pytest.mark.slow
def test_passing_array_is_read(receiver: str, distance_m: float, speed_m_s: float, yaw_deg: float) -> None:
    """At 1.5 px per frame, motion resembled a phase shift, blur or stretch."""
    settings, recorder = passing(receiver, distance_m, speed_m_s, yaw_deg), Recorder()
    frames = [frame for frame, _ in simulate(settings, default_messages(settings), 3, None, 40)]
    assert statuses(received(frames, settings, recorder)) == ["ok"] * 3
    assert len(recorder.found_s) == 1


def test_moving_background_does_not_mislead_the_clock() -> None:
    """An approaching bright edge lowered the apparent array brightness relative to its surroundings."""
    rng, header, pose = np.random.default_rng(2), header_levels(5, SIDE) / 2.0 - 1.0, Pose(40.0, 40.0, 2.0, 0.0, 0.55)
    panel, frames = draw(pose, np.ones((SIDE, SIDE)), (0, 0), (80, 80)), list[Frame]()
    for k in range(8):
        levels = 0.5 + (0.5 * (-1) ** k * header if 2 <= k < 6 else 0.0 * header)
        # background wall with an approaching edge
        behind = 0.1 + 0.6 * (np.arange(80) < 8 + 2 * k)
        frames.append(frame_of((1 - panel) * behind + 0.3 * draw(pose, levels, (0, 0), (80, 80)), k, rng))
    _, alternation, brightness, _ = measure_amplitudes(frames, [pose] * 8, header)
    assert np.ptp(brightness) < 0.06 * 0.3 * 255
    assert np.abs(alternation[[2, 4]] - 0.15 * 255).max() < 4


@cache
def read(number: int, until_s: float, seed: int = 1) -> tuple[int, list[Packet]]:
    """Return the number of the first packet after the post, and soft receiver packets until `until_s`."""
    settings, post, film_seed = draw_passage(np.random.default_rng((seed, number)))
    rng = np.random.default_rng(film_seed)
    receiver = make_receiver(settings.signal, replace(settings.receive, receiver="soft"))
    packets = list[Packet]()
    for frame, truth in simulate(settings, default_messages(settings), film_seed, None, 40):
        if frame.time_s >= until_s:
            break
        packets += receiver.push(post.draw(frame, truth, rng))
    return math.ceil(post.end_s / settings.signal.packet_s), [*packets, *receiver.finish()]


def numbers_of(packets: list[Packet]) -> list[int]:
    return [round(packet.start_time_s / 0.1) for packet in packets if packet.status == "ok"]


@pytest.mark.slow
def test_first_packet_after_a_post_is_read() -> None:
    # regression: the half-hidden header at 0.5 s resembled a tilt
    first, packets = read(1, 0.71)
    assert first in numbers_of(packets)


@pytest.mark.slow
@pytest.mark.xfail(strict=True, reason="a track 7 % too narrow is trusted after one packet; the next is lost")
def test_array_detected_at_the_edge_of_a_post_is_read_again() -> None:
    # the header at 0.3 s appears 7 % too narrow; LED-by-LED decoding recovers this packet, but not the next
    first, packets = read(4, 0.505, seed=11)
    assert numbers_of(packets)[-2:] == [3, 4]
    assert first in numbers_of(packets)


@pytest.mark.slow
def test_packet_with_a_header_measured_too_narrow_is_decoded_per_led() -> None:
    # the post's edge makes the header at 0.3 s appear 7 % too narrow
    assert numbers_of(read(4, 0.505, seed=11)[1])[:3] == [0, 1, 3]


@pytest.mark.parametrize(("number", "seed", "count"), [
    # regression: pose shifted by 1.4 px, 1.5 pitches
    (0, 1, 2),
    # regression: partly hidden LEDs next to the post were flagged late and gave overconfident wrong symbols
    (7, 3, 3),
    # the equaliser fails on the second packet; LED-by-LED decoding recovers this packet
    (23, 11, 2),
    # regression: pose shifted by 1.2 px before a post brighter than the array hid an LED, then by 20 px
    (6, 23, 4),
    # regression: the post is as bright as the array; LEDs learnt as dead shifted the pose by an LED
    (96, 41, 4),
])  # fmt: skip
@pytest.mark.slow
def test_packets_next_to_and_behind_a_post_are_read(number: int, seed: int, count: int) -> None:
    _, packets = read(number, 0.1 * count + 0.01, seed=seed)
    assert statuses(packets) == ["ok"] * count
