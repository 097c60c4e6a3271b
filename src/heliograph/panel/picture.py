"""What is taken for a frame: `heliograph.Frame`, or an array of gray levels or colours."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import Floats
from heliograph.base.errors import HeliographError
from heliograph.base.frames import Frame, check_unmasked

Levels = NDArray[np.float32]
"""Gray levels, (rows, columns), or (channels, rows, columns)."""

AnyFrame = Frame | NDArray[np.uint8] | NDArray[np.uint16] | NDArray[np.float32] | Floats
"""A frame: `heliograph.Frame`, or an array (rows, columns) or (rows, columns, 3)."""

COLOURS = 3
"""Channels of a frame in colour."""


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """A frame as it is computed with.

    Attributes
    ----------
    levels
        (channels, rows, columns) gray levels; one channel, or three.
    origin
        (x, y) on the sensor of the first pixel.
    """

    levels: Levels
    origin: tuple[int, int] = (0, 0)

    @property
    def gray(self) -> Levels:
        """(rows, columns) mean of the channels."""
        return self.levels[0] if len(self.levels) == 1 else np.asarray(self.levels.mean(axis=0))

    @property
    def corner(self) -> Floats:
        """Place (2,) of the first pixel on the sensor."""
        return np.array(self.origin, np.float64)


def picture_of(frame: object) -> Picture:
    """Take a frame."""
    if isinstance(frame, Frame):
        return Picture(_finite(frame.pixels[None]), frame.origin)
    if not isinstance(frame, np.ndarray):
        raise HeliographError(
            f"a frame is a heliograph.Frame or an array (rows, columns) or (rows, columns, 3), not "
            f"{type(frame).__name__}"
        )
    if frame.dtype.kind not in "uif" or not (frame.ndim == 2 or (frame.ndim == 3 and frame.shape[2] == COLOURS)):
        raise HeliographError(
            f"a frame's pixels are numbers of shape (rows, columns) or (rows, columns, 3), not {frame.dtype} of "
            f"{frame.shape}; give several frames as a list"
        )
    check_unmasked(frame)
    if not frame.size:
        raise HeliographError(f"a frame has no pixels: its shape is {frame.shape}; leave it out")
    return Picture(_finite(frame[None] if frame.ndim == 2 else np.moveaxis(frame, 2, 0)))


def _finite(levels: NDArray[np.number]) -> Levels:
    with np.errstate(over="ignore"):
        out = np.ascontiguousarray(levels, np.float32)
    if levels.dtype.kind == "f" and not np.isfinite(out).all():
        raise HeliographError("a frame has levels that are not finite; set them to 0 or leave the frame out")
    return out
