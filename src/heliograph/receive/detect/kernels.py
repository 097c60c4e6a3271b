"""Compiled loops of the detector; `tests/oracles/detect_oracle.py` is the reference in plain NumPy."""

import math

import numpy as np

from heliograph.base.arrays import TINY
from heliograph.base.compiled import compiled

BLOCK_PX = 8  # pixels of a side of a block: the smallest array
SINGLE_ERROR = 1e-5  # largest relative error of a product of 16 numbers in single precision, with a margin


@compiled(fastmath=True)
def combined(f0, f1, f2, f3, weights, out):
    """Compute the weighted sum of four frames."""
    w0, w1, w2, w3 = weights[0], weights[1], weights[2], weights[3]
    for i in range(out.shape[0]):
        a, b, c, d, o = f0[i], f1[i], f2[i], f3[i], out[i]
        for j in range(out.shape[1]):
            o[j] = w0 * np.float32(a[j]) + w1 * np.float32(b[j]) + w2 * np.float32(c[j]) + w3 * np.float32(d[j])


@compiled(fastmath=True)
def combined_means(f0, f1, f2, f3, weights, size, out):
    """Compute the mean magnitude of a weighted sum of four frames over blocks."""
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
    """Compute `combined_means` of a (f0 - f3) + b (f1 - f2) in 16 bits, of frames of 8 bits."""
    rows, cols = f0.shape
    sums = np.empty(out.shape[1] * BLOCK_PX, np.uint16)
    for bi in range(out.shape[0]):
        sums[:] = 0
        for i in range(bi * BLOCK_PX, min(bi * BLOCK_PX + BLOCK_PX, rows)):
            a, b, c, d = f0[i], f1[i], f2[i], f3[i]
            for j in range(cols):
                # explicit types, or Numba computes in 64 bits
                ends, within = np.int16(np.int16(a[j]) - np.int16(d[j])), np.int16(np.int16(b[j]) - np.int16(c[j]))
                change = np.int16(np.int16(outer * ends) + np.int16(inner * within))
                sums[j] = np.uint16(sums[j] + np.uint16(np.int16(-change) if change < 0 else change))
        for bj in range(out.shape[1]):
            # the compiler knows the number of columns
            total = np.uint32(0)
            for j in range(BLOCK_PX):
                total = np.uint32(total + np.uint32(sums[bj * BLOCK_PX + j]))
            out[bi, bj] = np.float32(total) * scale / np.float32(BLOCK_PX * BLOCK_PX)


@compiled()
def _corner(integral, y, x):
    """Interpolate an integral image."""
    i, j = int(y), int(x)
    fy, fx = y - i, x - j
    top = integral[i, j] + fx * (integral[i, j + 1] - integral[i, j])
    low = integral[i + 1, j] + fx * (integral[i + 1, j + 1] - integral[i + 1, j])
    return top + fy * (low - top)


@compiled()
def _box(integral, y, x, height, width):
    """Sum over a box."""
    return (
        _corner(integral, y + height, x + width)
        - _corner(integral, y, x + width)
        - _corner(integral, y + height, x)
        + _corner(integral, y, x)
    )


@compiled()
def _first_place(corner, margin, step, least):
    """Return the first place in an image from `least` on that lies a margin, and steps of the sensor, from a corner."""
    first = margin + (math.ceil(corner / step - TINY) * step - corner)
    return first + step * max(0.0, math.ceil((least - first) / step - TINY))


@compiled()
def _outer_box(integral, y, x, height, width):
    """Sum over the touched pixels of a box within the image."""
    top, low = max(0, math.floor(y)), min(integral.shape[0] - 1, math.ceil(y + height))
    left, right = max(0, math.floor(x)), min(integral.shape[1] - 1, math.ceil(x + width))
    return integral[low, right] - integral[top, right] - integral[low, left] + integral[top, left]


@compiled()
def _inner_box(integral, y, x, height, width):
    """Sum over the pixels within a box."""
    top, low = math.ceil(y), math.floor(y + height)
    left, right = math.ceil(x), math.floor(x + width)
    return integral[low, right] - integral[top, right] - integral[low, left] + integral[top, left]


@compiled(fastmath=True)
def _cell_sums(integral, y, x, cell, columns, rows, sums):
    """Sum over 4 x 4 cells, row by row; return the sum of squares. (5,) columns, (3, 5) rows are working memory."""
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
def _max_product(columns, sums, dots):
    """Multiply 16 sums with (16, headers) cells in single precision; return the largest magnitude."""
    dots[:] = 0.0
    for i in range(16):
        value, row = np.float32(sums[i]), columns[i]
        for t in range(dots.size):
            dots[t] += value * row[t]
    most = np.float32(0.0)
    for t in range(dots.size):
        most = max(most, abs(dots[t]))
    return most


@compiled()
def search(integrals, busy, cells, columns, sides, limits, ring_width, grid, corner, begin, max_work, best):
    """Correlate an alternation with all headers over scale and position; return counts, and candidates in `best`.

    `cells` (headers, 16) are the templates in float64, `columns` (16, headers) the same in float32.
    `limits` are contrast, correlation, imbalance and distance.
    """
    images, (contrast, threshold, _, _) = (integrals[0], integrals[1], integrals[2]), limits
    _, magnitude, square = images
    rows, cols = square.shape[0] - 1, square.shape[1] - 1
    memory = np.empty(5, np.int64), np.empty((3, 5)), np.empty(16), np.empty(cells.shape[0], np.float32)
    found = np.int64(0)  # of a plain 0 a second `_keep` would be compiled
    # in places compared, 6 ns each: sums over pixels; then exact sums, sums over cells, and headers by stages passed
    pixels_work, stages_work = 2, (8, 8 + 15, 8 + 15 + cells.shape[0] // 4)
    work = passed = compared = 0
    while passed < busy.size and work < max_work:
        down, across = divmod((begin + passed) % busy.size, busy.shape[1])
        passed += 1
        for k in range(sides.shape[0] if busy[down, across] else 0):
            side = sides[k]
            step = max(1.0, grid * side)
            ring = ring_width * side
            whole, least = side + 2 * ring, contrast * contrast * side * side
            filled = (1.0 - SINGLE_ERROR) * (threshold * side) ** 2
            # where places are dense, a quarter of the block at a time
            parts = 2 if 4 * step < BLOCK_PX else 1
            part = BLOCK_PX / parts
            for quarter in range(parts * parts):
                top, left = down * BLOCK_PX + quarter // parts * part, across * BLOCK_PX + quarter % parts * part
                work += 1
                if _outer_box(square, top - 0.5 * whole, left - 0.5 * whole, part + whole, part + whole) < least:
                    continue
                y = _first_place(corner[1], ring, step, top - 0.5 * side)
                while y + side + ring < rows - 1 and y + 0.5 * side < top + part:
                    x = _first_place(corner[0], ring, step, left - 0.5 * side)
                    while x + side + ring < cols - 1 and x + 0.5 * side < left + part:
                        work += 1
                        # sums over pixels are faster: touched pixels bound the energy, and |<D, T>| <= sum |D| is
                        # below the threshold where small lamps fill a part of the place
                        touched = _outer_box(square, y - ring, x - ring, whole, whole) >= least
                        work += pixels_work if touched else 0
                        if touched:
                            most = _outer_box(magnitude, y, x, side, side)
                            touched = most * most >= filled * _inner_box(square, y - ring, x - ring, whole, whole)
                        if touched:
                            place = y, x, side, ring
                            found, stages = _compare(images, cells, columns, place, limits, best, found, memory)
                            work += stages_work[stages]
                            compared += stages > 1
                        x += step
                    y += step
    return found, work, passed, compared


@compiled(inline="always")
def _compare(integrals, cells, columns, place, limits, best, found, memory):
    """Keep a square as a candidate for each similar header; return the number of passed stages too."""
    (total, magnitude, square), (y, x, side, ring), (corners, rows, sums, dots) = integrals, place, memory
    contrast, threshold, max_imbalance, min_distance = limits
    energy = _box(square, y - ring, x - ring, side + 2 * ring, side + 2 * ring)
    if energy < contrast * contrast * side * side:
        return found, 0
    size = side * math.sqrt(energy)
    bound = threshold * size
    # |<D, T>| <= sum |D| and |T| |D| = side sqrt(energy): lamps fill too little of a larger square
    whole = _box(magnitude, y, x, side, side)
    if whole < (1.0 - SINGLE_ERROR) * bound or abs(_box(total, y, x, side, side)) > max_imbalance * whole:
        return found, 0
    # |<D, T>| <= |sums| 4
    if 16.0 * _cell_sums(total, y, x, side / 4.0, corners, rows, sums) < bound * bound:
        return found, 1
    if _max_product(columns, sums, dots) >= (1.0 - SINGLE_ERROR) * bound:
        for t in range(cells.shape[0]):
            dot = 0.0
            for i in range(16):
                dot += cells[t, i] * sums[i]
            if abs(dot) >= bound:
                found = _keep(best, found, min_distance, dot / size, x + 0.5 * side, y + 0.5 * side, side, t)
    return found, 2


@compiled()
def _keep(best, found, min_distance, score, x, y, side, header):
    """Insert a candidate unless a better candidate lies on the same place; drop worse candidates there."""
    i = 0
    while i < found:
        reach = min_distance * max(side, best[i, 3])
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
    best[place, 0], best[place, 1], best[place, 2], best[place, 3], best[place, 4] = score, x, y, side, header
    return min(found + 1, best.shape[0])


@compiled(inline="always")
def _copy_row(rows, source, target):
    """Copy a row by numbers, as assignments of rows take long to compile."""
    for k in range(rows.shape[1]):
        rows[target, k] = rows[source, k]
