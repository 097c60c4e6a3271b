"""Recordings with frame numbers but no times, and their packed gray levels of 10 and 12 bits."""

from abc import abstractmethod
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from heliograph.base.errors import MediaError
from heliograph.base.frames import Frame, Pixels
from heliograph.media.reader import FilmReader, checked_time

_GROUPS = {10: (4, 5), 12: (2, 3)}
"""Levels of a group and its bytes, by the bits of a level: groups begin and end with a byte."""


def unpack(data: bytes | bytearray, bits: int) -> NDArray[np.uint16]:
    """Return gray levels as numbers of their own. Returns (levels,) gray levels in the order of the file."""
    held, size = _GROUPS[bits]
    levels = np.empty((len(data) // size, held), np.uint16)
    for place in range(held):
        # each level lies within two neighbouring bytes, `bits - 8` bits further on than the level before
        words = np.ndarray((len(levels),), ">u2", data, place, (size,))
        levels[:, place] = (words >> (16 - bits - place * (bits - 8))) & ((1 << bits) - 1)
    return levels.ravel()


def packed_size(levels: int, bits: int) -> int:
    """Return the bytes that hold so many levels; their last group is filled up."""
    held, size = _GROUPS[bits]
    return -(-levels // held) * size


def unpack_low_first(data: NDArray[np.uint8], bits: int) -> NDArray[np.uint16]:
    """Return gray levels packed without gaps, the lower bits first, as cameras' formats that end in "p" have them."""
    held, size = _GROUPS[bits]
    groups = data[: len(data) // size * size].reshape(-1, size).astype(np.uint16)
    levels = np.empty((len(groups), held), np.uint16)
    for place in range(held):
        first, shift = divmod(place * bits, 8)
        levels[:, place] = (groups[:, first] >> shift | groups[:, first + 1] << (8 - shift)) & ((1 << bits) - 1)
    return levels.ravel()


def unpack_pairs(data: NDArray[np.uint8], bits: int) -> NDArray[np.uint16]:
    """Return gray levels of GigE Vision 1's packing: two upper bytes about one that holds the lower bits of both."""
    groups = data[: len(data) // 3 * 3].reshape(-1, 3).astype(np.uint16)
    lower = bits - 8
    levels = np.empty((len(groups), 2), np.uint16)
    levels[:, 0] = groups[:, 0] << lower | groups[:, 1] & ((1 << lower) - 1)
    levels[:, 1] = groups[:, 2] << lower | groups[:, 1] >> 4 & ((1 << lower) - 1)
    return levels.ravel()


class NumberedReader(FilmReader):
    """A recording whose frame of number k is taken at ``k / rate_hz``; see `FilmReader`."""

    def _frames(self) -> Iterator[Frame]:
        count = 0
        for number, pixels in self._pictures():
            time_s = checked_time(self.path, number / self.rate_hz, count)
            yield Frame(number, time_s, pixels, self.bits)
            count += 1
        if not count:
            raise MediaError(f"{self.path} holds no frames: record it again")

    @abstractmethod
    def _pictures(self) -> Iterator[tuple[int, Pixels]]:
        """Yield each frame's number, rising from 0, and its gray levels."""


def camera_rate(path: Path, rate_hz: float | None, said_hz: float | None = None) -> float:
    """Return the frames per second that a file says, else those that were asked for."""
    rate = said_hz or rate_hz
    if not rate:
        raise MediaError(
            f"{path} has no clock: say how many frames a second the camera took, by --fps (rate_hz; on page Watch "
            "Frames/s)"
        )
    return rate


def expected_frames(path: Path, claimed: int, frame_bytes: int) -> int:
    """Return how many frames are to be expected of a file: those it claims, but no more than it has room for."""
    return min(claimed, path.stat().st_size // frame_bytes)


def blocks(path: Path, places: Iterable[int], size: int) -> Iterator[bytearray]:
    """Yield the bytes of each frame of a file in a writable array, for which the kernels are compiled."""
    try:
        with path.open("rb") as file:
            length = path.stat().st_size
            for count, place in enumerate(places):
                if place + size > length:  # before memory is taken for it
                    raise MediaError(f"{path} ends in the middle, after {count} whole frames: copy it again")
                file.seek(place)
                block = bytearray(size)
                if file.readinto(block) < size:
                    raise MediaError(f"{path} became shorter, after {count} whole frames: copy it again")
                yield block
    except MediaError:
        raise
    except OSError as error:
        raise MediaError(f"cannot read {path}: {error.strerror}") from error
