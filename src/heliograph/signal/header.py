"""Packet header: an M-sequence on 4 x 4 cells, large enough to survive blur at long distance (section 4).

15 chips fill the cells along a boustrophedon path (left to right, then right to left, ...); the 16th cell is dark.
8 chips are 1, so half of the array is lit, and pattern and inverse have equal means. On this path, a shift by a cell
differs from the next sequence phase, which separates identities if the position is unknown.
"""

import numpy as np
from numpy.typing import NDArray

from heliograph.signal.formats import ALL_MODES, DIMMED, words
from heliograph.signal.m_sequence import HEADER_POLYNOMIALS, m_sequence
from heliograph.signal.pwm import SLOTS

CELLS = 4  # header cells per row and column (section 4)
CHIPS = CELLS * CELLS - 1  # chips in the header M-sequence: a period at degree 4. The last cell is dark
IDENTITIES = CHIPS * len(HEADER_POLYNOMIALS)  # number of identities: 15 cyclic phases for each of two polynomials


def identity(number: int) -> tuple[int, int]:
    """Return the polynomial and the cyclic advance in chips, 0 to 14, for an identity number I = 15 q + s."""
    return HEADER_POLYNOMIALS[number // CHIPS], number % CHIPS


def header_cells(number: int) -> NDArray[np.int8]:
    """Return the header cells, (4, 4) int8: +1 lit, -1 dark. The sum is 0."""
    polynomial, phase = identity(number)
    cells = np.append(np.roll(m_sequence(polynomial), -phase), 0).reshape(CELLS, CELLS)
    cells[1::2] = cells[1::2, ::-1]  # odd rows run from right to left
    return 2 * cells.astype(np.int8) - 1


def header_levels(number: int, side: int = 16) -> NDArray[np.uint8]:
    """Return the header pattern, (side, side) uint8: level 4 in lit cells, 0 in dark cells."""
    return SLOTS * _enlarge(header_cells(number) > 0, side).astype(np.uint8)


def signalling_levels(number: int, form: int, side: int = 16) -> NDArray[np.uint8]:
    """Return the pattern for later header pairs, (side, side) uint8: 4 and 0, in dimmed cells 3 and 1 (section 4.1)."""
    lit = header_levels(number, side).astype(np.float64) - SLOTS // 2
    return (SLOTS // 2 + lit * np.where(dimmed_leds(form, side), DIMMED, 1.0)).astype(np.uint8)


def dimmed_leds(form: int, side: int = 16) -> NDArray[np.bool_]:
    """Return a (side, side) mask: True for LEDs with half contrast in later header pairs (section 4.1)."""
    return _enlarge(words(ALL_MODES)[form].reshape(CELLS, CELLS) > 0, side)


def _enlarge(cells: NDArray[np.bool_], side: int) -> NDArray[np.bool_]:
    """Repeat header cells for the LEDs of an array, (side, side)."""
    return cells.repeat(side // CELLS, 0).repeat(side // CELLS, 1)


def all_header_cells() -> NDArray[np.int8]:
    """Return the header cells for all identities, (30, 4, 4) int8: +1 lit, -1 dark."""
    return np.stack([header_cells(i) for i in range(IDENTITIES)])
