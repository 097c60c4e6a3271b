"""Search for a panel in pictures: candidate quadrilaterals, refined by the phase of the grid."""

from collections.abc import Iterator, Sequence
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import expit

from heliograph.base.arrays import RCOND, TINY, Floats
from heliograph.base.errors import HeliographError
from heliograph.panel import kernels
from heliograph.panel.lattice import REACH, mask_of, plane
from heliograph.panel.phase import RIM, GridView, refine
from heliograph.panel.place import UNIT, Levels, Place, Shape, area, corner_jacobian, grid, homographies, transform

Region = tuple[int, int, int, int]
"""Corner (x, y), columns and rows in px."""

MIN_CHANGE = 2.0  # minimum range of gray levels of a panel: smooth noise has far less


def evidence(images: Sequence[Levels]) -> Levels:
    """Return the contrast of a panel with the scene: change of several images, or brightness of a single image."""
    return images[0] if len(images) == 1 else np.asarray(np.stack(images).std(axis=0))


def quadrilateral(image: Levels, region: Region | None) -> Floats:
    """Find the largest bright quadrilateral of an image."""
    # closes the gaps of 20 LEDs a side that fill the image
    spread = 0.02 * min(image.shape)
    smooth = np.asarray(cv2.GaussianBlur(image, (0, 0), spread, borderType=cv2.BORDER_REPLICATE))
    if float(np.ptp(smooth)) < MIN_CHANGE:
        raise no_contrast(region)
    scaled = _scaled(smooth)
    hulls = [cv2.convexHull(outline) for outline in _contours(scaled > _otsu(scaled))]
    hull = max(hulls, key=cv2.contourArea, default=None)
    if hull is None or cv2.contourArea(hull) < 0.005 * image.size:
        raise HeliographError(
            f"no area that is bright or changes{_where(region)} is as large as a panel: give corners="
        )
    return order_corners(_four_corners(hull))


def no_contrast(region: Region | None) -> HeliographError:
    """Return the error for a uniform frame or region."""
    return HeliographError(
        f"nothing is bright or changes{_where(region)}: give corners=, the panel's four corners in px, or several "
        "frames"
    )


def _where(region: Region | None) -> str:
    return f" in the region {','.join(map(str, region))}" if region else ""


def _scaled(image: NDArray[Any]) -> NDArray[np.uint8]:
    return np.rint((image - image.min()) / max(float(np.ptp(image)), 1e-6) * 255).astype(np.uint8)


def _otsu(scaled: NDArray[np.uint8]) -> float:
    return float(cv2.threshold(scaled, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)[0])


def _contours(lit: NDArray[Any]) -> Sequence[Any]:
    return cv2.findContours(lit.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]


def _four_corners(hull: Any) -> Floats:
    """Return the four corners of a convex outline, by the coarsest quadrilateral approximation."""
    length = cv2.arcLength(hull, True)
    for fraction in np.geomspace(0.005, 0.2, 40):
        polygon = cv2.approxPolyDP(hull, fraction * length, True)[:, 0]
        if len(polygon) == 4:
            return np.asarray(polygon, np.float64)
        if len(polygon) < 4:
            break
    return np.asarray(cv2.boxPoints(cv2.minAreaRect(hull)), np.float64)


def order_corners(corners: Floats) -> Floats:
    """Return corners clockwise from the upper left."""
    corners = corners if area(corners) > 0 else corners[::-1]
    return np.roll(corners, -int(np.argmin(corners.sum(axis=1))), axis=0)


def fit_outline(image: Levels, corners: Floats) -> Floats:
    """Fit the corners of a uniform bright area to an image, with less and less smoothing."""
    # 16 LEDs a side appear uniform
    for width in (0.1 * area(corners) ** 0.5, 0.05 * area(corners) ** 0.5):
        corners = _fit_area(image, corners, width)
    return corners


def _fit_area(image: Levels, corners: Floats, width: float) -> Floats:
    smooth = np.asarray(cv2.GaussianBlur(image, (0, 0), width, borderType=cv2.BORDER_REPLICATE))
    # a smooth image is subsampled
    every = max(1, int(width / 1.5))
    small, at, sigma = np.ascontiguousarray(smooth[::every, ::every]), corners / every, width / every
    mask = mask_of(at, small.shape, 3 * sigma)
    inside = mask.ravel() > 0
    pixels, flat = small.ravel()[inside].astype(np.float64), plane(mask).reshape(3, -1).T[inside]
    for _ in range(8):
        lit, moved = _render_area(at, sigma, mask.shape)
        # light and background may have slopes
        shown = np.column_stack([flat * lit.ravel()[inside, None], flat])
        if len(shown) <= shown.shape[1]:
            break
        found = np.linalg.lstsq(shown, pixels, rcond=RCOND)[0]
        noise = max(float((pixels - shown @ found).std()), TINY)
        columns = np.column_stack([found[0] * moved.reshape(8, -1).T[inside], shown])
        # prior of half a smoothing width for the corners: the image is nearly linear
        prior = np.zeros((8, columns.shape[1]))
        prior[:, :8] = np.eye(8) * noise / (0.5 * sigma)
        step = np.linalg.lstsq(np.vstack([columns, prior]), np.append(pixels, np.zeros(8)), rcond=RCOND)[0][:8]
        step /= max(np.abs(step).max() / (2 * sigma), 1.0)
        at = at + step.reshape(4, 2)
        if np.abs(step).max() < 0.02 * sigma:
            break
    return at * every


def _render_area(corners: Floats, sigma: float, size: tuple[int, ...]) -> tuple[Levels, Levels]:
    """Render a uniform area and the derivatives by the corners, (8, rows, columns)."""
    # points 0.9 sigma apart stand for an area with a ripple of 1e-5
    count = int(np.ceil(np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1).max() / (0.9 * sigma)))
    unit, map_ = grid(count, count), homographies(corners)
    points, jacobian = transform(map_, unit), corner_jacobian(corners, unit)
    # a point has the weight of the area, det(H) / w^3
    amounts = np.zeros((9, len(unit), 4))
    weight = (unit @ map_[2, :2] + 1.0) ** -3.0
    amounts[0, :, 0] = weight / weight.mean()
    amounts[1:, :, 1:3] = amounts[0, :, :1] * jacobian
    images = np.zeros((9, *size), np.float32)
    for amount, image in zip(amounts, images, strict=True):
        kernels.render(amount, points, sigma, REACH * sigma, image)
    return images[0], images[1:]


def quadrilaterals(
    images: Sequence[Levels], colour: Levels, shape: Shape, region: Region | None = None
) -> list[Floats]:
    """Find quadrilaterals (4, 2) in px that may outline a panel, the clearest grid first."""
    maps = [image for image in (images[0], colour, evidence(images)) if float(np.ptp(image)) >= MIN_CHANGE]
    if not maps:
        raise no_contrast(region)
    found: list[Floats] = []
    for corners in (corners for image in maps for corners in _outlines(image)):
        is_known = any(np.abs(corners - other).max() <= 1.2 * shape.pitch(corners) for other in found)
        if not is_known and is_plausible(corners, shape):
            found.append(corners)
    ranked = []
    for corners in found:
        view = GridView(images[0], corners, shape)
        ranked.append((view.strength(), corners))
        stretched = view.stretched()
        if is_plausible(stretched, shape):
            ranked.append((GridView(images[0], stretched, shape).strength(), stretched))
    ranked.sort(key=lambda entry: -entry[0])
    return [corners for _, corners in ranked[:8]]


def best_candidate(
    images: Sequence[Levels], starts: Sequence[Floats], shape: Shape, hand: Floats | None = None
) -> Place:
    """Return the candidate with the highest score near any start."""
    best: Place | None = settle(images[:1], hand, shape, hand, shift=False) if hand is not None else None
    for start in starts:
        # starts of `quadrilaterals` are stretched already
        for stretch in (False,) if hand is None else (False, True):
            corners = refine(images[0], start, shape, stretch)
            # all corners are within 3 pitches of the manual corners
            is_near = hand is None or np.linalg.norm(corners - hand, axis=1).max() <= 3.0 * shape.pitch(hand)
            if is_near and is_plausible(corners, shape):
                found = settle(images[:1], corners, shape, hand)
                best = found if best is None or found.score > best.score else best
    if best is None:
        raise HeliographError(
            f"no panel of {shape.rows} x {shape.columns} LEDs was found: give corners=, its four corners in px"
        )
    return settle(images[:8], best.corners, shape, hand)


def is_plausible(corners: Floats, shape: Shape) -> bool:
    """Return True if a camera can see the panel, with similar pitches along rows and columns."""
    if not shape.is_possible(corners):
        return False
    return max(shape.pitches(corners)) <= 2.2 * shape.pitch(corners)


def _outlines(image: Levels) -> Iterator[Floats]:
    side = min(image.shape)
    wide = cv2.GaussianBlur(image, (0, 0), 0.15 * side)
    for spread in (0.012, 0.035):
        smooth = cv2.GaussianBlur(image, (0, 0), max(spread * side, 1.0))
        for scaled in (_scaled(smooth), _scaled(smooth - wide)):
            for level in (_otsu(scaled), 127.5):
                for gap in (0.0, 0.06):
                    yield from _hull_corners(_close(scaled > level, int(gap * side)))


def _close(lit: NDArray[np.bool_], gap: int) -> NDArray[np.uint8]:
    if not gap:
        return lit.astype(np.uint8)
    kernel = cv2.getStructuringElement(cv2.MORPH_RECT, (2 * gap + 1, 2 * gap + 1))
    padded = cv2.morphologyEx(np.pad(lit.astype(np.uint8), gap), cv2.MORPH_CLOSE, kernel)
    return np.asarray(padded[gap:-gap, gap:-gap], np.uint8)


def _hull_corners(lit: NDArray[np.uint8]) -> Iterator[Floats]:
    """Yield corners of the two largest lit areas, and of all large areas together."""
    outlines = sorted(_contours(lit), key=cv2.contourArea)[-40:]
    if not outlines:
        return
    largest = cv2.contourArea(outlines[-1])
    together = np.concatenate([outline for outline in outlines if cv2.contourArea(outline) >= 0.05 * largest])
    for points in (*outlines[-2:], together):
        hull = cv2.convexHull(points)
        if cv2.contourArea(hull) >= 0.005 * lit.size:
            yield order_corners(_four_corners(hull))
            yield order_corners(cv2.boxPoints(cv2.minAreaRect(hull)).astype(np.float64))


def settle(
    images: Sequence[Levels], corners: Floats, shape: Shape, hand: Floats | None = None, shift: bool = True
) -> Place:
    """Choose integer pitches near corners by lit LEDs and manual corners, and score the position."""
    views = [GridView(images[0], corners, shape)]
    for image in images[1:]:
        # the panel moves by less than half a pitch
        views.append(GridView(image, refine(image, views[-1].corners, shape, stretch=False), shape))
    agreements = [view.agreement() for view in views]
    first = agreements[0]
    good = [other for other in agreements if other.phases.min() >= first.phases.min() - 0.2] or [first]
    lit = first._replace(
        rows=np.max([other.rows for other in good], axis=0), columns=np.max([other.columns for other in good], axis=0)
    )
    # logistic regressions for a position up to integer pitches, and for a shift by a pitch (benchmarks/panel_places.py)
    log_odds = -15.4 + 10.7 * lit.phases[0] + 9.8 * lit.phases[1] - 2.2 * np.log(max(lit.leverage, TINY))
    score, moves = float(expit(log_odds)), list[int]()
    steps = np.arange(-RIM, RIM + 1)
    offset, growth = (np.zeros(2), np.zeros(2)) if hand is None else _compare(corners, hand, shape)
    counts = shape.columns, shape.rows
    for peaks, count, off, rise in zip((lit.columns, lit.rows), counts, offset, growth, strict=True):
        evidence = np.array([np.minimum(peaks, 6.0)[k : k + count].sum() for k in range(2 * RIM + 1)])
        if hand is not None:
            evidence = evidence - 2.0 * np.minimum((steps + off) ** 2, 2.0)
        best = int(np.argmax(evidence - 1e-6 * np.abs(steps))) if shift else RIM
        others = [evidence[k] for k in (best - 1, best + 1) if 0 <= k < len(evidence)]
        moves.append(int(steps[best]))
        odds = float(evidence[best] - max(others)) - 2.0 * abs(rise)
        score *= float(expit(0.8 + odds))
    return Place(views[0].shifted(*moves) if any(moves) else corners, score=score)


def search_near(image: Levels, starts: Sequence[Floats], shape: Shape) -> Place:
    """Return the candidate with the highest score near expected positions, the most likely position first."""
    found = []
    for start in starts:
        for windows in ((2.0, 1.5), (4.0, 3.0, 2.0, 2.0, 1.5)):
            found.append(settle([image], refine(image, start, shape, False, windows), shape, start))
            if found[-1].score >= 0.9:
                return found[-1]
    return max(found, key=lambda candidate: candidate.score)


def _compare(corners: Floats, hand: Floats, shape: Shape) -> tuple[Floats, Floats]:
    """Return shift (2,) and growth (2,) of corners relative to manual corners, in pitches along rows and columns."""
    to_unit = np.asarray(np.linalg.inv(homographies(hand)), np.float64)
    off = (transform(to_unit, np.asarray(corners, np.float64)) - UNIT) * np.array([shape.columns, shape.rows])
    left, right, top, low = off[[0, 3], 0].mean(), off[[1, 2], 0].mean(), off[:2, 1].mean(), off[2:, 1].mean()
    return np.array([left + right, top + low]) / 2, np.array([right - left, low - top])
