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
    chance = np.exp(_log_chances(mean).sum(-1))
    first = chance @ table
    return first.T.reshape(-1), np.maximum(chance @ table**2 - first**2, 0).T.reshape(-1)


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
    y, v = (a.reshape(4, -1).T[:, None, :] for a in (observed, variance))
    fit = -0.5 * (table - y) ** 2 / v
    prior = _log_chances(mean)
    known = mean.reshape(4, -1).T ** 2
    # part of the response's power that is products: 0 for the symbols themselves
    products = min(float((table**2).mean() / (table * VALUES).mean() ** 2) - 1, 1.0)
    out = np.empty((len(fit), 4))
    for i in range(4):
        # extrinsic: the symbol's own prior is left out
        others = prior.sum(-1) - prior[..., i]
        own, joint = _llr(fit[..., i] + others, i), _llr(fit.sum(-1) + others, i)
        trust = products + (1 - products) * np.delete(known, i, axis=1).prod(1)
        out[:, i] = own + trust * (joint - own)
    return out.T.reshape(-1)


def _llr(score: Floats, symbol: int) -> Floats:
    """LLRs (squares,) of a symbol by the log likelihoods (squares, 16) of all values."""
    plus, minus = (score[:, sign * VALUES[:, symbol] > 0] for sign in (1, -1))
    return np.asarray(np.logaddexp.reduce(plus, axis=-1) - np.logaddexp.reduce(minus, axis=-1))


def _log_chances(mean: Floats) -> Floats:
    """(squares, 16, 4) ln P of each symbol's part in each value of its square."""
    m = mean.reshape(4, -1).T[:, None, :]
    return np.asarray(np.log(np.maximum(0.5 * (1 + VALUES * m), TINY)))
