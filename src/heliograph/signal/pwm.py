"""Pulse width modulation: a level as the number of lit slots of a pattern period, Fig. 4 of Nagura et al."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

SLOTS = 4
"""Slots of a pattern period T_b; level k lights k of them (slot rate 4 / T_b = 4 kHz at T_b = 1 ms)."""


def invert(levels: ArrayLike) -> NDArray[np.uint8]:
    """The inverted pattern 1 - x: level k becomes 4 - k."""
    return (SLOTS - np.asarray(levels, dtype=np.uint8)).astype(np.uint8)


def lit_slots(levels: ArrayLike, order: Sequence[int] = tuple(range(SLOTS))) -> NDArray[np.bool_]:
    """Which LED is lit in which slot: the pulses of equations (1) and (2) on a grid of T_b / 4.

    Parameters
    ----------
    levels
        (..., n, n) levels 0 to 4.
    order
        The slot that is lit first (level 1), second, ...: a permutation of 0 to 3.

    Returns
    -------
    (..., 4, n, n) bool, slot s of the period on the third axis from the end.
    """
    array = np.asarray(levels)
    if array.size and (array.min() < 0 or array.max() > SLOTS):
        raise ValueError(f"levels are 0 to {SLOTS}, not {array.min()} to {array.max()}")
    if sorted(order) != list(range(SLOTS)):
        raise ValueError(f"the slot order is a permutation of 0 to {SLOTS - 1}, not {tuple(order)}")
    rank = np.argsort(np.asarray(order))  # slot s is the rank[s]-th to be lit
    return array[..., None, :, :] > rank[:, None, None]


def waveform(levels: ArrayLike, order: Sequence[int] = tuple(range(SLOTS))) -> NDArray[np.float64]:
    """Luminous flux of the whole array by slot, as a share of all LEDs on.

    Parameters
    ----------
    levels
        (patterns, n, n) levels 0 to 4 in the order of time.

    Returns
    -------
    (patterns * 4,) float64 in 0 to 1.
    """
    return lit_slots(levels, order).mean((-2, -1)).reshape(-1)


def light_centroids(order: Sequence[int] = tuple(range(SLOTS))) -> tuple[float, float]:
    """When the light of random data is on, as shares of the pattern period.

    Levels come as 0 to 4 heads of 4 coins, as the Haar transform of random data gives them.

    Returns
    -------
    The centroid of the mean light, and that of the light's change by level: cov(lit, level) in place of the mean.
    """
    levels = np.repeat(np.arange(SLOTS + 1), [math.comb(SLOTS, k) for k in range(SLOTS + 1)])
    lit = lit_slots(levels[:, None, None], order)[:, :, 0, 0].astype(np.float64)
    middle = (np.arange(SLOTS) + 0.5) / SLOTS
    mean, change = lit.mean(0), (levels - levels.mean()) @ lit
    return float(mean @ middle / mean.sum()), float(change @ middle / change.sum())
