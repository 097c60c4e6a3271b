"""Pulse width modulation: a level is the number of lit slots of a pattern period (Nagura et al. Fig. 4, section 3)."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

SLOTS = 4
"""Slots of a pattern period T_b; level k lights k of them. The paper's five luminances 0, 1/4, ..., 1 need four slots;
its table II gives their rate, 4 kHz at T_b = 1 ms."""

SLOT_ORDER = tuple(range(SLOTS))
"""Default order in which slots are lit as the level rises (section 1): level k lights the first k."""


def invert(levels: ArrayLike) -> NDArray[np.uint8]:
    """Return the inverted patterns 1 - x: level k becomes 4 - k, uint8.

    Parameters
    ----------
    levels
        Levels 0 to 4 of patterns, of any shape.
    """
    return (SLOTS - np.asarray(levels, dtype=np.uint8)).astype(np.uint8)


def lit_slots(levels: ArrayLike, order: Sequence[int] = SLOT_ORDER) -> NDArray[np.bool_]:
    """Return which LED is lit in which slot: the pulses of equations (1) and (2) on a grid of T_b / 4.

    Parameters
    ----------
    levels
        (..., n, n) levels 0 to 4.
    order
        The slot that is lit first (level 1), second, ...: a permutation of 0 to 3.

    Returns
    -------
    (..., 4, n, n) bool, slot s of the period on the third axis from the end.

    Raises
    ------
    ValueError
        A level is below 0 or above 4, or `order` is no permutation of 0 to 3.
    """
    array = np.asarray(levels)
    if array.size and (array.min() < 0 or array.max() > SLOTS):
        raise ValueError(f"levels are 0 to {SLOTS}, not {array.min()} to {array.max()}")
    if sorted(order) != list(SLOT_ORDER):
        raise ValueError(f"the slot order is a permutation of 0 to {SLOTS - 1}, not {tuple(order)}")
    rank = np.argsort(np.asarray(order))  # slot s is the rank[s]-th to be lit
    return array[..., None, :, :] > rank[:, None, None]


def waveform(levels: ArrayLike, order: Sequence[int] = SLOT_ORDER) -> NDArray[np.float64]:
    """Return the luminous flux of the array by slot; 1 is the flux of all LEDs on.

    Parameters
    ----------
    levels
        (patterns, n, n) levels 0 to 4 in the order of time.
    order
        The slots, 0 to 3, in the order in which they are lit, as for `lit_slots`.

    Returns
    -------
    (4 patterns,) float64, 0 to 1, slots in the order of time.
    """
    return lit_slots(levels, order).mean((-2, -1)).reshape(-1)


def light_centroids(order: Sequence[int] = SLOT_ORDER) -> tuple[float, float]:
    """Return the centroids in time of the light of random data, in pattern periods from the start of a pattern.

    The Haar transform of random data gives levels 0 to 4 with the probabilities 1, 4, 6, 4, 1 of 16.

    Parameters
    ----------
    order
        The slots, 0 to 3, in the order in which they are lit, as for `lit_slots`.

    Returns
    -------
    mean
        Centroid of the mean light, 0 to 1: sum_s P(lit_s) t_s / sum_s P(lit_s), t_s the middle of slot s.
    change
        Centroid of the light's change with the level, 0 to 1: the same with cov(lit_s, level) in place of P(lit_s).
    """
    levels = np.repeat(np.arange(SLOTS + 1), [math.comb(SLOTS, k) for k in range(SLOTS + 1)])
    lit = lit_slots(levels[:, None, None], order)[:, :, 0, 0].astype(np.float64)
    middle = (np.arange(SLOTS) + 0.5) / SLOTS
    mean, change = lit.mean(0), (levels - levels.mean()) @ lit
    return float(mean @ middle / mean.sum()), float(change @ middle / change.sum())
