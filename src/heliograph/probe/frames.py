"""Time stamps of a film: frame rate and jitter, lost and repeated frames."""

from collections import Counter
from dataclasses import dataclass

import numpy as np

from heliograph.base.frames import Frame


@dataclass(frozen=True, slots=True)
class FrameTimes:
    """Time stamps of a film.

    Attributes
    ----------
    count
        Number of frames.
    claimed_hz
        Frames per second by the container, or by the caller.
    rate_hz
        Frames per second by the median step between stamps; `claimed_hz` if the film has fewer than two frames.
    jitter_s
        Robust RMS error of a stamp in seconds for an even camera clock.
    every
        Camera frames per film frame; above 1 if the recorder keeps every n-th frame.
    lost
        Missing frames, counted by gaps in the frame numbers.
    gaps
        Number of gaps.
    repeated
        Frames with exactly the pixels of their predecessor.
    """

    count: int
    claimed_hz: float
    rate_hz: float
    jitter_s: float
    every: int
    lost: int
    gaps: int
    repeated: int


class FrameWatch:
    """Incremental statistics of time stamps in bounded memory."""

    def __init__(self, claimed_hz: float):
        self._claimed_hz = claimed_hz
        self._steps_s: list[float] = []
        self._every = 1
        self._last: Frame | None = None
        self._numbers: Counter[int] = Counter()
        self._count = self._repeated = 0

    def add(self, frame: Frame) -> bool:
        """Add the next frame; return True if it repeats the previous frame."""
        last, self._last = self._last, frame
        self._count += 1
        if last is None:
            return False
        step = max(frame.index - last.index, 1)
        # memory bounds: 256 different steps, further ones count as 2; 4096 durations, then every second one is dropped
        self._numbers[step if step in self._numbers or len(self._numbers) < 256 else 2] += 1
        if self._count % self._every == 0:
            self._steps_s.append((frame.time_s - last.time_s) / step)
        if len(self._steps_s) > 4096:
            self._steps_s, self._every = self._steps_s[::2], 2 * self._every
        # every 16th row already differs in nearly all frames
        a, b = last.pixels, frame.pixels
        repeated = np.array_equal(a[::16], b[::16]) and np.array_equal(a, b)
        self._repeated += repeated
        return repeated

    def times(self) -> FrameTimes:
        """Summarise the frames so far."""
        every = min(self._numbers, default=1)
        # random losses leave mostly steps of 1; a recorder that keeps every n-th frame has no step of 1
        every = every if 2 * self._numbers[every] >= sum(self._numbers.values()) else 1
        gaps = {step: count for step, count in self._numbers.items() if step > every}
        steps_s = every * np.array(self._steps_s or [1 / self._claimed_hz])
        median_s = float(np.median(steps_s))
        # a step has the error of two stamps; the median magnitude of a normal error is 0.6745 standard deviations
        jitter_s = float(np.median(np.abs(steps_s - median_s))) / 0.6745 / 2**0.5
        lost = sum(count * (round(step / every) - 1) for step, count in gaps.items())
        rate_hz = 1 / median_s if median_s > 0 else self._claimed_hz
        return FrameTimes(
            self._count, self._claimed_hz, rate_hz, jitter_s, every, lost, sum(gaps.values()), self._repeated
        )
