"""The field GF(2^16) of x^16 + x^12 + x^3 + x + 1, by logarithms to the base x (section 8.1).

An element is a number of 16 bits, bit i for x^i. Sum and difference are exclusive or.
"""

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

POLYNOMIAL = 0b1_0001_0000_0000_1011
"""x^16 + x^12 + x^3 + x + 1 (section 8.1), primitive: the powers of x are all elements but 0."""

ORDER = (1 << 16) - 1
"""Elements but 0, and the exponent from which on the powers of x come again."""

ZERO = 2 * ORDER
"""Stands for the logarithm of 0: beyond the sum of any two others, so that a product with 0 is looked up as 0."""

Logs = NDArray[np.int32]
Words = NDArray[np.uint16]


@lru_cache(maxsize=1)
def _tables() -> tuple[Words, Logs]:
    """Powers of x by exponent, 0 from `ZERO` on; and the logarithm of each element."""
    powers = np.zeros(2 * ZERO + 1, np.uint16)
    logs = np.full(ORDER + 1, ZERO, np.int32)
    element = 1
    for exponent in range(ORDER):
        powers[exponent] = element
        logs[element] = exponent
        element <<= 1
        if element > ORDER:
            element ^= POLYNOMIAL
    powers[ORDER:ZERO] = powers[:ORDER]
    for table in (powers, logs):
        table.setflags(write=False)
    return powers, logs


def log(elements: NDArray[np.integer]) -> Logs:
    """Return logarithms to the base x; `ZERO` for 0.

    Parameters
    ----------
    elements
        (...) elements, 0 to 65535.
    """
    return _tables()[1][elements]


def power(exponents: NDArray[np.integer]) -> Words:
    """Return powers of x; 0 if a logarithm in the sum is that of 0.

    Parameters
    ----------
    exponents
        (...) sums of up to two logarithms: 0 to twice `ZERO`.
    """
    return _tables()[0][exponents]
