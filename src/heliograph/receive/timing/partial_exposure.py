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

# (2, 4, 16) which values of a square have +1, and which have -1, of each symbol
_SPLIT = np.stack([VALUES.T > 0, VALUES.T < 0]).astype(np.float64)

LEAST_LIKELIHOOD = 1e-300
"""Least likelihood that is told from none: the LLR of two such is beyond `LARGEST_LLR` by far."""

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
    """
    return np.asarray(((_LIT - MEAN_LIT) @ weights) @ SIGNS.T)


def response_of_levels(weights: Floats, lit: NDArray[np.bool_]) -> Floats:
    """Observed symbols of LEDs that are lit through the whole pattern or not at all. Returns (symbols,)."""
    light = (lit[..., None] - MEAN_LIT) @ weights
    side = len(lit)
    squares = light.reshape(side // 2, 2, side // 2, 2).transpose(0, 2, 1, 3).reshape(-1, 4)
    return np.asarray((squares @ SIGNS.T).T.reshape(-1))


def moments(table: Floats, mean: Floats) -> tuple[Floats, Floats]:
    """Mean and variance of the observed symbols. Returns (..., symbols) each."""
    first, second = _moments(table, _chances(mean))
    return first, np.maximum(second - first**2, 0)


def posterior_moments(table: Floats, observed: Floats, variance: Floats, mean: Floats) -> tuple[Floats, Floats]:
    """Mean of the observed symbols and of their squares without the errors of estimates, once these are known."""
    # of known symbols too: what is observed may be out of all proportion to what they give
    chance = _joint(_fit(table, observed, variance)) * _chances(uncertain(mean))
    return _moments(table, chance / chance.sum(-2, keepdims=True))


def symbol_llrs(table: Floats, observed: Floats, variance: Floats, mean: Floats) -> Floats:
    """Extrinsic LLRs ln P(c=+1)/P(c=-1) of the true symbols.

    An observed symbol depends on another one by the product of three. The equaliser's errors within a square are
    correlated, and so look like such products. What others say of a symbol therefore counts only as far as the other
    three symbols are known, or as the response is made of products rather than symbols.
    """
    prior, squares = uncertain(mean), _by_kind(mean)
    chance, fit = _chances(prior), _fit(table, observed, variance)
    # extrinsic: the symbol's own prior is left out
    own_prior = 2 * np.arctanh(_by_kind(prior))
    joint = _llrs((_joint(fit) * chance)[..., None, :, :]) - own_prior
    # in place: new memory costs more than what is computed in it
    fit -= fit.max(-2, keepdims=True)
    fit = np.exp(fit, out=fit)
    fit *= chance[..., None, :, :]
    own = _llrs(fit) - own_prior
    # part of the response's power that is products: 0 for the symbols themselves
    linear = np.einsum("...ki,ki->...", table, VALUES) / VALUES.size
    products = np.minimum((table**2).mean((-2, -1)) / linear**2 - 1, 1.0)[..., None, None]
    # of the three others of each
    known = np.moveaxis(squares**2, -2, 0)
    first, last = known[0] * known[1], known[2] * known[3]
    three = np.stack([known[1] * last, known[0] * last, first * known[3], first * known[2]], -2)
    trust = products + (1 - products) * three
    return np.asarray((own + trust * (joint - own)).reshape(mean.shape))


def uncertain(mean: Floats) -> Floats:
    """Means of which none is certain, so that no value of a square is impossible."""
    return np.clip(mean, TINY - 1, 1 - TINY)


def _by_kind(symbols: Floats) -> Floats:
    """Symbols (..., symbols) as (..., 4, squares)."""
    return symbols.reshape(*symbols.shape[:-1], 4, -1)


def _moments(table: Floats, chance: Floats) -> tuple[Floats, Floats]:
    """Mean of the observed symbols and of their squares, (..., symbols), by the chance of each value."""
    responses = np.swapaxes(table, -2, -1)
    first, second = responses @ chance, responses**2 @ chance
    flat = *first.shape[:-2], -1
    return first.reshape(flat), second.reshape(flat)


def _fit(table: Floats, observed: Floats, variance: Floats) -> Floats:
    """(..., 4, 16, squares) log likelihood of each value of a square by each of its observed symbols."""
    error = np.swapaxes(table, -2, -1)[..., None] - _by_kind(observed)[..., None, :]
    error *= error
    error *= _by_kind(-0.5 / variance)[..., None, :]
    return np.asarray(error)


def _joint(fit: Floats) -> Floats:
    """(..., 16, squares) likelihood of each value by all observed symbols, at most 1."""
    together = fit.sum(-3)
    return np.asarray(np.exp(together - together.max(-2, keepdims=True)))


def _llrs(likelihood: Floats) -> Floats:
    """LLRs (..., 4, squares) of each symbol by likelihoods (..., 4 or 1, 16, squares) of all values."""
    plus, minus = (np.maximum((part[:, None, :] @ likelihood)[..., 0, :], LEAST_LIKELIHOOD) for part in _SPLIT)
    return np.asarray(np.log(plus) - np.log(minus))


def _chances(mean: Floats) -> Floats:
    """(..., 16, squares) chance of each value of a square."""
    symbols = _by_kind(mean)
    chance = np.ones((*symbols.shape[:-2], 1, symbols.shape[-1]))
    for i in range(4):
        # the next bit of a value's number: 0 for +1
        one = symbols[..., i : i + 1, :]
        chance = np.concatenate([chance * (0.5 + 0.5 * one), chance * (0.5 - 0.5 * one)], -2)
    return chance
