"""Hot loops of what pairs show of their symbols; `reference.py` says the same with whole matrices.

Symbols come in the order in which `PacketFormat.split` gives them: the quarters D11, D12, D21 and D22 of the data
matrix, row by row. The four symbols of equal place in their quarters are the Haar transform of one square of 2 x 2
LEDs, so the transform of a matrix of LEDs goes square by square. LEDs come in the order of `image.kernels.footprints`.
"""

import numpy as np

from heliograph.base.compiled import compiled


@compiled(inline="always")
def _haar(a, b, c, d):
    """A square of LEDs (0, 0), (0, 1), (1, 0), (1, 1) to its four symbols: 1/4 H t H^T."""
    q = np.float32(0.25)  # which leaves the sums in their own precision
    return q * (a + b + c + d), q * (a - b + c - d), q * (a + b - c - d), q * (a - b - c + d)


@compiled()
def correlate(image, across, down, first, out):
    """B^T image: correlation of an image with that of each symbol."""
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
def seen_by_symbols(difference, offset, root, first, last, matched, shown):
    """What a whitened pair shows of its symbols: B^T d and B^T o, B being the mean of two frames."""
    other = np.empty_like(matched)
    for image, out in ((difference, matched), (offset, shown)):
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
    """`correlate` of many images at once."""
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
    """Levels of LEDs about their mean, (n n,): t = 1/4 H^T D H."""
    squares = symbols.shape[0] // 4
    out = np.empty(4 * squares)
    for q in range(squares):
        a, b, c, d = symbols[q], symbols[squares + q], symbols[2 * squares + q], symbols[3 * squares + q]
        out[4 * q], out[4 * q + 1], out[4 * q + 2], out[4 * q + 3] = _haar(a, b, c, d)
    return out


@compiled()
def symbols_of(leds):
    """Symbols of LEDs, (n n,), the inverse of `leds_of`: D = H t H^T."""
    squares = leds.shape[0] // 4
    out = np.empty(4 * squares)
    for q in range(squares):
        a, b, c, d = _haar(leds[4 * q], leds[4 * q + 1], leds[4 * q + 2], leds[4 * q + 3])
        out[q], out[squares + q], out[2 * squares + q], out[3 * squares + q] = 4.0 * a, 4.0 * b, 4.0 * c, 4.0 * d
    return out


@compiled()
def spread(light, first, out):
    """Write LEDs' light by column or by row at its place, LEDs of equal place in their squares together."""
    squares = light.shape[0] // 4
    out[:] = 0.0
    for k in range(light.shape[0]):
        row = out[k % 4 * squares + k // 4]
        for i in range(max(0, -first[k]), min(light.shape[1], out.shape[1] - first[k])):
            row[first[k] + i] = light[k, i]


@compiled()
def gram(across, down, out):
    """B^T B of the symbols: <led_i, led_j> = <across_i, across_j> <down_i, down_j>, Haar transformed on both sides."""
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
    """Add B, the light of each symbol on each pixel."""
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
    """Add what a pair says of its LEDs' light: weight l_i l_j <led_i, led_j>, with 16 T G T^T = <led_i, led_j>."""
    squares, count = gram.shape[0] // 4, gram.shape[0]
    rows = np.empty((4, count), np.float32)
    for p in range(squares):
        a, b, c, d = gram[p], gram[squares + p], gram[2 * squares + p], gram[3 * squares + p]
        for j in range(count):
            rows[0, j], rows[1, j], rows[2, j], rows[3, j] = _haar(a[j], b[j], c[j], d[j])
        for k in range(4):
            row, one, scale = rows[k], out[4 * p + k], 16 * weight * levels[4 * p + k]
            for q in range(squares):
                x, y, z, w = _haar(row[q], row[squares + q], row[2 * squares + q], row[3 * squares + q])
                m = 4 * q
                one[m] += scale * levels[m] * x
                one[m + 1] += scale * levels[m + 1] * y
                one[m + 2] += scale * levels[m + 2] * z
                one[m + 3] += scale * levels[m + 3] * w
