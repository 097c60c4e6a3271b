"""Gray levels of 10 and 12 bits that are packed without gaps, the upper bits first."""

import numpy as np
from numpy.typing import NDArray

PACKED_BITS = (10, 12)
"""Bits of a gray level that `unpack` knows: Phantom cameras pack both, Photron cameras 12."""


def unpack(data: bytes, bits: int) -> NDArray[np.uint16]:
    """Return gray levels as numbers of their own.

    Parameters
    ----------
    data
        Whole groups of bytes: 5 bytes hold four levels of 10 bits, 3 bytes two of 12.
    bits
        Bits of a gray level, one of `PACKED_BITS`.

    Returns
    -------
    (levels,) gray levels in the order of the file.
    """
    if bits == 12:
        one, two, three = np.frombuffer(data, np.uint8).reshape(-1, 3).T.astype(np.uint16)
        return np.stack([one << 4 | two >> 4, (two & 0xF) << 8 | three], axis=1).ravel()
    a, b, c, d, e = np.frombuffer(data, np.uint8).reshape(-1, 5).T.astype(np.uint16)
    levels = [a << 2 | b >> 6, (b & 0x3F) << 4 | c >> 4, (c & 0xF) << 6 | d >> 2, (d & 0x3) << 8 | e]
    return np.stack(levels, axis=1).ravel()


def packed_size(levels: int, bits: int) -> int:
    """Return the bytes that hold so many levels; their last group is filled up.

    Parameters
    ----------
    levels
        Number of gray levels, 0 or more.
    bits
        Bits of a gray level, one of `PACKED_BITS`.
    """
    held, size = (4, 5) if bits == 10 else (2, 3)
    return -(-levels // held) * size
