"""Layouts of a slot's bits as LED drivers take them: plain bit planes, HUB75 row scan, chains of shift registers."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

RGB = 0b111
"""An LED that is on is white on a panel of three colours: R, G and B. Who wants one colour masks the others out."""

LOWER = 3
"""Place of R2 in a byte of a row scan: R1, G1, B1, R2, G2, B2 are bits 0 to 5."""

Slot = NDArray[np.uint8]
"""(n, n) LEDs of a slot, 1 on and 0 off, row by row as the camera sees them."""


@dataclass(frozen=True)
class Layout:
    """How the LEDs of a slot lie in the bytes of a file."""

    # First 8 bytes of such a file; the last but one is the layout's version
    signature: bytes
    # Bytes of a slot by the LEDs of a side
    size: Callable[[int], int]
    # Bytes of a slot
    pack: Callable[[Slot], bytes]
    # The slot of such bytes and the LEDs of a side; a ValueError where no slot has them
    unpack: Callable[[bytes, int], Slot]


def _plane_size(side: int) -> int:
    return side * side // 8


def _plane(slot: Slot) -> bytes:
    return np.packbits(slot).tobytes()


def _from_plane(data: bytes, side: int) -> Slot:
    return np.unpackbits(np.frombuffer(data, np.uint8)).reshape(side, side)


def _chain(slot: Slot) -> bytes:
    # what is shifted in first ends at the far end of the chain
    return np.packbits(slot.ravel()[::-1]).tobytes()


def _from_chain(data: bytes, side: int) -> Slot:
    return np.unpackbits(np.frombuffer(data, np.uint8))[::-1].reshape(side, side).copy()


def _scan_size(side: int) -> int:
    return side // 2 * (1 + side)


def _scan(slot: Slot) -> bytes:
    half = len(slot) // 2
    out = np.empty((half, 1 + len(slot)), np.uint8)
    out[:, 0] = np.arange(half)
    out[:, 1:] = RGB * slot[:half] | RGB * slot[half:] << LOWER
    return out.tobytes()


def _from_scan(data: bytes, side: int) -> Slot:
    rows = np.frombuffer(data, np.uint8).reshape(side // 2, 1 + side)
    if (rows[:, 0] != np.arange(side // 2)).any():
        raise ValueError("its rows do not come in the order of their addresses")
    lit = np.concatenate([rows[:, 1:] & RGB, rows[:, 1:] >> LOWER])
    if not np.isin(lit, (0, RGB)).all():
        raise ValueError("R, G and B of an LED differ")
    return lit // RGB


LAYOUTS = {
    ".bits": Layout(b"HGBITS1\n", _plane_size, _plane, _from_plane),
    ".hub75": Layout(b"HGHUBS1\n", _scan_size, _scan, _from_scan),
    ".shift": Layout(b"HGSHFT1\n", _plane_size, _chain, _from_chain),
}
"""Layouts of binary files by suffix. A C header has the bytes of ".bits"."""
