"""Where a screen's array is: the quadrilateral in which everything changes."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import TINY, Floats

Pixels32 = NDArray[np.float32]
"""Gray levels or light of pixels, (rows, columns)."""

COARSE_PX = 480
"""Most columns of the reduced frames in which changes are looked for: an array of 50 px in a frame of 1280 px has 19
there. Half as many would leave it two pixels for each of the header's cells."""

LEAST_CHANGE = 4.0
"""Least mean change of an array in thousandths of full scale: of 2 patterns a second at 30 frames a second it is 20."""

LEAST_SIDE = 9
"""Least side of an array in reduced pixels. Chosen: about two for each of the header's cells."""

CANDIDATES = 4
"""Most places that are examined. Chosen: what moves in a film makes few larger ones."""

FRACTIONS = tuple(np.geomspace(0.01, 0.15, 24).tolist())
"""Departures of a polygon from an outline that are tried, by the outline's length."""

FOUR = 4
"""Corners of a quadrilateral."""

PROFILES = 32
"""Places along a side where its edge is looked for. Chosen: lines through them are right to a tenth of a pixel."""

EDGE_REACH = 2.5
"""Reduced pixels across a side within which its edge is looked for: corners are right to one or two of them."""

AGREES = 2.0
"""Px from the line at which an edge counts half: cells at the rim that hardly changed show none."""


def reduced(pixels: Pixels32) -> tuple[Pixels32, int]:
    """Return a frame reduced for the search, and by what factor."""
    factor = max(1, -(-pixels.shape[1] // COARSE_PX))
    size = (pixels.shape[1] // factor, pixels.shape[0] // factor)
    cut = pixels[: size[1] * factor, : size[0] * factor]
    return np.asarray(cv2.resize(cut, size, interpolation=cv2.INTER_AREA), np.float32), factor


def changing(frames: Sequence[Pixels32]) -> Pixels32:
    """Return how much each pixel changes from frame to frame: an array again and again, an edge that moves but once."""
    total = np.zeros_like(frames[0])
    for one, next_one in pairwise(frames):
        total += cv2.absdiff(next_one, one)
    total *= 1000 / (len(frames) - 1)
    return np.maximum(total - np.float32(np.median(total)), 0)


def quadrilaterals(changes: Pixels32, factor: int) -> list[Floats]:
    """Find areas that change, the strongest first."""
    top = float(changes.max())
    if top < LEAST_CHANGE:
        return []
    scaled = np.rint(np.clip(changes / top, 0, 1) * 255).astype(np.uint8)
    level, _ = cv2.threshold(scaled, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    found: list[tuple[float, Floats]] = []
    for share in (1.0, 0.5):
        lit = (scaled > max(share * level, 255 * LEAST_CHANGE / top)).astype(np.uint8)
        kernel = np.ones((3, 3), np.uint8)
        lit = np.asarray(cv2.morphologyEx(lit, cv2.MORPH_CLOSE, kernel), np.uint8)
        lit = np.asarray(cv2.morphologyEx(lit, cv2.MORPH_OPEN, kernel), np.uint8)
        # the rim of a screen that moves surrounds the array
        outlines, _ = cv2.findContours(lit, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
        for one in outlines:
            _, _, width, height = cv2.boundingRect(one)
            if np.hypot(width, height) < LEAST_SIDE:
                continue
            corners = _corners(cv2.convexHull(one))
            sides = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
            if sides.min() >= LEAST_SIDE and sides.max() < 2.5 * sides.min():
                mask = np.zeros(lit.shape, np.uint8)
                cv2.fillConvexPoly(mask, np.rint(corners).astype(np.int32), 1)
                strength = float((changes * mask).sum() * (lit * mask).sum() / max(int(mask.sum()), 1))
                found.append((strength, (_ordered(corners) + 0.5) * factor - 0.5))
    found.sort(key=lambda one: -one[0])
    kept: list[Floats] = []
    for _, corners in found:
        if all(np.abs(corners - other).max() > 2 * factor for other in kept):
            kept.append(corners)
    return kept[:CANDIDATES]


def _corners(hull: Any) -> Floats:
    """The four corners of a convex outline, by the coarsest polygon that has four."""
    length = cv2.arcLength(hull, True)
    for fraction in FRACTIONS:
        polygon = cv2.approxPolyDP(hull, fraction * length, True)[:, 0]
        if len(polygon) == FOUR:
            return np.asarray(polygon, np.float64)
        if len(polygon) < FOUR:
            break
    return np.asarray(cv2.boxPoints(cv2.minAreaRect(hull)), np.float64)


def _ordered(corners: Floats) -> Floats:
    """Corners clockwise, the one nearest to the upper left first."""
    x, y = corners.T
    turn = float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))
    corners = corners if turn > 0 else corners[::-1]
    return np.roll(corners, -int(np.argmin(corners.sum(axis=1))), axis=0)


def sharpened(changes: Pixels32, corners: Floats, factor: int) -> Floats:
    """Return corners as the edges of an area show them where frames are not reduced."""
    reach = EDGE_REACH * factor + 1
    for _ in range(3):
        lines = [_edge(changes, corners[k], corners[(k + 1) % FOUR], corners.mean(0), reach) for k in range(FOUR)]
        moved = np.array([_crossing(lines[k - 1], lines[k]) for k in range(FOUR)])
        if not np.isfinite(moved).all() or np.abs(moved - corners).max() > 2 * reach:
            return corners
        done = np.abs(moved - corners).max() < 0.1
        corners = moved
        if done:
            break
    return corners


def _edge(changes: Pixels32, start: Floats, end: Floats, middle: Floats, reach: float) -> tuple[Floats, Floats]:
    """A point and the direction of the edge beside a side."""
    length = float(np.linalg.norm(end - start))
    along = (end - start) / max(length, TINY)
    out = np.array([along[1], -along[0]])
    if (start - middle) @ out < 0:
        out = -out
    across = np.linspace(-reach, reach, 2 * int(4 * reach) + 1)
    places = np.linspace(0.06, 0.94, PROFILES) * length
    points = start + places[:, None, None] * along + across[:, None] * out
    x, y = (np.asarray(points[..., k], np.float32) for k in (0, 1))
    seen = np.asarray(cv2.remap(changes, x, y, cv2.INTER_LINEAR), np.float64)
    inside = np.median(seen[:, : len(across) // 3], axis=1)
    outside = np.median(seen[:, -len(across) // 4 :], axis=1)
    strong = inside - outside > 0.4 * np.median(inside)
    if strong.sum() < PROFILES // 4:
        return start, along
    # an edge that is blurred has half its height where it is
    over = seen > ((inside + outside) / 2)[:, None]
    last = len(across) - 1 - np.argmax(over[:, ::-1], axis=1)
    offsets = across[last] + (across[1] - across[0]) / 2
    weight = strong.astype(float)
    fit = np.array([np.median(offsets[strong]), 0.0])
    columns = np.column_stack([np.ones(PROFILES), places / length - 0.5])
    for _ in range(8):
        far = np.abs(offsets - columns @ fit)
        w = weight / (1 + (far / AGREES) ** 2) ** 2
        fit = np.linalg.lstsq(columns * w[:, None], offsets * w, rcond=None)[0]
    a, b = (start + s * length * along + (fit[0] + fit[1] * (s - 0.5)) * out for s in (0.0, 1.0))
    return a, b - a


def _crossing(one: tuple[Floats, Floats], other: tuple[Floats, Floats]) -> Floats:
    (p, d), (q, e) = one, other
    across = d[0] * e[1] - d[1] * e[0]
    if abs(across) < TINY:
        return np.full(2, np.nan)
    t = ((q[0] - p[0]) * e[1] - (q[1] - p[1]) * e[0]) / across
    return p + t * d
