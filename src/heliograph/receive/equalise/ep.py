"""Expectation propagation for symbols of -1 or +1, which the equaliser treats as Gaussian.

Linear MMSE treats the light of undecoded symbols as Gaussian noise of variance 1. But symbols are -1 or +1, and less
uncertain after an observation. A Gaussian *site* of precision Lambda_i and mean eta_i / Lambda_i replaces the prior of
symbol i. The estimate without the site is the *cavity*. Site and cavity together have the mean and variance of the
cavity with -1 and +1, weighted by the turbo decoder's probabilities (Minka 2001; for equalisers Santos et al. 2017).
"""

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.receive.equalise.lmmse import KNOWN_VARIANCE, Estimate, llr_of

LEAST_PRECISION = 1e-6  # least precision of a site; an update below it leaves the site unchanged


class ExpectationPropagation:
    """Sites and cavities of a packet's symbols, (patterns, symbols)."""

    def __init__(self, shape: tuple[int, int]):
        # Lambda and eta of the sites: first of mean 0 and variance 1
        self.precision, self.weighted = np.ones(shape), np.zeros(shape)
        # Lambda and eta of the cavities; 0 for pairs not yet equalised
        self.cavity, self.cavity_weighted = np.zeros(shape), np.zeros(shape)

    def forget(self) -> None:
        """Drop the cavities, after a change of statistics or of guesses."""
        self.cavity[:], self.cavity_weighted[:] = 0.0, 0.0

    def priors(self, mean: Floats, variance: Floats) -> tuple[Floats, Floats]:
        """Update the sites and return the priors of the equaliser."""
        # P(+1) / P(-1) = exp(L), L = 2 artanh(mean) + L_cavity
        llr = 2 * np.arctanh(np.clip(mean, KNOWN_VARIANCE - 1, 1 - KNOWN_VARIANCE))
        llr += llr_of(self.cavity, self.cavity_weighted)
        joint = np.tanh(0.5 * llr)
        spread = np.maximum(1 - joint**2, 2 * KNOWN_VARIANCE)
        # Lambda_i = 1 / variance - Lambda_cavity, eta_i = mean / variance - eta_cavity
        precision, weighted = 1 / spread - self.cavity, joint / spread - self.cavity_weighted
        # a full step may make the sites of neighbours oscillate
        step = np.where(self.cavity == 0, 1.0, np.where(precision > LEAST_PRECISION, 0.7, 0.0))
        self.precision += step * (precision - self.precision)
        self.weighted += step * (weighted - self.weighted)
        known = variance < KNOWN_VARIANCE
        return np.where(known, mean, self.weighted / self.precision), np.where(known, variance, 1 / self.precision)

    def take(self, number: int, estimate: Estimate) -> Floats:
        """Store the cavities of an equalised pair and return the LLRs."""
        self.cavity[number], self.cavity_weighted[number] = estimate.extrinsic
        return llr_of(self.cavity[number], self.cavity_weighted[number])
