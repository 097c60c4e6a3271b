"""Hot loops of what pairs show of the background and of noise; `reference.py` says the same with whole matrices.

Pixels are weighted by the noise that each has. What moves behind the array, what changes beside it and how unevenly it
shines is told from the pairs themselves.
"""

import math

import numpy as np

from heliograph.base.arrays import RCOND
from heliograph.base.compiled import compiled


@compiled()
def weight_roots(light, first, lit, dark, ring, out):
    """Roots of the weights of a window's columns or rows, W = lit / s^2 with s^2 = dark + (lit - dark) f.

    f is the light of all LEDs together, 0 to 1.
    """
    out[:] = 0.0
    for k in range(light.shape[0]):
        for i in range(max(0, -first[k]), min(light.shape[1], out.shape[0] - first[k])):
            out[first[k] + i] += light[k, i]
    side = math.sqrt(light.shape[0])
    for j in range(out.shape[0]):
        f = min(out[j] / side, 1.0)
        inside = ring <= j < out.shape[0] - ring
        out[j] = math.sqrt(lit / (dark + (lit - dark) * f)) if inside else 0.0


@compiled()
def whitened(lit, dark, ring, faded, covered_x, covered_y, gains, levels, difference, middle, first, last, out):
    """Divide a pair's pixels, and the light that LEDs give them, by the roots of their noise."""
    root, white, offset, middle_x, middle_y, first_x, first_y, last_x, last_y = out
    rows, cols = difference.shape
    columns, lines = np.empty(cols), np.empty(rows)
    weight_roots(middle[0], middle[2][:, 0], lit, dark, ring, columns)
    weight_roots(middle[1], middle[2][:, 1], lit, dark, ring, lines)
    for j in range(cols):
        columns[j] *= faded * (covered_x[j] if covered_x.shape[0] else 1.0)
    for i in range(rows):
        lines[i] *= covered_y[i] if covered_y.shape[0] else 1.0
    _weighted(middle, columns, lines, gains, middle_x, middle_y)
    _weighted(first, columns, lines, gains, first_x, first_y)
    _weighted(last, columns, lines, gains, last_x, last_y)
    for i in range(rows):
        for j in range(cols):
            root[i, j] = lines[i] * columns[j]
            white[i, j] = root[i, j] * difference[i, j]
            offset[i, j] = 0.0
    # o = l_1 A_1 1 - l_2 A_2 1, none at all where nothing moves
    other = np.zeros((rows, cols))
    _add_all_on(first_x, first_y, first[2], levels[0], offset)
    _add_all_on(last_x, last_y, last[2], levels[1], other)
    offset -= other


@compiled()
def _weighted(light, columns, lines, gains, across, down):
    """Footprints times the root of each pixel's weight, and times the LEDs' gains."""
    x, y, first = light
    for k in range(x.shape[0]):
        gain = gains[k] if gains.shape[0] else 1.0
        for i in range(x.shape[1]):
            j, m = first[k, 0] + i, first[k, 1] + i
            across[k, i] = gain * x[k, i] * columns[j] if 0 <= j < columns.shape[0] else 0.0
            down[k, i] = y[k, i] * lines[m] if 0 <= m < lines.shape[0] else 0.0


@compiled()
def _add_all_on(across, down, first, level, out):
    """Add the image of all LEDs at one level."""
    rows, cols = out.shape
    width = across.shape[1]
    for n in range(across.shape[0]):
        x, y = first[n, 0], first[n, 1]
        for i in range(max(0, -y), min(width, rows - y)):
            w = level * down[n, i]
            for j in range(max(0, -x), min(width, cols - x)):
                out[y + i, x + j] += w * across[n, j]


@compiled()
def power_beside(difference, light, least):
    """Sum of the squares of a difference beside the array, and the number of pixels there."""
    whole, power, count = np.zeros(difference.shape), 0.0, 0
    _add_all_on(light[0], light[1], light[2], 1.0, whole)
    for i in range(whole.shape[0]):
        for j in range(whole.shape[1]):
            if whole[i, j] < least:
                power += difference[i, j] ** 2
                count += 1
    return power, count


@compiled()
def motion_compensated(difference, total, first, last, gains, gain, x, y, out):
    """Difference of a pair less (x, y) . grad b, b = (total - gain (A_1 + A_2) w) / 2 the background."""
    rows, cols = out.shape
    behind = total.copy()
    _add_leds(first, gains, -gain, behind)
    _add_leds(last, gains, -gain, behind)
    for i in range(rows):
        up, low = max(i - 1, 0), min(i + 1, rows - 1)
        for j in range(cols):
            left, right = max(j - 1, 0), min(j + 1, cols - 1)
            across, down = behind[i, right] - behind[i, left], behind[low, j] - behind[up, j]
            out[i, j] = difference[i, j] - 0.5 * (x * across / (right - left) + y * down / (low - up))


@compiled()
def unevenness(total, first, last, gains, in_sight, covered_x, covered_y, inside, out):
    """Residual of a pair's sum about the array's light and a plane; see `uneven`."""
    rows, cols = total.shape
    whole, lit, most = np.zeros((rows, cols)), np.zeros((rows, cols)), 0.0
    _add_leds(first, in_sight, 1.0, whole)
    _add_leds(first, gains, 0.5, lit)
    _add_leds(last, gains, 0.5, lit)
    for i in range(rows):
        for j in range(cols):
            if covered_x.shape[0]:
                whole[i, j] *= covered_x[j] * covered_y[i]
            most = max(most, whole[i, j])
    return uneven(total, lit, whole > inside * most, out)


@compiled()
def _add_leds(light, levels, factor, out):
    """Add the image of LEDs at levels of their own, times a factor."""
    across, down, first = light
    rows, cols = out.shape
    width = across.shape[1]
    for n in range(across.shape[0]):
        x, y = first[n, 0], first[n, 1]
        for i in range(max(0, -y), min(width, rows - y)):
            w = factor * levels[n] * down[n, i]
            for j in range(max(0, -x), min(width, cols - x)):
                out[y + i, x + j] += w * across[n, j]


@compiled()
def uneven(total, lit, inside, out):
    """Residual of a sum about the array's light and a plane, (a, 1, x, y), by least squares on the pixels inside."""
    rows, cols = total.shape
    count = 0
    for i in range(rows):
        for j in range(cols):
            count += inside[i, j]
    columns, rest, n = np.empty((4, count)), np.empty(count), 0
    for i in range(rows):
        for j in range(cols):
            out[i, j] = np.nan
            if inside[i, j]:
                columns[0, n], columns[1, n], columns[2, n], columns[3, n] = 1.0, i, j, lit[i, j]
                rest[n] = total[i, j]
                n += 1
    # Gram-Schmidt: each column less its part along those before it, and of the sum what none of them shows
    for k in range(4):
        before = math.sqrt(_dot(columns[k], columns[k]))
        for earlier in range(k):
            _take_off(columns[earlier], columns[k])
        length = math.sqrt(_dot(columns[k], columns[k]))
        known = length > RCOND * before  # else it says what others said: light that is even all over
        for n in range(count):
            columns[k, n] = columns[k, n] / length if known else 0.0
        _take_off(columns[k], rest)
    n = 0
    for i in range(rows):
        for j in range(cols):
            if inside[i, j]:
                out[i, j] = rest[n]
                n += 1
    return count


@compiled(inline="always")
def _dot(a, b):
    total = 0.0
    for n in range(a.shape[0]):
        total += a[n] * b[n]
    return total


@compiled(inline="always")
def _take_off(unit, values):
    """What lies along a vector of length 1, or 0, taken off."""
    along = _dot(unit, values)
    for n in range(values.shape[0]):
        values[n] -= along * unit[n]
