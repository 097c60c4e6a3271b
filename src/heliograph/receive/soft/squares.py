"""Squares of 2 x 2 LEDs, whose four levels carry four cells: what an exposure of part of a pattern sees of them.

PWM lights an LED of level k in the first k slots, so slot r of a pattern shows u_r = 1 where k > r, else 0, and slot r
of the inverse 1 - u_(3 - r). Only the sum of all four u_r is the level, in which the cells are linear; any other
combination, sum of w_r u_r, is a function of the four cells of the square with products of cells in it. All 16 values
of the four cells are few enough to be looked at one by one.
"""

import numpy as np
from numpy.typing import NDArray

from heliograph.signal.pwm import SLOTS

Floats = NDArray[np.float64]

SIGNS = np.array([[1, 1, 1, 1], [1, -1, 1, -1], [1, 1, -1, -1], [1, -1, -1, 1]], np.float64)
"""The Haar transform of a square: LEDs (0, 0), (0, 1), (1, 0), (1, 1) by cells of D11, D12, D21, D22."""

VALUES = np.array([[1 - 2 * (k >> i & 1) for i in range(4)] for k in range(16)], np.float64)
"""(16, 4) all values of a square's cells."""

# level = 4 x = 2 + 1/2 H^T d H
_LEVELS = 2 + VALUES @ SIGNS / 2
_LIT = (_LEVELS[..., None] > np.arange(SLOTS)).astype(np.float64)

MEAN_LIT = _LIT.mean((0, 1))
"""(4,) E u_r for random data."""

COVARIANCE = np.einsum("klr,kls->rs", _LIT - MEAN_LIT, _LIT - MEAN_LIT) / (16 * 4)
"""(4, 4) of the u_r of an LED."""

SLOPES = COVARIANCE.sum(0)
"""(4,) cov(u_r, level), which is also the slope of u_r over the level: its variance is 1."""


def seen(weights: Floats) -> Floats:
    """Cells as seen in the light sum of w_r u_r of each LED about its mean, by the values of the true ones.

    Parameters
    ----------
    weights
        (4,) w_r; 1/2 each for the whole of a pattern less the whole of its inverse.

    Returns
    -------
    (16, 4); for weights 1/2 the cells themselves, `VALUES`.
    """
    return np.asarray(((_LIT - MEAN_LIT) @ weights) @ SIGNS.T)


def seen_of_levels(weights: Floats, lit: NDArray[np.bool_]) -> Floats:
    """The same for LEDs (n, n) known to be lit through the pattern or not at all; (cells,)."""
    light = (lit[..., None] - MEAN_LIT) @ weights
    side = len(lit)
    squares = light.reshape(side // 2, 2, side // 2, 2).transpose(0, 2, 1, 3).reshape(-1, 4)
    return np.asarray((squares @ SIGNS.T).T.reshape(-1))


def moments(table: Floats, mean: Floats) -> tuple[Floats, Floats]:
    """Mean and variance (cells,) of the cells as seen by a table (16, 4), the true ones having a `mean` (cells,)."""
    chance = np.exp(_log_chances(mean).sum(-1))
    first = chance @ table
    return first.T.reshape(-1), np.maximum(chance @ table**2 - first**2, 0).T.reshape(-1)


def true_llrs(table: Floats, seen: Floats, variance: Floats, mean: Floats) -> Floats:
    """Extrinsic LLRs ln P(c=+1)/P(c=-1) of the true cells.

    What is seen of one cell tells of another by the product of three. But the errors of the equaliser within a square
    go together, so that they look like such products: it is trusted as far as the other three cells are known, or as
    what is seen is products rather than cells.

    Parameters
    ----------
    table
        (16, 4) as of `seen`.
    seen, variance
        (cells,) what was measured of the cells as seen, and its variance.
    mean
        (cells,) of the true cells beforehand.
    """
    y, v = (a.reshape(4, -1).T[:, None, :] for a in (seen, variance))
    fit = -0.5 * (table - y) ** 2 / v
    prior = _log_chances(mean)
    known = mean.reshape(4, -1).T ** 2
    bent = min(float((table**2).mean() / (table * VALUES).mean() ** 2) - 1, 1.0)
    out = np.empty((len(fit), 4))
    for i in range(4):
        # of the cell itself, nothing that was known
        others = prior.sum(-1) - prior[..., i]
        own, joint = _llr(fit[..., i] + others, i), _llr(fit.sum(-1) + others, i)
        trust = bent + (1 - bent) * np.delete(known, i, axis=1).prod(1)
        out[:, i] = own + trust * (joint - own)
    return out.T.reshape(-1)


def _llr(score: Floats, cell: int) -> Floats:
    """LLRs (squares,) of a cell of log likelihoods (squares, 16)."""
    return _log_sum(score[:, VALUES[:, cell] > 0]) - _log_sum(score[:, VALUES[:, cell] < 0])


def _log_chances(mean: Floats) -> Floats:
    """(squares, 16, 4) ln P of each cell's part in each value of its square."""
    m = mean.reshape(4, -1).T[:, None, :]
    return np.asarray(np.log(np.maximum(0.5 * (1 + VALUES * m), 1e-12)))


def _log_sum(x: Floats) -> Floats:
    top = x.max(-1)
    return np.asarray(top + np.log(np.exp(x - top[:, None]).sum(-1)))
