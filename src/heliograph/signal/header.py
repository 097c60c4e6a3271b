"""The packet header: an M-sequence laid out on 4 x 4 cells, so large that blur leaves them from afar.

15 chips fill the cells along a boustrophedon (left to right, then right to left, ...), the 16th cell is dark.
8 chips of 15 are one, so half of the array is lit: pattern and inverse have the same mean. On this path a shift by
one cell is not the next phase of the sequence, which keeps identities apart when the position is unknown.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.signal.formats import DIMMED, words
from heliograph.signal.m_sequence import HEADER_POLYNOMIALS, m_sequence
from heliograph.signal.pwm import SLOTS

CELLS = 4
"""Cells in a row and in a column of the header."""

CHIPS = CELLS * CELLS - 1

IDENTITIES = CHIPS * len(HEADER_POLYNOMIALS)
"""Number of identities: 15 cyclic phases of two polynomials."""

PATH = np.arange(CELLS * CELLS).reshape(CELLS, CELLS)
PATH[1::2] = PATH[1::2, ::-1]


@dataclass(frozen=True, slots=True)
class Identity:
    """What tells an array from others: the polynomial of its M-sequence and the cyclic phase.

    Attributes
    ----------
    polynomial
        Coefficients as bits; one of `HEADER_POLYNOMIALS`.
    phase
        Chips by which the sequence is advanced, 0 to 14.
    """

    polynomial: int
    phase: int

    @property
    def number(self) -> int:
        """15 times the index of the polynomial plus the phase: 0 to 29."""
        return HEADER_POLYNOMIALS.index(self.polynomial) * CHIPS + self.phase


def identity(number: int) -> Identity:
    """Identity of a number 0 to 29."""
    if not 0 <= number < IDENTITIES:
        raise ValueError(f"an identity is 0 to {IDENTITIES - 1}, not {number}")
    return Identity(HEADER_POLYNOMIALS[number // CHIPS], number % CHIPS)


def header_cells(number: int) -> NDArray[np.int8]:
    """Cells of an identity's header, (4, 4) int8: +1 lit, -1 dark; their sum is 0."""
    who = identity(number)
    chips = np.roll(m_sequence(who.polynomial), -who.phase)
    cells = np.append(chips, 0)[PATH]
    return (2 * cells.astype(np.int8) - 1).astype(np.int8)


def header_levels(number: int, side: int = 16) -> NDArray[np.uint8]:
    """Header pattern of an identity, (side, side) uint8: level 4 or 0; side a multiple of 4."""
    if side % CELLS:
        raise ValueError(f"the header needs a side that is a multiple of {CELLS}, not {side}")
    block = np.ones((side // CELLS, side // CELLS), dtype=np.uint8)
    return np.kron((header_cells(number) > 0).astype(np.uint8) * np.uint8(SLOTS), block).astype(np.uint8)


def named_levels(number: int, form: int, side: int = 16) -> NDArray[np.uint8]:
    """Pattern of the later header pairs, which name a format, (side, side) uint8: levels 4 and 0, or 3 and 1."""
    lit = header_levels(number, side).astype(np.float64) - SLOTS // 2
    return (SLOTS // 2 + lit * np.where(dimmed_leds(form, side), DIMMED, 1.0)).astype(np.uint8)


def dimmed_leds(form: int, side: int = 16) -> NDArray[np.bool_]:
    """Which LEDs are dimmed in the later header pairs, which name a format, (side, side)."""
    block = np.ones((side // CELLS, side // CELLS), dtype=np.uint8)
    return np.kron(words()[form].reshape(CELLS, CELLS), block) > 0


def all_on_levels(side: int = 16) -> NDArray[np.uint8]:
    """Header pattern without an identity, for comparison: (side, side) uint8, every LED at level 4."""
    return np.full((side, side), SLOTS, dtype=np.uint8)


def all_header_cells() -> NDArray[np.int8]:
    """Cells of all identities, (30, 4, 4) int8."""
    return np.stack([header_cells(i) for i in range(IDENTITIES)])
