"""Hierarchical code: the 2D fast Haar wavelet transform by Nagura et al. 2010, equations (8) to (10).

The data matrix D contains -1 and +1. Quarter D11 sets the lowest spatial frequencies in the pattern (high priority),
D12 and D21 the middle frequencies, D22 the highest (low priority). Blur attenuates the high frequencies first.
Section 6.1 defines the code.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray


def encode(d: ArrayLike) -> NDArray[np.uint8]:
    """Transform data matrices, (..., n, n) with values -1 and +1, to uint8 luminance levels 0 to 4."""
    # (8) x' = 1/2 H^T D H, in -2 .. 2; level = 4 x = x' + 2
    return (inverse_transform(d) + 2).astype(np.uint8)


def inverse_transform(d: ArrayLike) -> NDArray[np.float64]:
    """Return x' = 1/2 H^T D H by equation (8) for real matrices D, (..., n, n) with n even; the inverse of `decode`.

    H is the matrix in equation (9): sums of neighbours in the upper half, differences in the lower half.
    """
    # (8) x' = 1/2 H^T D H
    return 0.5 * _halves_to_pairs(_halves_to_pairs(_square(d).astype(np.float64), -1), -2)


def decode(x: ArrayLike) -> NDArray[np.float64]:
    """Transform received luminances to soft data, equation (10); positive values mean d = +1, bit 0.

    A gain on the luminances x' = level - 2, (..., n, n), is a gain on the result.
    """
    # (10) d^' = 1/2 H x' H^T
    return 0.5 * _pairs_to_halves(_pairs_to_halves(_square(x).astype(np.float64), -1), -2)


def _square(a: ArrayLike) -> NDArray[Any]:
    array = np.asarray(a)
    if array.ndim < 2 or array.shape[-1] != array.shape[-2] or array.shape[-1] % 2 or not array.shape[-1]:
        raise ValueError(f"expected (..., n, n) with n even, not an array of shape {array.shape}")
    return array


def _halves_to_pairs(a: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    """Apply H^T along an axis: the halves s and t become the pairs s + t, s - t."""
    s, t = np.split(a, 2, axis)
    out = np.empty_like(a)
    view = np.moveaxis(out, axis, 0)
    s, t = np.moveaxis(s, axis, 0), np.moveaxis(t, axis, 0)
    view[0::2], view[1::2] = s + t, s - t
    return out


def _pairs_to_halves(a: NDArray[np.float64], axis: int) -> NDArray[np.float64]:
    """Apply H along an axis: the sums of all pairs, followed by the differences."""
    view = np.moveaxis(a, axis, 0)
    return np.moveaxis(np.concatenate([view[0::2] + view[1::2], view[0::2] - view[1::2]]), 0, axis)
