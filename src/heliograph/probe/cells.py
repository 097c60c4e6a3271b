"""How many cells a screen's array has, by the lines between them: nobody need be told."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import TINY, Floats
from heliograph.base.frames import Frame
from heliograph.receive.screen.locate import find_quadrilaterals, reduce_frame

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
    """Return how many cells a side has of the array that some frames show; None where the lines do not tell.

    Parameters
    ----------
    frames
        Frames of 8 bits in the order of time, some dozens, of an array that hardly moves in a second.
    """
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


def sharpen_corners(changes: NDArray[np.float32], corners: Floats, factor: int) -> Floats:
    """Refine corners by the edges of the changes at full resolution."""
    reach = 2.5 * factor + 1
    for _ in range(3):
        lines = [_edge(changes, corners[k], corners[(k + 1) % 4], corners.mean(0), reach) for k in range(4)]
        moved = np.array([_crossing(lines[k - 1], lines[k]) for k in range(4)])
        if not np.isfinite(moved).all() or np.abs(moved - corners).max() > 2 * reach:
            return corners
        is_done = np.abs(moved - corners).max() < 0.1
        corners = moved
        if is_done:
            break
    return corners


def _edge(
    changes: NDArray[np.float32], start: Floats, end: Floats, middle: Floats, reach: float
) -> tuple[Floats, Floats]:
    """Fit the edge near a side; return a point and the direction."""
    length = float(np.linalg.norm(end - start))
    along = (end - start) / max(length, TINY)
    out = np.array([along[1], -along[0]])
    if (start - middle) @ out < 0:
        out = -out
    across = np.linspace(-reach, reach, 2 * int(4 * reach) + 1)
    places = np.linspace(0.06, 0.94, 32) * length
    points = start + places[:, None, None] * along + across[:, None] * out
    x, y = (np.asarray(points[..., k], np.float32) for k in (0, 1))
    profiles = np.asarray(cv2.remap(changes, x, y, cv2.INTER_LINEAR), np.float64)
    inside = np.median(profiles[:, : len(across) // 3], axis=1)
    outside = np.median(profiles[:, -len(across) // 4 :], axis=1)
    strong = inside - outside > 0.4 * np.median(inside)
    if strong.sum() < 8:
        return start, along
    # a blurred edge is at half the height
    over = profiles > ((inside + outside) / 2)[:, None]
    last = len(across) - 1 - np.argmax(over[:, ::-1], axis=1)
    offsets = across[last] + (across[1] - across[0]) / 2
    weight = strong.astype(float)
    fit = np.array([np.median(offsets[strong]), 0.0])
    columns = np.column_stack([np.ones(len(places)), places / length - 0.5])
    for _ in range(8):
        far = np.abs(offsets - columns @ fit)
        # an edge 2 px off counts a quarter
        w = weight / (1 + (far / 2) ** 2) ** 2
        fit = np.linalg.lstsq(columns * w[:, None], offsets * w, rcond=None)[0]
    a, b = (start + s * length * along + (fit[0] + fit[1] * (s - 0.5)) * out for s in (0.0, 1.0))
    return a, b - a


def _crossing(first: tuple[Floats, Floats], second: tuple[Floats, Floats]) -> Floats:
    """Intersect two lines, each a point and a direction."""
    (p, d), (q, e) = first, second
    across = d[0] * e[1] - d[1] * e[0]
    if abs(across) < TINY:
        return np.full(2, np.nan)
    t = ((q[0] - p[0]) * e[1] - (q[1] - p[1]) * e[0]) / across
    return p + t * d
