"""A camera frame: pixels, when they were exposed, and where they lie on the sensor."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Pixels = NDArray[np.uint8] | NDArray[np.uint16]


@dataclass(frozen=True, slots=True)
class Frame:
    """One camera frame, or a window of it.

    Attributes
    ----------
    index
        Number of the frame in the film, from 0; a dropped frame leaves a gap.
    time_s
        Start of the exposure in seconds.
    pixels
        Gray levels, shape (rows, columns), uint8 (8 bit) or uint16 (9 to 16 bit), [row, column].
    bits
        Bits of a gray level; full scale is ``2**bits - 1``.
    origin
        (x, y) on the sensor of ``pixels[0, 0]``; (0, 0) for a whole frame, else the window's corner.
    """

    index: int
    time_s: float
    pixels: Pixels
    bits: int = 8
    origin: tuple[int, int] = (0, 0)

    @property
    def full_scale(self) -> int:
        """Largest gray level."""
        return (1 << self.bits) - 1
