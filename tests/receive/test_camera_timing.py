"""Soft receiver with arbitrary frame rate, phase, exposure and clock offset."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from recorder import Recorder
from scenes import film, link, received, statuses, words_of

from heliograph.base.errors import HeliographError
from heliograph.base.frames import Frame
from heliograph.link.settings import LinkSettings
from heliograph.receive.api import receive_frames
from heliograph.receive.events import ExtractEvent
from heliograph.receive.geometry.window import CombinedFrame
from heliograph.receive.packet import Packet
from heliograph.receive.settings import ReceiveSettings
from heliograph.signal.settings import SignalSettings


def test_camera_slower_than_the_patterns_is_refused() -> None:
    rng = np.random.default_rng(1)
    frames = [Frame(k, 1.05e-3 * k, rng.integers(0, 255, (8, 8)).astype(np.uint8)) for k in range(16)]
    with pytest.raises(HeliographError, match="at least one frame per pattern") as error:
        list(receive_frames(frames, SignalSettings(), ReceiveSettings(receiver="soft")))
    assert "\n" not in str(error.value)


def test_clipped_synchronous_array_is_read_as_synchronous() -> None:
    """At 25 m some LEDs saturate, so brightness carries no phase information."""
    settings, recorder = link("receive.receiver=soft", "signal.data_pairs=16", distance_m=25.0), Recorder()
    received(film(settings, 37, roi_margin_px=30), settings, recorder)
    frames = [frame for event in recorder.of(ExtractEvent) for frame in event.frames]
    assert frames
    assert not any(isinstance(frame, CombinedFrame) for frame in frames)


def scene(*changes: str, start_s: float = 0.0, distance_m: float = 50.0, **camera: Any) -> LinkSettings:
    """Return a link with packets of 36 patterns, for an array starting at a given time."""
    settings = link("receive.receiver=soft", "signal.data_pairs=16", *changes, distance_m=distance_m)
    channel = replace(
        settings.channel,
        camera=replace(settings.channel.camera, **camera),
        arrays=(replace(settings.channel.arrays[0], start_s=start_s),),
    )
    return replace(settings, channel=channel)


def read(settings: LinkSettings, patterns: int = 84) -> list[Packet]:
    return received(film(settings, patterns, roi_margin_px=20), settings)


def assert_read(packets: Sequence[Packet], start_s: float, count: int) -> None:
    assert statuses(packets[:count]) == ["ok"] * count
    starts = [start_s + 0.036 * k for k in range(count)]
    assert [p.start_time_s for p in packets[:count]] == pytest.approx(starts, abs=1.5e-4)


@pytest.mark.parametrize(("fps", "exposure_s", "start_s", "changes"), [
    (1000, 1e-3, 2.2e-3, []), (1500, 1 / 1500, 2.2e-3, []), (2700, 0.3e-3, 2.2e-3, []), (4000, 0.25e-3, 2.7e-3, []),
    # half a pattern late: only the first and last header frames show the header
    (1000, 1e-3, 2.49e-3, []), (1000, 1e-3, 2.51e-3, []),
    (1500, 0.5e-3, 2.25e-3, ["signal.slot_order=[1, 3, 0, 2]"]),
])  # fmt: skip
@pytest.mark.slow
def test_any_rate_phase_and_order_is_read(fps: float, exposure_s: float, start_s: float, changes: list[str]) -> None:
    assert_read(read(scene(*changes, start_s=start_s, fps=fps, exposure_s=exposure_s)), start_s, 2)


@pytest.mark.slow
def test_dropped_repeated_and_jittered_frames_cost_no_packet() -> None:
    camera: dict[str, Any] = {"fps": 2000.0, "exposure_s": 0.5e-3, "dropped": 0.02, "repeated": 0.02, "jitter_s": 5e-5}
    assert_read(read(scene(start_s=10.3e-3, **camera), 130), 10.3e-3, 3)


@pytest.mark.slow
def test_clock_drift_is_followed() -> None:
    # 800 ppm represent 400 ppm over twice the duration
    camera = {"fps": 1300.0, "exposure_s": 0.75e-3, "clock_ppm": 400.0}
    packets = read(scene("channel.arrays.0.clock_ppm=-400", start_s=2.05e-3, **camera), 300)
    whole = [p for p in packets if p.pairs_seen > 0.9]
    assert len(whole) >= 7
    assert statuses(whole) == ["ok"] * len(whole)
    # in camera time
    spacing = np.diff([p.start_time_s for p in whole])[3:]
    assert spacing == pytest.approx(np.full(len(spacing), 0.036 * (1 - 800e-6)), abs=1e-5)


@pytest.mark.slow
def test_calibrated_exposure_resolves_the_phase() -> None:
    # central half-pattern and full-pattern exposures give the same header amplitudes
    calibrated, unknown = (
        abs(read(scene(*changes, start_s=0.3e-3, exposure_s=0.5e-3), 42)[0].start_time_s - 0.3e-3)
        for changes in (["receive.calibration.exposure_s=0.0005"], [])
    )
    assert calibrated < 3e-5
    assert unknown > 1e-4


@pytest.mark.slow
def test_packet_with_dark_header_is_read_by_the_clock() -> None:
    start_s = 2.3e-3
    off_s = [start_s + 0.036 - 1.5e-3, start_s + 0.036 + 5.5e-3]
    packets = read(scene(f"channel.arrays.0.off_s=[{off_s}]", start_s=start_s, distance_m=60.0), 116)
    assert "no_header" not in statuses(packets)
    assert_read(packets[:1], start_s, 1)
    assert packets[1].layers["high"][0].status == "ok"
    assert_read(packets[2:], start_s + 0.072, 1)


@pytest.mark.parametrize("receiver", ["plain", "soft"])
@pytest.mark.slow
def test_late_stamps_and_missing_frames_do_not_change_the_rate(receiver: str) -> None:
    """Only timestamps reveal the missing frame, as in films with consecutive numbers."""
    settings = link(f"receive.receiver={receiver}", "signal.data_pairs=24", distance_m=35.0)
    jitter = np.random.default_rng(4).normal(0, 6e-5, 120)
    frames = [frame for frame in film(settings, 120, roi_margin_px=20) if frame.index != 31]
    frames = [replace(frame, index=k, time_s=frame.time_s + jitter[frame.index]) for k, frame in enumerate(frames)]
    packets = received(frames, settings)
    assert statuses(packets)[:2] == ["ok", "ok"]
    # the soft receiver combines other frames from the pair
    assert packets[1].pairs_seen == 1


@pytest.mark.slow
def test_ten_patterns_per_second_are_read_from_an_ordinary_camera() -> None:
    settings = link(
        "receive.receiver=soft", "signal.pattern_period_s=0.1", "signal.data_pairs=8",
        camera={"fps": 30.0, "exposure_s": 0.02, "width": 160, "height": 120},
    )  # fmt: skip
    assert statuses(received(film(settings, 4500), settings)) == ["ok", "ok"]


@pytest.mark.slow
def test_far_arrays_half_a_pattern_late_stay_upright() -> None:
    """Data adjacent to the header resemble a tilt, which later headers would not correct."""
    packets = read(scene("signal.data_pairs=48", start_s=0.5e-3, distance_m=80.0), 104)
    assert packets[0].status == "ok"
    assert (packets[0].pose.stretch, packets[0].pose.shear) == pytest.approx((0, 0), abs=5e-3)


@pytest.mark.slow
def test_half_a_pattern_late_layers_end_at_the_documented_distances() -> None:
    """At 70 m all layers decode, at 95 m only the high layer; lost codewords never pass as valid."""
    assert statuses(read(scene(start_s=0.5e-3 - 0.036, distance_m=70.0), 80)) == ["ok", "ok"]
    far = read(scene(start_s=0.5e-3, distance_m=95.0), 44)
    assert far
    assert all([w.status for w in words_of(packet)] == ["ok", *["crc_fail"] * 3] for packet in far)
