"""A camera frame: its pixels, the time of its exposure, and its place on the sensor."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Pixels = NDArray[np.uint8] | NDArray[np.uint16]
"""Gray levels, shape (rows, columns)."""


@dataclass(frozen=True, slots=True)
class Frame:
    """One camera frame, or a window of it.

    Attributes
    ----------
    index
        Number of the frame in the film, at least 0; a dropped frame leaves a gap.
    time_s
        Start of the exposure in seconds, by the camera's clock.
    pixels
        Gray levels from 0 to full scale, shape (rows, columns), uint8 (8 bit) or uint16 (9 to 16 bit).
    bits
        Bits of a gray level, 8 to 16; full scale is ``2**bits - 1``.
    origin
        (x, y) on the sensor of ``pixels[0, 0]`` in pixels; (0, 0) for a whole frame, else the window's corner.
    """

    index: int
    time_s: float
    pixels: Pixels
    bits: int = 8
    origin: tuple[int, int] = (0, 0)

    @property
    def full_scale(self) -> int:
        """Largest gray level, ``2**bits - 1``."""
        return (1 << self.bits) - 1
