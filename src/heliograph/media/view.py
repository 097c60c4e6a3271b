"""A film seen through a crop and a turn."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from numbers import Integral
from typing import Any

import numpy as np

from heliograph.base.errors import MediaError, shown
from heliograph.base.frames import Frame
from heliograph.media.reader import FilmReader

TURNS = (0, 90, 180, 270)
"""Degrees by which a film may be turned."""


@dataclass(frozen=True, slots=True, kw_only=True)
class View:
    """Part of a film's frames, and their turn.

    Attributes
    ----------
    crop
        (x, y, width, height) in pixels of the film; x and y count from 0 at its upper left corner. None for all.
    rotate
        Degrees clockwise by which the part is then turned, one of `TURNS`.

    Raises
    ------
    MediaError
        The crop is no four whole numbers, or is empty; or the turn is none of those.
    """

    crop: tuple[int, int, int, int] | None = None
    rotate: int = 0

    def __post_init__(self) -> None:
        if self.rotate not in TURNS:
            raise MediaError(f"a film is turned by 0, 90, 180 or 270 degrees clockwise, not by {shown(self.rotate)}")
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
        return self.crop is None and self.rotate == 0


class ViewReader(FilmReader):
    """A film seen through a crop and a turn; see `FilmReader`.

    Parameters
    ----------
    film
        The film, which is closed with this one.
    view
        Part of its frames, and their turn.

    Raises
    ------
    MediaError
        The crop reaches beyond the film's frames.
    """

    def __init__(self, film: FilmReader, view: View) -> None:
        super().__init__(film.path)
        x, y, width, height = view.crop or (0, 0, film.width, film.height)
        if x + width > film.width or y + height > film.height:
            raise MediaError(
                f"the crop {x},{y},{width},{height} reaches beyond the frames of {film.path}, which have "
                f"{film.width}x{film.height} pixels"
            )
        self._film, self._quarters = film, view.rotate // 90
        self._part = (slice(y, y + height), slice(x, x + width))
        self.width, self.height = (height, width) if self._quarters % 2 else (width, height)
        self.bits, self.claimed_hz = film.bits, film.rate_hz
        self.frame_count, self.metadata = film.frame_count, film.metadata

    def _frames(self) -> Iterator[Frame]:
        for frame in self._film:
            # NumPy turns against the clock
            part: Any = frame.pixels[self._part]
            yield replace(frame, pixels=np.ascontiguousarray(np.rot90(part, -self._quarters)))

    def close(self) -> None:
        """Close the film; may be called twice."""
        super().close()
        self._film.close()
