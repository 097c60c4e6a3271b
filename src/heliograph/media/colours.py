"""Films in colour: red, green and blue together, each as `open_film` reads it."""

import os
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from heliograph.base.errors import MediaError
from heliograph.base.frames import Pixels
from heliograph.media.film import open_film
from heliograph.media.reader import FilmReader


class ColourFilm:
    """A film opened for reading in colour: iterate it for its frames; each iteration starts at the first frame.

    Memory does not grow with the film. Use it as a context manager, or call `close`.

    Parameters
    ----------
    films
        The film opened once for each of red, green and blue.

    Attributes
    ----------
    path
        The film's file, for error messages.
    width, height
        Columns and rows of a frame in pixels.
    bits
        Bits of a gray level, 8 to 16.
    rate_hz
        Frames per second of the camera.
    frame_count
        Expected frames, for a progress display; None if unknown.
    """

    def __init__(self, films: tuple[FilmReader, FilmReader, FilmReader]) -> None:
        self._films, first = films, films[0]
        self.path: Path = first.path
        self.width, self.height, self.bits = first.width, first.height, first.bits
        self.rate_hz, self.frame_count = first.rate_hz, first.frame_count

    def __iter__(self) -> Iterator[Pixels]:
        """Yield the frames in order of time.

        Yields
        ------
        Pixels
            (rows, columns, 3) uint8 for 8 bit, else uint16: red, green and blue.

        Raises
        ------
        MediaError
            The film is closed or damaged, as for `open_film`.
        """
        for frames in zip(*self._films, strict=True):
            pixels: Pixels = np.dstack([frame.pixels for frame in frames])  # type: ignore[assignment]
            yield pixels

    def close(self) -> None:
        """Close the film; may be called twice."""
        for film in self._films:
            film.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def open_colours(path: str | os.PathLike[str], **options: Any) -> ColourFilm:
    """Open a recording in colour, for panels with LEDs of several colours.

    The film is decoded once for each colour. In a gray film all three colours are the gray levels.

    Parameters
    ----------
    path
        The file, the folder of pictures, or their names with %d or %04d for a number.
    options
        Options of `open_film` except for the channel: rate_hz, crop, binning, rotate, expand_range.

    Returns
    -------
    ColourFilm
        A context manager and iterable of arrays (rows, columns, 3) of red, green and blue.

    Raises
    ------
    MediaError
        A channel is given, or the film cannot be read, as for `open_film`.
    """
    if "channel" in options:
        raise MediaError("a film in colour has all channels: leave channel out, or use open_film")
    red, green, blue = (open_film(path, channel=colour, **options) for colour in ("red", "green", "blue"))
    return ColourFilm((red, green, blue))
