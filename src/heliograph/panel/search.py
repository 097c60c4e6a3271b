"""Search for a panel in a picture: candidate quadrilaterals, each refined by the phase of its grid."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import RCOND, TINY, Floats
from heliograph.base.errors import HeliographError
from heliograph.panel.lattice import REACH, Shape, mask_of, plane
from heliograph.panel.phase import TUNING, Agreement, GridView, refined
from heliograph.panel.place import UNIT, Levels, area, grid, grown, homographies, is_possible, mapped, pitches, slopes

Region = tuple[int, int, int, int]
"""Corner (x, y), columns and rows in px."""

SMOOTHING = (0.1, 0.05)
"""Widths to which a panel of unknown pitch is smoothed in turn, as fractions of its side.

Chosen: LEDs of a panel of 16 a side then show as an even area; the first finds corners that are off by a tenth of it.
"""

LEAST_CHANGE = 2.0
"""Least gray levels by which an area differs from what surrounds it. Chosen: noise that is smoothed has far less."""

FOUR = 4
"""Corners of a quadrilateral."""


def evidence(images: Sequence[Levels]) -> Levels:
    """What tells a panel from its surroundings: how much several images change, or how bright one is."""
    return images[0] if len(images) == 1 else np.asarray(np.stack(images).std(axis=0))


def quadrilateral(image: Levels, region: Region | None) -> Floats:
    """Find the largest bright quadrilateral of an image."""
    # standard deviation of the smoothing in which a quadrilateral is searched, as a fraction of the region's side: it
    # closes the gaps between the LEDs of a panel of 20 a side that fills the region
    smooth = np.asarray(cv2.GaussianBlur(image, (0, 0), 0.02 * min(image.shape), borderType=cv2.BORDER_REPLICATE))
    low, high = float(smooth.min()), float(smooth.max())
    if high - low < LEAST_CHANGE:
        raise nothing_shows(region)
    scaled = np.rint((smooth - low) / (high - low) * 255).astype(np.uint8)
    _, lit = cv2.threshold(scaled, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    outlines, _ = cv2.findContours(lit, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    hulls = sorted((cv2.convexHull(one) for one in outlines), key=cv2.contourArea)
    # Least part of the region that a quadrilateral fills. Chosen
    if not hulls or cv2.contourArea(hulls[-1]) < 0.005 * image.size:
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
    # smoothing in px that is left when an image is reduced: Gaussians that are wider are sampled without loss
    every = max(1, int(width / 1.5))
    small, at, sigma = np.ascontiguousarray(smooth[::every, ::every]), corners / every, width / every
    mask = mask_of(grown(at, 3 * sigma), (small.shape[0], small.shape[1]))
    inside = mask.ravel() > 0
    seen, flat = small.ravel()[inside].astype(np.float64), plane(mask).reshape(3, -1).T[inside]
    # Most steps at each smoothing. Chosen: it bounds the time of what does not converge
    for _ in range(8):
        lit, moved = _even(at, sigma, mask.shape)
        # light may rise along the area, and what is behind it too
        shown = np.column_stack([flat * lit.ravel()[inside, None], flat])
        if len(shown) <= shown.shape[1]:
            break
        found = np.linalg.lstsq(shown, seen, rcond=RCOND)[0]
        noise = max(float((seen - shown @ found).std()), TINY)
        columns = np.column_stack([found[0] * moved.reshape(8, -1).T[inside], shown])
        prior = np.zeros((8, columns.shape[1]))
        # prior standard deviation of a step of a corner, in widths of the smoothing: farther the image is not linear in
        # it
        prior[:, :8] = np.eye(8) * noise / (0.5 * sigma)
        step = np.linalg.lstsq(np.vstack([columns, prior]), np.append(seen, np.zeros(8)), rcond=RCOND)[0][:8]
        step /= max(np.abs(step).max() / (2 * sigma), 1.0)
        at = at + step.reshape(4, 2)
        # Step of a corner, in widths of the smoothing, that ends a fit. A tolerance
        if np.abs(step).max() < 0.02 * sigma:
            break
    return at * every


def _even(corners: Floats, sigma: float, size: tuple[int, ...]) -> tuple[Levels, Levels]:
    """An even area and its derivatives by the corners, (8, rows, columns)."""
    from heliograph.panel import kernels  # Numba is slow to import

    longest = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1).max()
    # distance of the points that stand for an even area, in widths of the smoothing: it ripples by 1e-5 then
    count = int(np.ceil(longest / (0.9 * sigma)))
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


@dataclass(frozen=True, slots=True)
class SearchTuning:
    """How a panel is searched and judged. Chosen by `python -m benchmarks.panel_places`."""

    # Standard deviations of the smoothing before thresholds, as fractions of the image's shorter side
    spreads: tuple[float, ...] = (0.012, 0.035)
    # Levels between the lowest and highest from which an image counts as lit, beside Otsu's
    thresholds: tuple[float, ...] = (0.5,)
    # Gaps that are closed, as fractions of the image's shorter side
    gaps: tuple[float, ...] = (0.0, 0.06)
    # Smallest area of a quadrilateral as a fraction of the image's
    min_area: float = 0.005
    # Largest ratio of the pitches along rows and columns
    max_pitch_ratio: float = 2.2
    # Quadrilaterals that are refined, the best first
    n_refined: int = 8
    # Frames whose lit LEDs count together
    n_frames: int = 8
    # Largest error in pitches of corners by hand
    max_hand: float = 3.0
    # Square of the distance in pitches from corners by hand from which on lit LEDs alone decide
    max_hand_cost: float = 2.0
    # Score from which on no other start is tried
    sure: float = 0.9
    # Lit LEDs of a line that count for the choice among whole pitches
    max_peaks: float = 6.0
    # Log odds of a place up to whole pitches: a constant, and the factors of both `Agreement.phases` and of ln
    # `Agreement.leverage`
    phases: tuple[float, float, float, float] = (-15.4, 10.7, 9.8, -2.2)
    # Log odds of a place against a shift by a pitch: a constant, the weight of a lit LED in an outer line, and the
    # weight of the squared distance from corners by hand, and of the growth beside them
    shift: tuple[float, float, float] = (0.8, 1.0, 2.0)


SEARCH = SearchTuning()


class Candidate(NamedTuple):
    """A place that may be the panel's."""

    # (4, 2) corners in px of the picture
    corners: Floats
    # Agreement of the picture with the grid there
    agreement: Agreement
    # Probability that the place is right, 0 to 1
    score: float


def quadrilaterals(
    images: Sequence[Levels], colour: Levels, shape: Shape, region: Region | None = None
) -> list[Floats]:
    """Quadrilaterals (4, 2) in px that may be a panel's outline, those whose grid shows best first."""
    maps = [one for one in (images[0], colour, evidence(images)) if float(np.ptp(one)) >= LEAST_CHANGE]
    if not maps:
        raise nothing_shows(region)
    found: list[Floats] = []
    for corners in (corners for image in maps for corners in _outlines(image)):
        is_known = any(np.abs(corners - other).max() <= 1.2 * shape.pitch(corners) for other in found)
        if not is_known and is_plausible(corners, shape):
            found.append(corners)
    judged = []
    for corners in found:
        view = GridView(images[0], corners, shape)
        judged.append((view.strength(), corners))
        stretched = view.stretched()
        if is_plausible(stretched, shape):
            judged.append((GridView(images[0], stretched, shape).strength(), stretched))
    judged.sort(key=lambda one: -one[0])
    return [corners for _, corners in judged[: SEARCH.n_refined]]


def best_candidate(
    images: Sequence[Levels], starts: Sequence[Floats], shape: Shape, hand: Floats | None = None
) -> Candidate:
    """The candidate with the highest score near any start."""
    best = Candidate(UNIT, Agreement(np.zeros(2), 0.0, np.zeros(0), np.zeros(0)), -1.0) if hand is None else settled(
        images[:1], hand, shape, hand, shift=False)  # fmt: skip
    for start in starts:
        # starts without a hand are stretched already
        for stretch in (False,) if hand is None else (False, True):
            corners = refined(images[0], start, shape, stretch)
            if is_plausible(corners, shape) and (hand is None or is_near(corners, hand, shape)):
                best = max(best, settled(images[:1], corners, shape, hand), key=lambda one: one.score)
    if best.score < 0:
        raise HeliographError(
            f"no panel of {shape.rows} x {shape.columns} LEDs was found: give corners=, its four corners in px"
        )
    return settled(images[: SEARCH.n_frames], best.corners, shape, hand)


def is_plausible(corners: Floats, shape: Shape) -> bool:
    """True if a camera may see such a panel, with about the same pitch along rows and columns."""
    if not is_possible(corners, shape.rows, shape.columns):
        return False
    along, down = pitches(corners, shape.rows, shape.columns)
    return max(along, down) <= SEARCH.max_pitch_ratio * min(along, down)


def _outlines(image: Levels) -> Iterator[Floats]:
    side = min(image.shape)
    wide = cv2.GaussianBlur(image, (0, 0), 0.15 * side)
    for spread in SEARCH.spreads:
        smooth = cv2.GaussianBlur(image, (0, 0), max(spread * side, 1.0))
        for seen in (smooth, smooth - wide):
            scaled = np.rint((seen - seen.min()) / max(float(np.ptp(seen)), 1e-6) * 255).astype(np.uint8)
            otsu, _ = cv2.threshold(scaled, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
            for level in (otsu, *(255 * share for share in SEARCH.thresholds)):
                for gap in SEARCH.gaps:
                    yield from _hull_corners(_closed(scaled > level, int(gap * side)))


def _closed(lit: NDArray[np.bool_], gap: int) -> NDArray[np.uint8]:
    if not gap:
        return lit.astype(np.uint8)
    kernel = cv2.getStructuringElement(cv2.MORPH_RECT, (2 * gap + 1, 2 * gap + 1))
    padded = cv2.morphologyEx(np.pad(lit.astype(np.uint8), gap), cv2.MORPH_CLOSE, kernel)
    return np.asarray(padded[gap:-gap, gap:-gap], np.uint8)


def _hull_corners(lit: NDArray[np.uint8]) -> Iterator[Floats]:
    """Corners of the two largest lit areas, and of all large ones together."""
    outlines, _ = cv2.findContours(lit, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    outlines = sorted(outlines, key=cv2.contourArea)[-40:]
    if not outlines:
        return
    largest = cv2.contourArea(outlines[-1])
    together = np.concatenate([one for one in outlines if cv2.contourArea(one) >= 0.05 * largest])
    for points in (*outlines[-2:], together):
        hull = cv2.convexHull(points)
        if cv2.contourArea(hull) >= SEARCH.min_area * lit.size:
            yield ordered(four_corners(hull))
            yield ordered(cv2.boxPoints(cv2.minAreaRect(hull)).astype(np.float64))


def settled(
    images: Sequence[Levels], corners: Floats, shape: Shape, hand: Floats | None = None, shift: bool = True
) -> Candidate:
    """The place near corners that agrees best with pictures, whole pitches chosen by the lit LEDs and the hand."""
    views = [GridView(images[0], corners, shape)]
    for image in images[1:]:
        # the panel moves by less than half a pitch
        views.append(GridView(image, refined(image, views[-1].corners, shape, stretch=False), shape))
    agreements = [view.agreement() for view in views]
    good = [one for one in agreements if one.phases.min() >= agreements[0].phases.min() - 0.2] or agreements[:1]
    lit = agreements[0]._replace(
        rows=np.max([one.rows for one in good], axis=0), columns=np.max([one.columns for one in good], axis=0)
    )
    rim = TUNING.rim
    moves, odds = [], []
    offset, growth = (np.zeros(2), np.zeros(2)) if hand is None else _beside_hand(corners, hand, shape)
    counts = shape.columns, shape.rows
    for peaks, count, off, rise in zip((lit.columns, lit.rows), counts, offset, growth, strict=True):
        line = np.minimum(peaks, SEARCH.max_peaks)
        evidence = np.array([line[rim + k : rim + k + count].sum() for k in range(-rim, rim + 1)]) * SEARCH.shift[1]
        steps = np.arange(-rim, rim + 1)
        if hand is not None:
            evidence = evidence - SEARCH.shift[2] * np.minimum((steps + off) ** 2, SEARCH.max_hand_cost)
        best = int(np.argmax(evidence - 1e-6 * np.abs(steps))) if shift else rim
        others = [evidence[k] for k in (best - 1, best + 1) if 0 <= k < len(evidence)]
        moves.append(int(steps[best]))
        odds.append(float(evidence[best] - max(others)) - SEARCH.shift[2] * abs(rise))
    constant, narrow, wide, lever = SEARCH.phases
    log_odds = constant + narrow * lit.phases[0] + wide * lit.phases[1] + lever * np.log(max(lit.leverage, TINY))
    score = _probability(log_odds)
    for one in odds:
        score *= _probability(SEARCH.shift[0] + one)
    return Candidate(views[0].shifted(*moves) if any(moves) else corners, lit, score)


def found_again(image: Levels, starts: Sequence[Floats], shape: Shape) -> Candidate:
    """The candidate of the highest score near where the panel was expected, the most likely start first."""
    found = []
    for start in starts:
        for windows in (TUNING.windows_leds[-2:], TUNING.windows_leds):
            found.append(settled([image], refined(image, start, shape, False, windows), shape, start))
            if found[-1].score >= SEARCH.sure:
                return found[-1]
    return max(found, key=lambda one: one.score)


def is_near(corners: Floats, hand: Floats, shape: Shape) -> bool:
    """True if no corner is farther from those given by hand than a hand may err."""
    return bool(np.linalg.norm(corners - hand, axis=1).max() <= SEARCH.max_hand * shape.pitch(hand))


def _beside_hand(corners: Floats, hand: Floats, shape: Shape) -> tuple[Floats, Floats]:
    """Shift (2,) and growth (2,) in pitches along rows and columns of corners beside those given by hand."""
    to_unit = np.asarray(np.linalg.inv(homographies(hand)), np.float64)
    off = (mapped(to_unit, np.asarray(corners, np.float64)) - UNIT) * np.array([shape.columns, shape.rows])
    left, right, top, low = off[[0, 3], 0].mean(), off[[1, 2], 0].mean(), off[:2, 1].mean(), off[2:, 1].mean()
    return np.array([left + right, top + low]) / 2, np.array([right - left, low - top])


def _probability(log_odds: float) -> float:
    return float(1 / (1 + np.exp(-np.clip(log_odds, -50, 50))))
