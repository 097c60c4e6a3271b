"""Lines of LEDs in a sum, and changes from pattern to inverse, as machine code.

There are too many small steps each pair to take them in Python. Of the changes `reference.py` holds the same in plain
NumPy; a test holds the two together.

Steps of the Kalman filter, as machine code: on ten numbers a call of NumPy costs more than what it does.

`kalman_reference.py` holds the same in plain NumPy; a test holds the two together.
"""

import math

import numpy as np

from heliograph.base.compiled import compiled
from heliograph.receive.geometry.kernels import median, smallest

USUAL_RATE, COVERED_RATE = 0.1, 0.02
"""Weights of a pair in what a line usually shows: of lines as usual, and of covered ones.

What stays beside the array belongs to its surroundings after some 100 pairs. The slowest post that is drawn in
`benchmarks.poles` hides the outermost LEDs after 45.
"""

HIDDEN_BELOW = 0.5
"""Fraction of a line's LEDs in sight below which the line counts as hidden."""

LEAST_OPEN_LINES = 0.25
"""Least fraction of the lines across another that must be open for the other to show anything."""


@compiled()
def look(
    up,
    down,
    middle,
    axes,
    beside,
    before,
    least,
    width,
    bright,
    most,
    rate,
    sight_from,
    away,
    changed,
    usual,
    differs,
    total,
    after,
    sight,
    clear,
):
    """All that two frames of a pair show of an array before its pose is found in them."""
    for i in range(up.shape[0]):
        for j in range(up.shape[1]):
            differs[i, j], total[i, j] = up[i, j] - down[i, j], up[i, j] + down[i, j]
    noise = noise_beside(differs, middle[0], middle[1], beside)
    recent_change(before, differs, noise, middle[0], middle[1], axes, width, least, bright, most, rate, after)
    hidden, covered = False, False
    for u in range(after.shape[0]):
        for v in range(after.shape[1]):
            sight[u, v], clear[u, v] = 1.0 if after[u, v] >= sight_from else 0.0, 1.0
            hidden |= after[u, v] < sight_from
    uncover(total, middle, axes, away, changed, sight, usual, clear)
    for u in range(after.shape[0]):
        for v in range(after.shape[1]):
            covered |= clear[u, v] == 0.0
    return noise, hidden, covered


@compiled()
def uncover(image, middle, axes, away, least, in_sight, usual, clear):
    """Mark LEDs before which something came from a side, and renew what lines usually show."""
    side = in_sight.shape[0]
    levels, across, seen = np.empty(side + 2), np.empty(side), np.empty(side)
    hidden, covered = np.empty((2, side + 2), np.bool_), np.zeros((2, side + 2), np.bool_)
    for k in range(side):
        column, row = 0.0, 0.0
        for n in range(side):
            column += in_sight[n, k]
            row += in_sight[k, n]
        hidden[0, k + 1], hidden[1, k + 1] = column < HIDDEN_BELOW * side, row < HIDDEN_BELOW * side
    for axis in range(2):
        # the lines beside the array go with the outermost
        hidden[axis, 0], hidden[axis, side + 1] = hidden[axis, 1], hidden[axis, side]
    # columns first: posts are upright. Rows are looked at where no column is covered
    for axis in range(2):
        count = np.int64(0)  # of a plain 0 a second `_medians` would be compiled
        for k in range(side):
            if not (hidden[1 - axis, k + 1] or covered[1 - axis, k + 1]):
                across[count] = k - 0.5 * (side - 1)
                count += 1
        if count < LEAST_OPEN_LINES * side:
            continue
        _medians(image, middle, axes, axis, away, across, count, seen, levels)
        if math.isnan(usual[axis, 0]):
            for k in range(side + 2):
                usual[axis, k] = levels[k]
            continue
        _cover(levels, usual, least, hidden, covered, axis)
        for k in range(side + 2):
            # hidden LEDs come back as they were
            rate = 0.0 if hidden[axis, k] else COVERED_RATE if covered[axis, k] else USUAL_RATE
            usual[axis, k] += rate * (levels[k] - usual[axis, k])
    for i in range(side):
        for j in range(side):
            if covered[0, j + 1] or covered[1, i + 1]:
                clear[i, j] = 0.0


@compiled()
def _medians(image, middle, axes, axis, away, places, count, seen, levels):
    """Medians of an image along lines of LEDs and beside them, at so many places along each; they are at least one."""
    bottom, right = image.shape[0] - 1, image.shape[1] - 1
    last = levels.size - 1
    for line in range(last + 1):
        at = -away if line == 0 else away if line == last else line - 0.5 * last
        for k in range(count):
            x = min(max(middle[0] + at * axes[0, axis] + places[k] * axes[0, 1 - axis], 0.0), right - 1e-6)
            y = min(max(middle[1] + at * axes[1, axis] + places[k] * axes[1, 1 - axis], 0.0), bottom - 1e-6)
            i, j = int(y), int(x)
            down, over = y - i, x - j
            above = (1.0 - over) * image[i, j] + over * image[i, j + 1]
            below = (1.0 - over) * image[i + 1, j] + over * image[i + 1, j + 1]
            level = (1.0 - down) * above + down * below
            # sorted in
            n = k
            while n > 0 and seen[n - 1] > level:
                seen[n] = seen[n - 1]
                n -= 1
            seen[n] = level
        levels[line] = seen[count // 2]


@compiled()
def _cover(levels, usual, least, hidden, covered, axis):
    """Mark lines that are hidden or changed one after the other, from a line beside the array on."""
    last = levels.size - 1
    for end in (0, last):
        step, k = (1, 0) if end == 0 else (-1, last)
        while 0 <= k <= last:
            # the outermost LEDs seem to change where the pose is off: they go with the line beside them
            asked = end if k == end + step else k
            if not (hidden[axis, asked] or abs(levels[asked] - usual[axis, asked]) > least):
                break
            covered[axis, k] = True
            k += step
    if covered[axis, 0] and covered[axis, last]:
        # nothing would hold the array's place
        for k in range(last + 1):
            covered[axis, k] = False


@compiled()
def noise_beside(change, x, y, least):
    """Standard deviation about 0 of the pixels beside a square, by their median magnitude; 0 where there are none."""
    sizes, count = np.empty(change.size), 0
    for i in range(change.shape[0]):
        for j in range(change.shape[1]):
            if max(abs(i - y), abs(j - x)) > least:
                sizes[count] = abs(change[i, j])
                count += 1
    # median |x| / Phi^-1(3/4), as `image.robust` has it
    return 1.4826 * median(sizes[:count]) if count else 0.0


@compiled()
def power_within(change, x, y, most):
    """Sum of the squares of the pixels in a square, and their number."""
    power, count = 0.0, 0
    for i in range(change.shape[0]):
        for j in range(change.shape[1]):
            if max(abs(i - y), abs(j - x)) <= most:
                power += change[i, j] ** 2
                count += 1
    return power, count


@compiled()
def recent_change(before, change, noise, x, y, axes, width, least, bright, most, rate, out):
    """Recent change of each LED, with that of one more pair; see `sight.recent_change`."""
    side = before.shape[0]
    around, powers = np.empty((side, side)), np.empty(side * side)
    power_around(change, noise, x, y, axes, width, around)
    for u in range(side):
        for v in range(side):
            powers[u * side + v] = around[u, v]
    others = max(smallest(powers, bright), least)
    for u in range(side):
        for v in range(side):
            shown = min(around[u, v] / others, most)
            out[u, v] = before[u, v] + rate * (shown - before[u, v])


@compiled()
def power_around(change, noise, x, y, axes, width, around):
    """Mean power of a change over the squares about LEDs, less that of its noise."""
    side, reach = around.shape[0], width // 2
    bottom, right = change.shape[0] - 1, change.shape[1] - 1
    power, rows = np.empty((side, side)), np.empty((side, side))
    for u in range(side):
        for v in range(side):
            along, down = v - 0.5 * (side - 1), u - 0.5 * (side - 1)
            px = min(max(x + along * axes[0, 0] + down * axes[0, 1], 0.0), right - 1e-6)
            py = min(max(y + along * axes[1, 0] + down * axes[1, 1], 0.0), bottom - 1e-6)
            i, j = int(py), int(px)
            total = 0.0
            for a in range(2):
                for b in range(2):
                    part = (py - i if a else 1.0 - py + i) * (px - j if b else 1.0 - px + j)
                    total += part * max(change[i + a, j + b] ** 2 - noise**2, 0.0)
            power[u, v] = total
    # a mean over rows, then over columns
    for u in range(side):
        for v in range(side):
            total = 0.0
            for k in range(v - reach, v + reach + 1):
                total += power[u, -1 - k if k < 0 else 2 * side - 1 - k if k >= side else k]
            rows[u, v] = total
    for u in range(side):
        for v in range(side):
            total = 0.0
            for k in range(u - reach, u + reach + 1):
                total += rows[-1 - k if k < 0 else 2 * side - 1 - k if k >= side else k, v]
            around[u, v] = total / (width * width)


@compiled()
def predict(mean, covariance, dt, linear, quadratic, cubic):
    """State at a later time: x = F x, P = F P F^T + Q, where F adds dt times a rate to each of the first three."""
    x, p = mean.copy(), covariance.copy()
    size = x.shape[0]
    for k in range(3):
        x[k] += dt * x[5 + k]
        for n in range(size):
            p[k, n] += dt * p[5 + k, n]
    for n in range(size):
        for k in range(3):
            p[n, k] += dt * p[n, 5 + k]
        for k in range(size):
            p[n, k] += dt * linear[n, k] + dt**2 * quadratic[n, k] + dt**3 * cubic[n, k]
    return x, p


@compiled()
def expected(mean, covariance, h, variances):
    """What a fit will show: H x, H P H^T + R."""
    shown, size = h.shape
    z, s, across = np.zeros(shown), np.zeros((shown, shown)), np.zeros((shown, size))
    for k in range(shown):
        for n in range(size):
            # H is nearly empty
            if h[k, n] != 0.0:
                z[k] += h[k, n] * mean[n]
                for i in range(size):
                    across[k, i] += h[k, n] * covariance[n, i]
    for k in range(shown):
        s[k, k] = variances[k]
        for n in range(shown):
            for i in range(size):
                s[k, n] += across[k, i] * h[n, i]
    return z, s, across


@compiled()
def condition(mean, covariance, h, variances, vector, fitted):
    """State given the posterior of what a fit shows: K = P H^T S^-1; x += K (z - H x); P += K (C - S) K^T."""
    z, s, gain = expected(mean, covariance, h, variances)
    shown, size = h.shape
    less = np.empty((shown, shown))
    for k in range(shown):
        for n in range(shown):
            less[k, n] = fitted[k, n] - s[k, n]
    _divide(s, gain)
    x, p = mean.copy(), np.empty((size, size))
    turned = np.zeros((shown, size))
    for k in range(shown):
        for i in range(size):
            x[i] += gain[k, i] * (vector[k] - z[k])
            for n in range(shown):
                turned[k, i] += less[k, n] * gain[n, i]
    for i in range(size):
        for j in range(i + 1):
            total = 0.5 * (covariance[i, j] + covariance[j, i])
            for k in range(shown):
                total += 0.5 * (gain[k, i] * turned[k, j] + gain[k, j] * turned[k, i])
            p[i, j] = p[j, i] = total
    return x, p


@compiled()
def _divide(matrix, rhs):
    """Solve S X = B in place of B, (5, m), for a symmetric S, as S = L D L^T; S is overwritten."""
    size = matrix.shape[0]
    for k in range(size):
        for n in range(k):
            # D sits on the diagonal, L below it
            matrix[k, k] -= matrix[k, n] ** 2 * matrix[n, n]
        for i in range(k + 1, size):
            for n in range(k):
                matrix[i, k] -= matrix[i, n] * matrix[n, n] * matrix[k, n]
            matrix[i, k] /= matrix[k, k]
    for column in range(rhs.shape[1]):
        for k in range(size):
            for n in range(k):
                rhs[k, column] -= matrix[k, n] * rhs[n, column]
        for k in range(size - 1, -1, -1):
            rhs[k, column] /= matrix[k, k]
            for n in range(k + 1, size):
                rhs[k, column] -= matrix[n, k] * rhs[n, column]
