"""An array of a screen followed from frame to frame: what each frame shows of its cells."""

from dataclasses import dataclass

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.base.frames import Frame
from heliograph.receive.screen.grid import Look, Place, Seen, inside

LARGEST_MISFIT = 0.6
"""Largest part of a picture that cells may leave unexplained, by its rms. Chosen: 0.06 to 0.3 is seen of an array in its
place, 0.6 to 0.9 of one that is half a cell off."""

FORGOTTEN = 0.5
"""Part of a motion that is expected to go on from frame to frame. Chosen: sway goes on, tremor turns back."""


@dataclass(frozen=True)
class Sample:
    """What a frame shows of an array.

    Attributes
    ----------
    index
        Number of the frame.
    time_s
        Start of its first row's exposure by the camera's clock.
    rows
        (n, n) row of pixels of each cell.
    seen
        The cells' light, and their place.
    """

    index: int
    time_s: float
    rows: Floats
    seen: Seen


class Follower:
    """Follows an array.

    Parameters
    ----------
    look
        Finds cells in a frame.
    place
        Where the array is in the first frame.
    """

    def __init__(self, look: Look, place: Place):
        self._look, self.place = look, place
        n = look.side
        self._middles = np.stack(np.meshgrid(np.arange(n) + 0.5, np.arange(n) + 0.5), axis=-1)
        self._motion = np.zeros(2)
        self.lost_since: float | None = None

    def take(self, frame: Frame, steps: int = 4) -> Sample | None:
        """Find the array in the next frame; None where it is not seen.

        Parameters
        ----------
        frame
            The next frame.
        steps
            Most steps of its place.
        """
        expected = self.place.moved(FORGOTTEN * self._motion)
        seen = self._seen(frame, expected, steps)
        if seen is None:
            self._motion = np.zeros(2)
            if self.lost_since is None:
                self.lost_since = frame.time_s
            return None
        self.lost_since = None
        middle = np.array([self._look.side / 2] * 2)
        self._motion = seen.place.at(middle) - self.place.at(middle)
        self.place = seen.place
        return Sample(frame.index, frame.time_s, self.place.at(self._middles)[..., 1], seen)

    def _seen(self, frame: Frame, place: Place, steps: int) -> Seen | None:
        if not inside(place, self._look.side, frame.pixels.shape):
            return None
        seen = self._look(frame.pixels, place, steps)
        good = seen.misfit < LARGEST_MISFIT and inside(seen.place, self._look.side, frame.pixels.shape)
        return seen if good else None
