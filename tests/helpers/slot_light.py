"""What slots of a pattern contain of its symbols, from the definitions of PWM and of the hierarchical code alone.

An LED of level k shows u_r = 1 where k > r, else 0, in the slot that is the r-th to be lit.
"""

from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.signal import haar, pwm

Floats = NDArray[np.float64]

VALUES = np.array([value[::-1] for value in product((1.0, -1.0), repeat=4)])
"""(16, 4) all values of the four symbols of 2 x 2 LEDs, D11, D12, D21 and D22; those of D11 alternate."""

MEAN_LIT = np.array([15, 11, 5, 1]) / 16
"""(4,) P(k > r) of random data: of 16 values of the symbols 1, 4, 6, 4 and 1 give an LED the levels 0 to 4."""

COVARIANCE = np.minimum.outer(MEAN_LIT, MEAN_LIT) - np.outer(MEAN_LIT, MEAN_LIT)
"""(4, 4) of the u_r: slots r and s are both lit where k is above the larger of the two."""

SLOPES = np.array([1, 3, 3, 1]) / 8
"""(4,) cov(u_r, k), as E[k; k > r] - 2 P(k > r) is (32 - 30, 28 - 22, 16 - 10, 4 - 2) / 16; the variance of k is 1."""


def symbols_of(d: NDArray[Any]) -> Floats:
    """A data matrix in the order of symbols: quarters D11, D12, D21, D22, row by row."""
    h = len(d) // 2
    return np.concatenate([d[:h, :h].ravel(), d[:h, h:].ravel(), d[h:, :h].ravel(), d[h:, h:].ravel()]).astype(float)


def observed(light: Floats) -> Floats:
    """Symbols in a difference of light, which is 2 x - 1 for the whole of a pattern less its inverse."""
    return symbols_of(haar.decode(2 * light))


def values_of(symbols: Floats) -> NDArray[np.intp]:
    """For each symbol the row of `VALUES` that its 2 x 2 LEDs have."""
    square = symbols.reshape(4, -1).T
    return np.tile((square[:, None] == VALUES).all(2).argmax(1), 4)


def light_about_mean(levels: NDArray[np.uint8], weights: Floats) -> Floats:
    """Light sum_r w_r (u_r - E u_r) of LEDs of levels (..., n, n); weights (4,)."""
    return np.asarray(np.tensordot(pwm.lit_slots(levels), weights, (-3, 0)) - weights @ MEAN_LIT)
