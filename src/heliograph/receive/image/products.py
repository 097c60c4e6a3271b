"""Products of rows of pixels, summed up along them, for hot loops: what normal equations are made of."""

import numpy as np

from heliograph.base.compiled import compiled
from heliograph.receive.image.cholesky import mirror

TOGETHER = 4
"""Sums of products that `add_products` takes at a time: they are written out there."""


@compiled()
def rows_for_products(count, cols):
    """Rows of pixels for `add_products`, which takes four of them at a time: those beyond the count are 0."""
    return np.zeros((-(-count // TOGETHER) * TOGETHER, cols))


@compiled(fastmath={"reassoc", "contract"})
def add_products(left, right, cols, out):
    """Add left right^T to `out`: its lower half.

    A sum alone waits for its last addition, each time; four of them do not wait for each other.
    """
    for k in range(out.shape[0]):
        for n in range(0, k + 1, TOGETHER):
            a, b, c, d = 0.0, 0.0, 0.0, 0.0
            for j in range(cols):
                x = left[k, j]
                a += x * right[n, j]
                b += x * right[n + 1, j]
                c += x * right[n + 2, j]
                d += x * right[n + 3, j]
            out[k, n] += a
            if n + 1 <= k:
                out[k, n + 1] += b
            if n + 2 <= k:
                out[k, n + 2] += c
            if n + 3 <= k:
                out[k, n + 3] += d


@compiled()
def take_apart(products, matrix, rhs):
    """Normal equations from sums of products of images and, in the last row, of the target with them."""
    size = matrix.shape[0]
    for k in range(size):
        rhs[k] = products[size, k]
        for n in range(k + 1):
            matrix[k, n] = products[k, n]
    mirror(matrix)
