"""What usually alternates where, against which a header stands out."""

import cv2
import numpy as np
from numpy.typing import NDArray

SURGE = 1.4
"""Least alternation of a block and those beside it, over what is usual there, of a header.

Of levels of data p and q, 0 to 1, four frames show p + q - 1. A header's -1 and 1 are 2.5 times as much in the mean.
In a camera that is 0.2 patterns out of step they are 2.4 times as much, and at 0.4 1.4 times. From there on `straddled`
finds it.
"""

USUAL_WEIGHT = 1 / 8
"""Weight of a search in what is usual: eight of them count, a sixth of a packet."""


class UsualAlternation:
    """How much alternates about each block, in the mean of the last searches."""

    def __init__(self) -> None:
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
        surges = around > SURGE * self._mean
        self._mean = self._mean + np.float32(USUAL_WEIGHT) * (around - self._mean)
        return np.asarray(surges)
