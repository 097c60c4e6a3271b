"""Camera clocks: frame times despite jitter of the time stamps, missing frames and repeated frames."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import TINY
from heliograph.base.errors import HeliographError
from heliograph.base.frames import Frame

STEP_TOLERANCE = 0.02  # maximum relative deviation of the frame rate from the pattern rate of a synchronous camera
FIRST_FRAMES = 16  # frames for the first estimate of the frame rate: 0.3 % at a jitter of 5 %


class SynchronousClock:
    """Clock of a synchronous camera: checks the frame rate and drops repeated frames."""

    def __init__(self, pattern_period_s: float):
        self.period_s = pattern_period_s
        self._last: Frame | None = None
        self._gaps: list[tuple[float, int]] = []

    def push(self, frame: Frame) -> Iterator[Frame]:
        """Check the next frame; yield the frame unless it repeats the last frame."""
        if self._last is not None:
            if _is_copy(self._last, frame):
                return
            check_order(frame, self._last, by_index=True)
            self._gaps.append((frame.time_s - self._last.time_s, frame.index - self._last.index))
            if len(self._gaps) == FIRST_FRAMES:
                self._check_rate()
        self._last = frame
        yield frame

    def flush(self) -> Iterator[Frame]:
        """Check the rate of the last frames; no frame is pending."""
        self._check_rate()
        yield from ()

    def _check_rate(self) -> None:
        """Compare the frame rate with the pattern rate; late stamps and missing frames are tolerated."""
        steps_taken, self._gaps = self._gaps, []
        # fast path: no median is needed if each step matches
        tolerance = STEP_TOLERANCE * self.period_s
        if all(abs(gap - number * self.period_s) <= tolerance * number for gap, number in steps_taken):
            return
        gaps, numbers = np.array(steps_taken).T
        # rounded frame numbers may skip a number: count steps by time
        steps = np.maximum(np.round(gaps / frame_period(gaps / numbers)), 1)
        # steps across a pause are excluded: the phase changes
        period_s = float(gaps[steps == 1].mean())
        if abs(period_s - self.period_s) > STEP_TOLERANCE * self.period_s:
            # the soft receiver needs at least a frame per pattern as well
            hint = "use --receiver soft, " if period_s < self.period_s else ""
            rate = f"{1 / period_s:.1f}" if period_s < 1 else f"{1 / period_s:.2g}"
            raise HeliographError(
                f"the plain receiver needs one frame per pattern: the film has {rate} frames/s, the light "
                f"{1 / self.period_s:.1f} patterns/s; record at that rate, {hint}give times in seconds, or pass the "
                f"camera's true rate with --fps"
            )


class CameraClock:
    """Clock of a camera of any rate: a Kalman filter of time and period that smooths the time stamps.

    A step covers the missing frames as well. Repeated frames are dropped.
    """

    def __init__(self) -> None:
        self.period_s = 0.0
        # of a time stamp in frame periods: an rms error of 5 %
        self._variance = 0.05**2
        self._time_s = 0.0
        # covariance of time and period, in frame periods: P_00, P_01, P_11
        self._covariance = 0.0, 0.0, 0.0
        self._held: list[Frame] = []
        self._last: Frame | None = None

    def push(self, frame: Frame) -> Iterator[Frame]:
        """Add the next frame; yield the frames with known times."""
        if self._last is not None:
            if _is_copy(self._last, frame):
                return
            check_order(frame, self._last)
        self._last = frame
        if self.period_s:
            yield self._timed(frame)
            return
        self._held.append(frame)
        if len(self._held) == FIRST_FRAMES:
            yield from self.flush()

    def flush(self) -> Iterator[Frame]:
        """Yield the pending frames at the end of the film."""
        held, self._held = self._held, []
        if len(held) < 2:
            return
        times = np.array([f.time_s for f in held])
        gaps = np.diff(times)
        # frames may be missing despite consecutive numbers
        periods = gaps / frame_period(gaps)
        steps = np.maximum(np.round(periods), 1)
        number = np.append(0.0, np.cumsum(steps))
        run = np.append(0, np.cumsum([_is_pause(*step) for step in zip(steps, periods - steps, strict=True)]))
        # least squares of time = time_0 + number * period, with a time_0 for each run between two pauses
        count = np.bincount(run)
        number_0, time_0 = (np.bincount(run, of) / count for of in (number, times))
        centred = number - number_0[run]
        slope = float(centred @ times / max(float(centred @ centred), TINY))
        self.period_s = slope if slope > 0 else frame_period(gaps)
        self._time_s = float(time_0[0] + (number[0] - number_0[0] - 1) * self.period_s)
        self._covariance = self._variance, 0.0, 12 / len(held) ** 2 * self._variance
        for frame in held:
            yield self._timed(frame)

    def _timed(self, frame: Frame) -> Frame:
        """Replace the time stamp of a frame by the clock time, and correct the clock by the stamp."""
        late = (frame.time_s - self._time_s) / self.period_s - 1
        # from 15 times the jitter on, frames are missing
        steps = 1 + (round(late) if abs(late) >= 0.75 else 0)
        # P = F P F^T + Q, F = ((1, steps), (0, 1)); two numbers need no arrays
        p00, p01, p11 = self._covariance
        p00, p01 = p00 + 2 * steps * p01 + steps**2 * p11, p01 + steps * p11
        # random walk of the period: the filter remembers some hundred frames
        p11 += 1e-10 * max(steps, 0)
        if _is_pause(steps, late + 1 - steps):
            p00 += 1 / 12  # uniform phase
        # K = P H^T / (H P H^T + R), P = (1 - K H) P
        k0, k1 = p00 / (p00 + self._variance), p01 / (p00 + self._variance)
        error = (late + 1 - steps) * self.period_s
        self._time_s += steps * self.period_s + k0 * error
        self.period_s += k1 * error
        self._covariance = p00 - k0 * p00, p01 - k0 * p01, p11 - k1 * p01
        return replace(frame, time_s=self._time_s)


FrameClock = SynchronousClock | CameraClock  # clock that passes frames on with exact times


def frame_period(gaps: NDArray[np.float64]) -> float:
    """Estimate the frame period from the times between frames, up to three quarters of which hold missing frames."""
    median = float(np.median(gaps))
    # the median may be two periods; a jitter of 20 % leaves the lower quartile of single periods at 0.81 of the median
    short = gaps[gaps < 0.7 * median]
    return float(np.median(short)) if len(short) >= len(gaps) / 4 else median


def _is_pause(steps: float, error: float) -> bool:
    """Return True if the camera paused: after a long gap, or a gap off a number of periods by five times the jitter."""
    return steps > 16 or (steps > 1 and abs(error) > 0.25)


def _is_copy(last: Frame, frame: Frame) -> bool:
    """Return True if a frame repeats all pixels of the last frame; noise makes two exposures differ."""
    a, b = last.pixels, frame.pixels
    if a.shape != b.shape or last.origin != frame.origin or a.dtype != b.dtype:
        return False
    # compare a few pixels, then a few rows, before all pixels
    place = len(a) // 2, slice(a.shape[1] // 2, a.shape[1] // 2 + 16)
    are_alike = a[place].tobytes() == b[place].tobytes() and np.array_equal(a[::16], b[::16])
    return bool(are_alike and np.array_equal(a, b) and a.min() != a.max())


def owned(frame: Frame) -> Frame:
    """Return the frame with pixels that the caller cannot fill again: a copy unless NumPy holds them, read-only."""
    flags = frame.pixels.flags
    if not (flags.owndata and flags.c_contiguous) or flags.writeable:
        frame = frame.copied()
        # Numba compiles loops for read-only pixels apart
        frame.pixels.setflags(write=False)
    return frame


def check_next(frame: Frame, last: Frame | None) -> None:
    """Raise a HeliographError unless this is a `Frame` with pixels, of the same camera as the last frame, if any."""
    if not isinstance(frame, Frame):
        raise HeliographError(
            f"a receiver takes heliograph.Frame, not {type(frame).__name__}; write Frame(index, time_s, pixels)"
        )
    if not frame.pixels.size:
        raise HeliographError(f"frame {frame.index} has no pixels: its shape is {frame.pixels.shape}; leave it out")
    if last is None:
        return
    if frame.bits != last.bits or frame.pixels.dtype != last.pixels.dtype:
        raise HeliographError(
            f"all frames have the same bits: frame {frame.index} has {frame.bits} ({frame.pixels.dtype}), the one "
            f"before {last.bits} ({last.pixels.dtype}); take a new receiver where the camera changes"
        )
    if frame.pixels.shape != last.pixels.shape and frame.origin == last.origin == (0, 0):
        sizes = " after ".join(f"{item.pixels.shape[1]}x{item.pixels.shape[0]}" for item in (frame, last))
        raise HeliographError(
            f"all whole frames have the same size: frame {frame.index} has {sizes} pixels; give windows their origin "
            f"on the sensor, or take a new receiver where the camera changes"
        )


def check_order(frame: Frame, last: Frame, by_index: bool = False) -> None:
    """Raise a HeliographError if a frame does not follow the last one in time, or in number where that counts."""
    if frame.time_s <= last.time_s or (by_index and frame.index <= last.index):
        raise HeliographError(
            f"frames must follow in time: frame {frame.index} at {frame.time_s:.6f} s came after "
            f"frame {last.index} at {last.time_s:.6f} s"
        )
