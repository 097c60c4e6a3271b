"""Linear MMSE of all cells of a pair, what is known of them from elsewhere taken as a Gaussian prior."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import blas, lapack

from heliograph.receive.soft import kernels
from heliograph.receive.soft.look import Look, Weighted

Floats = NDArray[np.float64]

KNOWN = 1e-3
"""Variance of a cell below which its light is subtracted and it is not estimated any more."""

PADDING = 4
"""Rows added to a matrix of a multiple of 64: rows a power of two apart fall on each other in the processor's cache."""

FLOOR = 1e-9
"""Added to a matrix whose diagonal is 1 or more: near arrays' cells hardly touch, and without it the factors decay to
numbers so small that the processor takes several times as long for them."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """Cells of a look after equalising.

    Attributes
    ----------
    prior, variance
        (cells,) mean and variance of what was known beforehand.
    mean
        (cells,) posterior mean.
    unknown, spread
        Numbers of the cells that were estimated, and their posterior variances.
    root
        R of their posterior covariance S = R R^T, upper triangular, (unknown, unknown) float32.
    trace
        Trace of B^T W B times that covariance.
    """

    prior: Floats
    variance: Floats
    mean: Floats
    unknown: NDArray[np.intp]
    spread: Floats
    root: NDArray[np.float32]
    trace: float

    @property
    def covariance(self) -> NDArray[np.float32]:
        """S of the cells that were estimated, (unknown, unknown)."""
        # the triangle of R R^T, in place of R
        whole, _ = lapack.slauum(np.array(self.root).T, lower=1, overwrite_c=1)
        kernels.mirror(whole.T, covariance := np.empty_like(self.root, order="C"))
        return covariance

    @property
    def llr(self) -> Floats:
        """(cells,) extrinsic LLR = ln P(c=+1)/P(c=-1): what the look adds to what was known; 0 for known cells."""
        u, llr = self.unknown, np.zeros_like(self.mean)
        if not u.size:
            return llr
        part = np.empty(u.size)
        kernels.extrinsic(self.covariance, self.mean[u], self.prior[u], self.variance[u], part)
        llr[u] = part
        return llr

    @property
    def added(self) -> tuple[Floats, Floats]:
        """What the look adds to what was known, as a Gaussian: precision and it times mean, (cells,).

        Both are 0 for known cells.
        """
        precision, weighted = np.zeros_like(self.mean), np.zeros_like(self.mean)
        u, spread = self.unknown, self.spread
        precision[u] = np.maximum(1 / spread - 1 / self.variance[u], 0.0)
        weighted[u] = self.mean[u] / spread - self.prior[u] / self.variance[u]
        return precision, weighted


def equalise(look: Look, gain: float, noise: float, mean: Floats, variance: Floats) -> Estimate:
    """Estimate the cells.

    Parameters
    ----------
    look
        The pair.
    gain
        Gray levels of a wide array with all LEDs on, g.
    noise
        Variance of a pixel of the difference of the two frames, s^2.
    mean, variance
        (cells,) prior of each; a variance below `KNOWN` takes the cell for known.

    Returns
    -------
    Estimate
    """
    unknown = np.flatnonzero(variance >= KNOWN)
    m, v = mean.copy(), variance[unknown]
    if not unknown.size:
        return Estimate(mean, variance, m, unknown, v, np.zeros((0, 0), np.float32), 0.0)
    ratio = gain / noise
    known_too = look.gram @ mean.astype(np.float32)
    rhs = ratio * (look.seen - gain * (look.offset + known_too))[unknown]
    # (6) of Tuechler et al. 2002 in the cells: S = (g^2 / s^2 B^T B + V^-1)^-1, m = c + S B^T (d - g (B c + o)) g / s^2
    # K = L L^T, R = L^-T; LAPACK's own inverse of a triangle takes twice as long
    factor = _factor(look, unknown, ratio * gain, 1.0 / v)
    half = blas.strsm(1.0, factor, np.eye(len(factor), dtype=np.float32).T, lower=1, overwrite_b=1)
    root = half.T[: unknown.size, : unknown.size]
    m[unknown] += root @ (rhs.astype(np.float32) @ root)
    spread = np.einsum("ij,ij->i", root, root).astype(np.float64)
    # B^T B S g^2 / s^2 = I - V^-1 S
    trace = float((1.0 - spread / v).sum()) / max(ratio * gain, 1e-12)
    return Estimate(mean, variance, m, unknown, spread, root, trace)


def products(weighted: Weighted, look: Look, images: Floats, unknown: NDArray[np.intp], scale: float) -> Floats:
    """Products <a, b> of images before the light of cells that may be anything, which are noise to them.

    Parameters
    ----------
    weighted, look
        The pair.
    images
        (k, rows, columns), W^(1/2) on them.
    unknown
        Numbers of the cells that may be anything.
    scale
        g^2 / s^2.

    Returns
    -------
    (k, k)
    """
    # Woodbury: A^T (1 + g^2 / s^2 B B^T)^-1 A = A^T A - A^T B (B^T B + s^2 / g^2)^-1 B^T A, a matrix of cells
    flat = images.reshape(len(images), -1)
    whole = flat @ flat.T
    if not unknown.size:
        return np.asarray(whole)
    factor = _factor(look, unknown, scale, np.ones(unknown.size))
    seen = np.zeros((len(factor), len(images)), np.float32, order="F")
    seen[: unknown.size] = weighted.all_correlated(images)[unknown]
    half = blas.strsm(1.0, factor, seen, lower=1, overwrite_b=1)
    return np.asarray(whole - scale * half.T.astype(np.float64) @ half)


def _factor(look: Look, unknown: NDArray[np.intp], scale: float, inverse: Floats) -> NDArray[np.float32]:
    """L, lower triangular, of scale B^T B + V^-1 = L L^T of the unknown cells, V^-1 the diagonal `inverse`."""
    size = unknown.size + (PADDING if unknown.size % 64 == 0 else 0)
    matrix = kernels.precision(look.gram, unknown, scale, inverse, FLOOR, size)
    # transposed it is as LAPACK wants it, and nothing is copied
    factor, failed = lapack.spotrf(matrix.T, lower=1, clean=0, overwrite_a=1)
    if failed:
        raise np.linalg.LinAlgError("the equaliser's matrix is not positive definite")
    return np.asarray(factor)
