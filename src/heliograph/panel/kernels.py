"""Kernels for the images of LEDs; `tests/oracles/panel_oracle.py` has the same in NumPy."""

import math

import numpy as np

from heliograph.base.compiled import compiled


@compiled(fastmath=True)
def project(image, points, sigma, reach, out):
    """Write the inner products of an image with the image of each LED and the derivatives."""
    rows, columns = image.shape
    along = np.empty(2 * int(reach) + 3, np.float32)
    scale, norm = -0.5 / (sigma * sigma), 1.0 / (math.sqrt(2.0 * math.pi) * sigma)
    for n in range(points.shape[0]):
        px, py = points[n, 0], points[n, 1]
        out[n, :] = 0.0
        # beyond the image, or NaN
        if not (-reach < px < columns + reach and -reach < py < rows + reach):
            continue
        left, right = max(0, math.ceil(px - reach)), min(columns - 1, math.floor(px + reach))
        top, low = max(0, math.ceil(py - reach)), min(rows - 1, math.floor(py + reach))
        for j in range(right - left + 1):
            d = left + j - px
            along[j] = norm * math.exp(scale * d * d)
        s, sx, sy, sr = 0.0, 0.0, 0.0, 0.0
        for i in range(top, low + 1):
            e = i - py
            line = image[i, left : right + 1]
            a0, a1, a2 = np.float32(0.0), np.float32(0.0), np.float32(0.0)
            first = np.float32(left - px)
            for j in range(right - left + 1):
                d = first + np.float32(j)
                value = line[j] * along[j]
                a0 += value
                a1 += value * d
                a2 += value * d * d
            g = norm * math.exp(scale * e * e)
            s += g * a0
            sx += g * a1
            sy += g * e * a0
            sr += g * (a2 + e * e * a0)
        square = sigma * sigma
        out[n, 0], out[n, 1], out[n, 2], out[n, 3] = s, sx / square, sy / square, sr / square - 2.0 * s


@compiled(fastmath=True)
def render(amounts, points, sigma, reach, image):
    """Add the images of LEDs and the derivatives to an image."""
    rows, columns = image.shape
    along = np.empty(2 * int(reach) + 3, np.float32)
    scale, norm = -0.5 / (sigma * sigma), 1.0 / (math.sqrt(2.0 * math.pi) * sigma)
    square = sigma * sigma
    for n in range(points.shape[0]):
        px, py = points[n, 0], points[n, 1]
        if not (-reach < px < columns + reach and -reach < py < rows + reach):
            continue
        left, right = max(0, math.ceil(px - reach)), min(columns - 1, math.floor(px + reach))
        top, low = max(0, math.ceil(py - reach)), min(rows - 1, math.floor(py + reach))
        for j in range(right - left + 1):
            d = left + j - px
            along[j] = norm * math.exp(scale * d * d)
        first = np.float32(left - px)
        for i in range(top, low + 1):
            e = i - py
            g = norm * math.exp(scale * e * e)
            # a0 + a1 d + a2 d^2 along the row
            a0 = g * (amounts[n, 0] + amounts[n, 2] * e / square + amounts[n, 3] * (e * e / square - 2.0))
            a1, a2 = g * amounts[n, 1] / square, g * amounts[n, 3] / square
            b0, b1, b2 = np.float32(a0), np.float32(a1), np.float32(a2)
            line = image[i, left : right + 1]
            for j in range(right - left + 1):
                d = first + np.float32(j)
                line[j] += along[j] * (b0 + d * (b1 + d * b2))
