"""Log-likelihood ratios: their bound, and how much information they hold."""

import numpy as np
from scipy.special import entr, expit

from heliograph.base.arrays import Floats

LARGEST_LLR = 50.0
"""Largest magnitude of an LLR between equaliser and decoder: no model of the channel is right to e^-50."""


def information(llr: Floats) -> Floats:
    """Mean information in LLRs about their bits if they are calibrated, in bit per bit, (...,).

    Parameters
    ----------
    llr
        (..., E) LLRs, of either sign; only their magnitudes count.
    """
    # I = 1 - h2(P(wrong)), P(wrong) = 1 / (1 + exp |L|)
    wrong = expit(-np.abs(llr))
    return np.asarray(1 - (entr(wrong) + entr(1 - wrong)).mean(-1) / np.log(2))
