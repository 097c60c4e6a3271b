"""Compiled kernels of observations: symbols' images, noise weights, and the background of pairs.

Symbols come in the order of `PacketFormat.split`: the quarters D11, D12, D21 and D22 of the data matrix, row by row.
Four symbols at the same position in the quarters are the Haar transform of a square of 2 x 2 LEDs, so the kernels
transform square by square. LEDs come in the order of `geometry.kernels.footprints`.
`tests/oracles/observe_oracle.py` states the same with full matrices.
"""

import math

import numpy as np

from heliograph.base.arrays import RCOND
from heliograph.base.compiled import compiled
from heliograph.receive.geometry.kernels import add_image


@compiled(inline="always")
def _haar(a, b, c, d):
    """Transform a square of LEDs (0, 0), (0, 1), (1, 0), (1, 1) to four symbols: 1/4 H t H^T."""
    q = np.float32(0.25)  # float32 keeps the precision of the sums
    return q * (a + b + c + d), q * (a - b + c - d), q * (a + b - c - d), q * (a - b - c + d)


@compiled()
def correlate(image, across, down, first, out):
    """Correlate an image with the image of each symbol: B^T image."""
    squares, width = across.shape[0] // 4, across.shape[1]
    rows, cols = image.shape
    led = np.empty(4)
    for q in range(squares):
        for k in range(4):
            n = 4 * q + k
            x, y, total = first[n, 0], first[n, 1], 0.0
            for i in range(max(0, -y), min(width, rows - y)):
                line = 0.0
                for j in range(max(0, -x), min(width, cols - x)):
                    line += image[y + i, x + j] * across[n, j]
                total += line * down[n, i]
            led[k] = total
        out[q], out[squares + q], out[2 * squares + q], out[3 * squares + q] = _haar(led[0], led[1], led[2], led[3])


@compiled()
def match_symbols(difference, offset, root, first, last, matched, offset_matched):
    """Compute B^T d and B^T o of a whitened pair, B being the mean of two frames, and the inner products of d and o."""
    other = np.empty_like(matched)
    for image, out in ((difference, matched), (offset, offset_matched)):
        correlate(image, first[0], first[1], first[2], out)
        correlate(image, last[0], last[1], last[2], other)
        for k in range(out.shape[0]):
            out[k] = 0.5 * (out[k] + other[k])
    cross, offset_power, power, pixels = 0.0, 0.0, 0.0, 0
    for i in range(root.shape[0]):
        for j in range(root.shape[1]):
            d, o = difference[i, j], offset[i, j]
            cross, offset_power, power = cross + d * o, offset_power + o * o, power + d * d
            pixels += root[i, j] > 0
    return cross, offset_power, power, pixels


@compiled()
def correlate_all(images, across, down, first, out):
    """Correlate many images, (rows, columns, images), with the image of each symbol."""
    squares, width = across.shape[0] // 4, across.shape[1]
    rows, cols, count = images.shape
    led, line = np.empty((4, count)), np.empty(count)
    for q in range(squares):
        for k in range(4):
            n = 4 * q + k
            x, y = first[n, 0], first[n, 1]
            led[k] = 0.0
            for i in range(max(0, -y), min(width, rows - y)):
                line[:] = 0.0
                for j in range(max(0, -x), min(width, cols - x)):
                    for m in range(count):
                        line[m] += images[y + i, x + j, m] * across[n, j]
                for m in range(count):
                    led[k, m] += line[m] * down[n, i]
        for m in range(count):
            a, b, c, d = _haar(led[0, m], led[1, m], led[2, m], led[3, m])
            out[q, m], out[squares + q, m], out[2 * squares + q, m], out[3 * squares + q, m] = a, b, c, d


@compiled()
def leds_of(symbols):
    """Transform symbols to levels of LEDs about the mean, (n n,): t = 1/4 H^T D H."""
    squares = symbols.shape[0] // 4
    out = np.empty(4 * squares)
    for q in range(squares):
        a, b, c, d = symbols[q], symbols[squares + q], symbols[2 * squares + q], symbols[3 * squares + q]
        out[4 * q], out[4 * q + 1], out[4 * q + 2], out[4 * q + 3] = _haar(a, b, c, d)
    return out


@compiled()
def symbols_of(leds):
    """Transform LEDs to symbols, (n n,), the inverse of `leds_of`: D = H t H^T."""
    squares = leds.shape[0] // 4
    out = np.empty(4 * squares)
    for q in range(squares):
        a, b, c, d = _haar(leds[4 * q], leds[4 * q + 1], leds[4 * q + 2], leds[4 * q + 3])
        out[q], out[squares + q], out[2 * squares + q], out[3 * squares + q] = 4.0 * a, 4.0 * b, 4.0 * c, 4.0 * d
    return out


@compiled()
def spread(light, first, out):
    """Expand the light of LEDs by column or by row to the window; LEDs at the same position of squares are adjacent."""
    squares = light.shape[0] // 4
    out[:] = 0.0
    for k in range(light.shape[0]):
        row = out[k % 4 * squares + k // 4]
        for i in range(max(0, -first[k]), min(light.shape[1], out.shape[1] - first[k])):
            row[first[k] + i] = light[k, i]


@compiled()
def gram(across, down, out):
    """Compute B^T B: <led_i, led_j> = <across_i, across_j> <down_i, down_j>, Haar transformed on both sides."""
    squares = across.shape[0] // 4
    for i in range(across.shape[0]):
        x, y, row = across[i], down[i], out[i]
        for p in range(squares):
            a, b, c, d = p, p + squares, p + 2 * squares, p + 3 * squares
            row[a], row[b], row[c], row[d] = _haar(x[a] * y[a], x[b] * y[b], x[c] * y[c], x[d] * y[d])
    for q in range(squares):
        a, b, c, d = out[q], out[q + squares], out[q + 2 * squares], out[q + 3 * squares]
        for j in range(across.shape[0]):
            a[j], b[j], c[j], d[j] = _haar(a[j], b[j], c[j], d[j])


@compiled()
def add_light(across, down, first, out):
    """Add B, the light of each symbol on each pixel, (rows, columns, symbols)."""
    rows, cols, count = out.shape
    squares, width = count // 4, across.shape[1]
    for n in range(count):
        x, y, q, k = first[n, 0], first[n, 1], n // 4, n % 4
        a, b, c, d = _haar(1.0 * (k == 0), 1.0 * (k == 1), 1.0 * (k == 2), 1.0 * (k == 3))
        for i in range(max(0, -y), min(width, rows - y)):
            for j in range(max(0, -x), min(width, cols - x)):
                value = down[n, i] * across[n, j]
                pixel = out[y + i, x + j]
                pixel[q] += a * value
                pixel[squares + q] += b * value
                pixel[2 * squares + q] += c * value
                pixel[3 * squares + q] += d * value


@compiled()
def add_information(gram, levels, weight, out):
    """Add a pair's information on the LEDs: weight l_i l_j <led_i, led_j>, with 16 T G T^T = <led_i, led_j>."""
    squares, count = gram.shape[0] // 4, gram.shape[0]
    rows = np.empty((4, count), np.float32)
    for p in range(squares):
        a, b, c, d = gram[p], gram[squares + p], gram[2 * squares + p], gram[3 * squares + p]
        for j in range(count):
            rows[0, j], rows[1, j], rows[2, j], rows[3, j] = _haar(a[j], b[j], c[j], d[j])
        for k in range(4):
            row, into, scale = rows[k], out[4 * p + k], 16 * weight * levels[4 * p + k]
            for q in range(squares):
                x, y, z, w = _haar(row[q], row[squares + q], row[2 * squares + q], row[3 * squares + q])
                m = 4 * q
                into[m] += scale * levels[m] * x
                into[m + 1] += scale * levels[m + 1] * y
                into[m + 2] += scale * levels[m + 2] * z
                into[m + 3] += scale * levels[m + 3] * w


@compiled()
def weight_roots(light, first, lit, dark, ring, out):
    """Compute roots of weights of columns or rows, W = lit / s^2, s^2 = dark + (lit - dark) f, f the light 0 to 1."""
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
def whiten(lit, dark, ring, faded, covered_x, covered_y, gains, levels, difference, middle, first, last, out):
    """Divide the pixels of a pair, and the light of the LEDs on each pixel, by the standard deviation of the noise."""
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
    # o = l_1 A_1 1 - l_2 A_2 1, exactly 0 for an array at rest
    other, leds = np.zeros((rows, cols)), np.ones(first_x.shape[0])
    add_image(levels[0] * leds, first_x, first_y, first[2], offset)
    add_image(levels[1] * leds, last_x, last_y, last[2], other)
    offset -= other


@compiled()
def _weighted(light, columns, lines, gains, across, down):
    """Multiply footprints by the root of each pixel's weight and by the gains of the LEDs."""
    x, y, first = light
    for k in range(x.shape[0]):
        gain = gains[k] if gains.shape[0] else 1.0
        for i in range(x.shape[1]):
            j, m = first[k, 0] + i, first[k, 1] + i
            across[k, i] = gain * x[k, i] * columns[j] if 0 <= j < columns.shape[0] else 0.0
            down[k, i] = y[k, i] * lines[m] if 0 <= m < lines.shape[0] else 0.0


@compiled()
def measure_background(difference, light, max_light):
    """Sum the squares of a difference in pixels with little light of the array, and count the pixels."""
    lit, power, count = np.zeros(difference.shape), 0.0, 0
    add_image(np.ones(light[0].shape[0]), light[0], light[1], light[2], lit)
    for i in range(lit.shape[0]):
        for j in range(lit.shape[1]):
            if lit[i, j] < max_light:
                power += difference[i, j] ** 2
                count += 1
    return power, count


@compiled()
def compensate_motion(difference, total, first, last, gains, gain, x, y, out):
    """Subtract (x, y) . grad b from a difference, b = (total - gain (A_1 + A_2) w) / 2 being the background."""
    rows, cols = out.shape
    behind = total.copy()
    add_image(-gain * gains, first[0], first[1], first[2], behind)
    add_image(-gain * gains, last[0], last[1], last[2], behind)
    for i in range(rows):
        up, low = max(i - 1, 0), min(i + 1, rows - 1)
        for j in range(cols):
            left, right = max(j - 1, 0), min(j + 1, cols - 1)
            across, down = behind[i, right] - behind[i, left], behind[low, j] - behind[up, j]
            out[i, j] = difference[i, j] - 0.5 * (x * across / (right - left) + y * down / (low - up))


@compiled()
def measure_unevenness(total, first, last, gains, in_sight, covered_x, covered_y, inside, out):
    """Compute the residual of a pair's sum about the array's light and a plane in pixels inside the array."""
    rows, cols = total.shape
    visible, lit, brightest = np.zeros((rows, cols)), np.zeros((rows, cols)), 0.0
    add_image(in_sight, first[0], first[1], first[2], visible)
    add_image(0.5 * gains, first[0], first[1], first[2], lit)
    add_image(0.5 * gains, last[0], last[1], last[2], lit)
    for i in range(rows):
        for j in range(cols):
            if covered_x.shape[0]:
                visible[i, j] *= covered_x[j] * covered_y[i]
            brightest = max(brightest, visible[i, j])
    return fit_unevenness(total, lit, visible > inside * brightest, out)


@compiled()
def fit_unevenness(total, lit, inside, out):
    """Compute the residual of a sum about a plane and the array's light by least squares on the pixels inside."""
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
    # Gram-Schmidt: each column less the projections on earlier columns, and the sum less the projections on all
    for k in range(4):
        before = math.sqrt(_dot(columns[k], columns[k]))
        for earlier in range(k):
            _project_out(columns[earlier], columns[k])
        length = math.sqrt(_dot(columns[k], columns[k]))
        independent = length > RCOND * before  # False for light that is even in all pixels
        for n in range(count):
            columns[k, n] = columns[k, n] / length if independent else 0.0
        _project_out(columns[k], rest)
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
def _project_out(unit, values):
    """Subtract the projection on a vector of length 1, or 0."""
    along = _dot(unit, values)
    for n in range(values.shape[0]):
        values[n] -= along * unit[n]
