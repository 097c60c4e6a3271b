"""Steps of the Kalman filter, as machine code: on ten numbers a call of NumPy costs more than what it does.

`kalman_reference.py` holds the same in plain NumPy; a test holds the two together.
"""

import numpy as np

from heliograph.base.compiled import compiled


@compiled()
def predict(mean, covariance, dt, linear, quadratic, cubic):
    """State at a later time: x = F x, P = F P F^T + Q, where F adds dt times a rate to each of the first three."""
    x, p = mean.copy(), covariance.copy()
    size = x.shape[0]
    for k in range(3):
        x[k] += dt * x[5 + k]
        for n in range(size):
            p[k, n] += dt * p[5 + k, n]
    for n in range(size):
        for k in range(3):
            p[n, k] += dt * p[n, 5 + k]
        for k in range(size):
            p[n, k] += dt * linear[n, k] + dt**2 * quadratic[n, k] + dt**3 * cubic[n, k]
    return x, p


@compiled()
def expected(mean, covariance, h, variances):
    """What a fit will show: H x, H P H^T + R."""
    shown, size = h.shape
    z, s, across = np.zeros(shown), np.zeros((shown, shown)), np.zeros((shown, size))
    for k in range(shown):
        for n in range(size):
            # H is nearly empty
            if h[k, n] != 0.0:
                z[k] += h[k, n] * mean[n]
                for i in range(size):
                    across[k, i] += h[k, n] * covariance[n, i]
    for k in range(shown):
        s[k, k] = variances[k]
        for n in range(shown):
            for i in range(size):
                s[k, n] += across[k, i] * h[n, i]
    return z, s, across


@compiled()
def condition(mean, covariance, h, variances, vector, fitted):
    """State given the posterior of what a fit shows: K = P H^T S^-1; x += K (z - H x); P += K (C - S) K^T."""
    z, s, gain = expected(mean, covariance, h, variances)
    shown, size = h.shape
    less = np.empty((shown, shown))
    for k in range(shown):
        for n in range(shown):
            less[k, n] = fitted[k, n] - s[k, n]
    _divide(s, gain)
    x, p = mean.copy(), np.empty((size, size))
    turned = np.zeros((shown, size))
    for k in range(shown):
        for i in range(size):
            x[i] += gain[k, i] * (vector[k] - z[k])
            for n in range(shown):
                turned[k, i] += less[k, n] * gain[n, i]
    for i in range(size):
        for j in range(i + 1):
            total = 0.5 * (covariance[i, j] + covariance[j, i])
            for k in range(shown):
                total += 0.5 * (gain[k, i] * turned[k, j] + gain[k, j] * turned[k, i])
            p[i, j] = p[j, i] = total
    return x, p


@compiled()
def _divide(matrix, rhs):
    """Solve S X = B in place of B, (5, m), for a symmetric S, as S = L D L^T; S is overwritten."""
    size = matrix.shape[0]
    for k in range(size):
        for n in range(k):
            # D sits on the diagonal, L below it
            matrix[k, k] -= matrix[k, n] ** 2 * matrix[n, n]
        for i in range(k + 1, size):
            for n in range(k):
                matrix[i, k] -= matrix[i, n] * matrix[n, n] * matrix[k, n]
            matrix[i, k] /= matrix[k, k]
    for column in range(rhs.shape[1]):
        for k in range(size):
            for n in range(k):
                rhs[k, column] -= matrix[k, n] * rhs[n, column]
        for k in range(size - 1, -1, -1):
            rhs[k, column] /= matrix[k, k]
            for n in range(k + 1, size):
                rhs[k, column] -= matrix[n, k] * rhs[n, column]
