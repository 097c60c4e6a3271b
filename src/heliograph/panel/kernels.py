"""Kernels for the images of LEDs; `tests/oracles/panel_oracle.py` has the same in NumPy."""

import math

import numpy as np

from heliograph.base.compiled import compiled


@compiled(fastmath=True)
def _fill_window(point, sigma, reach, size, along):
    """Write the weights along x for an LED; return the first and last pixel along x and y, empty beyond the image."""
    px, py = point[0], point[1]
    # beyond the image, or NaN
    if not (-reach < px < size[1] + reach and -reach < py < size[0] + reach):
        return 0, -1, 0, -1
    left, right = max(0, math.ceil(px - reach)), min(size[1] - 1, math.floor(px + reach))
    for j in range(right - left + 1):
        along[j] = _density(left + j - px, sigma)
    return left, right, max(0, math.ceil(py - reach)), min(size[0] - 1, math.floor(py + reach))


@compiled(fastmath=True)
def _density(distance, sigma):
    return math.exp(-0.5 * distance * distance / (sigma * sigma)) / (math.sqrt(2.0 * math.pi) * sigma)


@compiled(fastmath=True)
def project(image, points, sigma, reach, out):
    """Write the inner products of an image with the image of each LED and the derivatives."""
    along, square = np.empty(2 * int(reach) + 3, np.float32), sigma * sigma
    for n in range(points.shape[0]):
        left, right, top, low = _fill_window(points[n], sigma, reach, image.shape, along)
        first = np.float32(left - points[n, 0])
        s, sx, sy, sr = 0.0, 0.0, 0.0, 0.0
        for i in range(top, low + 1):
            e = i - points[n, 1]
            line = image[i, left : right + 1]
            a0, a1, a2 = np.float32(0.0), np.float32(0.0), np.float32(0.0)
            for j in range(right - left + 1):
                d = first + np.float32(j)
                value = line[j] * along[j]
                a0 += value
                a1 += value * d
                a2 += value * d * d
            g = _density(e, sigma)
            s += g * a0
            sx += g * a1
            sy += g * e * a0
            sr += g * (a2 + e * e * a0)
        out[n, 0], out[n, 1], out[n, 2], out[n, 3] = s, sx / square, sy / square, sr / square - 2.0 * s


@compiled(fastmath=True)
def render(amounts, points, sigma, reach, image):
    """Add the images of LEDs and the derivatives to an image."""
    along, square = np.empty(2 * int(reach) + 3, np.float32), sigma * sigma
    for n in range(points.shape[0]):
        left, right, top, low = _fill_window(points[n], sigma, reach, image.shape, along)
        first = np.float32(left - points[n, 0])
        for i in range(top, low + 1):
            e = i - points[n, 1]
            g = _density(e, sigma)
            # a0 + a1 d + a2 d^2 along the row
            a0 = g * (amounts[n, 0] + amounts[n, 2] * e / square + amounts[n, 3] * (e * e / square - 2.0))
            a1, a2 = g * amounts[n, 1] / square, g * amounts[n, 3] / square
            b0, b1, b2 = np.float32(a0), np.float32(a1), np.float32(a2)
            line = image[i, left : right + 1]
            for j in range(right - left + 1):
                d = first + np.float32(j)
                line[j] += along[j] * (b0 + d * (b1 + d * b2))
