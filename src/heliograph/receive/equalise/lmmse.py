"""Log-likelihood ratios: their bound, and how much information they hold.

Linear MMSE estimate of all symbols of a pair, with a Gaussian prior from the decoder.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import blas, lapack
from scipy.special import entr, expit

from heliograph.base.arrays import TINY, Floats
from heliograph.receive.equalise import kernels
from heliograph.receive.equalise.kernels import UNMODELLED, UNMODELLED_SPREAD
from heliograph.receive.observe.statistics import PairStatistics, WhitenedCutout

LARGEST_LLR = 50.0
"""Largest magnitude of an LLR between equaliser and decoder: no model of the channel is right to e^-50."""


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


KNOWN_VARIANCE = 1e-3
"""Variance of a symbol below which it counts as known: its light is subtracted with 30 dB of rest."""

CACHE_ROWS, PADDING = 64, 4
"""A matrix of a multiple of so many rows gets so many rows more.

Its columns would lie a multiple of 256 bytes apart and fall on each other in the processor's cache.
"""

SOLVED_ROWS = 65
"""Most rows of a triangle that is inverted at once; a quarter of those of 256 symbols with their padding."""

FLOOR = 1e-9
"""Added to a matrix whose diagonal is 1 or more.

Symbols of near arrays hardly overlap. Without it the factors decay to denormal numbers, for which the processor takes
several times as long.
"""


@dataclass(frozen=True)  # without slots: what takes most of the time is found when it is asked for, and kept
class Estimate:
    """Symbols of a pair after equalising."""

    # (symbols,) prior mean of each symbol
    prior: Floats
    # (symbols,) prior variance of each symbol
    variance: Floats
    # (symbols,) posterior mean of each; of known symbols the prior mean
    mean: Floats
    # (unknown,) numbers of the symbols that were estimated
    unknown: NDArray[np.intp]
    # L of their posterior precision S^-1 = L L^T, lower triangular, (unknown, unknown) float32 and rows that pad it
    factor: NDArray[np.float32]
    # G^2 / s^2, ratio of the squared gain to the noise variance
    scale: float

    @cached_property
    def root(self) -> NDArray[np.float32]:
        """R of the posterior covariance S = R R^T, upper triangular, (unknown, unknown) float32."""
        # R = L^-T
        return _inverse(self.factor).T[: self.unknown.size, : self.unknown.size]

    @cached_property
    def spread(self) -> Floats:
        """(unknown,) posterior variances of the symbols that were estimated."""
        return np.einsum("ij,ij->i", self.root, self.root).astype(np.float64)

    @property
    def trace(self) -> float:
        """Trace of B^T W B S."""
        # B^T B S g^2 / s^2 = I - V^-1 S
        return float((1.0 - self.spread / self.variance[self.unknown]).sum()) / max(self.scale, TINY)

    @property
    def covariance(self) -> NDArray[np.float32]:
        """S of the symbols that were estimated, (unknown, unknown) float32."""
        # the triangle of R R^T, in place of R
        whole, _ = lapack.slauum(np.array(self.root).T, lower=1, overwrite_c=1)
        kernels.mirror(whole.T, covariance := np.empty_like(self.root, order="C"))
        return covariance

    @property
    def llr(self) -> Floats:
        """(symbols,) extrinsic LLR = ln P(c=+1)/P(c=-1), the prior left out; 0 for known symbols."""
        u, llr = self.unknown, np.zeros_like(self.mean)
        if not u.size:
            return llr
        part = np.empty(u.size)
        kernels.extrinsic(self.covariance, self.mean[u], self.prior[u], self.variance[u], part)
        llr[u] = part
        return llr

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
    right = np.zeros((len(factor), 1), np.float32, order="F")
    right[: unknown.size, 0] = ratio * (pair.matched - gain * (pair.offset + projected))[unknown]
    solved, _ = lapack.spotrs(factor, right, lower=1, overwrite_b=1)
    m[unknown] += solved[: unknown.size, 0]
    return Estimate(mean, variance, m, unknown, factor, ratio * gain)


def products(
    whitened: WhitenedCutout, pair: PairStatistics, images: Floats, unknown: NDArray[np.intp], scale: float
) -> Floats:
    """Inner products of images in the noise of a pair, to which the light of unknown symbols belongs."""
    # Woodbury: A^T (1 + g^2 / s^2 B B^T)^-1 A = A^T A - A^T B (B^T B + s^2 / g^2)^-1 B^T A, a matrix of symbols
    flat = images.reshape(len(images), -1)
    whole = flat @ flat.T
    if not unknown.size:
        return np.asarray(whole)
    factor = _factor(pair, unknown, scale, np.ones(unknown.size))
    seen = np.zeros((len(factor), len(images)), np.float32, order="F")
    seen[: unknown.size] = whitened.all_correlated(images)[unknown]
    half = blas.strsm(1.0, factor, seen, lower=1, overwrite_b=1)
    return np.asarray(whole - scale * half.T.astype(np.float64) @ half)


def _factor(pair: PairStatistics, unknown: NDArray[np.intp], scale: float, inverse: Floats) -> NDArray[np.float32]:
    """L, lower triangular, of scale B^T B + V^-1 = L L^T of the unknown symbols, V^-1 the diagonal `inverse`."""
    size = unknown.size + (PADDING if unknown.size % CACHE_ROWS == 0 else 0)
    matrix = kernels.precision(pair.gram, unknown, scale, inverse, FLOOR, size)
    # transposed it is as LAPACK wants it, and nothing is copied
    factor, failed = lapack.spotrf(matrix.T, lower=1, clean=0, overwrite_a=1)
    if failed:
        raise np.linalg.LinAlgError("the equaliser's matrix is not positive definite")
    return np.asarray(factor)


def _inverse(lower: NDArray[np.float32]) -> NDArray[np.float32]:
    """L^-1 of a lower triangular L, in halves: in half the time of LAPACK's own, which multiplies zeros too."""
    size = len(lower)
    if size <= SOLVED_ROWS:
        return np.asarray(blas.strsm(1.0, lower, np.eye(size, dtype=np.float32).T, lower=1, overwrite_b=1))
    # [[A, 0], [C, D]]^-1 = [[A^-1, 0], [-D^-1 C A^-1, D^-1]]
    half, out = size // 2, np.zeros((size, size), np.float32, order="F")
    out[:half, :half] = first = _inverse(lower[:half, :half])
    out[half:, half:] = last = _inverse(lower[half:, half:])
    np.matmul(-last, lower[half:, :half] @ first, out=out[half:, :half])
    return out
