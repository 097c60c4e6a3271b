"""How many cells a screen's array has, by the lines between them: nobody need be told."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import TINY, Floats
from heliograph.base.frames import Frame
from heliograph.receive.screen.locate import find_quadrilaterals, reduce_frame, sharpen_corners

SIDES = range(8, 33, 4)
"""Cells of a side that are told apart."""

AREA_PX = 672
"""Side to which the array's area is stretched: a whole number of pixels for each cell of 8, 12, 16, 24, 28 and 32."""

LOOKED_AT = 24
"""Frames that are compared, of a few seconds. Chosen: each shows other edges."""

WIDTH = 0.18
"""Standard deviation of a line in cells, which the lens' blur makes. Chosen: of 0.1 to 0.3 all tell the same."""

LEAST_LIKE, LEAST_LIKE_8 = 0.3, 0.45
"""Least correlation with evenly spaced lines. At 30 frames a second, 120 px for 16 cells and more, the right number had
0.34 to 0.8, wrong ones up to 0.2; but 8, on whose lines those of the header lie, up to 0.31."""


def cells_of_a_side(frames: Sequence[Frame]) -> int | None:
    """Return how many cells a side has of the array that some frames show; None where the lines do not tell."""
    some = frames[-4 * LOOKED_AT :][:: max(1, min(len(frames) // LOOKED_AT, 4))]
    pixels = np.stack([frame.pixels for frame in some]).astype(np.float32)
    changes = np.asarray(pixels.std(axis=0), np.float64)
    small, factor = reduce_frame(np.asarray(changes, np.float32))
    for corners in find_quadrilaterals(np.asarray(small, np.float64), factor):
        lines = _lines(pixels, sharpen_corners(np.asarray(changes, np.float32), corners, factor))
        like = {side: _like(lines, side) for side in SIDES}
        best = max(like, key=lambda side: like[side])
        if like[best] >= (LEAST_LIKE_8 if best == SIDES[0] else LEAST_LIKE):
            return best
    return None


def _lines(pixels: NDArray[np.float32], corners: Floats) -> Floats:
    """(AREA_PX - 1,) mean step from pixel to pixel across the array, along both directions, less its slow part."""
    square = np.array([(0, 0), (AREA_PX, 0), (AREA_PX, AREA_PX), (0, AREA_PX)], np.float32) - np.float32(0.5)
    warp = cv2.getPerspectiveTransform(np.asarray(corners, np.float32), square)
    profile = np.zeros(AREA_PX - 1)
    for one in pixels:
        area = cv2.warpPerspective(one, warp, (AREA_PX, AREA_PX))
        profile += np.abs(np.diff(area, axis=1)).mean(axis=0) + np.abs(np.diff(area, axis=0)).mean(axis=1)
    slow = cv2.GaussianBlur(profile[None], (0, 0), AREA_PX / SIDES[0] / 2)[0]
    return np.asarray(profile - slow, np.float64)


def _like(lines: Floats, side: int) -> float:
    """Correlation of steps with lines between so many cells, those within the outer two cells left out."""
    cell = AREA_PX / side
    places = np.arange(1, AREA_PX) / cell
    drawn = np.exp(-0.5 * ((places - np.round(places)) / WIDTH) ** 2)
    inner = slice(AREA_PX // 16, -AREA_PX // 16)
    a, b = lines[inner] - lines[inner].mean(), drawn[inner] - drawn[inner].mean()
    return float(a @ b / max(np.sqrt((a @ a) * (b @ b)), TINY))
