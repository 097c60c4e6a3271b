"""Linear MMSE of all cells of a pair, what is known of them from elsewhere taken as a Gaussian prior."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from heliograph.receive.soft.look import Look

Floats = NDArray[np.float64]

KNOWN = 1e-3
"""Variance of a cell below which its light is subtracted and it is not estimated any more."""


@dataclass(frozen=True, slots=True)
class Estimate:
    """Cells of a look after equalising.

    Attributes
    ----------
    llr
        (cells,) extrinsic LLR = ln P(c=+1)/P(c=-1): what the look adds to what was known; 0 for known cells.
    precision
        (cells,) inverse of the variance of what the look adds; 0 for known cells.
    mean
        (cells,) posterior mean.
    trace
        Trace of B^T B times the posterior covariance.
    """

    llr: Floats
    precision: Floats
    mean: Floats
    trace: float


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
    m = mean.copy()
    if not unknown.size:
        return Estimate(np.zeros_like(m), np.zeros_like(m), m, 0.0)
    ratio = gain / noise
    known_too = look.gram @ mean.astype(np.float32)
    rhs = ratio * (look.seen - gain * (look.offset + known_too))[unknown]
    whole = unknown.size == m.size
    gram = look.gram if whole else look.gram[np.ix_(unknown, unknown)]
    # (6) of Tuechler et al. 2002 in the cells: S = (g^2 / s^2 B^T B + V^-1)^-1, m = c + S B^T (d - g (B c + o)) g / s^2
    matrix = np.float32(ratio * gain) * gram
    matrix[np.diag_indices(unknown.size)] += (1.0 / variance[unknown]).astype(np.float32)
    covariance = _inverse(matrix)
    spread = covariance.diagonal().astype(np.float64)
    m[unknown] += covariance @ rhs.astype(np.float32)
    # extrinsic: what of the posterior is not the prior; LLR = 2 mean / variance
    llr, precision = np.zeros_like(m), np.zeros_like(m)
    llr[unknown] = 2 * (m[unknown] / spread - mean[unknown] / variance[unknown])
    precision[unknown] = np.maximum(1 / spread - 1 / variance[unknown], 0.0)
    return Estimate(llr, precision, m, float(np.vdot(gram, covariance)))


def _inverse(matrix: NDArray[np.float32]) -> NDArray[np.float32]:
    """Inverse of a positive definite matrix."""
    factor, failed = lapack.spotrf(matrix, lower=1, overwrite_a=1)
    half, wrong = lapack.spotri(factor, lower=1, overwrite_c=1)
    if failed or wrong:
        raise np.linalg.LinAlgError("the equaliser's matrix is not positive definite")
    lower = np.tril(half)
    return np.asarray(lower + np.tril(lower, -1).T)
