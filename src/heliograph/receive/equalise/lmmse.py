"""Linear MMSE estimate of the symbols of a pair with a Gaussian prior from the decoder, LLRs, expectation propagation.

Linear MMSE treats the light of undecoded symbols as Gaussian noise of variance 1. But symbols are -1 or +1, and less
uncertain after an observation. A Gaussian *site* of precision Lambda_i and mean eta_i / Lambda_i replaces the prior of
symbol i. The estimate without the site is the *cavity*. Site and cavity together have the mean and variance of the
cavity with -1 and +1, weighted by the turbo decoder's probabilities (Minka 2001; for equalisers Santos et al. 2017).
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import blas, lapack

from heliograph.base.arrays import TINY, Floats
from heliograph.receive.observe.statistics import PairStatistics, WhitenedCutout

LARGEST_LLR = 50.0  # bound of LLRs between equaliser and decoder: no model of the channel is right to e^-50
OUTLIER_PROBABILITY = 1e-20  # of light that no model explains, such as posts and lamps: a Gaussian would be sure of it
OUTLIER_SPREAD = 0.3  # mean distance of an outlier from the symbol, relative to the symbol: Laplace's distribution
LEAST_PRECISION = 1e-6  # least precision of a site; an update below it leaves the site unchanged
KNOWN_VARIANCE = 1e-3  # variance below which a symbol is known: subtracting its light leaves -30 dB


def llr_of(precision: Floats, weighted: Floats) -> Floats:
    """Compute LLRs ln P(c=+1)/P(c=-1) of symbols from Gaussians, without the prior, (...,)."""
    # p(m|c) = (1 - epsilon) N(m; c, 1 / Lambda) + epsilon Laplace(m; c, spread)
    precision = np.maximum(precision, TINY)
    mean = weighted / precision
    outlier = np.log(OUTLIER_PROBABILITY * np.sqrt(2 * np.pi / precision) / (2 * OUTLIER_SPREAD))
    plus, minus = (
        np.logaddexp(-0.5 * precision * (mean - c) ** 2, outlier - np.abs(mean - c) / OUTLIER_SPREAD) for c in (1, -1)
    )
    return np.asarray(plus - minus)


def information(llr: Floats) -> Floats:
    """Compute the mean information of calibrated LLRs, in bit per bit, (...,)."""
    # I = 1 - h2(p), p = 1 / (1 + exp |L|), h2 ln 2 = ln(1 + exp -|L|) + p |L|
    size = np.abs(llr)
    odds = np.exp(-size)
    return np.asarray(1 - (np.log1p(odds) + size * odds / (1 + odds)).mean(-1) / np.log(2))


@dataclass(frozen=True)  # without slots, for cached properties
class Estimate:
    """Equalised symbols of a pair."""

    # (symbols,) prior mean of each symbol
    prior: Floats
    # (symbols,) prior variance of each symbol
    variance: Floats
    # (symbols,) posterior mean of each symbol; for known symbols the prior mean
    mean: Floats
    # (unknown,) numbers of the estimated symbols
    unknown: NDArray[np.intp]
    # L of the posterior precision S^-1 = L L^T, lower triangular, (unknown, unknown) float32
    factor: NDArray[np.float32]
    # G^2 / s^2, ratio of the squared gain to the noise variance
    scale: float

    @cached_property
    def spread(self) -> Floats:
        """(unknown,) posterior variances of the estimated symbols."""
        # S = L^-T L^-1
        inverse = _inverse(self.factor)
        return np.einsum("ji,ji->i", inverse, inverse).astype(np.float64)

    @property
    def trace(self) -> float:
        """Trace of B^T W B S."""
        # B^T B S g^2 / s^2 = I - V^-1 S
        return float((1.0 - self.spread / self.variance[self.unknown]).sum()) / max(self.scale, TINY)

    @property
    def llr(self) -> Floats:
        """(symbols,) extrinsic LLR = ln P(c=+1)/P(c=-1), without the prior; 0 for known symbols."""
        return llr_of(*self.extrinsic)

    @property
    def extrinsic(self) -> tuple[Floats, Floats]:
        """Extrinsic Gaussian of each symbol: precision, and precision times mean, (symbols,); 0 for known symbols."""
        precision, weighted = np.zeros_like(self.mean), np.zeros_like(self.mean)
        u, spread = self.unknown, self.spread
        precision[u] = np.maximum(1 / spread - 1 / self.variance[u], 0.0)
        weighted[u] = self.mean[u] / spread - self.prior[u] / self.variance[u]
        return precision, weighted


def equalise(pair: PairStatistics, gain: float, noise: float, mean: Floats, variance: Floats) -> Estimate:
    """Estimate the symbols of a pair: (6) of Tuechler, Singer and Koetter 2002, in the symbols' domain."""
    unknown = np.flatnonzero(variance >= KNOWN_VARIANCE)
    m, ratio = mean.copy(), gain / noise
    if not unknown.size:
        return Estimate(mean, variance, m, unknown, np.zeros((0, 0), np.float32), ratio * gain)
    projected = pair.gram @ mean.astype(np.float32)
    # S = (g^2 / s^2 B^T B + V^-1)^-1 = (L L^T)^-1, m = c + S B^T (d - g (B c + o)) g / s^2
    factor = _factor(pair, unknown, ratio * gain, 1.0 / variance[unknown])
    right = ratio * (pair.matched - gain * (pair.offset + projected))[unknown]
    m[unknown] += lapack.spotrs(factor, right.astype(np.float32), lower=1)[0]
    return Estimate(mean, variance, m, unknown, factor, ratio * gain)


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


def products(whitened: WhitenedCutout, images: Floats, unknown: NDArray[np.intp], scale: float) -> Floats:
    """Compute inner products of images with the noise of a pair, which includes the light of unknown symbols."""
    # Woodbury: A^T (1 + g^2 / s^2 B B^T)^-1 A = A^T A - A^T B (B^T B + s^2 / g^2)^-1 B^T A, a matrix of symbols
    flat = images.reshape(len(images), -1)
    in_white_noise = flat @ flat.T
    if not unknown.size:
        return np.asarray(in_white_noise)
    factor = _factor(whitened.statistics, unknown, scale, np.ones(unknown.size))
    half = blas.strsm(1.0, factor, whitened.correlate(images)[unknown].astype(np.float32), lower=1)
    return np.asarray(in_white_noise - scale * half.T.astype(np.float64) @ half)


def _factor(pair: PairStatistics, unknown: NDArray[np.intp], scale: float, inverse: Floats) -> NDArray[np.float32]:
    """Factor scale B^T B + V^-1 = L L^T of the unknown symbols, V^-1 being the diagonal `inverse`."""
    matrix = pair.gram.take(unknown, 0).take(unknown, 1)
    matrix *= np.float32(scale)
    # keeps factors of hardly overlapping symbols from slow denormal numbers
    matrix += np.float32(1e-9)
    matrix.ravel()[:: unknown.size + 1] += inverse.astype(np.float32)
    # the transpose has the order of LAPACK and needs no copy
    factor, failed = lapack.spotrf(matrix.T, lower=1, clean=0, overwrite_a=1)
    if failed:
        raise np.linalg.LinAlgError("the equaliser's matrix is not positive definite")
    return np.asarray(factor)


def _inverse(lower: NDArray[np.float32]) -> NDArray[np.float32]:
    """Invert a lower triangular L by halves, in half the time of LAPACK, which multiplies zeros."""
    size = len(lower)
    if size <= 64:
        return np.asarray(blas.strsm(1.0, lower, np.eye(size, dtype=np.float32).T, lower=1, overwrite_b=1))
    # [[A, 0], [C, D]]^-1 = [[A^-1, 0], [-D^-1 C A^-1, D^-1]]
    half, out = size // 2, np.zeros((size, size), np.float32, order="F")
    out[:half, :half] = first = _inverse(lower[:half, :half])
    out[half:, half:] = last = _inverse(lower[half:, half:])
    np.matmul(-last, lower[half:, :half] @ first, out=out[half:, :half])
    return out
