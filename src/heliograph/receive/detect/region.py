"""Where somebody said an array is: a part of the frame that is searched, and a pose at which its header is tried."""

from collections.abc import Sequence
from dataclasses import replace
from math import ceil
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import TINY
from heliograph.base.errors import HeliographError
from heliograph.base.frames import Frame
from heliograph.receive.detect.alternation import RING, SearchRegion, coarse_search
from heliograph.receive.detect.budget import BudgetedSearch, SearchLoad
from heliograph.receive.detect.candidate import CANDIDATE_MARGIN_PX, cell_light
from heliograph.receive.detect.detection import Detection, HeaderSearch
from heliograph.receive.detect.kernels import BLOCK_PX
from heliograph.receive.geometry.pose import Orientation, Pose
from heliograph.receive.geometry.window import Window, window_around

AROUND_SIDES = 0.5
"""Sides of an array about it that are searched where its corners were given, or where it was followed last.

Chosen: half of its side on each side. A car that shakes moves an array by some pixels from packet to packet, and
corners may be those of a later frame.
"""


class Candidate(NamedTuple):
    """What may be an array."""

    # Pose from which its fit starts, on the sensor
    start: Pose
    # Number of its header among those searched
    number: int
    # Correlation with its header, -1 to 1: above 0 where the header comes first, below where its inverse does
    score: float


def pose_of(corners: Sequence[float], side: int, blur: float) -> Pose:
    """Pose of an array whose corners somebody gave."""
    points = np.asarray(corners, np.float64).reshape(4, 2)
    x, y = points.mean(axis=0).tolist()
    # clockwise in the image, the first one between left and up
    upper_left, upper_right, lower_right, lower_left = points[
        np.argsort(np.arctan2(points[:, 1] - y, points[:, 0] - x))
    ]
    along = (upper_right - upper_left + lower_right - lower_left) / (2 * side)
    down = (lower_left - upper_left + lower_right - upper_right) / (2 * side)
    # A = R(roll) P, P = pitch ((1 + stretch, shear), (shear, 1 - stretch)): the polar decomposition
    u, sizes, vt = np.linalg.svd(np.stack([along, down], axis=1))
    rotation, form = u @ vt, vt.T @ np.diag(sizes) @ vt
    pitch, roll = float(np.trace(form)) / 2, float(np.arctan2(rotation[1, 0], rotation[0, 0]))
    stretch, shear = float(form[0, 0] - form[1, 1]) / (2 * pitch), float(form[0, 1]) / pitch
    # with another corner first rows are columns, which turns a tilt's sign
    quarters = round(roll / (np.pi / 2))
    sign = -1 if quarters % 2 else 1
    return Pose(x, y, pitch, roll - quarters * np.pi / 2, blur, sign * stretch, sign * shear)


def candidates_of(
    parts: Sequence[SearchRegion], coarse: BudgetedSearch, side: int, roll: float = 0.0
) -> list[tuple[Candidate, SearchRegion]]:
    """Candidates: the best of the coarse search or, around a given pose, arrays turned and tilted alike."""
    if coarse.parameters.start is not None:
        start = coarse.parameters.start
        return [(one, part) for part in parts for one in _given(part, coarse, start, side)]
    blur = coarse.parameters.blur_px
    found = list[tuple[Candidate, SearchRegion]]()
    turn = np.array([[np.cos(roll), -np.sin(roll)], [np.sin(roll), np.cos(roll)]])
    drawn = [_upright(part, turn) if roll else _as_it_is(part) for part in parts]
    for part, (_, map_), rows in zip(parts, drawn, coarse.candidates([one for one, _ in drawn]), strict=True):
        for score, across, down, width, number in rows.tolist():
            x, y = (map_ @ [across - 0.5, down - 0.5, 1.0]).tolist()
            pose = Pose(x, y, width / side, roll, blur)
            found.append((Candidate(pose, int(number), score), part))
    return sorted(found, key=lambda one: -abs(one[0].score))[: coarse.parameters.candidates]


def _as_it_is(part: SearchRegion) -> tuple[SearchRegion, NDArray[np.float64]]:
    """A part to be searched for upright arrays, and the map (2, 3) from its pixels to the sensor."""
    return part, np.column_stack([np.eye(2), part.first.origin])


def _upright(part: SearchRegion, turn: NDArray[np.float64]) -> tuple[SearchRegion, NDArray[np.float64]]:
    """A part as it would look if arrays of an image (2, 2) were upright, and the map (2, 3) from it to the sensor."""
    rows, columns = part.change.shape
    # about the middles of both
    size = [ceil(n) for n in np.abs(np.linalg.inv(turn)) @ [columns, rows]]
    middle, there = np.array([columns - 1, rows - 1]) / 2, (np.array(size) - 1) / 2
    map_ = np.column_stack([turn, middle - turn @ there])
    change = cv2.warpAffine(part.change, map_, size, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
    down, across = np.indices((-(-size[1] // BLOCK_PX), -(-size[0] // BLOCK_PX))) * BLOCK_PX + (BLOCK_PX - 1) / 2
    x, y = np.tensordot(map_, [across, down, np.ones_like(across)], 1) // BLOCK_PX
    within = (x >= 0) & (y >= 0) & (x < part.busy.shape[1]) & (y < part.busy.shape[0])
    busy = within & part.busy[np.where(within, y, 0).astype(int), np.where(within, x, 0).astype(int)]
    on_sensor = map_ + np.column_stack([np.zeros((2, 2)), part.first.origin])
    return SearchRegion(np.asarray(change, np.float32), busy, replace(part.first, origin=(0, 0))), on_sensor


def _given(part: SearchRegion, coarse: BudgetedSearch, start: Pose, side: int) -> list[Candidate]:
    """Candidates turned and tilted as a pose, and that pose itself.

    The coarse search takes arrays for upright. So what alternates is drawn as it would look if the given array were
    upright, and searched. Then the given pose itself is a candidate, with the header that its cells resemble most.
    """
    change, frame = part.change, part.first
    (upright, busy, placed), drawn = _upright(part, start.axes / start.pitch)
    everywhere = np.ones_like(busy)
    out, (parameters, searched, sides) = list[Candidate](), (coarse.parameters, coarse.headers, coarse.sides)
    # it is as small as somebody made it, and costs what it costs
    found = coarse_search(upright, everywhere, placed, parameters, searched.cells, sides, searched.apart)
    for row in found.rows:
        x, y = (drawn @ [row[1] - 0.5, row[2] - 0.5, 1.0]).tolist()
        pose = replace(start, x=x, y=y, pitch=float(row[3]) / side, blur=parameters.blur_px)
        out.append(Candidate(pose, int(row[4]), float(row[0])))
    if sides[0] <= side * start.pitch <= sides[-1] and _within(change, frame.origin, start, side):
        light = cell_light(change, frame.origin, start, np.ones((side, side)))
        # each header has 16 cells of +-1
        alike = searched.cells @ light / max(4 * float(np.linalg.norm(light)), TINY)
        best = int(np.argmax(np.abs(alike)))
        out.append(Candidate(replace(start, blur=parameters.blur_px), best, float(alike[best])))
    return out


def _within(change: NDArray[np.float32], origin: tuple[int, int], pose: Pose, side: int) -> bool:
    """Whether an image holds an array and what is fitted about it."""
    x, y, width, height = window_around(pose, side, RING * side * pose.pitch + CANDIDATE_MARGIN_PX)
    rows, columns = change.shape
    left, top = x - origin[0], y - origin[1]
    return left >= 0 and top >= 0 and left + width <= columns and top + height <= rows


class RegionSearch:
    """A search of a part of the frames: the region given, and what lies about the arrays followed last."""

    def __init__(self, search: HeaderSearch, region: Window, side: int):
        self._search, self._given, self._region, self._side = search, region, _wider(region), side
        self._whole: list[Frame] = []

    def start(self, period_s: float) -> None:
        """Begin to search frames; see `HeaderSearch`."""
        self._search.start(period_s)

    def settle(self, orientation: Orientation) -> None:
        """Look for one orientation alone from now on; see `HeaderSearch`."""
        self._search.settle(orientation)

    @property
    def load(self) -> SearchLoad:
        """What the searches did and left out so far."""
        return self._search.load

    @property
    def recent(self) -> Sequence[Frame]:
        """The last frames as they came, oldest first; see `HeaderSearch`."""
        whole = {frame.time_s: frame for frame in self._whole}
        return [whole.get(frame.time_s, frame) for frame in self._search.recent]

    def push(self, frame: Frame, taken: Sequence[Pose] = ()) -> list[Detection]:
        """Take the next frame; see `HeaderSearch`."""
        if not self._whole and _part(frame, self._given) is None:
            (x, y), (rows, columns) = frame.origin, frame.pixels.shape
            where = f" from {x},{y} on" if frame.origin != (0, 0) else ""
            raise HeliographError(
                f"the region {','.join(map(str, self._given))} that was given lies beyond the frames, which are "
                f"{columns}x{rows}{where}"
            )
        for pose in taken:
            self._region = _joined(self._region, around(pose, self._side))
        part = _part(frame, self._region)
        # a camera's window may be elsewhere for a while
        found = self._search.push(part, taken) if part is not None else []
        kept = {one.time_s for one in self._search.recent}
        self._whole = [one for one in (*self._whole, frame) if one.time_s in kept]
        return found


def around(pose: Pose, side: int) -> Window:
    """The part of the sensor about an array that is searched."""
    return window_around(pose, side, AROUND_SIDES * side * pose.pitch)


def _wider(region: Window) -> Window:
    """A region with the ring about an array that must not alternate, were it as large as the region."""
    x, y, width, height = region
    margin = ceil(RING * max(width, height) + CANDIDATE_MARGIN_PX) + BLOCK_PX
    return x - margin, y - margin, width + 2 * margin, height + 2 * margin


def _joined(a: Window, b: Window) -> Window:
    left, top = min(a[0], b[0]), min(a[1], b[1])
    right, low = max(a[0] + a[2], b[0] + b[2]), max(a[1] + a[3], b[1] + b[3])
    return left, top, right - left, low - top


def _part(frame: Frame, region: Window) -> Frame | None:
    """The part of a frame in a region; None where it shows nothing of it."""
    (x, y), (rows, columns) = frame.origin, frame.pixels.shape
    left, top = max(0, region[0] - x), max(0, region[1] - y)
    right, low = min(columns, region[0] + region[2] - x), min(rows, region[1] + region[3] - y)
    if right <= left or low <= top:
        return None
    return replace(frame, pixels=frame.pixels[top:low, left:right], origin=(x + left, y + top))
