"""A panel's outline: a quadrilateral that is bright or in which something changes, found and fitted as an even area."""

from collections.abc import Sequence
from typing import Any

import cv2
import numpy as np

from heliograph.base.arrays import RCOND, TINY, Floats
from heliograph.base.errors import HeliographError
from heliograph.panel.lattice import REACH, mask_of, plane
from heliograph.panel.picture import Levels
from heliograph.panel.place import area, grid, grown, homographies, mapped, slopes

Region = tuple[int, int, int, int]
"""Corner (x, y), columns and rows in px."""

SMOOTHING = (0.1, 0.05)
"""Widths to which a panel of unknown pitch is smoothed in turn, as fractions of its side.

Chosen: LEDs of a panel of 16 a side then show as an even area; the first finds corners that are off by a tenth of it.
"""

EVEN = 0.9
"""Distance of the points that stand for an even area, in widths of the smoothing: it ripples by 1e-5 then."""

REDUCED_PX = 1.5
"""Smoothing in px that is left when an image is reduced: Gaussians that are wider are sampled without loss."""

STEPS = 8
"""Most steps at each smoothing. Chosen: it bounds the time of what does not converge."""

ENOUGH = 0.02
"""Step of a corner, in widths of the smoothing, that ends a fit. A tolerance."""

HELD = 0.5
"""Prior standard deviation of a step of a corner, in widths of the smoothing: farther the image is not linear in it."""

SPREAD = 0.02
"""Standard deviation of the smoothing in which a quadrilateral is searched, as a fraction of the region's side: it
closes the gaps between the LEDs of a panel of 20 a side that fills the region."""

LEAST_CHANGE = 2.0
"""Least gray levels by which an area differs from what surrounds it. Chosen: noise that is smoothed has far less."""

LEAST_AREA = 0.005
"""Least part of the region that a quadrilateral fills. Chosen."""

FOUR = 4
"""Corners of a quadrilateral."""


def evidence(images: Sequence[Levels]) -> Levels:
    """What tells a panel from its surroundings: how much several images change, or how bright one is."""
    return images[0] if len(images) == 1 else np.asarray(np.stack(images).std(axis=0))


def quadrilateral(image: Levels, region: Region | None) -> Floats:
    """Find the largest bright quadrilateral of an image."""
    smooth = np.asarray(cv2.GaussianBlur(image, (0, 0), SPREAD * min(image.shape), borderType=cv2.BORDER_REPLICATE))
    low, high = float(smooth.min()), float(smooth.max())
    if high - low < LEAST_CHANGE:
        raise nothing_shows(region)
    scaled = np.rint((smooth - low) / (high - low) * 255).astype(np.uint8)
    _, lit = cv2.threshold(scaled, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    outlines, _ = cv2.findContours(lit, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    hulls = sorted((cv2.convexHull(one) for one in outlines), key=cv2.contourArea)
    if not hulls or cv2.contourArea(hulls[-1]) < LEAST_AREA * image.size:
        raise HeliographError(
            f"no area that is bright or changes{_where(region)} is as large as a panel: give corners="
        )
    return ordered(four_corners(hulls[-1]))


def nothing_shows(region: Region | None) -> HeliographError:
    """The error for a frame, or its region, that shows nothing."""
    return HeliographError(
        f"nothing is bright or changes{_where(region)}: give corners=, the panel's four corners in px, or several "
        "frames"
    )


def _where(region: Region | None) -> str:
    return f" in the region {','.join(map(str, region))}" if region else ""


def four_corners(hull: Any) -> Floats:
    """The four corners of a convex outline, by the coarsest polygon that has four."""
    length = cv2.arcLength(hull, True)
    for fraction in np.geomspace(0.005, 0.2, 40):
        polygon = cv2.approxPolyDP(hull, fraction * length, True)[:, 0]
        if len(polygon) == FOUR:
            return np.asarray(polygon, np.float64)
        if len(polygon) < FOUR:
            break
    return np.asarray(cv2.boxPoints(cv2.minAreaRect(hull)), np.float64)


def ordered(corners: Floats) -> Floats:
    """Corners clockwise, the one nearest to the upper left first."""
    corners = corners if area(corners) > 0 else corners[::-1]
    return np.roll(corners, -int(np.argmin(corners.sum(axis=1))), axis=0)


def outlined(image: Levels, corners: Floats, widths: Sequence[float]) -> Floats:
    """Fit the corners of an even bright area to an image, smoothed less and less."""
    for width in widths:
        corners = _fitted(image, corners, width)
    return corners


def _fitted(image: Levels, corners: Floats, width: float) -> Floats:
    smooth = np.asarray(cv2.GaussianBlur(image, (0, 0), width, borderType=cv2.BORDER_REPLICATE))
    every = max(1, int(width / REDUCED_PX))
    small, at, sigma = np.ascontiguousarray(smooth[::every, ::every]), corners / every, width / every
    mask = mask_of(grown(at, 3 * sigma), (small.shape[0], small.shape[1]))
    inside = mask.ravel() > 0
    seen, flat = small.ravel()[inside].astype(np.float64), plane(mask).reshape(3, -1).T[inside]
    for _ in range(STEPS):
        lit, moved = _even(at, sigma, mask.shape)
        # light may rise along the area, and what is behind it too
        shown = np.column_stack([flat * lit.ravel()[inside, None], flat])
        if len(shown) <= shown.shape[1]:
            break
        found = np.linalg.lstsq(shown, seen, rcond=RCOND)[0]
        noise = max(float((seen - shown @ found).std()), TINY)
        columns = np.column_stack([found[0] * moved.reshape(8, -1).T[inside], shown])
        prior = np.zeros((8, columns.shape[1]))
        prior[:, :8] = np.eye(8) * noise / (HELD * sigma)
        step = np.linalg.lstsq(np.vstack([columns, prior]), np.append(seen, np.zeros(8)), rcond=RCOND)[0][:8]
        step /= max(np.abs(step).max() / (2 * sigma), 1.0)
        at = at + step.reshape(4, 2)
        if np.abs(step).max() < ENOUGH * sigma:
            break
    return at * every


def _even(corners: Floats, sigma: float, size: tuple[int, ...]) -> tuple[Levels, Levels]:
    """An even area and its derivatives by the corners, (8, rows, columns)."""
    from heliograph.panel import kernels  # Numba is slow to import

    longest = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1).max()
    count = int(np.ceil(longest / (EVEN * sigma)))
    unit, map_ = grid(count, count), homographies(corners)
    points, moves = mapped(map_, unit), slopes(corners, unit)
    # a surface is as bright near as far: each point stands for its area, det(H) / w^3
    amounts = np.zeros((9, len(unit), 4))
    weight = (unit @ map_[2, :2] + 1.0) ** -3.0
    amounts[0, :, 0] = weight / weight.mean()
    amounts[1:, :, 1:3] = amounts[0, :, :1] * moves
    images = np.zeros((9, *size), np.float32)
    for amount, image in zip(amounts, images, strict=True):
        kernels.drawn(amount, points, sigma, REACH * sigma, image)
    return images[0], images[1:]
