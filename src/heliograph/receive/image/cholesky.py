"""Positive definite systems of a few unknowns, for hot loops.

It is compiled in tenths of a second; SciPy's, called from machine code, in three seconds.
"""

import math

import numpy as np

from heliograph.base.compiled import compiled


@compiled()
def solve(matrix, rhs):
    """Solve M x = b in place of b, by Cholesky."""
    lower = np.empty(matrix.shape)
    _factor(matrix, lower)
    _substitute(lower, rhs)


@compiled()
def invert(matrix, out):
    """First rows and columns of an inverse, as many as `out` has."""
    lower, column = np.empty(matrix.shape), np.empty(matrix.shape[0])
    _factor(matrix, lower)
    for k in range(out.shape[0]):
        column[:] = 0.0
        column[k] = 1.0
        _substitute(lower, column)
        for n in range(out.shape[0]):
            out[n, k] = column[n]


@compiled()
def _factor(matrix, lower):
    """Cholesky's L of M = L L^T; not finite where M is not positive definite."""
    for k in range(matrix.shape[0]):
        for n in range(k + 1):
            total = matrix[k, n]
            for i in range(n):
                total -= lower[k, i] * lower[n, i]
            lower[k, n] = math.sqrt(total) if k == n and total > 0.0 else np.nan if k == n else total / lower[n, n]


@compiled()
def _substitute(lower, rhs):
    """Solve L y = b, then L^T x = y, in place of b."""
    size = lower.shape[0]
    for k in range(size):
        for i in range(k):
            rhs[k] -= lower[k, i] * rhs[i]
        rhs[k] /= lower[k, k]
    for k in range(size - 1, -1, -1):
        for i in range(k + 1, size):
            rhs[k] -= lower[i, k] * rhs[i]
        rhs[k] /= lower[k, k]


@compiled()
def mirror(matrix):
    """Give a matrix the upper half that its lower one has."""
    for k in range(matrix.shape[0]):
        for n in range(k):
            matrix[n, k] = matrix[k, n]
