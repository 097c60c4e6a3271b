"""The camera's own clock: times of frames, even though stamps jitter, frames are missing or come twice."""

from collections.abc import Iterator
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import TINY
from heliograph.base.errors import HeliographError
from heliograph.base.frames import Frame, check_order

SAMPLED_ROWS = 16
"""Every so many rows of two frames are compared before all of them: nearly all frames differ there already."""

SAMPLED_PIXELS = 16
"""So many pixels in a row are compared before all else."""

FIRST_FRAMES = 16
"""Frames by which the camera's rate is first found: with a jitter of 5 % they give it to 0.3 %."""

JITTER = 0.05
"""Rms error of a time stamp that the filter expects, as a fraction of the frame period: 50 us at 1000 frames/s."""

WANDER = 1e-5
"""Random walk of the frame period from frame to frame, as a fraction of it.

The filter remembers some hundred frames.
"""

MISSING = 0.75
"""Frame periods by which a stamp must be late for a frame to be missing before it: 15 times the jitter expected."""

PAUSE_PERIODS, PAUSE_OFF = 16, 0.25
"""Frame periods from which on a gap is a pause of the camera, and the part of a period by which a shorter pause differs
from a whole number of periods: five times the jitter expected."""

ANY_PHASE = 1 / 12
"""Variance in squared frame periods of the phase at which a camera goes on after a pause: it is uniform."""

STEP_TOLERANCE = 0.02
"""Largest departure of the camera's rate from the light's, as a fraction, for frames to count as in step."""


SHORT = 0.7
"""Gaps below this fraction of the median are of one frame period where a quarter are: the median is then of two.

A jitter of 20 % leaves the lower quartile at 0.81 of the median; half of the median is 0.5.
"""


class FrameClock(Protocol):
    """Passes frames on with their times."""

    # Frame period in seconds; 0 until it is known
    period_s: float

    def push(self, frame: Frame) -> Iterator[Frame]:
        """Take the next frame; yield those whose times are known by now."""

    def flush(self) -> Iterator[Frame]:
        """Yield the frames held back, as there will be no more."""


class SteppedClock:
    """Clock of a camera that takes one frame per pattern; it passes frames on as they are and checks their rate.

    A frame with the very pixels of the one before is a copy and is left out.
    """

    def __init__(self, pattern_period_s: float):
        self.period_s = pattern_period_s
        self._last: Frame | None = None
        self._gaps: list[tuple[float, int]] = []

    def push(self, frame: Frame) -> Iterator[Frame]:
        """Check and pass on the next frame; see `FrameClock`."""
        if self._last is not None:
            if _copied(self._last, frame):
                return
            check_order(frame, self._last, by_index=True)
            self._gaps.append((frame.time_s - self._last.time_s, frame.index - self._last.index))
            if len(self._gaps) == FIRST_FRAMES:
                self._check_rate()
        self._last = frame
        yield frame

    def flush(self) -> Iterator[Frame]:
        """No frame is held back."""
        self._check_rate()
        yield from ()

    def _check_rate(self) -> None:
        """Compare the rate of the last frames with the light's; a late stamp or a missing frame says nothing of it."""
        taken, self._gaps = self._gaps, []
        # mostly each step is the light's, and no median is needed
        even = STEP_TOLERANCE * self.period_s
        if all(abs(gap - number * self.period_s) <= even * number for gap, number in taken):
            return
        gaps, numbers = np.array(taken).T
        # a number that was rounded up after one that was rounded down skips one: times alone count steps
        steps = np.maximum(np.round(gaps / frame_period(gaps / numbers)), 1)
        # after a pause a camera goes on at any phase
        period_s = float(gaps[steps == 1].mean())
        if abs(period_s - self.period_s) > STEP_TOLERANCE * self.period_s:
            # the soft receiver, too, needs a frame a pattern
            other = "use --receiver soft, " if period_s < self.period_s else ""
            rate = f"{1 / period_s:.1f}" if period_s < 1 else f"{1 / period_s:.2g}"
            raise HeliographError(
                f"the plain receiver needs one frame a pattern: the film has {rate} frames/s, the light "
                f"{1 / self.period_s:.1f} patterns/s; film at that rate, {other}give times in seconds, or say by --fps "
                f"what the camera did where the film misstates it"
            )


class CameraClock:
    """Clock of a camera of any rate, which gives frames even times.

    Stamps are inexact readings of a clock that ticks once per frame. A Kalman filter follows time and period. Its step
    is one frame or, where a stamp is late by more than `MISSING` periods, one more for each missing frame. A frame with
    the very pixels of the one before is a copy and is left out.
    """

    def __init__(self) -> None:
        self.period_s = 0.0
        self._time_s = 0.0
        # covariance of time and period, in frame periods: P_00, P_01, P_11
        self._covariance = 0.0, 0.0, 0.0
        self._held: list[Frame] = []
        self._last: Frame | None = None

    def push(self, frame: Frame) -> Iterator[Frame]:
        """Take the next frame; yield those whose times are known by now; see `FrameClock`."""
        if self._last is not None:
            if _copied(self._last, frame):
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
        """Yield the frames held back, as there will be no more."""
        held, self._held = self._held, []
        if len(held) < 2:
            return
        times = np.array([f.time_s for f in held])
        gaps = np.diff(times)
        # frames may be missing though their numbers run on
        periods = gaps / frame_period(gaps)
        steps = np.maximum(np.round(periods), 1)
        number = np.append(0.0, np.cumsum(steps))
        pause = (steps > PAUSE_PERIODS) | ((steps > 1) & (np.abs(periods - steps) > PAUSE_OFF))
        run = np.append(0, np.cumsum(pause))
        # least squares of time = time_0 + number * period, with a time_0 for each run between two pauses
        count = np.bincount(run)
        number_0, time_0 = (np.bincount(run, of) / count for of in (number, times))
        centred = number - number_0[run]
        slope = float(centred @ times / max(float(centred @ centred), TINY))
        self.period_s = slope if slope > 0 else frame_period(gaps)
        self._time_s = float(time_0[0] + (number[0] - number_0[0] - 1) * self.period_s)
        self._covariance = JITTER**2, 0.0, 12 / len(held) ** 2 * JITTER**2
        for frame in held:
            yield self._timed(frame)

    def _timed(self, frame: Frame) -> Frame:
        """Give a frame the time of the clock, and correct the clock by its stamp."""
        late = (frame.time_s - self._time_s) / self.period_s - 1
        steps = 1 + (round(late) if abs(late) >= MISSING else 0)
        # P = F P F^T + Q, F = ((1, steps), (0, 1)); two numbers need no arrays
        p00, p01, p11 = self._covariance
        p00, p01 = p00 + 2 * steps * p01 + steps**2 * p11, p01 + steps * p11
        p11 += WANDER**2 * max(steps, 0)
        if steps > PAUSE_PERIODS or (steps > 1 and abs(late + 1 - steps) > PAUSE_OFF):
            p00 += ANY_PHASE
        # K = P H^T / (H P H^T + R), P = (1 - K H) P
        k0, k1 = p00 / (p00 + JITTER**2), p01 / (p00 + JITTER**2)
        error = (late + 1 - steps) * self.period_s
        self._time_s += steps * self.period_s + k0 * error
        self.period_s += k1 * error
        self._covariance = p00 - k0 * p00, p01 - k0 * p01, p11 - k1 * p01
        return frame.at_time(self._time_s)


def frame_period(gaps: NDArray[np.float64]) -> float:
    """Frame period by the times between frames, of which up to three quarters may hold missing ones."""
    median = float(np.median(gaps))
    short = gaps[gaps < SHORT * median]
    return float(np.median(short)) if len(short) >= len(gaps) / 4 else median


def _copied(last: Frame, frame: Frame) -> bool:
    """Whether a frame has the very pixels of the one before; a camera's noise makes no two alike."""
    a, b = last.pixels, frame.pixels
    if a.shape != b.shape or last.origin != frame.origin or a.dtype != b.dtype:
        return False
    # some pixels tell nearly always, and some rows where these are dark
    place = len(a) // 2, slice(a.shape[1] // 2, a.shape[1] // 2 + SAMPLED_PIXELS)
    alike = a[place].tobytes() == b[place].tobytes() and np.array_equal(a[::SAMPLED_ROWS], b[::SAMPLED_ROWS])
    return bool(alike and np.array_equal(a, b) and a.min() != a.max())
