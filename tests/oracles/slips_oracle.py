"""Reference for the pairing kernel in `kernels.py`."""

import numpy as np

from heliograph.base.arrays import Floats


def means_at_leds(image: Floats, x: float, y: float, axes: Floats, width: int, rim: int, side: int) -> Floats:
    """Return image means over squares about LEDs, with bilinear interpolation."""
    pad, reach = len(image), width // 2
    wide, out = np.pad(image, pad, "edge"), []
    for row in range(rim, side - rim):
        for column in range(rim, side - rim):
            px, py = np.array([x, y]) + axes @ (column - (side - 1) / 2, row - (side - 1) / 2) + pad
            i, j = int(py), int(px)
            # means over squares about the four nearest pixels
            means = [[_mean(wide, i + a, j + b, reach) for b in (0, 1)] for a in (0, 1)]
            out.append([1 - py + i, py - i] @ np.array(means) @ [1 - px + j, px - j])
    return np.array(out)


def _mean(image: Floats, i: int, j: int, reach: int) -> float:
    return float(image[i - reach : i + reach + 1, j - reach : j + reach + 1].mean())
