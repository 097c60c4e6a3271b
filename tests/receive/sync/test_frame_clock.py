"""Camera clock estimation from timestamps."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from properties import examples

from heliograph.base.arrays import Floats
from heliograph.base.errors import HeliographError
from heliograph.base.frames import Frame, Pixels
from heliograph.receive.sync.frame_clock import CameraClock, FrameClock, SynchronousClock, owned

FIRST = 16  # frames buffered until the camera rate is known


def stamped(times_s: Sequence[float] | NDArray[Any], indices: Sequence[int] | None = None) -> list[Frame]:
    """Return noise frames with timestamps."""
    pixels = np.random.default_rng(1).integers(0, 255, (len(times_s), 8, 8), np.uint8)
    return [Frame(k, float(t), p) for k, t, p in zip(indices or range(len(times_s)), times_s, pixels, strict=True)]


def timed(frames: Sequence[Frame], clock: FrameClock | None = None) -> list[Frame]:
    clock = clock or CameraClock()
    return [out for frame in frames for out in clock.push(frame)]


def times_of(frames: Sequence[Frame]) -> Floats:
    return np.array([frame.time_s for frame in frames])


@pytest.mark.parametrize("fps", [1000.0, 2700.0, 4000.0])
def test_jitter_is_smoothed(fps: float) -> None:
    true, jitter = np.arange(2000) / (fps * (1 + 150e-6)), np.random.default_rng(4).normal(0, 5e-5, 2000)
    error = times_of(timed(stamped(true + np.clip(jitter, -0.45 / fps, 0.45 / fps)))) - true
    assert np.sqrt(np.mean(error[300:] ** 2)) < 1.2e-5


@pytest.mark.parametrize("numbered", [True, False])
def test_dropped_frames_leave_a_gap_in_time(numbered: bool) -> None:
    kept = np.delete(np.arange(400), [8, 50, 51, 120, 300])
    out = timed(stamped(kept / 1500, kept.tolist() if numbered else None))
    assert times_of(out) == pytest.approx(kept / 1500, abs=1e-6)


@examples(60)
@given(
    period_s=st.floats(1e-4, 0.05),
    jitter=st.floats(0, 0.15),
    gaps=st.lists(st.integers(1, 6), min_size=40, max_size=150),
    seed=st.integers(0, 99),
)
@pytest.mark.slow
def test_dropped_frames_leave_order_and_period(period_s: float, jitter: float, gaps: list[int], seed: int) -> None:
    """Drop two of three frames on average after the first 16, with timestamp jitter up to 15 % of a period."""
    steps = np.concatenate([np.ones(FIRST, int), gaps])
    stamps = period_s * (np.cumsum(steps) + np.random.default_rng(seed).uniform(-jitter, jitter, len(steps)))
    clock = CameraClock()
    out = timed(stamped(stamps), clock)
    # no frame is lost, and pixels stay with their frame
    assert [f.index for f in out] == list(range(len(steps)))
    between = np.diff(times_of(out))
    assert (between > 0).all()
    # steps are multiples of the period
    assert between / period_s == pytest.approx(steps[1:], abs=0.25)
    assert clock.period_s == pytest.approx(period_s, rel=0.03)


def test_repeated_frames_are_skipped() -> None:
    frames = stamped(np.arange(60) * 1e-3)
    for k in (5, 30, 31):
        frames[k] = replace(frames[k], pixels=frames[k - 1].pixels.copy())
    # one duplicate with the same timestamp
    out, kept = timed([*frames[:41], *frames[40:]]), np.delete(np.arange(60), [5, 30, 31])
    assert [f.index for f in out] == kept.tolist()
    assert times_of(out) == pytest.approx(kept * 1e-3, abs=1e-9)


def test_frames_without_noise_are_not_repeated_frames() -> None:
    """Dark or saturated frames may equal their predecessors."""
    even = [replace(f, pixels=np.full((8, 8), 255, np.uint8)) for f in stamped(np.arange(30) * 1e-3)]
    assert [f.index for f in timed(even)] == list(range(30))


def test_frames_are_held_until_the_rate_is_known() -> None:
    clock, frames = CameraClock(), stamped(np.arange(FIRST) * 1e-3)
    assert timed(frames[:-1], clock) == []
    assert clock.period_s == 0
    assert len(timed(frames[-1:], clock)) == FIRST
    assert clock.period_s == pytest.approx(1e-3)
    # a single frame has no period
    for count, flushed, period_s in ((5, 5, 1e-3), (1, 0, 0)):
        short = CameraClock()
        timed(frames[:count], short)
        assert [f.index for f in short.flush()] == list(range(flushed))
        assert short.period_s == pytest.approx(period_s)


@pytest.mark.parametrize("fps", [979.0, 1021.0, 2000.0])
def test_synchronous_clock_refuses_another_rate(fps: float) -> None:
    with pytest.raises(HeliographError, match=rf"has {fps:.1f} frames/s.*--fps"):
        timed(stamped(np.arange(40) / fps), SynchronousClock(1e-3))


def test_short_film_is_checked_at_its_end() -> None:
    clock = SynchronousClock(1e-3)
    timed(stamped([0.0, 2e-3, 4e-3]), clock)
    with pytest.raises(HeliographError, match=r"500\.0 frames/s"):
        list(clock.flush())


def late(by_s: float, count: int) -> NDArray[np.float64]:
    return np.asarray(1e-3 * np.arange(40) + np.repeat([0, by_s, 0], [20, count, 20 - count]))


@pytest.mark.parametrize(("times_s", "numbers"), [
    *((np.array([0, 1, 2, 7, 8]) / fps, [0, 1, 2, 7, 8]) for fps in (981.0, 1019.0)),
    # a timestamp is early or late, or frames are missing although numbers run on
    (late(0.4e-3, 1), None), (late(-0.4e-3, 1), None), (late(1e-3, 20), None), (late(5e-3, 20), None),
    # frames at 0.5, 1.5, 2.5 ms get numbers 0, 2, 3 if 0.5 rounds down
    ((np.arange(20) + 0.5) * 1e-3, [0, *range(2, 21)]),
])  # fmt: skip
def test_synchronous_frames_pass_unchanged(times_s: NDArray[np.float64], numbers: list[int] | None) -> None:
    clock, frames = SynchronousClock(1e-3), stamped(times_s, numbers)
    assert [*timed(frames, clock), *clock.flush()] == frames


@pytest.mark.parametrize("pause", [3.5, 10.5, 7000.4])
@pytest.mark.parametrize("at", [3, 8, 20, 200])
def test_camera_may_resume_at_any_phase_after_a_pause(pause: float, at: int) -> None:
    stamps, clock = 1e-3 * (np.arange(300) + pause * (np.arange(300) >= at)), CameraClock()
    frames = stamped(stamps)
    assert times_of(timed(frames, clock)) == pytest.approx(stamps, abs=0.05e-3)
    assert clock.period_s == pytest.approx(1e-3, rel=1e-4)
    assert timed(frames, SynchronousClock(1e-3)) == frames


def test_pauses_between_all_first_frames_leave_a_period() -> None:
    clock = CameraClock()
    timed(stamped(np.cumsum(0.01 * 3.0 ** np.arange(FIRST))), clock)
    assert clock.period_s > 0


REUSED: dict[str, Callable[[Pixels], Any]] = {
    "writable": lambda pixels: pixels,
    "flipped": lambda pixels: pixels[::-1],
    "columns first": np.asfortranarray,
    "colour channel": lambda pixels: np.stack([pixels] * 3, 2)[..., 1],
    "masked array": np.ma.masked_array,
    "read-only view": lambda pixels: np.broadcast_to(pixels, pixels.shape),
}


@pytest.mark.parametrize("kind", REUSED)
def test_pixels_that_the_caller_may_reuse_are_copied(kind: str) -> None:
    pixels = REUSED[kind](np.arange(12, dtype=np.uint8).reshape(3, 4))
    kept = owned(Frame(0, 0.0, pixels)).pixels
    assert np.array_equal(kept, pixels)
    assert (np.shares_memory(kept, pixels), kept.flags.c_contiguous, kept.flags.writeable) == (False, True, False)


def test_read_only_pixels_are_kept() -> None:
    pixels = np.zeros((3, 4), np.uint8)
    pixels.setflags(write=False)
    assert owned(Frame(0, 0.0, pixels)).pixels is pixels
