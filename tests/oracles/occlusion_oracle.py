"""Changes from pattern to inverse, written for reading.

Nothing runs on this but the tests that hold `kernels.py` to it.
"""

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.receive.geometry.fit import robust_std


def noise_outside(change: Floats, x: float, y: float, least: float) -> float:
    """Standard deviation about 0 of the pixels beside a square; 0 where there are none."""
    around = change[_away(change, x, y) > least]
    return robust_std(around) if around.size else 0.0


def power_within(change: Floats, x: float, y: float, most: float) -> tuple[float, int]:
    """Sum of the squares of the pixels in a square, and their number."""
    inner = change[_away(change, x, y) <= most]
    return float(inner @ inner), inner.size


def power_around(change: Floats, noise: float, x: float, y: float, axes: Floats, width: int, side: int) -> Floats:
    """Mean power of a change over the squares about LEDs, less that of its noise, (n, n)."""
    power = np.pad(np.maximum(change**2 - noise**2, 0.0), ((0, 1), (0, 1)), "edge")
    at_leds = np.empty((side, side))
    for u, v in np.ndindex(side, side):
        px, py = np.array([x, y]) + axes @ (v - (side - 1) / 2, u - (side - 1) / 2)
        px, py = np.clip(px, 0, change.shape[1] - 1), np.clip(py, 0, change.shape[0] - 1)
        i, j = int(py), int(px)
        at_leds[u, v] = [1 - py + i, py - i] @ power[i : i + 2, j : j + 2] @ [1 - px + j, px - j]
    mirrored = np.pad(at_leds, width // 2, "symmetric")
    squares = np.lib.stride_tricks.sliding_window_view(mirrored, (width, width))
    return np.asarray(squares.mean((2, 3)))


def recent_change(before: Floats, around: Floats, least: float, bright: int, most: float, rate: float) -> Floats:
    """Recent change of each LED, with that of one more pair, (n, n)."""
    others = max(float(np.sort(around, axis=None)[bright]), least)
    return before + rate * (np.minimum(around / others, most) - before)


def _away(change: Floats, x: float, y: float) -> Floats:
    """Distance of each pixel from a point, along a row or a column, whichever is larger."""
    rows, cols = np.indices(change.shape)
    return np.maximum(np.abs(rows - y), np.abs(cols - x))
