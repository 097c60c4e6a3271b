"""Pulse width modulation: level k lights k slots in a pattern period (Nagura et al. Fig. 4, section 3)."""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

SLOTS = 4
"""Slots per pattern period T_b. The five luminances 0, 1/4, ..., 1 in the paper need four slots; table II in the paper
gives a slot rate of 4 kHz at T_b = 1 ms."""

SLOT_ORDER = tuple(range(SLOTS))  # default slot order (section 1): level k lights the first k slots


def invert(levels: ArrayLike) -> NDArray[np.uint8]:
    """Return the inverted patterns 1 - x: level k becomes 4 - k, uint8."""
    return (SLOTS - np.asarray(levels, dtype=np.uint8)).astype(np.uint8)


def lit_slots(levels: ArrayLike, order: Sequence[int] = SLOT_ORDER) -> NDArray[np.bool_]:
    """Return the LED states by slot, the pulses in equations (1) and (2): (..., n, n) levels give (..., 4, n, n) bool.

    `order` lists the slots, a permutation of 0 to 3, as lit with increasing level.
    """
    rank = np.argsort(np.asarray(order))  # slot s is the rank[s]-th to be lit
    return np.asarray(levels)[..., None, :, :] > rank[:, None, None]


def waveform(levels: ArrayLike, order: Sequence[int] = SLOT_ORDER) -> NDArray[np.float64]:
    """Return the luminous flux by slot, (4 patterns,), relative to the flux with all LEDs on."""
    return lit_slots(levels, order).mean((-2, -1)).reshape(-1)


def light_centroids(order: Sequence[int] = SLOT_ORDER) -> tuple[float, float]:
    """Return temporal centroids of the light from random data, in pattern periods after the pattern start.

    The first centroid is for the mean light: sum_s P(lit_s) t_s / sum_s P(lit_s) with the centre t_s of slot s. The
    second is for the level-dependent light: cov(lit_s, level) replaces P(lit_s). The Haar transform of random data
    gives levels 0 to 4 with the probabilities 1, 4, 6, 4, 1 out of 16.
    """
    levels = np.repeat(np.arange(SLOTS + 1), [math.comb(SLOTS, k) for k in range(SLOTS + 1)])
    lit = lit_slots(levels[:, None, None], order)[:, :, 0, 0].astype(np.float64)
    middle = (np.arange(SLOTS) + 0.5) / SLOTS
    mean, change = lit.mean(0), (levels - levels.mean()) @ lit
    return float(mean @ middle / mean.sum()), float(change @ middle / change.sum())
