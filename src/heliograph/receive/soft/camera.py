"""The camera's own clock: even times for frames whose stamps jitter, and frames that came twice left out."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from heliograph.base.errors import HeliographError
from heliograph.base.frames import Frame

FIRST = 16
"""Frames by which the camera's rate is first found."""

JITTER = 0.05
"""Rms error of a time stamp that is allowed for, as a share of the frame period."""

WANDER = 1e-5
"""Random walk of the frame period from frame to frame, as a share of it: some hundreds of frames are remembered."""

MISSING = 0.75
"""Frame periods by which a stamp must be late for a frame to be missing before it."""


class CameraClock:
    """Gives frames the times of an even camera.

    Stamps are taken as inexact readings of a clock that ticks once a frame: a Kalman filter of time and period, whose
    steps are one frame or, where a stamp is late by more than `MISSING` periods, as many as were dropped.

    Attributes
    ----------
    period_s
        Time from frame to frame, 0 until it is known.
    """

    def __init__(self) -> None:
        self.period_s = 0.0
        self._time_s = 0.0
        # variances of time and period and their covariance, in frame periods
        self._spread = np.zeros((2, 2))
        self._held: list[Frame] = []
        self._last: Frame | None = None

    def push(self, frame: Frame) -> Iterator[Frame]:
        """Take a frame; yield those whose times are known by now.

        Raises
        ------
        HeliographError
            The frame comes before the last one.
        """
        last, self._last = self._last, frame
        if last is not None:
            if _copied(last, frame):
                return
            if frame.time_s <= last.time_s:
                self._last = last
                raise HeliographError(
                    f"frames must follow in time: frame {frame.index} at {frame.time_s:.6f} s came after "
                    f"frame {last.index} at {last.time_s:.6f} s"
                )
        if self.period_s:
            yield self._timed(frame)
            return
        self._held.append(frame)
        if len(self._held) == FIRST:
            yield from self.flush()

    def flush(self) -> Iterator[Frame]:
        """Yield the frames held back, as there will be no more."""
        held, self._held = self._held, []
        if len(held) < 2:
            return
        times = np.array([f.time_s for f in held])
        gaps = np.diff(times)
        # the median passes over frames that were dropped; their numbers may run on all the same
        number = np.append(0.0, np.cumsum(np.maximum(np.round(gaps / np.median(gaps)), 1)))
        centred = number - number.mean()
        self.period_s = float(centred @ times / (centred @ centred))
        self._time_s = float(times.mean() + (number[0] - number.mean() - 1) * self.period_s)
        self._spread = np.diag([1.0, 12 / len(held) ** 2]) * JITTER**2
        for frame in held:
            yield self._timed(frame)

    def _timed(self, frame: Frame) -> Frame:
        """The frame with the time of the clock, which it corrects."""
        late = (frame.time_s - self._time_s) / self.period_s - 1
        steps = 1 + (round(late) if abs(late) >= MISSING else 0)
        move = np.array([[1.0, steps], [0.0, 1.0]])
        spread = move @ self._spread @ move.T + np.diag([0.0, WANDER**2 * max(steps, 0)])
        gain = spread[:, 0] / (spread[0, 0] + JITTER**2)
        error = (late + 1 - steps) * self.period_s
        self._time_s += steps * self.period_s + float(gain[0]) * error
        self.period_s += float(gain[1]) * error
        self._spread = spread - np.outer(gain, spread[0])
        return replace(frame, time_s=self._time_s)


def _copied(last: Frame, frame: Frame) -> bool:
    """Whether a frame has the very pixels of the one before: noise makes no two alike."""
    a, b = last.pixels, frame.pixels
    if a.shape != b.shape or last.origin != frame.origin or a.dtype != b.dtype:
        return False
    return bool(np.array_equal(a[::16], b[::16]) and np.array_equal(a, b) and a.min() != a.max())
