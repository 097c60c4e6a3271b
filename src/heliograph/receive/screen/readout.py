"""What is kept of an array: samples of its frames, with the way in which the camera reads its rows out."""

from collections import deque
from dataclasses import dataclass

import numpy as np

from heliograph.base.arrays import TINY, Floats
from heliograph.receive.screen.clock import Clock
from heliograph.receive.screen.follow import Sample
from heliograph.receive.screen.samples import Samples

FLICKER = 0.15
"""Part by which a frame's light differs from that of the frames around, from which it is the backlight's and not that
of the data: of 16 x 16 cells these differ by 0.03 rms, of 8 x 8 by 0.06."""


@dataclass(frozen=True)
class Readout:
    """The way in which a frame is read out, as pictures that are turned upright show it."""

    # 0 where columns are read one after the other, 1 where rows are
    axis: int
    # Whether the last one is read first
    back: bool
    # Columns or rows of a frame
    length: int

    def rows(self, at: Floats) -> Floats:
        """Return how many rows of the sensor are read before some places."""
        row = at[..., self.axis]
        return self.length - 1 - row if self.back else row


class Kept:
    """Samples of an array that are kept."""

    def __init__(self, shape: tuple[int, ...], frame_s: float):
        self.readouts = [Readout(axis, back, shape[1 - axis]) for axis in (1, 0) for back in (False, True)]
        self.readout = self.readouts[0]
        self.frame_s = frame_s
        self._samples: deque[Sample] = deque()

    def __len__(self) -> int:
        return len(self._samples)

    @property
    def first(self) -> Sample:
        """The first sample that is kept."""
        return self._samples[0]

    @property
    def last(self) -> Sample:
        """The last sample."""
        return self._samples[-1]

    def take(self, sample: Sample) -> None:
        """Keep a sample."""
        self._samples.append(sample)

    def drop_before(self, time_s: float) -> None:
        """Forget samples before a time, but for the last one."""
        while len(self._samples) > 1 and self._samples[0].time_s < time_s:
            self._samples.popleft()

    def between(self, start_s: float, end_s: float) -> list[Sample]:
        """Return the samples between two times."""
        return [one for one in self._samples if start_s <= one.time_s <= end_s]

    def gathered(self, start_s: float, end_s: float) -> Samples:
        """Return the light and the rows of cells between two times."""
        kept = self.between(start_s, end_s)
        return Samples(
            np.array([one.time_s for one in kept]),
            np.stack([self.readout.rows(one.at) for one in kept]),
            np.stack([one.seen.light for one in kept]),
            np.ones(len(kept)),
        )

    def evened(self, start_s: float, end_s: float, clock: Clock) -> Samples:
        """Return the same without the camera's gain, which is even over a pair."""
        samples = self.gathered(start_s, end_s)
        mean, t = samples.light.mean((1, 2)), samples.times_s
        near = np.clip(1.0 + 0.5 * self.frame_s / clock.period_s - np.abs(t[:, None] - t) / clock.period_s, 0, None)
        near = np.minimum(near, self.frame_s / clock.period_s)
        even = (near @ mean) / np.maximum(near.sum(1), TINY)
        # a backlight that is switched shows in single frames
        return samples.evened(np.where(np.abs(mean / np.maximum(even, TINY) - 1) > FLICKER, mean, even))
