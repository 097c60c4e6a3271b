"""Where a screen's array is: the quadrilateral in which everything changes.

An array looked for in frames that are kept: where everything changes, and where cells fit.
"""

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
    Follower,
    Look,
    Place,
    Sample,
    SearchBudget,
    inside,
    light_of,
)

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


KEPT_FRAMES = 64
"""Frames that are kept while an array is looked for: 2 s at 30 frames a second, 16 patterns of 60 a second at 240. They
take 60 MB at 1280 x 720."""

SEARCH_EVERY = 6
"""Frames from one search to the next. Chosen: a fifth of a second at 30 frames a second."""

BELIEVED = 48
"""Frames from which a doubtful array is taken for one. Chosen: 1.6 s at 30 frames a second, three patterns of 2 a
second."""

FIRST_SEARCH = 12
"""Frames before the first search: four patterns at three frames a pattern."""

WINDOWS = (8, 16, 64)
"""Latest frames whose changes are looked at: few, as a hand moves the array meanwhile; many, where patterns are
slow."""

BLURS_PX = (1.0, 0.6, 1.6, 2.4)
"""Blurs that are tried in px."""

WIDEST = 0.45
"""Largest blur that is tried in cells: a wider one lets cells explain anything."""

TRIED = 8
"""Best places of one frame that are tried in several."""

DOUBTFUL = 0.3
"""Misfit, and change of the ring by that of the array, above which other places are tried: of an array in its place
both are 0.06 to 0.25 together."""

SWAY_PX = 14.0
"""Px by which an array may seem larger. Chosen: a hand moves a phone's picture by about 8 px in 0.25 s at most."""

SMALLEST = 0.75
"""Least scale that is tried. Chosen."""

SCALES = 0.9
"""Cells from one size that is tried to the next: the fit finds one that is half a cell off at either edge."""

TRIAL_FRAMES = 8
"""Frames in which a place is tried. Chosen: two to four patterns, at 30 frames a second."""

SETTLING = 10
"""Most steps of a place that is tried. Chosen: it may be a cell off."""


@dataclass(frozen=True)
class Taken:
    """An array that was found."""

    # Follows it from the next frame on
    follower: Follower
    # The frames that were kept, each with what it shows, None for nothing; in the order of time
    seen: list[tuple[Frame, Sample | None]]


@dataclass(frozen=True)
class Placed:
    """What may be an array."""

    # How badly its cells fit, and how much its ring changes
    score: float
    # Where it is in the latest frames but a few
    place: Place
    # Finds it, by the blur that fits best
    look: Look


class ArraySearch:
    """Looks for an array."""

    def __init__(self, side: int, gamma: float, budget: SearchBudget | None = None):
        self._side, self._gamma, self._budget = side, gamma, budget or SearchBudget()
        self._light: NDArray[np.float32] | None = None
        self._factor = 1
        self._window = 0  # with which the next search begins
        self.forget()

    def forget(self) -> None:
        """Forget all frames."""
        self._frames: deque[Frame] = deque(maxlen=KEPT_FRAMES)
        self._small: deque[Pixels32] = deque(maxlen=KEPT_FRAMES)
        self._since = 0

    def take(self, frame: Frame) -> Taken | None:
        """Keep a frame; return the array if it is time to look for one, and it is found."""
        self._frames.append(frame)
        small, self._factor = reduced(self._linear(frame))
        self._small.append(small)
        self._since += 1
        if self._since < SEARCH_EVERY:
            return None
        return self.find()

    def find(self) -> Taken | None:
        """Look for an array in the frames kept; None where there is none, or too few frames."""
        if len(self._frames) < FIRST_SEARCH:
            return None
        self._since = 0
        for window in (*range(self._window, len(WINDOWS)), *range(self._window)):
            count, self._window = WINDOWS[window], window
            if count > 2 * len(self._small):
                continue
            if not self._budget.lasts:
                return None
            places = quadrilaterals(changing(list(self._small)[-count:]), self._factor)
            # the strongest change comes first
            changes = self._changes(count) if places else np.empty((0, 0), np.float32)
            found = [self._placed(one, changes) for one in places if self._budget.lasts]
            tried = sorted(found, key=lambda one: one.score)
            if tried and DOUBTFUL < tried[0].score < np.inf and self._budget.lasts:
                tried = [self._searched(tried[0]), *tried]
            # what is doubtful may be noise while a slow light has not changed yet
            most = np.inf if len(self._frames) >= BELIEVED else DOUBTFUL
            for one in tried:
                taken = self._whole(one) if one.score < most else None
                if taken is not None:
                    return taken
        self._window = 0
        return None

    def _linear(self, frame: Frame) -> Pixels32:
        if self._light is None:
            levels = np.arange(frame.full_scale + 1) / frame.full_scale
            self._light = (levels**self._gamma).astype(np.float32)
        return light_of(frame.pixels, self._light)

    def _changes(self, count: int) -> Pixels32:
        """How much each pixel changes in the latest frames, in some of them if they are many."""
        latest = list(self._frames)[-count:]
        linear = [self._linear(one) for one in latest[:: max(1, len(latest) // 16)]]
        self._budget.spend(PIXEL_SAMPLES * len(linear) * linear[0].size)
        return changing(linear)

    def _placed(self, corners: Floats, changes: Pixels32) -> Placed:
        """Where what may be an array fits best, and how well."""
        frames = list(self._frames)
        middle = max(len(frames) - TRIAL_FRAMES, 0)
        sharp = sharpened(changes, corners, self._factor)
        assert self._light is not None
        looks = [Look(self._side, blur, self._light, self._budget) for blur in BLURS_PX]
        some = frames[middle : middle + TRIAL_FRAMES]
        starts = [Place.of(one, self._side) for one in (sharp, corners)]
        best = min((self._trial(looks[0], one, some) for one in starts), key=lambda one: one[0])
        cell = best[1].cell_px(self._side)
        tried = [Placed(*self._trial(one, best[1], some), one) for one in looks if one.blur_px < WIDEST * cell]
        return min(tried, key=lambda one: one.score, default=Placed(*best, looks[0]))

    def _searched(self, placed: Placed) -> Placed:
        """The best of many places about one: a hand that sways makes an array seem larger."""
        look, place = placed.look, placed.place
        frames = list(self._frames)[max(len(self._frames) - TRIAL_FRAMES, 0) :]
        n, (wide, high) = self._side, _motion(place, self._side, self._factor)
        found: list[tuple[float, Place]] = []
        for x, y in product(np.arange(1.0, wide, -SCALES / n), np.arange(1.0, high, -SCALES / n)):
            for right, down in product((0.0, 0.5), (0.0, 0.5)):
                one = place.scaled(x, y, n).shifted(right, down)
                if inside(one, n, frames[0].pixels.shape) and self._budget.lasts:
                    seen = look(frames[0].pixels, one, SETTLING)
                    found.append((seen.misfit, seen.place))
        found.sort(key=lambda one: one[0])
        tried = [Placed(*self._trial(look, one, frames), look) for _, one in found[:TRIED]]
        return min((placed, *tried), key=lambda one: one.score)

    def _trial(self, look: Look, place: Place, frames: list[Frame]) -> tuple[float, Place]:
        """How well cells fit some frames from a place on, and where they are in the first of them."""
        try:
            start = look(frames[0].pixels, place, SETTLING).place
        except np.linalg.LinAlgError:
            return np.inf, place
        follower = Follower(look, start, firm=False)
        seen = [one for one in map(follower.take, frames) if one is not None]
        if len(seen) < len(frames):
            return np.inf, start
        change = np.stack([one.seen.cells for one in seen]).std(axis=0)
        inner = change[RIM_CELLS:-RIM_CELLS, RIM_CELLS:-RIM_CELLS]
        ring = (change.sum() - inner.sum()) / (change.size - inner.size)
        # beside the array nothing changes
        return float(np.mean([one.seen.misfit for one in seen]) + ring / max(float(inner.mean()), TINY)), start

    def _whole(self, placed: Placed) -> Taken | None:
        """Follow an array back to the first frame kept and on to the last; shift it where a rim does not change."""
        frames, look, start = list(self._frames), placed.look, placed.place
        middle = max(len(frames) - TRIAL_FRAMES, 0)
        for _ in range(3):
            back = Follower(look, start)
            before = [back.take(one) for one in frames[middle::-1]]
            ahead = Follower(look, start)
            after = [ahead.take(one) for one in frames[middle + 1 :]]
            seen = list(zip(frames, (*before[::-1], *after), strict=True))
            samples = [one for _, one in seen if one is not None]
            if len(samples) < len(frames) // 2:
                return None
            shift = rim_shift(np.stack([one.seen.cells for one in samples]))
            if not any(shift):
                return Taken(ahead, seen)
            start = start.shifted(*shift)
        return None


def _motion(place: Place, side: int, factor: int) -> tuple[float, float]:
    """Least scales, across and down, of an array that seems larger by the motion of a hand."""
    size = max(place.cell_px(side) * side, 1.0)
    least = max(1 - (SWAY_PX + factor) / size, SMALLEST)
    return least, least


def rim_shift(cells: Floats) -> tuple[int, int]:
    """Return by how many cells, right and down, an array lies beside where it is taken for."""
    change = cells.std(axis=0)
    typical = float(np.median(change[RIM_CELLS:-RIM_CELLS, RIM_CELLS:-RIM_CELLS]))
    inner = slice(RIM_CELLS, -RIM_CELLS)
    lines = {
        "left": (change[inner, 0], change[inner, 1]),
        "right": (change[inner, -1], change[inner, -2]),
        "top": (change[0, inner], change[1, inner]),
        "low": (change[-1, inner], change[-2, inner]),
    }
    outer = {name: float(np.median(a)) > typical / 2 for name, (a, _) in lines.items()}
    dark = {name: float(np.median(b)) < typical / 4 for name, (_, b) in lines.items()}
    across = int(outer["right"] and dark["left"]) - int(outer["left"] and dark["right"])
    down = int(outer["low"] and dark["top"]) - int(outer["top"] and dark["low"])
    return across, down
