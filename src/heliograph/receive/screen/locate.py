"""Location of a screen array: quadrilaterals that change from frame to frame, and fits of cells inside."""

from collections import deque
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import TINY, Floats
from heliograph.base.frames import Frame
from heliograph.receive.screen.cells import (
    PARAMETERS,
    RIM_CELLS,
    CellTracker,
    Pixels32,
    Place,
    Sample,
    SearchBudget,
    light_of,
    reduced,
)

# misfit of the cells plus change of the ring, place in the first trial frame, and best blur in px
Candidate = tuple[float, Place, float]

# tracker of an array, and each recent frame with the sample; None where the array is invisible
Acquired = tuple[CellTracker, list[tuple[Frame, Sample | None]]]


def reduce_frame(pixels: Pixels32) -> tuple[Pixels32, int]:
    """Reduce a frame to 480 columns for the search; return the frame and the factor."""
    factor = max(1, -(-pixels.shape[1] // 480))
    return reduced(pixels, factor), factor


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
    x, y = (corners - corners.mean(axis=0)).T
    corners = corners[np.argsort(np.arctan2(y, x))]
    return np.roll(corners, -int(np.argmin(corners.sum(axis=1))), axis=0)


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

    def push(self, frame: Frame) -> Acquired | None:
        """Add a frame; search at intervals, see `find`."""
        self._frames.append(frame)
        small, self._factor = reduce_frame(self._linear(frame))
        self._small.append(small)
        self._since += 1
        return self.find() if self._since >= 6 else None

    def find(self) -> Acquired | None:
        """Search an array in the recent frames."""
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
            # the strongest change comes first
            candidates = [self._fit_candidate(four) for four in corners if self._budget.is_left]
            candidates.sort(key=lambda candidate: candidate[0])
            # a doubtful candidate may be noise before the first change of a slow light
            max_score = np.inf if len(self._frames) >= PARAMETERS.max_doubtful else PARAMETERS.min_doubt
            for score, place, blur_px in candidates:
                acquired = self._track_all(place, blur_px) if score < max_score else None
                if acquired is not None:
                    return acquired
        self._window = 0
        return None

    def _linear(self, frame: Frame) -> Pixels32:
        """Convert the gray levels of a frame to light."""
        if self._light is None:
            self._light = ((np.arange(frame.full_scale + 1) / frame.full_scale) ** self._gamma).astype(np.float32)
        return light_of(frame.pixels, self._light)

    def _fit_candidate(self, corners: Floats) -> Candidate:
        """Fit place and blur of a candidate with given corners."""
        best = self._trial(Place.of(corners, self._side), PARAMETERS.blurs_px[0], rough=True)
        # a blur of at most 0.45 cells
        max_blur_px = 0.45 * best[1].cell_px(self._side)
        tried = [self._trial(best[1], blur_px) for blur_px in PARAMETERS.blurs_px if blur_px < max_blur_px]
        return min(tried, key=lambda candidate: candidate[0], default=best)

    def _tracker(self, place: Place, blur_px: float, correct_slips: bool = True) -> CellTracker:
        """Return a tracker of cells from a place on."""
        assert self._light is not None
        return CellTracker(self._side, blur_px, self._light, self._budget, place, correct_slips)

    def _trial(self, place: Place, blur_px: float, rough: bool = False) -> Candidate:
        """Track cells through the last frames from a place on."""
        frames = list(self._frames)[-PARAMETERS.trial_frames :]
        try:
            tracker = self._tracker(place, blur_px)
            start = tracker.fit(frames[0], tracker.fit_blocks(frames[0], place) if rough else place, max_steps=10).place
        except np.linalg.LinAlgError:
            return np.inf, place, blur_px
        tracker = self._tracker(start, blur_px, correct_slips=False)
        samples = [sample for sample in map(tracker.track, frames) if sample is not None]
        if len(samples) < len(frames):
            return np.inf, start, blur_px
        change = np.stack([sample.cells for sample in samples]).std(axis=0)
        inner = change[RIM_CELLS:-RIM_CELLS, RIM_CELLS:-RIM_CELLS]
        ring = (change.sum() - inner.sum()) / (change.size - inner.size)
        # the surroundings are static
        misfit = np.mean([sample.misfit for sample in samples])
        return float(misfit + ring / max(float(inner.mean()), TINY)), start, blur_px

    def _track_all(self, start: Place, blur_px: float) -> Acquired | None:
        """Track an array through all frames; None for an array that is lost in half of the frames."""
        frames = list(self._frames)
        first = max(len(frames) - PARAMETERS.trial_frames, 0)
        backward, forward = self._tracker(start, blur_px), self._tracker(start, blur_px)
        before = [backward.track(frame) for frame in frames[first::-1]]
        samples = [*before[::-1], *map(forward.track, frames[first + 1 :])]
        if sum(sample is not None for sample in samples) < len(frames) // 2:
            return None
        return forward, list(zip(frames, samples, strict=True))
