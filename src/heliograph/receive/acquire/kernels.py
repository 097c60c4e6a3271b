"""Hot loops of the detector; `reference.py` holds the same in plain NumPy, and a test holds the two together."""

import math

import numpy as np

from heliograph.base.arrays import TINY
from heliograph.base.compiled import compiled
from heliograph.receive.acquire.coarse import BLOCK_PX


@compiled(fastmath=True)
def combined(f0, f1, f2, f3, weights, out):
    """Weighted sum of four frames.

    Parameters
    ----------
    f0, f1, f2, f3
        (rows, columns) uint8 or uint16 gray levels.
    weights
        (4,) float32, one for each.
    out
        (rows, columns) float32, overwritten.
    """
    w0, w1, w2, w3 = weights[0], weights[1], weights[2], weights[3]
    for i in range(out.shape[0]):
        a, b, c, d, o = f0[i], f1[i], f2[i], f3[i], out[i]
        for j in range(out.shape[1]):
            o[j] = w0 * np.float32(a[j]) + w1 * np.float32(b[j]) + w2 * np.float32(c[j]) + w3 * np.float32(d[j])


@compiled(fastmath=True)
def combined_means(f0, f1, f2, f3, weights, size, out):
    """Mean magnitude over blocks of a weighted sum of four frames, which is not written down.

    Parameters
    ----------
    f0, f1, f2, f3
        (rows, columns) uint8 or uint16 gray levels.
    weights
        (4,) float32, one for each.
    size
        Pixels of a block's side; what a block lacks at the frames' end counts as 0.
    out
        (blocks down, blocks across) float32, overwritten.
    """
    rows, cols = f0.shape
    w0, w1, w2, w3 = weights[0], weights[1], weights[2], weights[3]
    sums = np.empty(out.shape[1] * size, np.float32)
    for bi in range(out.shape[0]):
        sums[:] = 0.0
        for i in range(bi * size, min(bi * size + size, rows)):
            a, b, c, d = f0[i], f1[i], f2[i], f3[i]
            for j in range(cols):
                sums[j] += abs(
                    w0 * np.float32(a[j]) + w1 * np.float32(b[j]) + w2 * np.float32(c[j]) + w3 * np.float32(d[j])
                )
        for bj in range(out.shape[1]):
            total = np.float32(0.0)
            for j in range(bj * size, bj * size + size):
                total += sums[j]
            out[bi, bj] = total / np.float32(size * size)


@compiled()
def integer_means(f0, f1, f2, f3, outer, inner, scale, out):
    """`combined_means` over blocks of `BLOCK_PX` of a (f0 - f3) + b (f1 - f2) of frames of 8 bits, in 16 bits.

    Parameters
    ----------
    f0, f1, f2, f3
        (rows, columns) uint8 gray levels.
    outer, inner
        a and b, int16; a block's column of weighted sums stays below 65536.
    scale
        float32 that the sums are multiplied by.
    out
        (blocks down, blocks across) float32, overwritten.
    """
    rows, cols = f0.shape
    sums = np.empty(out.shape[1] * BLOCK_PX, np.uint16)
    for bi in range(out.shape[0]):
        sums[:] = 0
        for i in range(bi * BLOCK_PX, min(bi * BLOCK_PX + BLOCK_PX, rows)):
            a, b, c, d = f0[i], f1[i], f2[i], f3[i]
            for j in range(cols):
                # each step is told its type: Numba would go on in 64 bits
                ends, within = np.int16(np.int16(a[j]) - np.int16(d[j])), np.int16(np.int16(b[j]) - np.int16(c[j]))
                whole = np.int16(np.int16(outer * ends) + np.int16(inner * within))
                sums[j] = np.uint16(sums[j] + np.uint16(np.int16(-whole) if whole < 0 else whole))
        for bj in range(out.shape[1]):
            # so many columns, known to the compiler, are added at once
            total = np.uint32(0)
            for j in range(BLOCK_PX):
                total = np.uint32(total + np.uint32(sums[bj * BLOCK_PX + j]))
            out[bi, bj] = np.float32(total) * scale / np.float32(BLOCK_PX * BLOCK_PX)


@compiled()
def middle_of_busy(means, spans, blank, busy, least, left):
    """Blank the blocks of arrays that are followed, and tell whether the others may be busy.

    Parameters
    ----------
    means
        (blocks down, blocks across) float32 mean changes, at least 0.
    spans
        (arrays, 4) int64: first row and column of each array's blocks, and those after its last, at least 0.
    blank
        What stands for a blanked block, below 0.
    busy
        Busy is what has more than so many times the median.
    least
        Least change of a busy block.
    left
        (blocks down, blocks across) float32, overwritten: the means, those of the arrays blanked.

    Returns
    -------
    Number of the block, sorted by its change, that has the median of those not blanked; -1 where none can be busy.
    """
    rows, columns = means.shape
    for i in range(rows):
        for j in range(columns):
            left[i, j] = means[i, j]
    for k in range(spans.shape[0]):
        for i in range(spans[k, 0], min(spans[k, 2], rows)):
            for j in range(spans[k, 1], min(spans[k, 3], columns)):
                left[i, j] = blank
    most, blanked = np.float32(0.0), 0
    for i in range(rows):
        for j in range(columns):
            most = max(most, left[i, j])
            blanked += left[i, j] == blank
    # those blanked come first
    middle, below = blanked + (rows * columns - blanked) // 2, 0
    if most <= least:
        return -1
    for i in range(rows):
        for j in range(columns):
            below += left[i, j] < most / np.float32(busy)
    # half of the blocks have more than most / busy, so none has more than busy times the median
    return middle if below > middle else -1


@compiled()
def _corner(integral, y, x):
    """Integral image between its grid points."""
    i, j = int(y), int(x)
    fy, fx = y - i, x - j
    top = integral[i, j] + fx * (integral[i, j + 1] - integral[i, j])
    low = integral[i + 1, j] + fx * (integral[i + 1, j + 1] - integral[i + 1, j])
    return top + fy * (low - top)


@compiled()
def _box(integral, y, x, height, width):
    return (
        _corner(integral, y + height, x + width)
        - _corner(integral, y, x + width)
        - _corner(integral, y + height, x)
        + _corner(integral, y, x)
    )


@compiled()
def _to_grid(start, step):
    """How far the next multiple of a step is from a start."""
    return math.ceil(start / step - TINY) * step - start


@compiled()
def _busy_ends(busy):
    """Number of the block after the last busy one in each row of blocks, 0 where none is."""
    ends = np.zeros(busy.shape[0], np.int64)
    for i in range(busy.shape[0]):
        for j in range(busy.shape[1]):
            if busy[i, j]:
                ends[i] = j + 1
    return ends


@compiled()
def search(total, square, busy, block, cells, sides, contrast, threshold, ring_width, grid, apart, corner, best):
    """Correlate what alternates with all headers over scale and position.

    Parameters
    ----------
    total, square
        (rows + 1, columns + 1) float64 integral images of the alternation and of its square.
    busy
        (blocks down, blocks across) bool, blocks in which an array may have its centre.
    block
        Pixels of a block's side.
    cells
        (identities, 16) cells of the headers, +-1.
    sides
        (sizes,) sides of arrays looked for, in px.
    contrast
        Least rms alternation in gray levels.
    threshold
        Least correlation, 0 to 1.
    ring_width
        Width of the ring around a candidate that must not alternate, as a fraction of its side.
    grid
        Step of the places as a fraction of the side; at least a pixel.
    apart
        Least distance of two candidates along x or y, as a fraction of the larger one's side.
    corner
        (2,) x, y on the sensor of the first pixel: the grid is fixed to the sensor, whatever the window.
    best
        (count, 5), overwritten: score with the sign of the correlation, x, y, side, identity; the best first, of
        overlapping ones only the best.

    Returns
    -------
    Number of candidates written.
    """
    rows, cols = total.shape[0] - 1, total.shape[1] - 1
    sums, above, below = np.empty(16), np.empty(5), np.empty(5)
    ends = _busy_ends(busy)
    found = np.int64(0)  # of a plain 0 a second `_keep` would be compiled
    for k in range(sides.shape[0]):
        side = sides[k]
        step = max(1.0, grid * side)
        ring = ring_width * side
        cell = side / 4.0
        y = ring + _to_grid(corner[1], step)
        while y + side + ring < rows - 1:
            down = int((y + 0.5 * side) / block)
            x = ring + _to_grid(corner[0], step)
            while x + side + ring < cols - 1:
                across = int((x + 0.5 * side) / block)
                if across >= ends[down]:
                    break
                if not busy[down, across]:
                    x += step
                    continue
                energy = _box(square, y - ring, x - ring, side + 2 * ring, side + 2 * ring)
                if energy < contrast * contrast * side * side:
                    x += step
                    continue
                # neighbouring cells share their corners
                for j in range(5):
                    above[j] = _corner(total, y, x + j * cell)
                power = 0.0
                for i in range(4):
                    for j in range(5):
                        below[j] = _corner(total, y + (i + 1) * cell, x + j * cell)
                    for j in range(4):
                        value = below[j + 1] - below[j] - above[j + 1] + above[j]
                        sums[4 * i + j] = value
                        power += value * value
                    for j in range(5):
                        above[j] = below[j]
                # |<D, T>| <= |sums| 4 and |T| |D| = side sqrt(energy)
                bound = threshold * side * math.sqrt(energy)
                if 16.0 * power >= bound * bound:
                    for t in range(cells.shape[0]):
                        dot = 0.0
                        for i in range(16):
                            dot += cells[t, i] * sums[i]
                        if abs(dot) >= bound:
                            score = dot / (side * math.sqrt(energy))
                            found = _keep(best, found, apart, score, x + 0.5 * side, y + 0.5 * side, side, t)
                x += step
            y += step
    return found


@compiled()
def _keep(best, found, apart, score, x, y, side, identity):
    """Insert a candidate unless a better one lies on the same place; drop worse ones there."""
    i = 0
    while i < found:
        reach = apart * max(side, best[i, 3])
        if abs(best[i, 1] - x) < reach and abs(best[i, 2] - y) < reach:
            if abs(best[i, 0]) >= abs(score):
                return found
            for m in range(i, found - 1):
                _copy_row(best, m + 1, m)
            found -= 1
        else:
            i += 1
    place = found
    while place > 0 and abs(best[place - 1, 0]) < abs(score):
        place -= 1
    if place >= best.shape[0]:
        return found
    last = min(found, best.shape[0] - 1)
    for m in range(last, place, -1):
        _copy_row(best, m - 1, m)
    best[place, 0], best[place, 1], best[place, 2], best[place, 3], best[place, 4] = score, x, y, side, identity
    return min(found + 1, best.shape[0])


@compiled(inline="always")
def _copy_row(rows, source, target):
    """Copy a row, number by number: to assign whole rows takes long to compile, for the words of its errors."""
    for k in range(rows.shape[1]):
        rows[target, k] = rows[source, k]
