"""What usually alternates where, against which a header stands out."""

import cv2
import numpy as np
from numpy.typing import NDArray

SURGE, OOK_SURGE = 1.4, 1.1
"""Least alternation of a block and those beside it, over what is usual there, of a header; and beside data of OOK.

Of patterns of data p, q and so on, 0 to 1, four frames show p + q - 1 where a search begins with a pattern, and
(4 - p - 6 q - r) / 4 where it begins with an inverse; a header shows -1 and 1, or 7/8 of that. In the mean that is 2.5
and 1.9 times as much as data of five even levels, and 2.0 and 1.2 times as much as data that are on or off. Of those
that are 0.4 patterns out of step it is 1.4 times with five levels; from there on `straddled` finds them.
"""

USUAL_WEIGHT = 1 / 8
"""Weight of a search in what is usual: eight of them count, a sixth of a packet of 100 patterns."""


class UsualAlternation:
    """How much alternates about each block, in the mean of the last searches.

    Parameters
    ----------
    modulation
        That of the data, "haar" or "ook".
    """

    def __init__(self, modulation: str):
        self._surge = OOK_SURGE if modulation == "ook" else SURGE
        self._mean, self._origin = np.zeros((0, 0), np.float32), (0, 0)

    def surges(self, change: NDArray[np.float32], origin: tuple[int, int]) -> NDArray[np.bool_]:
        """Take what alternates in the frames of a search; tell where that is as much more than usual as a header's.

        Parameters
        ----------
        change
            (blocks down, blocks across) gray levels of what alternates.
        origin
            (x, y) on the sensor of the first block.

        Returns
        -------
        (blocks down, blocks across); all of a place that is seen first.
        """
        around = np.asarray(cv2.blur(change, (3, 3)), np.float32)
        if (around.shape, origin) != (self._mean.shape, self._origin):
            self._mean, self._origin = around, origin
            return np.ones(around.shape, bool)
        surges = around > self._surge * self._mean
        self._mean = self._mean + np.float32(USUAL_WEIGHT) * (around - self._mean)
        return np.asarray(surges)
