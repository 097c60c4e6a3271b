"""Headerless films: NumPy's .npy files of an array (frames, rows, columns), and advice on raw dumps."""

import warnings
from pathlib import Path
from tokenize import TokenError
from typing import Any

import numpy as np

from heliograph.base.errors import MediaError, brief
from heliograph.base.frames import BITS, Pixels
from heliograph.media.reader import Reading
from heliograph.media.stamps import BlockReader


class ArrayReader(BlockReader):
    """A film in an .npy file; see `FilmReader`. The format has no clock, so the rate is needed."""

    def __init__(self, path: Path, reading: Reading) -> None:
        super().__init__(path, reading)
        (frames, self.height, self.width), self._dtype, self._start = _header(path)
        self.bits = 8 * self._dtype.itemsize
        self._set_blocks(frames, self.width * self.height * self._dtype.itemsize)
        self._number_frames()

    def _levels(self, data: bytearray) -> Pixels:
        levels: Any = np.frombuffer(data, self._dtype).reshape(self.height, self.width)
        return levels.astype(self._dtype.newbyteorder("="), copy=False)


def _header(path: Path) -> tuple[tuple[int, int, int], np.dtype[np.uint8] | np.dtype[np.uint16], int]:
    """Return the shape and type of the array, and the place of the first number."""
    try:
        # NumPy warns about files of Python 2, which are films, and about old names of types, which are none
        with path.open("rb") as file, warnings.catch_warnings(action="ignore"):
            version = np.lib.format.read_magic(file)
            read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
            shape, by_columns, dtype = read(file)
            start = file.tell()
    except (ValueError, OSError, SyntaxError, TypeError, IndexError, RecursionError, MemoryError, TokenError) as error:
        raise MediaError(f"{path} is no array of NumPy, or damaged: save it by numpy.save ({brief(error)})") from None
    if len(shape) != 3 or min(shape) < 0 or dtype.newbyteorder("=") not in BITS:
        got = brief(f"{shape} of {dtype}")
        raise MediaError(f"{path} holds an array {got}: a film is (frames, rows, columns) of uint8 or uint16")
    if by_columns and sum(length > 1 for length in shape) > 1:
        raise MediaError(f"{path} is in Fortran's order: save numpy.ascontiguousarray of the array")
    frames, rows, columns = map(int, shape)  # a damaged length may be True
    return (frames, rows, columns), dtype, start


_GRAY_DUMPS = (
    ".raw", ".raw8", ".raw10", ".raw12", ".raw16", ".bin", ".dat", ".data", ".dump", ".gray", ".gray8", ".gray16",
    ".grey", ".y", ".y8", ".y10", ".y12", ".y16", ".mono8", ".mono16", ".bayer", ".rgb", ".bgr", ".img",
)  # fmt: skip
_YUV_DUMPS = (".yuv", ".i420", ".yv12", ".nv12", ".nv21", ".yuv420p")


def refuse_dump(path: Path) -> None:
    """Refuse a raw dump, a headerless file of levels, by the suffix."""
    suffix = path.suffix.lower()
    if suffix not in (*_GRAY_DUMPS, *_YUV_DUMPS):
        return
    # in YUV half a frame of colours follows the gray levels of each frame
    shape = "-1, ROWS, COLUMNS))" if suffix in _GRAY_DUMPS else "-1, ROWS * 3 // 2, COLUMNS)[:, :ROWS])"
    command = f"import numpy as n; n.save('{path.stem}.npy', n.fromfile('{path.name}', 'u1').reshape({shape}"
    cure = f"save it as .npy by python -c \"{command}\", with '<u2' in place of 'u1' for words of 16 bits"
    raise MediaError(f"{path} ({path.stat().st_size} bytes) has no known header with the size of its frames: {cure}")
