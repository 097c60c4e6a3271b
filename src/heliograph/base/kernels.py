"""Cubic interpolation of images, compiled; `tests/oracles/per_led_oracle.py` is the reference."""

import math

import numpy as np

from heliograph.base.compiled import compiled


@compiled()
def sample_cubic(image, points, out):
    """Image between its pixels by cubic convolution (Keys 1981, a = -1/2); the border repeats."""
    wx, wy = np.empty(4), np.empty(4)
    for p in range(points.shape[0]):
        out[p] = _cubic(image, points[p, 0], points[p, 1], wx, wy)


@compiled()
def cubic_at_leds(image, x, y, axes, out):
    """Image at the LEDs by cubic convolution, as in `sample_cubic`."""
    side = out.shape[0]
    wx, wy = np.empty(4), np.empty(4)
    for u in range(side):
        for v in range(side):
            along, down = v - 0.5 * (side - 1), u - 0.5 * (side - 1)
            px = along * axes[0, 0] + down * axes[0, 1] + x
            out[u, v] = _cubic(image, px, along * axes[1, 0] + down * axes[1, 1] + y, wx, wy)


@compiled()
def _cubic(image, x, y, wx, wy):
    """Image at a point, with scratch for the weights along x and y."""
    rows, cols = image.shape
    j, i = math.floor(x), math.floor(y)
    for axis in range(2):
        t, w = (x - j, wx) if axis == 0 else (y - i, wy)
        w[0] = ((-0.5 * t + 1.0) * t - 0.5) * t
        w[1] = (1.5 * t - 2.5) * t * t + 1.0
        w[2] = ((-1.5 * t + 2.0) * t + 0.5) * t
        w[3] = (0.5 * t - 0.5) * t * t
    value = 0.0
    for a in range(4):
        r = min(max(i + a - 1, 0), rows - 1)
        for b in range(4):
            value += wy[a] * wx[b] * image[r, min(max(j + b - 1, 0), cols - 1)]
    return value
