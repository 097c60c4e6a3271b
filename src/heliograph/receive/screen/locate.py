"""Location of a screen array: quadrilaterals that change from frame to frame, and fits of cells inside."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise, product
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import TINY, Floats
from heliograph.base.frames import Frame
from heliograph.receive.screen.cells import (
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


@dataclass(frozen=True)
class LocateParameters:
    """Parameters of the location of an array."""

    # Maximum columns of the reduced frames, and minimum side of an array in reduced px
    reduced_columns: int = 480
    min_side: int = 9
    # Minimum mean change in thousandths of full scale; 2 patterns/s at 30 frames/s change by 20
    min_change: float = 4.0
    # Maximum number of quadrilaterals, and maximum ratio of the sides
    max_candidates: int = 4
    max_side_ratio: float = 2.5
    # Tolerances of the polygons of an outline, relative to the length
    tolerances: tuple[float, ...] = tuple(np.geomspace(0.01, 0.15, 24).tolist())
    # Profiles across a side, reach of a profile in reduced px, and distance in px at which an edge counts half
    profiles: int = 32
    edge_reach: float = 2.5
    edge_distance_px: float = 2.0
    # Kept frames: 16 patterns of 60 patterns/s at 240 frames/s
    kept_frames: int = 64
    # Frames between two searches, and before the first
    search_interval: int = 6
    first_search: int = 12
    # Frames after which a doubtful array is accepted
    max_doubtful: int = 48
    # Numbers of recent frames for the changes: few for shaken cameras, many for slow patterns
    windows: tuple[int, ...] = (8, 16, 64)
    # Blurs in px to try, and the maximum in cells
    blurs_px: tuple[float, ...] = (1.0, 0.6, 1.6, 2.4)
    max_blur: float = 0.45
    # Best candidates of a frame to try in several frames
    max_trials: int = 8
    # Misfit plus change of the ring above which a candidate is doubtful; 0.06 to 0.25 for the right place
    min_doubt: float = 0.3
    # Increase of the apparent size by sway in px, minimum scale, and step of the scales in cells
    sway_px: float = 14.0
    min_scale: float = 0.75
    scale_step: float = 0.9
    # Frames of a trial, and maximum steps of a fit
    trial_frames: int = 8
    max_steps: int = 10


PARAMETERS = LocateParameters()


def reduce_frame(pixels: Pixels32) -> tuple[Pixels32, int]:
    """Reduce a frame for the search; return the frame and the factor."""
    factor = max(1, -(-pixels.shape[1] // PARAMETERS.reduced_columns))
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
            if sides.min() >= PARAMETERS.min_side and sides.max() < PARAMETERS.max_side_ratio * sides.min():
                mask = np.zeros(lit.shape, np.uint8)
                cv2.fillConvexPoly(mask, np.rint(corners).astype(np.int32), 1)
                strength = float((changes * mask).sum() * (lit * mask).sum() / max(int(mask.sum()), 1))
                candidates.append((strength, (_ordered(corners) + 0.5) * factor - 0.5))
    candidates.sort(key=lambda candidate: -candidate[0])
    kept: list[Floats] = []
    for _, corners in candidates:
        if all(np.abs(corners - other).max() > 2 * factor for other in kept):
            kept.append(corners)
    return kept[: PARAMETERS.max_candidates]


def _corners(hull: Any) -> Floats:
    """Approximate a convex outline by four corners."""
    length = cv2.arcLength(hull, True)
    for fraction in PARAMETERS.tolerances:
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
    reach = PARAMETERS.edge_reach * factor + 1
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
    places = np.linspace(0.06, 0.94, PARAMETERS.profiles) * length
    points = start + places[:, None, None] * along + across[:, None] * out
    x, y = (np.asarray(points[..., k], np.float32) for k in (0, 1))
    profiles = np.asarray(cv2.remap(changes, x, y, cv2.INTER_LINEAR), np.float64)
    inside = np.median(profiles[:, : len(across) // 3], axis=1)
    outside = np.median(profiles[:, -len(across) // 4 :], axis=1)
    strong = inside - outside > 0.4 * np.median(inside)
    if strong.sum() < PARAMETERS.profiles // 4:
        return start, along
    # a blurred edge is at half the height
    over = profiles > ((inside + outside) / 2)[:, None]
    last = len(across) - 1 - np.argmax(over[:, ::-1], axis=1)
    offsets = across[last] + (across[1] - across[0]) / 2
    weight = strong.astype(float)
    fit = np.array([np.median(offsets[strong]), 0.0])
    columns = np.column_stack([np.ones(PARAMETERS.profiles), places / length - 0.5])
    for _ in range(8):
        far = np.abs(offsets - columns @ fit)
        w = weight / (1 + (far / PARAMETERS.edge_distance_px) ** 2) ** 2
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


@dataclass(frozen=True)
class CandidateArray:
    """A candidate for an array."""

    # Misfit of the cells plus change of the ring
    score: float
    # Place in the first of the trial frames
    place: Place
    # Fitter with the best blur
    fitter: CellFitter


class ArraySearch:
    """Search for an array in recent frames."""

    def __init__(self, side: int, gamma: float, budget: SearchBudget | None = None):
        self._side, self._gamma, self._budget = side, gamma, budget or SearchBudget()
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
        return self.find() if self._since >= PARAMETERS.search_interval else None

    def find(self) -> tuple[CellTracker, list[tuple[Frame, Sample | None]]] | None:
        """Search an array in the recent frames; return a tracker of the array, and each frame with the sample."""
        if len(self._frames) < PARAMETERS.first_search:
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
            candidates.sort(key=lambda candidate: candidate.score)
            if candidates and PARAMETERS.min_doubt < candidates[0].score < np.inf and self._budget.is_left:
                candidates.insert(0, self._search_around(candidates[0]))
            # a doubtful candidate may be noise before the first change of a slow light
            max_score = np.inf if len(self._frames) >= PARAMETERS.max_doubtful else PARAMETERS.min_doubt
            for candidate in candidates:
                acquired = self._track_all(candidate) if candidate.score < max_score else None
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

    def _fit_candidate(self, corners: Floats, changes: Pixels32) -> CandidateArray:
        """Fit place and blur of a candidate with given corners."""
        frames = list(self._frames)
        first = max(len(frames) - PARAMETERS.trial_frames, 0)
        sharp = sharpen_corners(changes, corners, self._factor)
        assert self._light is not None
        fitters = [CellFitter(self._side, blur, self._light, self._budget) for blur in PARAMETERS.blurs_px]
        some = frames[first : first + PARAMETERS.trial_frames]
        starts = [Place.of(four, self._side) for four in (sharp, corners)]
        best = min((self._trial(fitters[0], start, some) for start in starts), key=lambda trial: trial[0])
        max_blur_px = PARAMETERS.max_blur * best[1].cell_px(self._side)
        fitters_tried = [fitter for fitter in fitters if fitter.blur_px < max_blur_px]
        tried = [CandidateArray(*self._trial(fitter, best[1], some), fitter) for fitter in fitters_tried]
        return min(tried, key=lambda candidate: candidate.score, default=CandidateArray(*best, fitters[0]))

    def _search_around(self, candidate: CandidateArray) -> CandidateArray:
        """Return the best of many places around a candidate, as sway enlarges the changing area."""
        fitter, place, n = candidate.fitter, candidate.place, self._side
        frames = list(self._frames)[max(len(self._frames) - PARAMETERS.trial_frames, 0) :]
        size = max(place.cell_px(n) * n, 1.0)
        min_scale = max(1 - (PARAMETERS.sway_px + self._factor) / size, PARAMETERS.min_scale)
        scales = np.arange(1.0, min_scale, -PARAMETERS.scale_step / n)
        places: list[tuple[float, Place]] = []
        for x, y, right, down in product(scales, scales, (0.0, 0.5), (0.0, 0.5)):
            start = place.scaled(x, y, n).shifted(right, down)
            if is_inside(start, n, frames[0].pixels.shape) and self._budget.is_left:
                fit = fitter(frames[0].pixels, start, PARAMETERS.max_steps)
                places.append((fit.misfit, fit.place))
        places.sort(key=lambda scored: scored[0])
        best = [start for _, start in places[: PARAMETERS.max_trials]]
        tried = [CandidateArray(*self._trial(fitter, start, frames), fitter) for start in best]
        return min((candidate, *tried), key=lambda scored: scored.score)

    def _trial(self, fitter: CellFitter, place: Place, frames: list[Frame]) -> tuple[float, Place]:
        """Track cells from a place on; return the score and the place in the first frame."""
        try:
            start = fitter(frames[0].pixels, place, PARAMETERS.max_steps).place
        except np.linalg.LinAlgError:
            return np.inf, place
        tracker = CellTracker(fitter, start, corrects_slips=False)
        samples = [sample for sample in map(tracker.track, frames) if sample is not None]
        if len(samples) < len(frames):
            return np.inf, start
        change = np.stack([sample.fit.cells for sample in samples]).std(axis=0)
        inner = change[RIM_CELLS:-RIM_CELLS, RIM_CELLS:-RIM_CELLS]
        ring = (change.sum() - inner.sum()) / (change.size - inner.size)
        # the surroundings are static
        misfit = np.mean([sample.fit.misfit for sample in samples])
        return float(misfit + ring / max(float(inner.mean()), TINY)), start

    def _track_all(self, candidate: CandidateArray) -> tuple[CellTracker, list[tuple[Frame, Sample | None]]] | None:
        """Track an array through all frames; shift the array by a cell if a rim is static."""
        frames, fitter, start = list(self._frames), candidate.fitter, candidate.place
        first = max(len(frames) - PARAMETERS.trial_frames, 0)
        for _ in range(3):
            backward = CellTracker(fitter, start)
            before = [backward.track(frame) for frame in frames[first::-1]]
            forward = CellTracker(fitter, start)
            after = [forward.track(frame) for frame in frames[first + 1 :]]
            tracked = list(zip(frames, (*before[::-1], *after), strict=True))
            samples = [sample for _, sample in tracked if sample is not None]
            if len(samples) < len(frames) // 2:
                return None
            shift = rim_shift(np.stack([sample.fit.cells for sample in samples]))
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
