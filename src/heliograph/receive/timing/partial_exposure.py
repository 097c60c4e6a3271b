"""What an exposure of part of a pattern shows of the four symbols of a square of 2 x 2 LEDs.

PWM lights an LED of level k in the first k slots: slot j of a pattern shows on_j = 1 where k > j, else 0, and slot j of
the inverse shows 1 - on_(3 - j). Only the sum of all four on_j is the level, which is linear in the symbols. Any other
sum of lambda_j on_j is a function of the square's four symbols that holds products of symbols. The four symbols have 16
values in all, few enough to list the *response* to each.
"""

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import TINY, Floats
from heliograph.signal.pwm import SLOTS

SIGNS = np.array([[1, 1, 1, 1], [1, -1, 1, -1], [1, 1, -1, -1], [1, -1, -1, 1]], np.float64)
"""The Haar transform of a square: LEDs (0, 0), (0, 1), (1, 0), (1, 1) by symbols of D11, D12, D21, D22."""

VALUES = np.array([[1 - 2 * (k >> i & 1) for i in range(4)] for k in range(16)], np.float64)
"""(16, 4) all values of a square's symbols."""

# (4, 2, 8) numbers of the values in which a symbol is +1, and of those in which it is -1
_SPLIT = np.array([[np.flatnonzero(VALUES[:, i] == sign) for sign in (1, -1)] for i in range(4)])

# level = 4 x = 2 + 1/2 H^T d H
_LEVELS = 2 + VALUES @ SIGNS / 2
_LIT = (_LEVELS[..., None] > np.arange(SLOTS)).astype(np.float64)

MEAN_LIT = _LIT.mean((0, 1))
"""(4,) E on_j of random data: 15, 11, 5 and 1 sixteenths."""

COVARIANCE = np.einsum("klr,kls->rs", _LIT - MEAN_LIT, _LIT - MEAN_LIT) / (16 * 4)
"""(4, 4) of the on_j of an LED."""

SLOPES = COVARIANCE.sum(0)
"""(4,) cov(on_j, level); as the level's variance is 1, also the slope of on_j over the level."""


def response(weights: Floats) -> Floats:
    """Observed symbols, by the 16 values of the true ones.

    They are the Haar transform of the light sum_j lambda_j on_j of each LED about its mean.

    Parameters
    ----------
    weights
        (4,) lambda_j; 1/2 each for the whole of a pattern less the whole of its inverse.

    Returns
    -------
    (16, 4); for weights 1/2 the true symbols themselves, `VALUES`.
    """
    return np.asarray(((_LIT - MEAN_LIT) @ weights) @ SIGNS.T)


def response_of_levels(weights: Floats, lit: NDArray[np.bool_]) -> Floats:
    """Observed symbols of LEDs that are lit through the whole pattern or not at all.

    Parameters
    ----------
    weights
        (4,) lambda_j, the weight of each slot, as of `response`.
    lit
        (n, n) LEDs that are lit.

    Returns
    -------
    (symbols,).
    """
    light = (lit[..., None] - MEAN_LIT) @ weights
    side = len(lit)
    squares = light.reshape(side // 2, 2, side // 2, 2).transpose(0, 2, 1, 3).reshape(-1, 4)
    return np.asarray((squares @ SIGNS.T).T.reshape(-1))


def moments(table: Floats, mean: Floats) -> tuple[Floats, Floats]:
    """Mean and variance of the observed symbols.

    Parameters
    ----------
    table
        (16, 4) their `response`.
    mean
        (symbols,) mean of the true ones, -1 to 1.

    Returns
    -------
    (symbols,) each.
    """
    chance = _chances(mean).prod(1)
    first = table.T @ chance
    return first.reshape(-1), np.maximum((table**2).T @ chance - first**2, 0).reshape(-1)


def symbol_llrs(table: Floats, observed: Floats, variance: Floats, mean: Floats) -> Floats:
    """Extrinsic LLRs ln P(c=+1)/P(c=-1) of the true symbols.

    An observed symbol depends on another one by the product of three. The equaliser's errors within a square are
    correlated, and so look like such products. What others say of a symbol therefore counts only as far as the other
    three symbols are known, or as the response is made of products rather than symbols.

    Parameters
    ----------
    table
        (16, 4) their `response` to all values of a square's symbols.
    observed
        (symbols,) estimates of the observed symbols.
    variance
        (symbols,) variances of these estimates, above 0.
    mean
        (symbols,) prior mean of the true symbols, -1 to 1.

    Returns
    -------
    (symbols,).
    """
    y, v = (a.reshape(4, 1, -1) for a in (observed, variance))
    fit = -0.5 * (table.T[..., None] - y) ** 2 / v
    prior = np.log(np.maximum(_chances(mean), TINY)).transpose(1, 0, 2)
    known = mean.reshape(4, -1) ** 2
    # part of the response's power that is products: 0 for the symbols themselves
    products = min(float((table**2).mean() / (table * VALUES).mean() ** 2) - 1, 1.0)
    # extrinsic: the symbol's own prior is left out
    others = prior.sum(0) - prior
    own, joint = _llrs(np.stack([fit + others, fit.sum(0) + others]))
    # of the three others of each
    first, last = known[0] * known[1], known[2] * known[3]
    three = np.stack([known[1] * last, known[0] * last, first * known[3], first * known[2]])
    trust = products + (1 - products) * three
    return np.asarray((own + trust * (joint - own)).reshape(-1))


def _llrs(scores: Floats) -> Floats:
    """LLRs (n, 4, squares) of each symbol by n times log likelihoods (n, 4, 16, squares) of all values."""
    split = scores[:, np.arange(4)[:, None, None], _SPLIT]
    most = split.max(-2, keepdims=True)
    plus, minus = np.moveaxis(np.log(np.exp(split - most).sum(-2)) + most[..., 0, :], 2, 0)
    return np.asarray(plus - minus)


def _chances(mean: Floats) -> Floats:
    """(16, 4, squares) chance of each symbol's part in each value of its square."""
    return np.asarray(0.5 * (1 + VALUES[..., None] * mean.reshape(4, -1)))
