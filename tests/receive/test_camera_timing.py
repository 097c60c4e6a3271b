"""Soft receiver with arbitrary frame rate, phase, exposure and clock offset."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from recorder import Recorder
from scenes import film, link

from heliograph.base.errors import HeliographError
from heliograph.base.frames import Frame
from heliograph.receive import Packet, ReceiveSettings, make_receiver, receive_frames
from heliograph.receive.events import ExtractEvent
from heliograph.receive.geometry.window import CombinedFrame
from heliograph.signal.settings import SignalSettings


def test_a_camera_slower_than_the_light_is_refused() -> None:
    rng = np.random.default_rng(1)
    frames = [Frame(k, 1.05e-3 * k, rng.integers(0, 255, (8, 8)).astype(np.uint8)) for k in range(16)]
    with pytest.raises(HeliographError, match="at least one frame a pattern") as error:
        list(receive_frames(frames, SignalSettings(), ReceiveSettings(receiver="soft")))
    assert "\n" not in str(error.value)


def test_a_clipped_array_in_step_is_read_as_in_step() -> None:
    """At 25 m some LEDs saturate, so brightness carries no phase information."""
    settings, recorder = link("receive.receiver=soft", distance_m=25.0), Recorder()
    list(receive_frames(film(settings, 101, roi_margin_px=30), settings.signal, settings.receive, recorder))
    frames = [frame for event in recorder.of(ExtractEvent) for frame in event.frames]
    assert frames
    assert not any(isinstance(frame, CombinedFrame) for frame in frames)


def soft_packets(
    changes: Sequence[str], patterns: int = 90, start_s: float = 0.0, distance_m: float = 50.0, **camera: Any
) -> list[Packet]:
    """Return soft receiver packets, 36 patterns each, for an array starting at a given time."""
    settings = link("receive.receiver=soft", "signal.data_pairs=16", *changes, distance_m=distance_m)
    channel = replace(
        settings.channel,
        camera=replace(settings.channel.camera, **camera),
        arrays=(replace(settings.channel.arrays[0], start_s=start_s),),
    )
    # `film` counts 1 ms frames
    frames = film(replace(settings, channel=channel), patterns)
    return list(receive_frames(frames, settings.signal, settings.receive))


def assert_read(packets: Sequence[Packet], start_s: float, count: int) -> None:
    assert [p.status for p in packets[:count]] == ["ok"] * count
    starts = [start_s + 0.036 * k for k in range(count)]
    assert [p.start_time_s for p in packets[:count]] == pytest.approx(starts, abs=1.5e-4)


@pytest.mark.parametrize(
    ("fps", "exposure_s"),
    [(1000, 1e-3), (1000, 0.75e-3), (1500, 1 / 1500), (2000, 0.5e-3), (2700, 0.3e-3), (4000, 0.25e-3)],
)
@pytest.mark.parametrize("start_s", [2.2e-3, 2.7e-3])
@pytest.mark.slow
def test_any_phase_and_rate_is_read(fps: float, exposure_s: float, start_s: float) -> None:
    assert_read(soft_packets([], start_s=start_s, fps=fps, exposure_s=exposure_s), start_s, 2)


@pytest.mark.parametrize("start_s", [2.49e-3, 2.5e-3, 2.51e-3])
@pytest.mark.slow
def test_half_a_pattern_out_of_step_is_read(start_s: float) -> None:
    """Only the first and last header frames show the header."""
    assert_read(soft_packets([], start_s=start_s), start_s, 2)


@pytest.mark.parametrize("start_s", [2.0e-3, 2.25e-3])
@pytest.mark.slow
def test_slots_lit_in_another_order(start_s: float) -> None:
    camera: dict[str, Any] = {"fps": 1500.0, "exposure_s": 0.5e-3}
    assert_read(soft_packets(["signal.slot_order=[1, 3, 0, 2]"], start_s=start_s, **camera), start_s, 2)


@pytest.mark.slow
def test_dropped_repeated_and_jittered_frames() -> None:
    camera: dict[str, Any] = {"fps": 2000.0, "exposure_s": 0.5e-3, "dropped": 0.02, "repeated": 0.02, "jitter_s": 5e-5}
    packets = soft_packets([], 130, start_s=10.3e-3, **camera)
    assert_read(packets, 10.3e-3, 3)


@pytest.mark.parametrize("fps", [1000.0, 1300.0])
@pytest.mark.slow
def test_clocks_that_differ_are_followed(fps: float) -> None:
    # 800 ppm represent 400 ppm over twice the duration
    packets = soft_packets(
        ["channel.arrays.0.clock_ppm=-400"], 400, start_s=2.05e-3, fps=fps, exposure_s=0.75e-3, clock_ppm=400.0
    )
    whole = [p for p in packets if p.pairs_seen > 0.9]
    assert len(whole) >= 10
    assert [p.status for p in whole] == ["ok"] * len(whole)
    # in camera time
    spacing = np.diff([p.start_time_s for p in whole])
    assert spacing[3:] == pytest.approx(np.full(len(spacing) - 3, 0.036 * (1 - 800e-6)), abs=1e-5)


@pytest.mark.slow
def test_any_chunking_gives_the_same() -> None:
    settings = link("signal.data_pairs=16", distance_m=50.0)
    channel = replace(settings.channel, camera=replace(settings.channel.camera, fps=1500.0, exposure_s=6e-4))
    frames = film(replace(settings, channel=channel), 80)
    soft = ReceiveSettings(receiver="soft")
    whole, receiver = list(receive_frames(iter(frames), settings.signal, soft)), make_receiver(settings.signal, soft)
    single = [packet for frame in frames for packet in receiver.push(frame)] + list(receiver.finish())
    assert [p.status for p in whole] == ["ok", "ok"]
    assert [replace(p, layers={}) for p in single] == [replace(p, layers={}) for p in whole]
    words = [[w.block for by in p.layers.values() for w in by] for p in single]
    assert words == [[w.block for by in p.layers.values() for w in by] for p in whole]


@pytest.mark.slow
def test_the_exposure_may_be_given() -> None:
    # central half-pattern and full-pattern exposures give the same header amplitudes
    given = soft_packets(["receive.calibration.exposure_s=0.0005"], start_s=0.3e-3, exposure_s=0.5e-3)
    assert given[0].start_time_s == pytest.approx(0.3e-3, abs=3e-5)
    assert abs(soft_packets([], start_s=0.3e-3, exposure_s=0.5e-3)[0].start_time_s - 0.3e-3) > 1e-4


@pytest.mark.parametrize(("fps", "start_s"), [(1000.0, 2.3e-3), (1500.0, 2.0e-3), (2500.0, 2.0e-3)])
@pytest.mark.slow
def test_a_packet_whose_header_is_dark_is_read_by_the_clock(fps: float, start_s: float) -> None:
    dark = (start_s + 0.036 - 1.5e-3, start_s + 0.036 + 5.5e-3)
    packets = soft_packets([f"channel.arrays.0.off_s=[{list(dark)}]"], 116, start_s, 60.0, fps=fps, exposure_s=1 / fps)
    assert [p.status != "no_header" for p in packets] == [True] * len(packets)
    assert_read(packets[:1], start_s, 1)
    assert packets[1].layers["high"][0].status == "ok"
    assert_read(packets[2:], start_s + 0.072, 1)


@pytest.mark.parametrize("receiver", ["plain", "soft"])
@pytest.mark.slow
def test_late_stamps_and_missing_frames_say_nothing_of_the_rate(receiver: str) -> None:
    """Only timestamps reveal the missing frame, as in films with consecutive numbers."""
    settings = link(f"receive.receiver={receiver}", "signal.data_pairs=24")
    jitter = np.random.default_rng(4).normal(0, 6e-5, 170)
    frames = [replace(frame, time_s=frame.time_s + jitter[k]) for k, frame in enumerate(film(settings, 170)) if k != 31]
    frames = [replace(frame, index=k) for k, frame in enumerate(frames)]
    packets = list(receive_frames(frames, settings.signal, settings.receive))
    assert [packet.status for packet in packets] == ["ok", "ok", "ok"]
    # the soft receiver combines other frames from the pair
    assert [packet.pairs_seen for packet in packets[1:]] == [1, 1]


@pytest.mark.parametrize("rate_hz", [500.0, 985.0, 1015.0, 2000.0])
def test_the_plain_receiver_names_the_rate_it_cannot_read(rate_hz: float) -> None:
    settings = link()
    frames = [Frame(k, k / rate_hz, np.zeros((60, 60), np.uint8)) for k in range(40)]
    if abs(rate_hz - 1000) < 20:
        assert list(receive_frames(frames, settings.signal, settings.receive)) == []
    else:
        with pytest.raises(HeliographError, match=rf"has {rate_hz:.1f} frames/s.*--fps"):
            list(receive_frames(frames, settings.signal, settings.receive))


@pytest.mark.slow
def test_a_light_of_ten_patterns_per_second_is_read_from_an_ordinary_camera() -> None:
    settings = link(
        "receive.receiver=soft", "signal.pattern_period_s=0.1", "signal.data_pairs=8",
        camera={"fps": 30.0, "exposure_s": 0.02, "width": 160, "height": 120},
    )  # fmt: skip
    packets = list(receive_frames(film(settings, 4500), settings.signal, settings.receive))
    assert [packet.status for packet in packets] == ["ok", "ok"]


@pytest.mark.parametrize("phase", [0.47, 0.475, 0.5, 0.53])
@pytest.mark.slow
def test_half_a_pattern_out_of_step_far_arrays_stay_upright(phase: float) -> None:
    """Data adjacent to the header resemble a tilt, which later headers would not correct."""
    packets = soft_packets(["signal.data_pairs=48"], patterns=112, start_s=phase * 1e-3, distance_m=80.0)
    assert packets[0].status == "ok"
    assert (packets[0].pose.stretch, packets[0].pose.shear) == pytest.approx((0, 0), abs=5e-3)


@pytest.mark.slow
def test_half_a_pattern_out_of_step_layers_end_at_the_distances_of_the_documentation() -> None:
    """At 70 m all layers decode, at 95 m only the high layer; lost codewords never pass as valid."""
    assert [packet.status for packet in soft_packets([], 80, 0.5e-3 - 0.036, 70.0)] == ["ok", "ok"]
    far = soft_packets([], 80, 0.5e-3, 95.0)
    assert far
    for packet in far:
        words = {name: {word.status for word in by} for name, by in packet.layers.items()}
        assert words == {"high": {"ok"}, "middle": {"crc_fail"}, "low": {"crc_fail"}}
