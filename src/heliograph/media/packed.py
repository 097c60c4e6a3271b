"""Gray levels of 10 and 12 bits that are packed: without gaps, or as cameras send them."""

import numpy as np
from numpy.typing import NDArray

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
