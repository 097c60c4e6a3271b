"""Hot loops of the detector; `reference.py` holds the same in plain NumPy, and a test holds the two together."""

import math

import numpy as np

from heliograph.base.arrays import TINY
from heliograph.base.compiled import compiled

BLOCK_PX = 8
"""Pixels of a side of the blocks in which the search first asks whether anything alternates: the smallest array."""

BOXES_WORK, EXACT_WORK, CELLS_WORK = 2, 8, 15
"""Work of two sums over the whole pixels of a place, of its exact sums, and of summing its cells. The unit is one place
compared; that takes 6 ns on the machine measured on."""

HEADERS_AT_ONCE = 4
"""Headers that a place is correlated with in the time of looking at one."""


SINGLE = 1e-5
"""What single precision may take from a product of 16 numbers, and more, as a fraction of it."""


@compiled(fastmath=True)
def combined(f0, f1, f2, f3, weights, out):
    """Weighted sum of four frames."""
    w0, w1, w2, w3 = weights[0], weights[1], weights[2], weights[3]
    for i in range(out.shape[0]):
        a, b, c, d, o = f0[i], f1[i], f2[i], f3[i], out[i]
        for j in range(out.shape[1]):
            o[j] = w0 * np.float32(a[j]) + w1 * np.float32(b[j]) + w2 * np.float32(c[j]) + w3 * np.float32(d[j])


@compiled(fastmath=True)
def combined_means(f0, f1, f2, f3, weights, size, out):
    """Mean magnitude over blocks of a weighted sum of four frames, which is not written down."""
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
    """`combined_means` over blocks of `BLOCK_PX` of a (f0 - f3) + b (f1 - f2) of frames of 8 bits, in 16 bits."""
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
    """Blank the blocks of arrays that are followed, and tell whether the others may be busy."""
    rows, columns = means.shape
    for i in range(rows):
        for j in range(columns):
            left[i, j] = means[i, j]
    for k in range(spans.shape[0]):
        for i in range(spans[k, 0], min(spans[k, 2], rows)):
            for j in range(spans[k, 1], min(spans[k, 3], columns)):
                left[i, j] = blank
    # the most of each column first, of many at once
    tops, blanked = np.zeros(columns, np.float32), 0
    for i in range(rows):
        for j in range(columns):
            tops[j] = left[i, j] if left[i, j] > tops[j] else tops[j]
    most = np.float32(0.0)
    for j in range(columns):
        most = max(most, tops[j])
    if most <= least:
        return -1, True
    for i in range(rows):
        for j in range(columns):
            blanked += left[i, j] == blank
    # those blanked come first
    middle, below, still = blanked + (rows * columns - blanked) // 2, 0, 0
    for i in range(rows):
        for j in range(columns):
            below += left[i, j] < most / np.float32(busy)
            still += left[i, j] < least / busy
    # half of the blocks have more than most / busy, so none has more than busy times the median
    return middle if below > middle else -1, still > middle


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
def _first_place(first, step, least):
    """First place of a grid from `least` on."""
    return first + step * max(0.0, math.ceil((least - first) / step - TINY))


@compiled()
def _outer_box(integral, y, x, height, width):
    """Sum over the whole pixels that a box touches, as far as the image goes."""
    top, low = max(0, math.floor(y)), min(integral.shape[0] - 1, math.ceil(y + height))
    left, right = max(0, math.floor(x)), min(integral.shape[1] - 1, math.ceil(x + width))
    return integral[low, right] - integral[top, right] - integral[low, left] + integral[top, left]


@compiled()
def _inner_box(integral, y, x, height, width):
    """Sum over the whole pixels that lie within a box."""
    top, low = math.ceil(y), math.floor(y + height)
    left, right = math.ceil(x), math.floor(x + width)
    return integral[low, right] - integral[top, right] - integral[low, left] + integral[top, left]


@compiled(fastmath=True)
def _cell_sums(integral, y, x, cell, columns, rows, sums):
    """Sums over 4 x 4 cells, row by row; returns the sum of their squares. (5,) columns, (3, 5) rows are to work in."""
    parts, above, below = rows[0], rows[1], rows[2]
    # neighbouring cells share their corners
    for j in range(5):
        columns[j] = int(x + j * cell)
        parts[j] = x + j * cell - columns[j]
    power = 0.0
    for i in range(5):
        row = int(y + i * cell)
        part = y + i * cell - row
        upper, lower = integral[row], integral[row + 1]
        for j in range(5):
            k = columns[j]
            top = upper[k] + parts[j] * (upper[k + 1] - upper[k])
            below[j] = top + part * (lower[k] + parts[j] * (lower[k + 1] - lower[k]) - top)
        if i > 0:
            for j in range(4):
                value = below[j + 1] - below[j] - above[j + 1] + above[j]
                sums[4 * (i - 1) + j] = value
                power += value * value
        for j in range(5):
            above[j] = below[j]
    return power


@compiled(fastmath=True)
def _most_alike(columns, sums, dots):
    """Products of 16 sums with (16, headers) cells, all at once in single precision; returns the largest magnitude."""
    for t in range(dots.size):
        dots[t] = np.float32(0.0)
    for i in range(16):
        one, row = np.float32(sums[i]), columns[i]
        for t in range(dots.size):
            dots[t] += one * row[t]
    most = np.float32(0.0)
    for t in range(dots.size):
        most = max(most, abs(dots[t]))
    return most


@compiled()
def search(
    integrals,
    busy,
    block,
    cells,
    sides,
    contrast,
    threshold,
    one_sided,
    ring_width,
    grid,
    apart,
    corner,
    begin,
    limit,
    best,
):
    """Correlate what alternates with all headers over scale and position."""
    total, magnitude, square = integrals[0], integrals[1], integrals[2]
    rows, cols = total.shape[0] - 1, total.shape[1] - 1
    columns, room = (
        np.ascontiguousarray(cells.T).astype(np.float32),
        (np.empty(5, np.int64), np.empty((3, 5)), np.empty(16)),
    )
    dots = np.empty(cells.shape[0], np.float32)
    found = np.int64(0)  # of a plain 0 a second `_keep` would be compiled
    work = passed = compared = 0
    while passed < busy.size and work < limit:
        down, across = divmod((begin + passed) % busy.size, busy.shape[1])
        passed += 1
        for k in range(sides.shape[0] if busy[down, across] else 0):
            side = sides[k]
            step = max(1.0, grid * side)
            ring = ring_width * side
            whole, least = side + 2 * ring, contrast * contrast * side * side
            filled = (1.0 - SINGLE) * (threshold * side) ** 2
            # where places are dense, a quarter of the block at a time
            parts = 2 if 4 * step < block else 1
            part = block / parts
            for quarter in range(parts * parts):
                top, left = down * block + quarter // parts * part, across * block + quarter % parts * part
                work += 1
                if _outer_box(square, top - 0.5 * whole, left - 0.5 * whole, part + whole, part + whole) < least:
                    continue
                y = _first_place(ring + _to_grid(corner[1], step), step, top - 0.5 * side)
                while y + side + ring < rows - 1 and y + 0.5 * side < top + part:
                    x = _first_place(ring + _to_grid(corner[0], step), step, left - 0.5 * side)
                    while x + side + ring < cols - 1 and x + 0.5 * side < left + part:
                        work += 1
                        # whole pixels are summed faster: those that it touches have no less energy, and
                        # |<D, T>| <= sum |D| is below the threshold where small lamps fill a part of the place
                        touched = _outer_box(square, y - ring, x - ring, whole, whole) >= least
                        work += BOXES_WORK if touched else 0
                        if touched:
                            most = _outer_box(magnitude, y, x, side, side)
                            touched = most * most >= filled * _inner_box(square, y - ring, x - ring, whole, whole)
                        if touched:
                            place = y, x, side, ring
                            found, seen = _look(
                                (total, magnitude, square),
                                cells,
                                columns,
                                dots,
                                place,
                                least,
                                threshold,
                                one_sided,
                                apart,
                                best,
                                found,
                                room,
                            )
                            work += EXACT_WORK
                            work += CELLS_WORK if seen > 0 else 0
                            work += cells.shape[0] // HEADERS_AT_ONCE if seen > 1 else 0
                            compared += seen > 1
                        x += step
                    y += step
    return found, work, passed, compared


@compiled(inline="always")
def _look(integrals, cells, columns, dots, place, least, threshold, one_sided, apart, best, found, room):
    """Keep what lies in a square as a candidate for each header that it resembles."""
    (total, magnitude, square), (y, x, side, ring), (corners, rows, sums) = integrals, place, room
    energy = _box(square, y - ring, x - ring, side + 2 * ring, side + 2 * ring)
    if energy < least:
        return found, 0
    size = side * math.sqrt(energy)
    bound = threshold * size
    # |<D, T>| <= sum |D| and |T| |D| = side sqrt(energy): lamps fill too little of a larger square
    whole = _box(magnitude, y, x, side, side)
    if whole < (1.0 - SINGLE) * bound or abs(_box(total, y, x, side, side)) > one_sided * whole:
        return found, 0
    # |<D, T>| <= |sums| 4
    if 16.0 * _cell_sums(total, y, x, side / 4.0, corners, rows, sums) < bound * bound:
        return found, 1
    if _most_alike(columns, sums, dots) >= (1.0 - SINGLE) * bound:
        for t in range(cells.shape[0]):
            dot = 0.0
            for i in range(16):
                dot += cells[t, i] * sums[i]
            if abs(dot) >= bound:
                found = _keep(best, found, apart, dot / size, x + 0.5 * side, y + 0.5 * side, side, t)
    return found, 2


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
