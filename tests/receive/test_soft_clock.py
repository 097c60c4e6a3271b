"""The light's clock by headers, the camera's by its stamps, and headers found at any phase."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from receive_scenes import film, link

from heliograph.base.errors import HeliographError
from heliograph.base.frames import Frame
from heliograph.receive import Packet, ReceiveSettings, make_receiver, receive_frames
from heliograph.receive.soft.camera import FIRST, CameraClock
from heliograph.receive.soft.clock import Clock, HeaderView
from heliograph.receive.soft.mix import VirtualFrame
from heliograph.signal.formats import words
from heliograph.signal.header import header_cells
from heliograph.signal.settings import SignalSettings

Floats = NDArray[np.float64]
SIGNAL = SignalSettings()
IDENTITY = 29
FINE = 2000
SLOTS = np.array([15, 11, 5, 1]) / 16


def header_view(start: float, exposure: float, period: float, seed: int = 0, form: int = 0) -> HeaderView:
    """What frames `period` patterns apart show of a header that begins `start` patterns late, by fine sums.

    Its second pair names a format: dimmed cells have the levels 3 and 1.
    """
    rng = np.random.default_rng(seed)
    times: Floats = np.arange(-2, 6 + 1e-9, period)
    steps = np.arange(-6 * FINE, 10 * FINE) / FINE
    pattern, slot = np.floor(steps), np.floor(4 * (steps % 1)).astype(int)
    cells, dimmed = header_cells(IDENTITY).ravel().astype(float), words()[form] > 0
    wave = rng.normal(0, 0.03, 16)[(pattern + 6).astype(int)]
    bright = SLOTS[slot]
    for k in range(4):
        sign = -1 if k % 2 else 1
        levels = np.where(dimmed & (k >= 2), 2 + sign * cells, 2 + 2 * sign * cells)
        lit = (levels > np.arange(4)[:, None]).astype(float)
        here = pattern == k
        wave[here], bright[here] = (2 * lit @ cells / 16)[slot[here]], lit.mean(1)[slot[here]]
    shown = []
    for t in times:
        part = (steps >= t - start) & (steps < t - start + exposure)
        shown.append((100 * wave[part].mean(), 200 * bright[part].mean() + 31))
    alternation, brightness = (np.array(column, np.float64) for column in zip(*shown, strict=True))
    return HeaderView(1e-3 * times, alternation, brightness)


@pytest.mark.parametrize(("exposure", "period"), [(1.0, 1.0), (2 / 3, 2 / 3), (0.37, 0.37), (0.25, 0.25)])
@pytest.mark.parametrize("start", [0.3, -0.37, 0.12])
def test_one_header_tells_start_and_exposure(start: float, exposure: float, period: float) -> None:
    clock = Clock(0.0, period * 1e-3, SIGNAL, IDENTITY)
    clock.measure(header_view(start, exposure, period), 0)
    assert clock.start_s == pytest.approx(start * 1e-3, abs=2e-5)
    assert clock.exposure == pytest.approx(exposure, abs=0.04)
    assert clock.gain == pytest.approx(200, rel=0.04)
    assert clock.explained > 0.95


def test_the_brightness_of_a_clipped_array_is_not_used() -> None:
    """At 25 m single LEDs are at full scale; the clock was then off by 0.3 T_b."""
    view = header_view(0.0, 1.0, 1.0)
    wrong = replace(view, brightness=np.roll(view.brightness, 3) * 2, clipped=True)
    clock = Clock(0.0, 1e-3, SIGNAL, IDENTITY)
    clock.measure(wrong, 0)
    assert clock.start_s == pytest.approx(0, abs=3e-5)
    assert clock.explained > 0.95
    frames: list[object] = []
    settings = link("receive.receiver=soft", distance_m=25.0)
    receiver = make_receiver(
        settings.signal,
        settings.receive,
        lambda stage, data: frames.extend(data["frames"]) if stage == "extract" else None,
    )
    for frame in film(settings, 101, roi_margin_px=30):
        list(receiver.push(frame))
    list(receiver.finish())
    assert frames
    assert not any(isinstance(frame, VirtualFrame) for frame in frames)


def telling_formats() -> list[int]:
    """Formats that dim most lit cells, most dark ones, all cells, and as many of both."""
    cells, dimmed = header_cells(IDENTITY).ravel(), words().astype(int)
    lit, count = dimmed @ cells, dimmed.sum(1)
    return [int(np.argmax(lit)), int(np.argmin(lit)), int(np.argmax(count)), int(np.argmax((lit == 0) & (count == 8)))]


@pytest.mark.parametrize("form", telling_formats())
@pytest.mark.parametrize(("exposure", "period"), [(1.0, 1.0), (2 / 3, 2 / 3), (0.37, 0.37)])
@pytest.mark.parametrize("start", [0.0, 0.3, -0.37])
def test_dimmed_cells_do_not_mislead_the_clock(start: float, exposure: float, period: float, form: int) -> None:
    clock = Clock(0.0, period * 1e-3, SIGNAL, IDENTITY)
    clock.measure(header_view(start, exposure, period, form=form), 0)
    assert clock.start_s == pytest.approx(start * 1e-3, abs=2e-5)
    assert clock.exposure == pytest.approx(exposure, abs=0.04)
    assert clock.gain == pytest.approx(200, rel=0.05)
    assert clock.explained > 0.95


@pytest.mark.parametrize(("exposure", "period"), [(0.9, 1.0), (0.5, 1.0), (0.3, 2 / 3)])
@pytest.mark.parametrize("start", [0.3, -0.37, 0.12])
def test_with_a_short_exposure_known_one_header_tells_the_start(start: float, exposure: float, period: float) -> None:
    clock = Clock(0.0, period * 1e-3, SIGNAL, IDENTITY, exposure * 1e-3)
    clock.measure(header_view(start, exposure, period), 0)
    assert clock.start_s == pytest.approx(start * 1e-3, abs=5e-5)


def test_of_exposures_that_look_alike_the_longest_is_taken() -> None:
    # six tenths about the middle of each pattern, and the whole of it
    clock = Clock(0.0, 1e-3, SIGNAL, IDENTITY)
    clock.measure(header_view(-0.2, 0.6, 1.0), 0)
    assert clock.exposure == pytest.approx(1, abs=0.05)


def test_an_exposure_that_is_known_is_not_asked_for() -> None:
    clock = Clock(0.0, 1e-3, SIGNAL, IDENTITY, 0.45e-3)
    clock.measure(header_view(0.2, 0.45, 1.0), 0)
    assert clock.exposure == pytest.approx(0.45)


def test_what_is_no_header_is_told() -> None:
    rng = np.random.default_rng(3)
    clock = Clock(0.0, 1e-3, SIGNAL, IDENTITY)
    alternation, brightness = (rng.normal(0, 50, 9) for _ in range(2))
    clock.measure(HeaderView(np.linspace(-2e-3, 6e-3, 9), alternation, brightness), 0)
    assert clock.explained < 0.7


def test_rate_comes_from_header_to_header() -> None:
    clock, rate = Clock(0.0, 0.66e-3, SIGNAL, IDENTITY), -400e-6
    for packet in range(12):
        first = packet * 0.1 * (1 + rate)
        # frames fall where they do
        view = header_view(first / 1e-3 % 0.66, 0.66, 0.66, packet)
        frames_s = first - first / 1e-3 % 0.66 * 1e-3
        clock.measure(replace(view, times_s=view.times_s + frames_s), 100 * packet)
    assert clock.rate == pytest.approx(rate, abs=2e-5)
    assert clock.time_s(1150) == pytest.approx(1.15 * (1 + rate), abs=3e-5)
    assert clock.place(clock.time_s(1234.5)) == pytest.approx(1234.5)


def stamped(times_s: Sequence[float], indices: Sequence[int] | None = None) -> list[Frame]:
    """Frames of noise with stamps."""
    rng = np.random.default_rng(1)
    numbers = indices or range(len(times_s))
    return [
        Frame(k, float(t), rng.integers(0, 255, (8, 8)).astype(np.uint8)) for k, t in zip(numbers, times_s, strict=True)
    ]


def timed(frames: Sequence[Frame]) -> list[Frame]:
    clock = CameraClock()
    return [out for frame in frames for out in clock.push(frame)]


@pytest.mark.parametrize("fps", [1000.0, 2700.0, 4000.0])
def test_jitter_is_smoothed(fps: float) -> None:
    rng = np.random.default_rng(4)
    true = np.arange(2000) / (fps * (1 + 150e-6))
    out = timed(stamped(list(true + np.clip(rng.normal(0, 5e-5, 2000), -0.45 / fps, 0.45 / fps))))
    error = np.array([f.time_s for f in out]) - true
    assert np.sqrt(np.mean(error[300:] ** 2)) < 1.2e-5


def test_even_stamps_stay() -> None:
    true = np.arange(200) * 1e-3 + 0.3
    assert [f.time_s for f in timed(stamped(list(true)))] == pytest.approx(list(true), abs=1e-9)


@pytest.mark.parametrize("numbered", [True, False])
def test_dropped_frames_leave_a_gap_in_time(numbered: bool) -> None:
    kept = [k for k in range(400) if k not in (8, 50, 51, 120, 300)]
    frames = stamped([k / 1500 for k in kept], kept if numbered else None)
    assert [f.time_s for f in timed(frames)] == pytest.approx([k / 1500 for k in kept], abs=1e-6)


def test_copies_are_left_out() -> None:
    frames = stamped([k * 1e-3 for k in range(60)])
    for k in (5, 30, 31):
        frames[k] = replace(frames[k], pixels=frames[k - 1].pixels.copy())
    # and one that came twice with the same stamp
    frames.insert(41, frames[40])
    out = timed(frames)
    assert [f.index for f in out] == [k for k in range(60) if k not in (5, 30, 31)]
    assert [f.time_s for f in out] == pytest.approx([f.index * 1e-3 for f in out], abs=1e-9)


def test_frames_that_go_back_are_refused() -> None:
    clock, frames = CameraClock(), stamped([0.0, 1e-3, 0.5e-3, 2e-3])
    assert list(clock.push(frames[0])) + list(clock.push(frames[1])) == []
    with pytest.raises(HeliographError, match="must follow in time") as error:
        list(clock.push(frames[2]))
    assert "\n" not in str(error.value)
    assert list(clock.push(frames[3])) == []


def test_a_camera_slower_than_the_light_is_refused() -> None:
    frames = stamped([k * 1.05e-3 for k in range(FIRST)])
    with pytest.raises(HeliographError, match="at least one frame a pattern") as error:
        list(receive_frames(frames, SIGNAL, ReceiveSettings(receiver="soft")))
    assert "\n" not in str(error.value)


def soft_packets(
    changes: Sequence[str], patterns: int = 90, start_s: float = 0.0, distance_m: float = 50.0, **camera: Any
) -> list[Packet]:
    """What the soft receiver reads of an array that starts at a time, in packets of 36 patterns."""
    settings = link("signal.data_pairs=16", *changes, distance_m=distance_m)
    channel = replace(
        settings.channel,
        camera=replace(settings.channel.camera, **camera),
        arrays=(replace(settings.channel.arrays[0], start_s=start_s),),
    )
    # `film` counts frames of 1 ms
    frames = film(replace(settings, channel=channel), patterns)
    return list(receive_frames(frames, settings.signal, replace(settings.receive, receiver="soft")))


def assert_read(packets: Sequence[Packet], start_s: float, count: int) -> None:
    assert [p.status for p in packets[:count]] == ["ok"] * count
    starts = [start_s + 0.036 * k for k in range(count)]
    assert [p.start_time_s for p in packets[:count]] == pytest.approx(starts, abs=1.5e-4)


@pytest.mark.parametrize(
    ("fps", "exposure_s"),
    [(1000, 1e-3), (1000, 0.75e-3), (1500, 1 / 1500), (2000, 0.5e-3), (2700, 0.3e-3), (4000, 0.25e-3)],
)
@pytest.mark.parametrize("start_s", [2.2e-3, 2.7e-3])
def test_any_phase_and_rate_is_read(fps: float, exposure_s: float, start_s: float) -> None:
    assert_read(soft_packets([], start_s=start_s, fps=fps, exposure_s=exposure_s), start_s, 2)


@pytest.mark.parametrize("start_s", [2.0e-3, 2.25e-3])
def test_slots_lit_in_another_order(start_s: float) -> None:
    camera: dict[str, Any] = {"fps": 1500.0, "exposure_s": 0.5e-3}
    assert_read(soft_packets(["signal.slot_order=[1, 3, 0, 2]"], start_s=start_s, **camera), start_s, 2)


def test_dropped_repeated_and_jittered_frames() -> None:
    camera: dict[str, Any] = {"fps": 2000.0, "exposure_s": 0.5e-3, "dropped": 0.02, "repeated": 0.02, "jitter_s": 5e-5}
    packets = soft_packets([], 130, start_s=10.3e-3, **camera)
    assert_read(packets, 10.3e-3, 3)


@pytest.mark.parametrize("fps", [1000.0, 1300.0])
def test_clocks_apart_are_followed(fps: float) -> None:
    # 800 ppm stand for 400 ppm in a film twice as long
    packets = soft_packets(
        ["channel.arrays.0.clock_ppm=-400"], 400, start_s=2.05e-3, fps=fps, exposure_s=0.75e-3, clock_ppm=400.0
    )
    whole = [p for p in packets if p.pairs_seen > 0.9]
    assert len(whole) >= 10
    assert [p.status for p in whole] == ["ok"] * len(whole)
    # by the camera's clock
    spacing = np.diff([p.start_time_s for p in whole])
    assert spacing[3:] == pytest.approx(np.full(len(spacing) - 3, 0.036 * (1 - 800e-6)), abs=1e-5)


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


def test_the_exposure_may_be_told() -> None:
    # exposures of half a pattern in the middle of it, or of the whole pattern, show the same of a header
    told = soft_packets(["receive.calibration.exposure_s=0.0005"], start_s=0.3e-3, exposure_s=0.5e-3)
    assert told[0].start_time_s == pytest.approx(0.3e-3, abs=3e-5)
    assert abs(soft_packets([], start_s=0.3e-3, exposure_s=0.5e-3)[0].start_time_s - 0.3e-3) > 1e-4


@pytest.mark.parametrize("period", [1.0, 0.5])
@pytest.mark.parametrize("clipped", [False, True])
def test_a_header_is_as_sure_as_it_is(period: float, clipped: bool) -> None:
    """Errors of the start are those claimed, the first header seen once more with other noise or not."""
    for again in (False, True):
        errors = []
        for seed in range(60):
            rng, clock = np.random.default_rng([seed, 3]), Clock(0.0, period * 1e-3, SIGNAL, IDENTITY)
            view = replace(header_view(0.3, period, period, seed), clipped=clipped)
            noisy = replace(view, alternation=view.alternation + rng.normal(0, 4, len(view.times_s)))
            assert clock.measure(noisy, 0)
            if again:
                assert clock.measure(noisy, 0, again=True)
            errors.append((clock.time_s(0) * 1e3 - 0.3) / clock.deviation)
        assert 0.5 < np.sqrt(np.mean(np.square(errors))) < 1.5


def test_a_header_that_is_not_seen_leaves_the_clock_alone() -> None:
    clock = Clock(0.0, 1e-3, SIGNAL, IDENTITY)
    assert clock.measure(header_view(0.2, 1.0, 1.0), 0)
    before = clock.time_s(50), clock.gain, clock.exposure
    rng = np.random.default_rng(0)
    times = (50.0 + np.arange(-2, 7)) * np.float64(1e-3)
    assert not clock.measure(HeaderView(times, rng.normal(0, 3, 9), rng.normal(0, 3, 9)), 50)
    assert (clock.time_s(50), clock.gain, clock.exposure) == pytest.approx(before)


@pytest.mark.parametrize(("fps", "start_s"), [(1000.0, 2.3e-3), (1500.0, 2.0e-3), (2500.0, 2.0e-3)])
def test_a_packet_whose_header_is_dark_is_read_by_the_clock(fps: float, start_s: float) -> None:
    dark = (start_s + 0.036 - 1.5e-3, start_s + 0.036 + 5.5e-3)
    packets = soft_packets([f"channel.arrays.0.off_s=[{list(dark)}]"], 116, start_s, 60.0, fps=fps, exposure_s=1 / fps)
    assert [p.status != "no_header" for p in packets] == [True] * len(packets)
    assert_read(packets[:1], start_s, 1)
    assert packets[1].layers["high"][0].status == "ok"
    assert_read(packets[2:], start_s + 0.072, 1)
