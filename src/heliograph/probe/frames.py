"""The frames of a film as they are stamped: their rate, its jitter, frames that are lost or come twice."""

from collections import Counter
from dataclasses import dataclass

import numpy as np

from heliograph.base.frames import Frame

MOST_KINDS, MANY = 256, 2
"""Different steps between frames' numbers that are counted, and what further ones count as: so that memory is
bounded."""


@dataclass(frozen=True, slots=True)
class FrameTimes:
    """How a film's frames are stamped.

    Attributes
    ----------
    count
        Frames that were looked at.
    first_s, last_s
        Stamps of the first and of the last one in seconds.
    claimed_hz
        Frames per second as the film, or whoever opened it, says.
    rate_hz
        Frames per second by the median step between stamps; the claimed ones where there are fewer than two frames.
    jitter_s
        Rms error of a stamp in seconds, robust, if the camera itself is even.
    every
        How many of the camera's frames there are for each of the film: 1, or more where only every so many are kept.
    lost
        Frames that are missing by the gaps in their numbers.
    gaps
        Places where they are missing.
    repeated
        Frames with the very pixels of the one before.
    """

    count: int
    first_s: float
    last_s: float
    claimed_hz: float
    rate_hz: float
    jitter_s: float
    every: int
    lost: int
    gaps: int
    repeated: int


class FrameWatch:
    """Takes a film's frames one after the other, and keeps of them what their stamps say."""

    def __init__(self, claimed_hz: float):
        self._claimed_hz = claimed_hz
        self._steps: list[float] = []
        self._every = 1
        self._first: Frame | None = None
        self._last: Frame | None = None
        self._numbers: Counter[int] = Counter()
        self._count = self._repeated = 0

    def add(self, frame: Frame) -> bool:
        """Take the next frame."""
        last, self._last = self._last, frame
        self._count += 1
        if last is None:
            self._first = frame
            return False
        number = max(frame.index - last.index, 1)
        self._numbers[number if number in self._numbers or len(self._numbers) < MOST_KINDS else MANY] += 1
        if self._count % self._every == 0:
            self._steps.append((frame.time_s - last.time_s) / number)
        # Most steps between stamps that are kept: beyond it every second one is left out, so that memory is bounded. A
        # median of so many is right to 2 % of their spread
        if len(self._steps) > 4096:
            self._steps, self._every = self._steps[::2], 2 * self._every
        copied = same_pixels(last, frame)
        self._repeated += copied
        return copied

    def times(self) -> FrameTimes:
        """What the stamps of the frames so far say."""
        every = min(self._numbers, default=1)
        # where frames are lost at random most steps are of one; a camera that keeps every so many has no step of one
        every = every if 2 * self._numbers[every] >= sum(self._numbers.values()) else 1
        gaps = {step: many for step, many in self._numbers.items() if step > every}
        steps = every * np.array(self._steps or [1 / self._claimed_hz])
        middle = float(np.median(steps))
        # a step has the error of two stamps; the median magnitude of a normal error is 0.6745 of its deviation
        jitter_s = float(np.median(np.abs(steps - middle))) / 0.6745 / 2**0.5
        return FrameTimes(
            count=self._count,
            first_s=self._first.time_s if self._first else 0.0,
            last_s=self._last.time_s if self._last else 0.0,
            claimed_hz=self._claimed_hz,
            rate_hz=1 / middle if middle > 0 else self._claimed_hz,
            jitter_s=jitter_s,
            every=every,
            lost=sum(many * (round(step / every) - 1) for step, many in gaps.items()),
            gaps=sum(gaps.values()),
            repeated=self._repeated,
        )


def same_pixels(one: Frame, other: Frame) -> bool:
    """Whether two frames show the very same."""
    if one.pixels.shape != other.pixels.shape:
        return False
    # every so many rows of two frames are compared first: nearly all frames differ there already
    some = slice(None, None, 16)
    return bool(np.array_equal(one.pixels[some], other.pixels[some]) and np.array_equal(one.pixels, other.pixels))
