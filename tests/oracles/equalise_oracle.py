"""The equaliser written for reading: the whole matrix of pixels, textbook formulas, no tricks.

Nothing runs on it but the tests that hold `lmmse.py` to it.
"""

from dataclasses import dataclass

import numpy as np

from heliograph.base.arrays import Floats


@dataclass(frozen=True, slots=True)
class Posterior:
    """Symbols after linear MMSE estimation."""

    # (symbols,) posterior mean of each symbol
    mean: Floats
    # (symbols, symbols) posterior covariance of the symbols
    covariance: Floats
    # (symbols,) LLR = ln P(c=+1)/P(c=-1) of each without its own prior
    extrinsic: Floats


def lmmse(b: Floats, d: Floats, noise: Floats, mean: Floats, variance: Floats) -> Posterior:
    """Linear MMSE estimate of symbols c of d = B c + n, gain and offset within B and d."""
    # K = B V B^T + N, m = c + V B^T K^-1 (d - B c), S = V - V B^T K^-1 B V
    k = (b * variance) @ b.T + np.diag(noise)
    gain = variance[:, None] * np.linalg.solve(k, b).T
    rest = d - b @ mean
    covariance = np.diag(variance) - (gain @ b) * variance
    extrinsic = np.array([_extrinsic(i, k, b, rest, mean, variance) for i in range(len(mean))])
    return Posterior(mean + gain @ rest, covariance, extrinsic)


def _extrinsic(i: int, k: Floats, b: Floats, rest: Floats, mean: Floats, variance: Floats) -> float:
    """LLR of symbol i by the matched filter in coloured noise: all others are noise, its own prior is taken out."""
    # K_i = K - v b b^T, f = K_i^-1 b, z = f^T (d - B c + b c_i): mean mu c_i, variance mu, mu = f^T b
    image = b[:, i]
    matched = np.linalg.solve(k - variance[i] * np.outer(image, image), image)
    mu, z = matched @ image, matched @ (rest + image * mean[i])
    # Laplace's distribution of spread 0.3 about each with a chance of 1e-20, beside the Gaussian's peak of 1
    other = np.log(1e-20 * np.sqrt(2 * np.pi * mu) / (2 * 0.3 * mu))
    plus, minus = (
        np.logaddexp(-((z - sign * mu) ** 2) / (2 * mu), other - abs(z - sign * mu) / (0.3 * mu)) for sign in (1, -1)
    )
    return float(plus - minus)
