"""Poses of a packet that was not read whole: where the differences of its pairs have their power.

What shines beside an array pulls the pose that a sum shows. In differences of pattern and inverse nothing but the array
changes: their power, over many pairs of random data, is that of the array with all LEDs on, squared.
"""

from collections.abc import Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from heliograph.base.arrays import Floats
from heliograph.receive.image.footprint import image_of
from heliograph.receive.observe.cutout import Cutout

PAIRS_TOGETHER = 8
"""Pairs before and after one whose power shows its error too: 17 together show the rim of 16 LEDs to a fifth of a px.

A post passes an LED of an array at 63 m in 3 to 30 pairs, and pulls for as long.
"""

MOST_PX = 4
"""Largest error looked for, in px: cut-outs have as much around the array."""


def realigned(cutouts: Sequence[Cutout | None], led_gains: Floats) -> tuple[list[Cutout | None], float]:
    """Move each pair to where the power of the differences about it is."""
    matches = [np.zeros((2 * MOST_PX + 1,) * 2) if cutout is None else _match(cutout, led_gains) for cutout in cutouts]
    sums = np.cumsum([np.zeros_like(matches[0]), *matches], axis=0)
    moved, largest = list[Cutout | None](), 0.0
    for k, cutout in enumerate(cutouts):
        if cutout is None:
            moved.append(None)
            continue
        near = sums[min(k + PAIRS_TOGETHER + 1, len(cutouts))] - sums[max(k - PAIRS_TOGETHER, 0)]
        step = _peak(near)
        moved.append(cutout.moved(np.append(step, np.zeros(2))))
        largest = max(largest, float(np.hypot(*step)))
    return moved, largest


def _match(cutout: Cutout, led_gains: Floats) -> Floats:
    """Match of the difference's power and the array's, moved by (row, column) from -`MOST_PX` to `MOST_PX` px."""
    profile = image_of(cutout.shining(led_gains), cutout.middle, cutout.corner, cutout.shape) ** 2
    power = np.pad(np.asarray(cutout.difference, np.float64) ** 2, MOST_PX)
    # so few moves need no Fourier transform, and none of SciPy's modules that have one: they take a second to import
    return np.asarray(np.einsum("ijkl,kl->ij", sliding_window_view(power, profile.shape), profile))


def _peak(match: Floats) -> Floats:
    """Place (x, y) of the largest match in px, between pixels by a parabola."""
    i, j = (min(max(k, 1), 2 * MOST_PX - 1) for k in divmod(int(np.argmax(match)), match.shape[1]))
    return np.array([j + _vertex(match[i, j - 1 : j + 2]), i + _vertex(match[i - 1 : i + 2, j])]) - MOST_PX


def _vertex(three: Floats) -> float:
    """Place of a parabola's largest value through values at -1, 0 and 1."""
    bend = three[0] - 2 * three[1] + three[2]
    return float(np.clip(0.5 * (three[0] - three[2]) / bend, -1, 1)) if bend < 0 else 0.0
