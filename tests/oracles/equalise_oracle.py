"""Reference for `lmmse.py`: dense matrices and textbook formulas."""

import numpy as np

from heliograph.base.arrays import Floats


def lmmse(b: Floats, d: Floats, noise: Floats, mean: Floats, variance: Floats) -> tuple[Floats, Floats, Floats]:
    """Estimate symbols c from d = B c + n by linear MMSE; B and d include gain and offset.

    Returns the posterior mean (symbols,) and covariance (symbols, symbols), and extrinsic LLRs, ln P(c=+1)/P(c=-1) with
    the prior excluded.
    """
    # K = B V B^T + N, m = c + V B^T K^-1 (d - B c), S = V - V B^T K^-1 B V
    k = (b * variance) @ b.T + np.diag(noise)
    gain = variance[:, None] * np.linalg.solve(k, b).T
    rest = d - b @ mean
    covariance = np.diag(variance) - (gain @ b) * variance
    extrinsic = np.array([_extrinsic(i, k, b, rest, mean, variance) for i in range(len(mean))])
    return mean + gain @ rest, covariance, extrinsic


def _extrinsic(i: int, k: Floats, b: Floats, rest: Floats, mean: Floats, variance: Floats) -> float:
    """Return the extrinsic LLR for symbol i: matched filter with all other symbols as coloured noise."""
    # K_i = K - v b b^T, f = K_i^-1 b, z = f^T (d - B c + b c_i): mean mu c_i, variance mu, mu = f^T b
    image = b[:, i]
    matched = np.linalg.solve(k - variance[i] * np.outer(image, image), image)
    mu, z = matched @ image, matched @ (rest + image * mean[i])
    # outlier model: Laplace density with spread 0.3 and probability 1e-20, relative to a Gaussian peak at 1
    other = np.log(1e-20 * np.sqrt(2 * np.pi * mu) / (2 * 0.3 * mu))
    plus, minus = (
        np.logaddexp(-((z - sign * mu) ** 2) / (2 * mu), other - abs(z - sign * mu) / (0.3 * mu)) for sign in (1, -1)
    )
    return float(plus - minus)
