"""Symbol content of pattern slots, derived only from the definitions of PWM and the hierarchical code.

An LED with level k shows u_r = 1 if k > r, else 0, in the r-th slot to light up.
"""

from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import Floats
from heliograph.signal import haar, pwm

VALUES = np.array([value[::-1] for value in product((1.0, -1.0), repeat=4)])
"""(16, 4) all values of the four symbols D11, D12, D21 and D22 in a 2 x 2 square; D11 alternates."""

MEAN_LIT = np.array([15, 11, 5, 1]) / 16
"""(4,) P(k > r) for random data: 1, 4, 6, 4 and 1 of the 16 symbol values give levels 0 to 4."""

COVARIANCE = np.minimum.outer(MEAN_LIT, MEAN_LIT) - np.outer(MEAN_LIT, MEAN_LIT)
"""(4, 4) covariance of u_r; slots r and s are both lit if k exceeds the larger index."""

SLOPES = np.array([1, 3, 3, 1]) / 8
"""(4,) cov(u_r, k) = E[k; k > r] - 2 P(k > r) = (32 - 30, 28 - 22, 16 - 10, 4 - 2) / 16; var k = 1."""


def symbols_of(d: NDArray[Any]) -> Floats:
    """Return a data matrix in symbol order: quarters D11, D12, D21, D22, row by row."""
    h = len(d) // 2
    return np.concatenate([d[:h, :h].ravel(), d[:h, h:].ravel(), d[h:, :h].ravel(), d[h:, h:].ravel()]).astype(float)


def observed(light: Floats) -> Floats:
    """Return symbols from a light difference, which is 2 x - 1 for a pattern minus its inverse."""
    return symbols_of(haar.decode(2 * light))


def values_of(symbols: Floats) -> NDArray[np.intp]:
    """Return the row of `VALUES` for each symbol's 2 x 2 square."""
    square = symbols.reshape(4, -1).T
    return np.tile((square[:, None] == VALUES).all(2).argmax(1), 4)


def light_about_mean(levels: NDArray[np.uint8], weights: Floats) -> Floats:
    """Return light sum_r w_r (u_r - E u_r) for LED levels (..., n, n) and weights (4,)."""
    return np.asarray(np.tensordot(pwm.lit_slots(levels), weights, (-3, 0)) - weights @ MEAN_LIT)
