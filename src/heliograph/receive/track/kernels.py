"""Compiled kernels of the tracker; `tests/oracles/occlusion_oracle.py` is the reference."""

import math

import numpy as np

from heliograph.base.compiled import compiled
from heliograph.receive.geometry.kernels import invert, median, smallest

# weights of a pair in the usual level of a line, and of a covered line: a slow post covers the rim for 45 pairs
LINE_RATE, COVERED_LINE_RATE = 0.1, 0.02


@compiled()
def preview(difference, total, middle, axes, before, lines, parameters):
    """Measure noise, recent changes and covered LEDs of a pair before the fit; renews `lines`.

    Returns noise, recent changes, and the result of `uncover`.
    """
    edge, width, bright, min_power, max_change, rate, min_visible, away, min_line_change = parameters
    noise = noise_outside(difference, middle[0], middle[1], edge)
    around = power_around(difference, noise, middle[0], middle[1], axes, width, before.shape[0])
    after = recent_change(before, around, min_power, bright, max_change, rate)
    return noise, after, uncover(total, middle, axes, away, min_line_change, after, min_visible, lines)


@compiled()
def uncover(image, middle, axes, away, least, change, min_visible, usual):
    """Mark LEDs that an object from a side covers, and renew the usual levels of the lines.

    Returns 1 for each uncovered LED, and whether any LED is covered.
    """
    side = change.shape[0]
    levels, across, sorted_levels = np.empty(side + 2), np.empty(side), np.empty(side)
    hidden, covered = np.empty((2, side + 2), np.bool_), np.zeros((2, side + 2), np.bool_)
    for k in range(side):
        column, row = 0.0, 0.0
        for n in range(side):
            column += change[n, k] >= min_visible
            row += change[k, n] >= min_visible
        # a line with less than half of the LEDs visible is hidden
        hidden[0, k + 1], hidden[1, k + 1] = column < 0.5 * side, row < 0.5 * side
    for axis in range(2):
        # the lines outside the array follow the outermost lines
        hidden[axis, 0], hidden[axis, side + 1] = hidden[axis, 1], hidden[axis, side]
    # columns first: posts are upright. Rows are sampled at uncovered columns
    for axis in range(2):
        count = np.int64(0)  # a plain 0 would compile a second `_medians`
        for k in range(side):
            if not (hidden[1 - axis, k + 1] or covered[1 - axis, k + 1]):
                across[count] = k - 0.5 * (side - 1)
                count += 1
        # too few samples along a line
        if count < 0.25 * side:
            continue
        _medians(image, middle, axes, axis, away, across, count, sorted_levels, levels)
        if math.isnan(usual[axis, 0]):
            for k in range(side + 2):
                usual[axis, k] = levels[k]
            continue
        _cover(levels, usual, least, hidden, covered, axis)
        for k in range(side + 2):
            # hidden LEDs return unchanged
            rate = 0.0 if hidden[axis, k] else COVERED_LINE_RATE if covered[axis, k] else LINE_RATE
            usual[axis, k] += rate * (levels[k] - usual[axis, k])
    uncovered, covers = np.empty((side, side)), False
    for i in range(side):
        for j in range(side):
            uncovered[i, j] = 0.0 if covered[0, j + 1] or covered[1, i + 1] else 1.0
            covers = covers or uncovered[i, j] == 0.0
    return uncovered, covers


@compiled()
def _medians(image, middle, axes, axis, away, places, count, sorted_levels, levels):
    """Compute the median of an image along each line of LEDs and along the lines outside, at `count` >= 1 places."""
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
            # insertion sort
            n = k
            while n > 0 and sorted_levels[n - 1] > level:
                sorted_levels[n] = sorted_levels[n - 1]
                n -= 1
            sorted_levels[n] = level
        levels[line] = sorted_levels[count // 2]


@compiled()
def _cover(levels, usual, least, hidden, covered, axis):
    """Mark consecutive hidden or changed lines, from the line outside the array inwards."""
    last = levels.size - 1
    for end in (0, last):
        step, k = (1, 0) if end == 0 else (-1, last)
        while 0 <= k <= last:
            # pose errors change the outermost LEDs: the line outside decides
            line = end if k == end + step else k
            if not (hidden[axis, line] or abs(levels[line] - usual[axis, line]) > least):
                break
            covered[axis, k] = True
            k += step
    if covered[axis, 0] and covered[axis, last]:
        # covered from both sides: no line would fix the pose
        covered[axis] = False


@compiled()
def noise_outside(change, x, y, least):
    """Return the standard deviation about 0 of the pixels outside a square, by the median; 0 if no pixel is outside."""
    sizes, count = np.empty(change.size), 0
    for i in range(change.shape[0]):
        for j in range(change.shape[1]):
            if max(abs(i - y), abs(j - x)) > least:
                sizes[count] = abs(change[i, j])
                count += 1
    # median |x| / Phi^-1(3/4)
    return 1.4826 * median(sizes[:count]) if count else 0.0


@compiled()
def power_within(change, x, y, most):
    """Return the sum of squares of the pixels in a square, and the number of pixels."""
    power, count = 0.0, 0
    for i in range(change.shape[0]):
        for j in range(change.shape[1]):
            if max(abs(i - y), abs(j - x)) <= most:
                power += change[i, j] ** 2
                count += 1
    return power, count


@compiled()
def recent_change(before, around, least, bright, most, rate):
    """Update the recent change of each LED by the power of one pair around it, relative to bright LEDs."""
    was, power, after = before.ravel(), around.ravel(), np.empty(before.size)
    usual = max(smallest(power.copy(), bright), least)
    for k in range(after.size):
        after[k] = was[k] + rate * (min(power[k] / usual, most) - was[k])
    return after.reshape(before.shape)


@compiled()
def power_around(change, noise, x, y, axes, width, side):
    """Average the power of a change, less the noise power, over squares around LEDs."""
    reach, bottom, right = width // 2, change.shape[0] - 1, change.shape[1] - 1
    power, rows, around = np.empty((side, side)), np.empty((side, side)), np.empty((side, side))
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
    return around


@compiled()
def predict(mean, covariance, dt, linear, quadratic, cubic):
    """Predict a state at a later time: F x + e, F P F^T + Q, where F adds dt times the rates to x, y and ln pitch.

    At a constant speed v, the rate r = v / Z of ln pitch becomes r / (1 - r dt): e, bounded for long gaps.
    """
    x, p = mean.copy(), covariance.copy()
    part = min(max(dt * x[7], -0.5), 0.5)
    x[2] -= math.log(1.0 - part) + part
    for k in range(3):
        x[k] += dt * x[5 + k]
        for n in range(x.size):
            p[k, n] += dt * p[5 + k, n]
    for n in range(x.size):
        for k in range(3):
            p[n, k] += dt * p[n, 5 + k]
        for k in range(x.size):
            p[n, k] += dt * (linear[n, k] + dt * (quadratic[n, k] + dt * cubic[n, k]))
    x[7] /= 1.0 - part
    return x, p


@compiled()
def project(mean, covariance, matrix, errors):
    """Predict a fit: H x and H P H^T + R; also returns H P."""
    shown, size = matrix.shape
    fit, spread, across = np.zeros(shown), errors.copy(), np.zeros((shown, size))
    for k in range(shown):
        for n in range(size):
            # H is nearly empty
            if matrix[k, n] != 0.0:
                fit[k] += matrix[k, n] * mean[n]
                for i in range(size):
                    across[k, i] += matrix[k, n] * covariance[n, i]
    for k in range(shown):
        for n in range(shown):
            for i in range(size):
                spread[k, n] += across[k, i] * matrix[n, i]
    return fit, spread, across


@compiled()
def condition(mean, covariance, matrix, errors, vector, posterior):
    """Update a state by a fit z of covariance C: K = P H^T S^-1, x + K (z - H x), P + K (C - S) K^T."""
    fit, spread, across = project(mean, covariance, matrix, errors)
    shown, size = matrix.shape
    precision, gain, change = np.empty((shown, shown)), np.zeros((shown, size)), np.zeros((shown, size))
    invert(spread, precision)
    for k in range(shown):
        for n in range(shown):
            for i in range(size):
                gain[k, i] += precision[k, n] * across[n, i]
    x, p = mean.copy(), covariance.copy()
    for k in range(shown):
        for i in range(size):
            x[i] += gain[k, i] * (vector[k] - fit[k])
            for n in range(shown):
                change[k, i] += (posterior[k, n] - spread[k, n]) * gain[n, i]
    for k in range(shown):
        for i in range(size):
            for j in range(size):
                p[i, j] += 0.5 * (gain[k, i] * change[k, j] + gain[k, j] * change[k, i])
    return x, p
