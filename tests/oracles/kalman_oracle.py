"""Steps of the Kalman filter written for reading.

Nothing runs on this but the test that holds `kalman_kernels.py` to it.
"""

import numpy as np

from heliograph.base.arrays import Floats


def predict(mean: Floats, covariance: Floats, dt: float, process_noise: Floats) -> tuple[Floats, Floats]:
    """State at a later time: x = F x, P = F P F^T + Q."""
    f = np.eye(len(mean))
    f[:3, 5:8] = dt * np.eye(3)
    return f @ mean, f @ covariance @ f.T + process_noise


def expected(mean: Floats, covariance: Floats, h: Floats, variances: Floats) -> tuple[Floats, Floats]:
    """Mean (5,) and covariance (5, 5) of what a fit will show: H x, H P H^T + R."""
    return h @ mean, h @ covariance @ h.T + np.diag(variances)


def condition(
    mean: Floats, covariance: Floats, h: Floats, variances: Floats, vector: Floats, fitted: Floats
) -> tuple[Floats, Floats]:
    """State given the posterior of what a fit shows."""
    # S = H P H^T + R, K = P H^T S^-1; x += K (z - H x); P += K (C - S) K^T
    z, s = expected(mean, covariance, h, variances)
    gain = np.linalg.solve(s, h @ covariance).T
    full = covariance + gain @ (fitted - s) @ gain.T
    return mean + gain @ (vector - z), 0.5 * (full + full.T)
