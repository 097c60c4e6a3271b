"""The packet header: an M-sequence on 4 x 4 cells, large enough to outlast the blur of a great distance (section 4).

15 chips fill the cells along a boustrophedon (left to right, then right to left, ...); the 16th cell is dark.
8 of the 15 chips are 1, so half of the array is lit, and pattern and inverse have the same mean. On this path a shift
by a cell is not the next phase of the sequence, which keeps identities apart if the position is unknown.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.signal.formats import ALL_MODES, DIMMED, words
from heliograph.signal.m_sequence import HEADER_POLYNOMIALS, m_sequence
from heliograph.signal.pwm import SLOTS

CELLS = 4
"""Cells in a row and in a column of the header (section 4)."""

CHIPS = CELLS * CELLS - 1
"""Chips of the header's M-sequence: a period of degree 4; the last cell is dark."""

IDENTITIES = CHIPS * len(HEADER_POLYNOMIALS)
"""Number of identities: 15 cyclic phases of two polynomials."""

PATH = np.arange(CELLS * CELLS).reshape(CELLS, CELLS)
PATH[1::2] = PATH[1::2, ::-1]
"""(4, 4) number of the chip in each cell, left to right in even rows and right to left in odd rows; 15 is dark."""

DEFAULT_SIDE = 16
"""LEDs in a row and in a column of the paper's array."""


@dataclass(frozen=True, slots=True)
class Identity:
    """Identity of an array: the polynomial of its M-sequence and the cyclic phase.

    Attributes
    ----------
    polynomial
        Coefficients as bits, bit i for x^i; one of `HEADER_POLYNOMIALS`.
    phase
        Chips by which the sequence is advanced, 0 to 14.
    """

    polynomial: int
    phase: int

    @property
    def number(self) -> int:
        """Number of the identity, I = 15 q + s: 15 times the polynomial's index plus the phase, 0 to 29."""
        return HEADER_POLYNOMIALS.index(self.polynomial) * CHIPS + self.phase


def identity(number: int) -> Identity:
    """Return the identity of a number.

    Parameters
    ----------
    number
        Number of the identity, 0 to 29.

    Raises
    ------
    ValueError
        The number is below 0 or above 29.
    """
    if not 0 <= number < IDENTITIES:
        raise ValueError(f"an identity is 0 to {IDENTITIES - 1}, not {number}")
    return Identity(HEADER_POLYNOMIALS[number // CHIPS], number % CHIPS)


def header_cells(number: int) -> NDArray[np.int8]:
    """Return the header cells of an identity, (4, 4) int8: +1 lit, -1 dark; their sum is 0.

    Parameters
    ----------
    number
        Number of the identity, 0 to 29.
    """
    who = identity(number)
    chips = np.roll(m_sequence(who.polynomial), -who.phase)
    cells = np.append(chips, 0)[PATH]
    return (2 * cells.astype(np.int8) - 1).astype(np.int8)


def header_levels(number: int, side: int = DEFAULT_SIDE) -> NDArray[np.uint8]:
    """Return the header pattern of an identity.

    Parameters
    ----------
    number
        Identity, 0 to 29.
    side
        LEDs in a row and in a column, a multiple of 4.

    Returns
    -------
    (side, side) uint8 levels: 4 in lit cells, 0 in dark cells.

    Raises
    ------
    ValueError
        The identity is unknown, or the side is no multiple of 4.
    """
    if side % CELLS:
        raise ValueError(f"the header needs a side that is a multiple of {CELLS}, not {side}")
    block = np.ones((side // CELLS, side // CELLS), dtype=np.uint8)
    return np.kron((header_cells(number) > 0).astype(np.uint8) * np.uint8(SLOTS), block).astype(np.uint8)


def signalling_levels(number: int, form: int, side: int = DEFAULT_SIDE) -> NDArray[np.uint8]:
    """Return the pattern of the later header pairs, which signal a format (section 4.1).

    Parameters
    ----------
    number
        Identity, 0 to 29.
    form
        Number of the format, 0 to 2047; 0 gives `header_levels`.
    side
        LEDs in a row and in a column, a multiple of 4.

    Returns
    -------
    (side, side) uint8 levels: 4 and 0, in dimmed cells 3 and 1.
    """
    lit = header_levels(number, side).astype(np.float64) - SLOTS // 2
    return (SLOTS // 2 + lit * np.where(dimmed_leds(form, side), DIMMED, 1.0)).astype(np.uint8)


def dimmed_leds(form: int, side: int = DEFAULT_SIDE) -> NDArray[np.bool_]:
    """Return which LEDs have half the contrast in the later header pairs, which signal a format (section 4.1).

    Parameters
    ----------
    form
        Number of the format, 0 to 2047.
    side
        LEDs in a row and in a column, a multiple of 4.

    Returns
    -------
    (side, side) bool.
    """
    block = np.ones((side // CELLS, side // CELLS), dtype=np.uint8)
    return np.kron(words(ALL_MODES)[form].reshape(CELLS, CELLS), block) > 0


def all_on_levels(side: int = DEFAULT_SIDE) -> NDArray[np.uint8]:
    """Return the header pattern of the mode "all on", for comparison: (side, side) uint8, every LED at level 4.

    Parameters
    ----------
    side
        LEDs in a row and in a column.
    """
    return np.full((side, side), SLOTS, dtype=np.uint8)


def all_header_cells() -> NDArray[np.int8]:
    """Return the header cells of all identities, (30, 4, 4) int8: +1 lit, -1 dark."""
    return np.stack([header_cells(i) for i in range(IDENTITIES)])
