"""Log-likelihood ratios: their bound, and how much information they hold."""

import numpy as np
from scipy.special import entr, expit

from heliograph.base.arrays import TINY, Floats

LARGEST_LLR = 50.0
"""Largest magnitude of an LLR between equaliser and decoder: no model of the channel is right to e^-50."""


UNMODELLED = 1e-20
"""Probability that a symbol's value comes from something that no model of the light holds: 9 standard deviations.

What passes before an array hides LEDs in part, and what shines beside it pulls its pose. Symbols of such LEDs lie far
from -1 and +1, some dozens of standard deviations, and a Gaussian alone is then sure of one by chance. Of two films of
bright posts 22 codewords were read without it, and 27 or 28 with 1e-15, 1e-20 and 1e-30.
"""

UNMODELLED_SPREAD = 0.3
"""How far such a value lies from its symbol on average, as a fraction of the symbol: Laplace's distribution.

Of three films with posts 52 codewords were read with 0.3, 48 with 0.5 and 49 with 1.
"""


def llr_of(precision: Floats, weighted: Floats) -> Floats:
    """LLRs ln P(c=+1)/P(c=-1) of symbols that Gaussians tell of. Returns (...,), the prior left out."""
    # p(m|c) = (1 - epsilon) N(m; c, 1 / Lambda) + epsilon Laplace(m; c, spread)
    sure = np.maximum(precision, TINY)
    mean = weighted / sure
    other = np.log(UNMODELLED * np.sqrt(2 * np.pi / sure) / (2 * UNMODELLED_SPREAD))
    plus, minus = (
        np.logaddexp(-0.5 * sure * (mean - c) ** 2, other - np.abs(mean - c) / UNMODELLED_SPREAD) for c in (1, -1)
    )
    return np.asarray(plus - minus)


def information(llr: Floats) -> Floats:
    """Mean information in LLRs about their bits if they are calibrated, in bit per bit, (...,)."""
    # I = 1 - h2(P(wrong)), P(wrong) = 1 / (1 + exp |L|)
    wrong = expit(-np.abs(llr))
    return np.asarray(1 - (entr(wrong) + entr(1 - wrong)).mean(-1) / np.log(2))
