"""Reference for the change statistics in `kernels.py`."""

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.receive.geometry.fit import robust_std


def noise_outside(change: Floats, x: float, y: float, least: float) -> float:
    """Return the robust standard deviation outside a square, or 0 if no pixels remain."""
    around = change[_away(change, x, y) > least]
    return robust_std(around) if around.size else 0.0


def power_within(change: Floats, x: float, y: float, most: float) -> tuple[float, int]:
    """Return sum of squares and pixel count within a square."""
    inner = change[_away(change, x, y) <= most]
    return float(inner @ inner), inner.size


def power_around(change: Floats, noise: float, x: float, y: float, axes: Floats, width: int, side: int) -> Floats:
    """Return mean excess power over noise around each LED, (n, n)."""
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
    """Update the recent change at each LED with a new pair, (n, n)."""
    others = max(float(np.sort(around, axis=None)[bright]), least)
    return before + rate * (np.minimum(around / others, most) - before)


def _away(change: Floats, x: float, y: float) -> Floats:
    """Return the Chebyshev distance from a point to each pixel."""
    rows, cols = np.indices(change.shape)
    return np.maximum(np.abs(rows - y), np.abs(cols - x))
