"""Crop, binning and rotation of a film."""

from dataclasses import replace
from numbers import Integral
from typing import Any

import numpy as np

from heliograph.base.errors import MediaError, shown
from heliograph.base.frames import Pixels
from heliograph.media.reader import FilmReader, Frames


def check_view(crop: Any, binning: Any, rotate: Any) -> None:
    """Refuse an invalid crop, binning or rotation."""
    if rotate not in (0, 90, 180, 270):
        raise MediaError(f"a film is turned by 0, 90, 180 or 270 degrees clockwise, not by {shown(rotate)}")
    if not (isinstance(binning, Integral) and 1 <= int(binning) <= 16):
        text = shown(binning)
        raise MediaError(f"squares of 1 to 16 pixels a side are averaged, not of {text}: give 2 for a Bayer mosaic")
    if crop is None:
        return
    is_whole = isinstance(crop, (tuple, list)) and all(isinstance(side, Integral) and int(side) >= 0 for side in crop)
    if not is_whole or len(crop) != 4 or not crop[2] * crop[3]:
        raise MediaError(f"a crop is x, y, width and height in whole pixels, x and y from 0, not {shown(str(crop))}")


class ViewReader(FilmReader):
    """A film after crop, binning and rotation; see `FilmReader`, and `open_film` for the parameters."""

    def __init__(self, film: FilmReader, crop: tuple[int, int, int, int] | None, binning: int, rotate: int) -> None:
        super().__init__(film.path)
        x, y, width, height = crop or (0, 0, film.width, film.height)
        try:
            if x + width > film.width or y + height > film.height:
                place, size = f"{x},{y},{width},{height}", f"{film.width}x{film.height}"
                raise MediaError(f"the crop {place} reaches beyond the frames of {film.path}, which have {size} pixels")
            if min(width, height) < binning:
                size = f"{width}x{height} pixels"
                raise MediaError(f"{film.path} is seen in {size}, less than a square of {binning}: average fewer")
        except MediaError:
            film.close()
            raise
        self.film, self._binning, self._quarters = film, binning, rotate // 90
        width, height = width // binning, height // binning
        self._part = (slice(y, y + height * binning), slice(x, x + width * binning))
        self.width, self.height = (height, width) if self._quarters % 2 else (width, height)
        self.bits, self.claimed_hz = film.bits, film.rate_hz
        self.frame_count, self.metadata = film.frame_count, film.metadata

    def _frames(self) -> Frames:
        for frame in self.film:
            pixels: Any = _bin(frame.pixels[self._part], self._binning)
            # NumPy rotates counterclockwise
            yield replace(frame, pixels=np.ascontiguousarray(np.rot90(pixels, -self._quarters)))

    def close(self) -> None:
        """Close the film; may be called twice."""
        super().close()
        self.film.close()


def _bin(pixels: Any, side: int) -> Pixels:
    """Return the means of squares of pixels, rounded half up."""
    if side == 1:
        return pixels
    sums = np.zeros((pixels.shape[0] // side, pixels.shape[1] // side), np.uint32)
    for row in range(side):
        for column in range(side):
            sums += pixels[row::side, column::side]
    means: Any = (sums + side * side // 2) // (side * side)
    return means.astype(pixels.dtype)
