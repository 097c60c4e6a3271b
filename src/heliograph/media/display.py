"""The way up of a video's pictures: phones and cameras note it, and leave the pixels as the sensor gave them."""

import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from heliograph.base.frames import Pixels

if TYPE_CHECKING:
    import av

_MATRIX = struct.Struct("<9i")
"""A display matrix, FFmpeg's AV_FRAME_DATA_DISPLAYMATRIX: (x, y, 1) times it is the place on the display, y down."""


@dataclass(frozen=True, slots=True)
class Orientation:
    """How pictures are put upright: rows and columns changed about first, then turned back to front."""

    # Whether rows become columns
    transposed: bool = False
    # rows_back, columns_back: whether rows, and columns, then run the other way
    rows_back: bool = False
    columns_back: bool = False

    def upright(self, pixels: Pixels) -> Pixels:
        """Return a picture the right way up."""
        turned: Any = pixels.T if self.transposed else pixels
        turned = turned[:: -1 if self.rows_back else 1, :: -1 if self.columns_back else 1]
        upright: Pixels = np.ascontiguousarray(turned)
        return upright

    def size(self, width: int, height: int) -> tuple[int, int]:
        """Return columns and rows of an upright picture."""
        return (height, width) if self.transposed else (width, height)


def orientation(picture: "av.VideoFrame") -> Orientation:
    """Return how a picture is put upright; turns by other angles than quarters are left as they are."""
    from av.sidedata.sidedata import Type

    held: Any = picture.side_data
    note = held.get(Type.DISPLAYMATRIX)
    if note is None or len(bytes(note)) < _MATRIX.size:
        return Orientation()
    # x' = a x + c y, y' = b x + d y
    a, b, _, c, d, *_ = _MATRIX.unpack_from(bytes(note))
    if not b and not c:
        return Orientation(rows_back=d < 0, columns_back=a < 0)
    return Orientation(True, rows_back=b < 0, columns_back=c < 0) if not a and not d else Orientation()
