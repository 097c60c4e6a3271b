"""Numba kernel for successive-cancellation list decoding (Tal and Vardy 2015), min-sum, LLR metrics.

Level s of a path has 2^s values at 2^s to 2^(s + 1) - 1; level n are the received LLRs.
"""

import numpy as np
from numpy.typing import NDArray

from heliograph.base.compiled import compiled


@compiled()
def decode_lists(llr: NDArray[np.float32], frozen: NDArray[np.bool_], most: int) -> NDArray[np.uint8]:
    """Decode blocks (n, N); return the bits of the paths, best first, (n, most, N)."""
    blocks, size = llr.shape
    found = np.zeros((blocks, most, size), np.uint8)
    soft, left = np.empty((most, 2 * size), np.float32), np.empty((most, 2 * size), np.uint8)
    bits, metric = np.empty((most, size), np.uint8), np.empty(most, np.float32)
    sums, costs = np.empty(2 * size, np.uint8), np.empty(2 * most, np.float32)
    kept, free, order = np.empty(2 * most, np.bool_), np.empty(most, np.int64), np.empty(2 * most, np.int64)
    for block in range(blocks):
        paths, metric[0] = 1, 0
        for path in range(most):
            for i in range(size):
                soft[path, size + i] = llr[block, i]
        for leaf in range(size):
            for path in range(paths):
                _update_soft(soft[path], left[path], leaf, size)
                value = soft[path, 1]
                costs[2 * path] = metric[path] - min(value, np.float32(0))
                costs[2 * path + 1] = metric[path] + max(value, np.float32(0))
            if frozen[leaf]:
                for path in range(paths):
                    metric[path], bits[path, leaf] = costs[2 * path], 0
            else:
                _sort(costs, order, 2 * paths)
                for place in range(2 * paths):
                    kept[order[place]] = place < most
                old, vacant = paths, 0
                for path in range(old):
                    if not (kept[2 * path] or kept[2 * path + 1]):
                        free[vacant] = path
                        vacant += 1
                for path in range(old):
                    first = 0 if kept[2 * path] else 1
                    if not kept[2 * path + first]:
                        continue
                    if kept[2 * path] and kept[2 * path + 1]:
                        if vacant:
                            vacant -= 1
                            target = free[vacant]
                        else:
                            target, paths = paths, paths + 1
                        for i in range(size):
                            soft[target, i], left[target, i] = soft[path, i], left[path, i]
                            bits[target, i] = bits[path, i]
                        metric[target], bits[target, leaf] = costs[2 * path + 1], 1
                    metric[path], bits[path, leaf] = costs[2 * path + first], first
            for path in range(paths):
                _update_left(left[path], bits[path, leaf], leaf, sums)
        _sort(metric, order, paths)
        for place in range(paths):
            for i in range(size):
                found[block, place, i] = bits[order[place], i]
    return found


@compiled()
def _sort(values: NDArray[np.float32], order: NDArray[np.int64], count: int) -> None:
    """Store the indices of the first values in ascending order; for a few values, compiled faster than argsort."""
    for i in range(count):
        place = i
        while place and values[order[place - 1]] > values[i]:
            order[place] = order[place - 1]
            place -= 1
        order[place] = i


@compiled()
def _update_soft(soft: NDArray[np.float32], left: NDArray[np.uint8], leaf: int, size: int) -> None:
    """Compute the LLR of a leaf from the levels above that changed."""
    half = size // 2
    while leaf and half > 1 and leaf % half:
        half //= 2
    while half:
        for i in range(half):
            a, b = soft[2 * half + i], soft[3 * half + i]
            if leaf & half:
                soft[half + i] = b - a if left[half + i] else b + a
            else:
                small = min(abs(a), abs(b))
                soft[half + i] = small if (a < 0) == (b < 0) else -small
        half //= 2


@compiled()
def _update_left(left: NDArray[np.uint8], bit: int, leaf: int, sums: NDArray[np.uint8]) -> None:
    """Store the partial sums of the largest subtree that a leaf completes."""
    sums[0], half = bit, 1
    while leaf & half:
        for i in range(half):
            sums[half + i] = sums[i]
            sums[i] ^= left[half + i]
        half *= 2
    if 2 * half <= len(left):
        for i in range(half):
            left[half + i] = sums[i]
