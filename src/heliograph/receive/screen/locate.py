"""Location of a screen array: quadrilaterals that change from frame to frame, and fits of cells inside."""

from collections import deque
from collections.abc import Sequence
from itertools import pairwise, product
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import TINY, Floats
from heliograph.base.frames import Frame
from heliograph.receive.screen.cells import (
    PARAMETERS,
    PIXEL_SAMPLES,
    RIM_CELLS,
    CellFitter,
    CellTracker,
    Place,
    Sample,
    SearchBudget,
    is_inside,
    light_of,
)

Pixels32 = NDArray[np.float32]
"""Gray levels or light of pixels, (rows, columns)."""


Candidate = tuple[float, Place, CellFitter]
"""Misfit of the cells plus change of the ring, place in the first trial frame, and fitter with the best blur."""


def reduce_frame(pixels: Pixels32) -> tuple[Pixels32, int]:
    """Reduce a frame to 480 columns for the search; return the frame and the factor."""
    factor = max(1, -(-pixels.shape[1] // 480))
    size = (pixels.shape[1] // factor, pixels.shape[0] // factor)
    cut = pixels[: size[1] * factor, : size[0] * factor]
    return np.asarray(cv2.resize(cut, size, interpolation=cv2.INTER_AREA), np.float32), factor


def mean_change(frames: Sequence[Pixels32]) -> Pixels32:
    """Return the mean change of each pixel from frame to frame, less the median, in thousandths."""
    total = np.zeros_like(frames[0])
    for before, after in pairwise(frames):
        total += cv2.absdiff(after, before)
    total *= 1000 / (len(frames) - 1)
    return np.maximum(total - np.float32(np.median(total)), 0)


def find_quadrilaterals(changes: Pixels32, factor: int) -> list[Floats]:
    """Find quadrilaterals that change, the strongest first."""
    top = float(changes.max())
    if top < PARAMETERS.min_change:
        return []
    scaled = np.rint(np.clip(changes / top, 0, 1) * 255).astype(np.uint8)
    level, _ = cv2.threshold(scaled, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    candidates: list[tuple[float, Floats]] = []
    for share in (1.0, 0.5):
        lit = (scaled > max(share * level, 255 * PARAMETERS.min_change / top)).astype(np.uint8)
        kernel = np.ones((3, 3), np.uint8)
        lit = np.asarray(cv2.morphologyEx(lit, cv2.MORPH_CLOSE, kernel), np.uint8)
        lit = np.asarray(cv2.morphologyEx(lit, cv2.MORPH_OPEN, kernel), np.uint8)
        # all outlines: the changing rim of a moving screen surrounds the array
        outlines, _ = cv2.findContours(lit, cv2.RETR_LIST, cv2.CHAIN_APPROX_NONE)
        for outline in outlines:
            _, _, width, height = cv2.boundingRect(outline)
            if np.hypot(width, height) < PARAMETERS.min_side:
                continue
            corners = _corners(cv2.convexHull(outline))
            sides = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
            if sides.min() >= PARAMETERS.min_side and sides.max() < 2.5 * sides.min():
                mask = np.zeros(lit.shape, np.uint8)
                cv2.fillConvexPoly(mask, np.rint(corners).astype(np.int32), 1)
                strength = float((changes * mask).sum() * (lit * mask).sum() / max(int(mask.sum()), 1))
                candidates.append((strength, (_ordered(corners) + 0.5) * factor - 0.5))
    candidates.sort(key=lambda candidate: -candidate[0])
    kept: list[Floats] = []
    for _, corners in candidates:
        if all(np.abs(corners - other).max() > 2 * factor for other in kept):
            kept.append(corners)
    return kept[:4]


def _corners(hull: Any) -> Floats:
    """Approximate a convex outline by four corners."""
    length = cv2.arcLength(hull, True)
    for fraction in np.geomspace(0.01, 0.15, 24).tolist():
        polygon = cv2.approxPolyDP(hull, fraction * length, True)[:, 0]
        if len(polygon) == 4:
            return np.asarray(polygon, np.float64)
        if len(polygon) < 4:
            break
    return np.asarray(cv2.boxPoints(cv2.minAreaRect(hull)), np.float64)


def _ordered(corners: Floats) -> Floats:
    """Order corners clockwise from the upper left."""
    x, y = corners.T
    turn = float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))
    corners = corners if turn > 0 else corners[::-1]
    return np.roll(corners, -int(np.argmin(corners.sum(axis=1))), axis=0)


def sharpen_corners(changes: Pixels32, corners: Floats, factor: int) -> Floats:
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


def _edge(changes: Pixels32, start: Floats, end: Floats, middle: Floats, reach: float) -> tuple[Floats, Floats]:
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


class ArraySearch:
    """Search for an array in recent frames."""

    def __init__(self, side: int, gamma: float, budget: SearchBudget):
        self._side, self._gamma, self._budget = side, gamma, budget
        self._light: NDArray[np.float32] | None = None
        self._factor = 1
        self._window = 0  # window at which the next search starts
        self.forget()

    def forget(self) -> None:
        """Drop all frames."""
        self._frames: deque[Frame] = deque(maxlen=PARAMETERS.kept_frames)
        self._small: deque[Pixels32] = deque(maxlen=PARAMETERS.kept_frames)
        self._since = 0

    def push(self, frame: Frame) -> tuple[CellTracker, list[tuple[Frame, Sample | None]]] | None:
        """Add a frame; search at intervals, see `find`."""
        self._frames.append(frame)
        small, self._factor = reduce_frame(self._linear(frame))
        self._small.append(small)
        self._since += 1
        return self.find() if self._since >= 6 else None

    def find(self) -> tuple[CellTracker, list[tuple[Frame, Sample | None]]] | None:
        """Search an array in the recent frames; return a tracker of the array, and each frame with the sample."""
        if len(self._frames) < 12:
            return None
        self._since, windows = 0, PARAMETERS.windows
        for window in (*range(self._window, len(windows)), *range(self._window)):
            count, self._window = windows[window], window
            if count > 2 * len(self._small):
                continue
            if not self._budget.is_left:
                return None
            corners = find_quadrilaterals(mean_change(list(self._small)[-count:]), self._factor)
            changes = self._mean_change(count) if corners else np.empty((0, 0), np.float32)
            # the strongest change comes first
            candidates = [self._fit_candidate(four, changes) for four in corners if self._budget.is_left]
            candidates.sort(key=lambda candidate: candidate[0])
            if candidates and PARAMETERS.min_doubt < candidates[0][0] < np.inf and self._budget.is_left:
                candidates.insert(0, self._search_around(*candidates[0]))
            # a doubtful candidate may be noise before the first change of a slow light
            max_score = np.inf if len(self._frames) >= PARAMETERS.max_doubtful else PARAMETERS.min_doubt
            for score, place, fitter in candidates:
                acquired = self._track_all(place, fitter) if score < max_score else None
                if acquired is not None:
                    return acquired
        self._window = 0
        return None

    def _linear(self, frame: Frame) -> Pixels32:
        """Convert the gray levels of a frame to light."""
        if self._light is None:
            levels = np.arange(frame.full_scale + 1) / frame.full_scale
            self._light = (levels**self._gamma).astype(np.float32)
        return light_of(frame.pixels, self._light)

    def _mean_change(self, count: int) -> Pixels32:
        """Return the mean change of each pixel in recent frames, subsampled to about 16."""
        latest = list(self._frames)[-count:]
        linear = [self._linear(frame) for frame in latest[:: max(1, len(latest) // 16)]]
        self._budget.spend(PIXEL_SAMPLES * len(linear) * linear[0].size)
        return mean_change(linear)

    def _fit_candidate(self, corners: Floats, changes: Pixels32) -> Candidate:
        """Fit place and blur of a candidate with given corners."""
        assert self._light is not None
        fitters = [CellFitter(self._side, blur, self._light, self._budget) for blur in PARAMETERS.blurs_px]
        starts = [Place.of(four, self._side) for four in (sharpen_corners(changes, corners, self._factor), corners)]
        best = min((self._trial(fitters[0], start) for start in starts), key=lambda trial: trial[0])
        # a blur of at most 0.45 cells
        max_blur_px = 0.45 * best[1].cell_px(self._side)
        tried = [self._trial(fitter, best[1]) for fitter in fitters if fitter.blur_px < max_blur_px]
        return min(tried, key=lambda candidate: candidate[0], default=best)

    def _search_around(self, score: float, place: Place, fitter: CellFitter) -> Candidate:
        """Return the best of many places around a candidate, as sway enlarges the changing area by up to 14 px."""
        n, frame = self._side, self._trial_frames[0]
        size = max(place.cell_px(n) * n, 1.0)
        scales = np.arange(1.0, max(1 - (14 + self._factor) / size, 0.75), -0.9 / n)
        places: list[tuple[float, Place]] = []
        for x, y, right, down in product(scales, scales, (0.0, 0.5), (0.0, 0.5)):
            start = place.scaled(x, y, n).shifted(right, down)
            if is_inside(start, n, frame.pixels.shape) and self._budget.is_left:
                fit = fitter(frame, start, PARAMETERS.max_steps)
                places.append((fit.misfit, fit.place))
        places.sort(key=lambda scored: scored[0])
        tried = [self._trial(fitter, start) for _, start in places[:8]]
        return min(((score, place, fitter), *tried), key=lambda scored: scored[0])

    @property
    def _trial_frames(self) -> list[Frame]:
        """The last frames, in which candidates are tried."""
        return list(self._frames)[-PARAMETERS.trial_frames :]

    def _trial(self, fitter: CellFitter, place: Place) -> Candidate:
        """Track cells through the trial frames from a place on."""
        frames = self._trial_frames
        try:
            start = fitter(frames[0], place, PARAMETERS.max_steps).place
        except np.linalg.LinAlgError:
            return np.inf, place, fitter
        tracker = CellTracker(fitter, start, corrects_slips=False)
        samples = [sample for sample in map(tracker.track, frames) if sample is not None]
        if len(samples) < len(frames):
            return np.inf, start, fitter
        change = np.stack([sample.cells for sample in samples]).std(axis=0)
        inner = change[RIM_CELLS:-RIM_CELLS, RIM_CELLS:-RIM_CELLS]
        ring = (change.sum() - inner.sum()) / (change.size - inner.size)
        # the surroundings are static
        misfit = np.mean([sample.misfit for sample in samples])
        return float(misfit + ring / max(float(inner.mean()), TINY)), start, fitter

    def _track_all(
        self, start: Place, fitter: CellFitter
    ) -> tuple[CellTracker, list[tuple[Frame, Sample | None]]] | None:
        """Track an array through all frames; shift the array by a cell if a rim is static."""
        frames = list(self._frames)
        first = max(len(frames) - PARAMETERS.trial_frames, 0)
        for _ in range(3):
            backward, forward = CellTracker(fitter, start), CellTracker(fitter, start)
            before = [backward.track(frame) for frame in frames[first::-1]]
            tracked = list(zip(frames, [*before[::-1], *map(forward.track, frames[first + 1 :])], strict=True))
            samples = [sample for _, sample in tracked if sample is not None]
            if len(samples) < len(frames) // 2:
                return None
            shift = rim_shift(np.stack([sample.cells for sample in samples]))
            if not any(shift):
                return forward, tracked
            start = start.shifted(*shift)
        return None


def rim_shift(cells: Floats) -> tuple[int, int]:
    """Return the offset of an array in cells, right and down, by static rims and changing rings."""
    change = cells.std(axis=0)
    typical = float(np.median(change[RIM_CELLS:-RIM_CELLS, RIM_CELLS:-RIM_CELLS]))
    inner = slice(RIM_CELLS, -RIM_CELLS)
    shifts = []
    for rows in (change[inner].T, change[:, inner]):
        ring = [float(np.median(rows[k])) > typical / 2 for k in (0, -1)]
        is_static = [float(np.median(rows[k])) < typical / 4 for k in (1, -2)]
        shifts.append(int(ring[1] and is_static[0]) - int(ring[0] and is_static[1]))
    return shifts[0], shifts[1]
