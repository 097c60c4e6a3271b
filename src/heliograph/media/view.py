"""A film seen through a crop, in squares of pixels, and turned."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from numbers import Integral
from typing import Any

import numpy as np

from heliograph.base.errors import MediaError, shown
from heliograph.base.frames import Frame, Pixels
from heliograph.media.reader import FilmReader

TURNS = (0, 90, 180, 270)
"""Degrees by which a film may be turned."""

MOST_BINNED = 16
"""Most pixels along a side of a square of which the mean is taken. Chosen: a Bayer mosaic needs 2."""


@dataclass(frozen=True, slots=True, kw_only=True)
class View:
    """Part of a film's frames, its squares as single pixels, and their turn."""

    # (x, y, width, height) in pixels of the film; x and y count from 0 at its upper left corner. None for all
    crop: tuple[int, int, int, int] | None = None
    # Pixels along a side of the squares that are then replaced by their mean, 1 to `MOST_BINNED`; 1 for none. What is
    # left over at the right and at the bottom is cut off
    binning: int = 1
    # Degrees clockwise by which the part is then turned, one of `TURNS`
    rotate: int = 0

    def __post_init__(self) -> None:
        if self.rotate not in TURNS:
            raise MediaError(f"a film is turned by 0, 90, 180 or 270 degrees clockwise, not by {shown(self.rotate)}")
        if not (isinstance(self.binning, Integral) and 1 <= self.binning <= MOST_BINNED):
            raise MediaError(
                f"squares of 1 to {MOST_BINNED} pixels a side are averaged, not of {shown(self.binning)}: give 2 for a "
                "Bayer mosaic"
            )
        if self.crop is None:
            return
        whole = isinstance(self.crop, (tuple, list)) and all(
            isinstance(number, Integral) and number >= 0 for number in self.crop
        )
        if not whole or len(self.crop) != 4 or not self.crop[2] * self.crop[3]:
            raise MediaError(
                f"a crop is x, y, width and height in whole pixels, x and y from 0, not {shown(str(self.crop))}"
            )

    @property
    def is_whole(self) -> bool:
        """Whether it shows the film as it is."""
        return self.crop is None and self.binning == 1 and self.rotate == 0


class ViewReader(FilmReader):
    """A film seen through a crop, in squares of pixels, and turned; see `FilmReader`."""

    def __init__(self, film: FilmReader, view: View) -> None:
        super().__init__(film.path)
        x, y, width, height = view.crop or (0, 0, film.width, film.height)
        if x + width > film.width or y + height > film.height:
            film.close()
            raise MediaError(
                f"the crop {x},{y},{width},{height} reaches beyond the frames of {film.path}, which have "
                f"{film.width}x{film.height} pixels"
            )
        if min(width, height) < view.binning:
            film.close()
            raise MediaError(
                f"{film.path} is seen in {width}x{height} pixels, less than a square of {view.binning}: average fewer"
            )
        self.film, self._binning, self._quarters = film, view.binning, view.rotate // 90
        width, height = width // view.binning, height // view.binning
        self._part = (slice(y, y + height * view.binning), slice(x, x + width * view.binning))
        self.width, self.height = (height, width) if self._quarters % 2 else (width, height)
        self.bits, self.claimed_hz = film.bits, film.rate_hz
        self.frame_count, self.metadata, self.faster = film.frame_count, film.metadata, film.faster

    def _frames(self) -> Iterator[Frame]:
        for frame in self.film:
            pixels: Any = _binned(frame.pixels[self._part], self._binning)
            # NumPy turns against the clock
            yield replace(frame, pixels=np.ascontiguousarray(np.rot90(pixels, -self._quarters)))

    def close(self) -> None:
        """Close the film; may be called twice."""
        super().close()
        self.film.close()


def _binned(pixels: Any, side: int) -> Pixels:
    """Means of the squares of so many pixels a side, rounded, halves up."""
    if side == 1:
        return pixels
    sums = np.zeros((pixels.shape[0] // side, pixels.shape[1] // side), np.uint32)
    for row in range(side):
        for column in range(side):
            sums += pixels[row::side, column::side]
    means: Any = (sums + side * side // 2) // (side * side)
    return means.astype(pixels.dtype)
