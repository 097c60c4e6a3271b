"""Blocks in which something blinks, put together to what may be one thing."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components

from heliograph.base.arrays import Floats

MOST_SPOTS = 4096
"""Most spots that are put together: their distances are all compared."""

DOTS = 9
"""Least number of blinking spots that are taken for one array: LEDs that lie so far apart that nothing blinks
between."""

DOTS_APART = 4.0
"""Largest gap between two such spots, in their sides. An LED takes a quarter of its pitch in the reference link."""


@dataclass(frozen=True, slots=True)
class Group:
    """Blocks that belong together."""

    # (blocks down, blocks across), which they are
    blocks: NDArray[np.bool_]
    # Spots they are made of: more than 1 where LEDs lie far apart
    spots: int


def groups_of(busy: NDArray[np.bool_]) -> list[Group]:
    """Busy blocks that touch each other; many spots near each other are one."""
    closed = cv2.morphologyEx(busy.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))
    count, labels, stats, _ = cv2.connectedComponentsWithStats(closed, connectivity=8)
    if count <= 1:
        return []
    boxes = stats[1:, :4].astype(float)
    sizes = np.sqrt(stats[1:, cv2.CC_STAT_AREA])
    chained = _chained(boxes, sizes) if DOTS <= count - 1 <= MOST_SPOTS else np.arange(count - 1)
    out = list[Group]()
    for one in np.unique(chained):
        spots = np.flatnonzero(chained == one)
        if 1 < len(spots) < DOTS:
            out += [Group(labels == spot + 1, 1) for spot in spots]
        else:
            out.append(Group(np.isin(labels, spots + 1), len(spots)))
    return out


def _chained(boxes: Floats, sizes: Floats) -> NDArray[np.intp]:
    """Numbers (spots,) of chains of spots of about one size that lie near each other."""
    first, end = boxes[:, :2], boxes[:, :2] + boxes[:, 2:]
    gaps = np.maximum(np.maximum(first[:, None] - end[None], first[None] - end[:, None]), 0.0).max(-1)
    alike = np.maximum(sizes[:, None], sizes) <= 2 * np.minimum(sizes[:, None], sizes)
    near = (gaps <= DOTS_APART * np.minimum(sizes[:, None], sizes)) & alike
    return np.asarray(connected_components(near, directed=False)[1], np.intp)
