"""Read films that NumPy saved: .npy files of an array (frames, rows, columns)."""

import warnings
from collections.abc import Iterator
from pathlib import Path
from tokenize import TokenError
from typing import Any

import numpy as np

from heliograph.base.errors import MediaError, brief
from heliograph.base.frames import BITS, Pixels
from heliograph.media.numbered import NumberedReader, blocks, camera_rate, expected_frames
from heliograph.media.reader import Reading, checked_size

SUFFIXES = (".npy",)
"""Suffixes of arrays."""

SIGNATURE = b"\x93NUMPY"
"""First bytes of an .npy file, by its format specification."""

_BROKEN = (ValueError, OSError, SyntaxError, TypeError, IndexError, RecursionError, MemoryError, TokenError)
"""All that NumPy makes of a damaged header."""


class ArrayReader(NumberedReader):
    """A film in an .npy file; see `FilmReader`. It has no clock, so the rate is needed."""

    def __init__(self, path: Path, reading: Reading) -> None:
        super().__init__(path, reading.rate_hz)
        shape, self._dtype, self._start = _header(path)
        self._claimed, self.height, self.width = shape
        self.bits = 8 * self._dtype.itemsize
        checked_size(path, self.width, self.height)
        self._frame_bytes = self.width * self.height * self._dtype.itemsize
        self.frame_count = expected_frames(path, self._claimed, self._frame_bytes)
        self.claimed_hz = camera_rate(path, reading.rate_hz)
        self.metadata = {}

    def _pictures(self) -> Iterator[tuple[int, Pixels]]:
        places = (self._start + count * self._frame_bytes for count in range(self._claimed))
        for number, data in enumerate(blocks(self.path, places, self._frame_bytes)):
            levels: Any = np.frombuffer(data, self._dtype).reshape(self.height, self.width)
            yield number, levels.astype(self._dtype.newbyteorder("="), copy=False)


def _header(path: Path) -> tuple[tuple[int, int, int], np.dtype[np.uint8] | np.dtype[np.uint16], int]:
    """The array's shape and type, and where its numbers begin."""
    try:
        # it warns of files of Python 2, which it reads, and of old names of types, which are no film
        with path.open("rb") as file, warnings.catch_warnings(action="ignore"):
            version = np.lib.format.read_magic(file)
            read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
            shape, by_columns, dtype = read(file)
            start = file.tell()
    except _BROKEN as error:
        raise MediaError(
            f"{path} is no array of NumPy, or damaged: save it again by numpy.save ({brief(error)})"
        ) from None
    if len(shape) != 3 or min(shape) < 0 or dtype.newbyteorder("=") not in BITS:
        got = brief(f"{shape} of {dtype}")
        raise MediaError(
            f"{path} holds an array {got}: a film is (frames, rows, columns) of uint8 or uint16; reshape it, use astype"
        )
    if by_columns and sum(length > 1 for length in shape) > 1:
        raise MediaError(
            f"{path} is in Fortran's order, each frame all over the file: save numpy.ascontiguousarray of it"
        )
    frames, rows, columns = map(int, shape)  # a damaged length may be True
    return (frames, rows, columns), dtype, start
