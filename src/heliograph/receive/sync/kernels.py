"""Compiled kernels of the slip detection; `tests/oracles/slips_oracle.py` is the reference."""

import numpy as np

from heliograph.base.compiled import compiled


@compiled()
def light_at_leds(image, x, y, axes, width, rim, side, mean):
    """Average an image over squares around LEDs, with linear interpolation between pixels.

    Returns the light, the light less its mean of earlier frames, the sum of squares of this contrast, and True if the
    contrast is a pattern's: it varies from LED to LED, so the variance is more than a quarter of the mean square.
    """
    inner, reach = side - 2 * rim, (width - 1) // 2
    bottom, right = image.shape[0] - 1, image.shape[1] - 1
    out, contrast, power, whole = np.empty(inner * inner), np.empty(inner * inner), 0.0, 0.0
    for led in range(inner * inner):
        down, along = led // inner + rim - 0.5 * (side - 1), led % inner + rim - 0.5 * (side - 1)
        px = x + along * axes[0, 0] + down * axes[0, 1]
        py = y + along * axes[1, 0] + down * axes[1, 1]
        # a square between pixels: the first and last row and column count by the overlap
        top, left = int(np.floor(py)) - reach, int(np.floor(px)) - reach
        below, over = py - np.floor(py), px - np.floor(px)
        total = 0.0
        for a in range(width + 1):
            i, line = min(max(top + a, 0), bottom), 0.0
            for b in range(width + 1):
                part = 1.0 - over if b == 0 else over if b == width else 1.0
                line += part * image[i, min(max(left + b, 0), right)]
            total += (1.0 - below if a == 0 else below if a == width else 1.0) * line
        out[led] = total / (width * width)
        contrast[led] = out[led] - mean[led]
        power, whole = power + contrast[led] ** 2, whole + contrast[led]
    return out, contrast, power, whole**2 < 0.75 * power * inner * inner
