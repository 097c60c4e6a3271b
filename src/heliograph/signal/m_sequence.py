"""Maximum length sequences (M-sequences) from a linear feedback shift register."""

import numpy as np
from numpy.typing import NDArray

HEADER_POLYNOMIALS = (0b11001, 0b10011)
"""Primitive polynomials at degree 4: x^4 + x^3 + 1 (Nagura et al. 2010, section IV.A) and the reciprocal.

These are all; another degree needs another number of cells in header, formats and detection.
"""

WHITENING_POLYNOMIAL = 0b1100_0000_0000_0001  # primitive polynomial x^15 + x^14 + 1


def m_sequence(polynomial: int, state: int = 1) -> NDArray[np.uint8]:
    """Return a period of the M-sequence for a primitive polynomial, (2**m - 1,) uint8 chips 0 and 1.

    The register obeys a[k + m] = sum_i c_i a[k + i] (mod 2) for f(x) = x^m + ... + c_1 x + c_0. Bit i in `polynomial`
    is c_i, and bit k in `state`, above 0, is chip k for k < m.
    """
    m = polynomial.bit_length() - 1
    period = (1 << m) - 1
    taps, register = polynomial & period, state
    chips = np.empty(period, dtype=np.uint8)
    for k in range(period):
        chips[k] = register & 1
        # a[k + m] = sum_i c_i a[k + i]
        register = register >> 1 | (taps & register).bit_count() % 2 << m - 1
    return chips


def periodic_correlation(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> NDArray[np.int64]:
    """Return sum_k a_k b_{(k + s) mod n} for s = 0 to n - 1, int64, with bit 0 as +1 and bit 1 as -1."""
    x, y = 1 - 2 * a.astype(np.int64), 1 - 2 * b.astype(np.int64)
    return np.array([int(x @ np.roll(y, -s)) for s in range(len(y))])
