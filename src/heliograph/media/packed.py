"""Gray levels of 10 and 12 bits that are packed without gaps, the upper bits first."""

import numpy as np
from numpy.typing import NDArray

_GROUPS = {10: (4, 5), 12: (2, 3)}
"""Levels of a group and its bytes, by the bits of a level: groups begin and end with a byte."""


def unpack(data: bytes | bytearray, bits: int) -> NDArray[np.uint16]:
    """Return gray levels as numbers of their own.

    Parameters
    ----------
    data
        Whole groups of bytes: 5 bytes hold four levels of 10 bits, 3 bytes two of 12.
    bits
        Bits of a gray level, 10 or 12.

    Returns
    -------
    (levels,) gray levels in the order of the file.
    """
    held, size = _GROUPS[bits]
    levels = np.empty((len(data) // size, held), np.uint16)
    for place in range(held):
        # each level lies within two neighbouring bytes, `bits - 8` bits further on than the level before
        words = np.ndarray((len(levels),), ">u2", data, place, (size,))
        levels[:, place] = (words >> (16 - bits - place * (bits - 8))) & ((1 << bits) - 1)
    return levels.ravel()


def packed_size(levels: int, bits: int) -> int:
    """Return the bytes that hold so many levels; their last group is filled up.

    Parameters
    ----------
    levels
        Number of gray levels, 0 or more.
    bits
        Bits of a gray level, 10 or 12.
    """
    held, size = _GROUPS[bits]
    return -(-levels // held) * size
