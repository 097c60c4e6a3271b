"""The equaliser written for reading: the whole matrix of pixels, textbook formulas, no tricks.

Nothing runs on it but the tests that hold `lmmse.py` and `kernels.py` to it.
"""

from dataclasses import dataclass
from itertools import product

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


@dataclass(frozen=True, kw_only=True)
class DrawnSymbols:
    """How many disturbing symbols are drawn from -1 and +1."""

    # few, many: in the first evaluation, and in the second
    few: int
    many: int
    # doubtful, sure: lLRs in magnitude between which a symbol is evaluated again
    doubtful: float
    sure: float
    # unmodelled, spread: probability that a value is none of -1 and +1 and Gaussian noise, and its mean error then
    unmodelled: float
    spread: float


def lmmse(b: Floats, d: Floats, noise: Floats, mean: Floats, variance: Floats, drawn: DrawnSymbols) -> Posterior:
    """Linear MMSE estimate of symbols c of d = B c + n, gain and offset within B and d."""
    # K = B V B^T + N, m = c + V B^T K^-1 (d - B c), S = V - V B^T K^-1 B V
    k = (b * variance) @ b.T + np.diag(noise)
    gain = variance[:, None] * np.linalg.solve(k, b).T
    rest = d - b @ mean
    covariance = np.diag(variance) - (gain @ b) * variance
    extrinsic = np.array([_extrinsic(i, k, b, rest, mean, variance, drawn) for i in range(len(mean))])
    return Posterior(mean + gain @ rest, covariance, extrinsic)


def _extrinsic(
    i: int, k: Floats, b: Floats, rest: Floats, mean: Floats, variance: Floats, drawn: DrawnSymbols
) -> float:
    """LLR of symbol i by the matched filter in coloured noise: all others are noise, its own prior is taken out.

    The few that disturb it most are taken as the +-1 they are, the others as Gaussian; more where it is worth it.
    """
    # K_i = K - v b b^T, f = K_i^-1 b, z = f^T (d - B c + b c_i): mean mu c_i, variance mu, mu = f^T b
    image = b[:, i]
    matched = np.linalg.solve(k - variance[i] * np.outer(image, image), image)
    mu, z = matched @ image, matched @ (rest + image * mean[i])
    overlap = matched @ b
    power = overlap**2 * variance
    power[i] = 0.0
    llr = 0.0
    for most in (drawn.few, drawn.many):
        worst = np.argsort(-power)[:most]
        spread = mu - power[worst].sum()
        others = np.array([*product((1, -1), repeat=len(worst))])
        prior = np.prod(0.5 * (1 + others * mean[worst]), axis=1)
        off = z - (others - mean[worst]) @ overlap[worst]
        log_p = [np.logaddexp.reduce(np.log(prior) - (off - sign * mu) ** 2 / (2 * spread)) for sign in (1, -1)]
        # Laplace's distribution about each, beside the Gaussian's peak of 1
        other = np.log(drawn.unmodelled * np.sqrt(2 * np.pi * spread) / (2 * drawn.spread * mu))
        log_p = [
            np.logaddexp(one, other - abs(z - sign * mu) / (drawn.spread * mu))
            for one, sign in zip(log_p, (1, -1), strict=True)
        ]
        llr = float(log_p[0] - log_p[1])
        if not drawn.doubtful < abs(llr) < drawn.sure:
            break
    return llr
