"""Compiled kernels of observations: symbols' images and noise weights.

Symbols come in the order of `PacketFormat.split`: the quarters D11, D12, D21 and D22 of the data matrix, row by row.
Four symbols at the same position in the quarters are the Haar transform of a square of 2 x 2 LEDs, so the kernels
transform square by square. LEDs come in the order of `geometry.kernels.footprints`.
`tests/oracles/observe_oracle.py` states the same with full matrices.
"""

import math

import numpy as np

from heliograph.base.compiled import compiled


@compiled(inline="always")
def _haar(a, b, c, d):
    """Transform a square of LEDs (0, 0), (0, 1), (1, 0), (1, 1) to four symbols: 1/4 H t H^T."""
    q = np.float32(0.25)  # float32 keeps the precision of the sums
    return q * (a + b + c + d), q * (a - b + c - d), q * (a + b - c - d), q * (a - b - c + d)


@compiled()
def correlate(images, across, down, first, out):
    """Correlate images, (rows, columns, images), with the image of each symbol: B^T images."""
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
def weight_roots(light, first, lit, dark, ring, size):
    """Compute roots of weights of columns or rows, W = lit / s^2, s^2 = dark + (lit - dark) f, f the light 0 to 1."""
    out, side = np.zeros(size), math.sqrt(light.shape[0])
    for k in range(light.shape[0]):
        for i in range(max(0, -first[k]), min(light.shape[1], size - first[k])):
            out[first[k] + i] += light[k, i]
    for j in range(size):
        f = min(out[j] / side, 1.0)
        inside = ring <= j < size - ring
        out[j] = math.sqrt(lit / (dark + (lit - dark) * f)) if inside else 0.0
    return out


@compiled()
def weigh(light, columns, lines, gains):
    """Multiply footprints by the root of each pixel's weight and by the gains of the LEDs."""
    x, y, first = light
    across, down = np.zeros_like(x), np.zeros_like(y)
    for k in range(x.shape[0]):
        for i in range(x.shape[1]):
            j, m = first[k, 0] + i, first[k, 1] + i
            if 0 <= j < columns.shape[0]:
                across[k, i] = gains[k] * x[k, i] * columns[j]
            if 0 <= m < lines.shape[0]:
                down[k, i] = y[k, i] * lines[m]
    return across, down
