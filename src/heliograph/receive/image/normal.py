"""The normal distribution by a table, for hot loops."""

import math

import numpy as np
from scipy.special import ndtr

from heliograph.base.compiled import compiled

_FARTHEST, _NODES = 8, 64
"""Standard deviations to which the table of the normal distribution goes, where 6e-16 is left, and its nodes in each.

Three terms of the series err by h^4 / 24 times the fourth derivative, 0.55 at most: 9e-11 half a node away.
"""

_Z = np.arange(-_FARTHEST * _NODES, _FARTHEST * _NODES + 1) / _NODES
_CDF, _PDF = ndtr(_Z), np.exp(-0.5 * _Z**2) / math.sqrt(2.0 * math.pi)


@compiled(inline="always")
def normal(z):
    """Normal distribution by a table, in a fifth of the time of erf and exp."""
    z = min(max(z, -_FARTHEST), _FARTHEST)
    k = int((z + _FARTHEST) * _NODES + 0.5)
    h, at, pdf = z - _Z[k], _Z[k], _PDF[k]
    # Taylor series about the nearest node: phi' = -z phi, phi'' = (z^2 - 1) phi
    curve = at * at - 1.0
    return _CDF[k] + pdf * h * (1.0 - h * (at / 2.0 - h * curve / 6.0)), pdf * (1.0 - h * (at - h * curve / 2.0))
