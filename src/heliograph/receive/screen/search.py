"""An array looked for in frames that are kept: where everything changes, and where cells fit."""

from collections import deque
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import TINY, Floats
from heliograph.base.frames import Frame
from heliograph.receive.screen.budget import SearchBudget
from heliograph.receive.screen.follow import Follower, Sample
from heliograph.receive.screen.grid import PIXEL_SAMPLES, RIM_CELLS, Look, Place, inside, light_of
from heliograph.receive.screen.outline import Pixels32, changing, quadrilaterals, reduced, sharpened

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
