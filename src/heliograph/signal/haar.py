"""Hierarchical code: the 2D fast Haar wavelet transform of Nagura et al. 2010, equations (8) to (10).

The data matrix D holds +-1. Its quarter D11 becomes the lowest spatial frequencies of the pattern (high
priority), D12 and D21 the middle ones, D22 the highest (low priority). Blur takes the high frequencies first.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

LEVELS = 5
"""Luminance levels 0, 1/4, 1/2, 3/4, 1, counted 0 to 4."""


def haar_matrix(n: int) -> NDArray[np.int8]:
    """Matrix H of equation (9): sums of neighbours in the upper half, differences in the lower half.

    Parameters
    ----------
    n
        Even number of rows and columns.

    Returns
    -------
    (n, n) int8 array of -1, 0, 1; ``H @ H.T == 2 I``.
    """
    if n < 2 or n % 2:
        raise ValueError(f"the Haar transform needs an even size of at least 2, not {n}")
    pair = np.kron(np.eye(n // 2, dtype=np.int8), np.array([[1, 1]], dtype=np.int8))
    difference = np.kron(np.eye(n // 2, dtype=np.int8), np.array([[1, -1]], dtype=np.int8))
    return np.vstack([pair, difference])


def encode(d: ArrayLike) -> NDArray[np.uint8]:
    """Turn data matrices into patterns of luminance levels.

    Parameters
    ----------
    d
        (..., n, n) array of -1 and +1; n even.

    Returns
    -------
    (..., n, n) uint8, level k of 0 to 4 for the luminance x = k / 4.

    Raises
    ------
    ValueError
        The matrices are not square, of odd size, or hold anything else than -1 and +1.
    """
    data = _square(d)
    if not np.isin(data, (-1, 1)).all():
        raise ValueError("a data matrix holds -1 and +1 only")
    # (8) x' = 1/2 H^T D H, in -2 .. 2; level = 4 x = x' + 2
    return (inverse_transform(data) + 2).astype(np.uint8)


def inverse_transform(d: ArrayLike) -> NDArray[np.float64]:
    """Turn coefficients into x' = 1/2 H^T D H of equation (8); real values, (..., n, n)."""
    s = _halves_to_pairs(_halves_to_pairs(_square(d).astype(np.float64), -1), -2)
    return 0.5 * s


def decode(x: ArrayLike) -> NDArray[np.float64]:
    """Soft data of received luminances, equation (10).

    Parameters
    ----------
    x
        (..., n, n) luminances x' about their mean: -2 to 2 for levels 0 to 4, or any multiple of that.

    Returns
    -------
    (..., n, n) float64; without noise `encode`'s input times that multiple (times 1 for x' = level - 2).
    Positive means d = +1, that is bit 0.
    """
    # (10) d^' = 1/2 H x' H^T
    return 0.5 * _pairs_to_halves(_pairs_to_halves(_square(x).astype(np.float64), -1), -2)


def decide(soft: ArrayLike) -> NDArray[np.int8]:
    """Threshold at 0 of equation (10)'s soft data: +1 where positive, else -1, int8 of the same shape."""
    return np.where(np.asarray(soft) > 0, 1, -1).astype(np.int8)


def _square(a: ArrayLike) -> NDArray[Any]:
    array = np.asarray(a)
    if array.ndim < 2 or array.shape[-1] != array.shape[-2] or array.shape[-1] % 2 or not array.shape[-1]:
        raise ValueError(f"expected (..., n, n) with n even, not an array of shape {array.shape}")
    return array


def _halves_to_pairs(a: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    """H^T along an axis: sums s and differences t of the two halves become the pairs s + t, s - t."""
    s, t = np.split(a, 2, axis)
    out = np.empty_like(a)
    view = np.moveaxis(out, axis, 0)
    s, t = np.moveaxis(s, axis, 0), np.moveaxis(t, axis, 0)
    view[0::2], view[1::2] = s + t, s - t
    return out


def _pairs_to_halves(a: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    """H along an axis: the pairs become their sums, then their differences."""
    view = np.moveaxis(a, axis, 0)
    return np.moveaxis(np.concatenate([view[0::2] + view[1::2], view[0::2] - view[1::2]]), 0, axis)
