"""Candidates of the coarse search, turned and tilted as the user's corners, and the search of a part of the frames."""

from collections.abc import Sequence
from dataclasses import replace
from math import ceil
from typing import NamedTuple

import cv2
import numpy as np

from heliograph.base.arrays import TINY, Floats
from heliograph.base.errors import HeliographError
from heliograph.base.frames import Frame
from heliograph.receive.detect.alternation import COARSE, SearchRegion, coarse_search
from heliograph.receive.detect.budget import BudgetedSearch, SearchLoad
from heliograph.receive.detect.candidate import FIT, find_window, measure_cells
from heliograph.receive.detect.detection import Detection, HeaderSearch
from heliograph.receive.detect.header_bank import Hypothesis
from heliograph.receive.detect.kernels import BLOCK_PX
from heliograph.receive.geometry.pose import Orientation, Pose
from heliograph.receive.geometry.window import Window, window_around


class Candidate(NamedTuple):
    """Place with a similarity to a header."""

    # Pose from which the fit starts, on the sensor
    start: Pose
    # Correlation with the header, -1 to 1: above 0 where the header comes first, below where the inverse does
    score: float
    # (16,) of +-1
    cells: Floats
    # Identities and orientations with this header, the most plausible first
    hypotheses: tuple[Hypothesis, ...]
    # Region of the candidate
    region: SearchRegion


def pose_of(corners: Sequence[float], side: int, blur: float) -> Pose:
    """Compute the pose of an array from the corners, x and y of each."""
    points = np.asarray(corners, np.float64).reshape(4, 2)
    x, y = points.mean(axis=0).tolist()
    # clockwise in the image, the first corner between left and up
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


def find_candidates(
    regions: Sequence[SearchRegion], search: BudgetedSearch, side: int, roll: float = 0.0
) -> list[Candidate]:
    """Return the best candidates of a roll or, if the user gave a pose, of the same roll and tilt."""
    candidates = list[Candidate]()
    if search.parameters.start is not None:
        for region in regions:
            candidates += _candidates_like(search.parameters.start, region, search, side)
        return candidates
    start = Pose(0.0, 0.0, 1.0, roll, search.parameters.blur_px)
    turn = np.array([[np.cos(roll), -np.sin(roll)], [np.sin(roll), np.cos(roll)]])
    drawn = [
        _draw_upright(region, turn) if roll else (region, np.column_stack([np.eye(2), region.first.origin]))
        for region in regions
    ]
    for region, (_, map_), rows in zip(regions, drawn, search.search([image for image, _ in drawn]), strict=True):
        candidates += [_candidate_of(row, map_, start, region, search, side) for row in rows.tolist()]
    return sorted(candidates, key=lambda candidate: -abs(candidate.score))[: search.parameters.candidates]


def _candidates_like(start: Pose, region: SearchRegion, search: BudgetedSearch, side: int) -> list[Candidate]:
    """Return candidates turned and tilted as a pose, and the pose itself with the most similar header.

    The coarse search finds upright arrays. So the alternation is drawn as if arrays of this roll and tilt were upright.
    """
    parameters, headers, sides = search.parameters, search.headers, search.sides
    initial = replace(start, blur=parameters.blur_px)
    upright, map_ = _draw_upright(region, start.axes / start.pitch)
    # the user chose the size, so the budget does not apply
    everywhere = upright._replace(busy=np.ones_like(upright.busy))
    rows = coarse_search(everywhere, parameters, headers.cells, sides, headers.min_distance).rows
    candidates = [_candidate_of(row, map_, initial, region, search, side) for row in rows.tolist()]
    change, origin = region.change, region.first.origin
    if sides[0] <= side * start.pitch <= sides[-1] and find_window(change, origin, start, side) is not None:
        light = measure_cells(change, origin, start, np.ones((side, side)))
        # each header has 16 cells of +-1
        scores = headers.cells @ light / max(4 * float(np.linalg.norm(light)), TINY)
        best = int(np.argmax(np.abs(scores)))
        candidates.append(
            Candidate(initial, float(scores[best]), headers.cells[best], headers.hypotheses[best], region)
        )
    return candidates


def _candidate_of(
    row: Sequence[float], map_: Floats, start: Pose, region: SearchRegion, search: BudgetedSearch, side: int
) -> Candidate:
    """Return a candidate on the sensor from a row of `CoarseResult`."""
    score, across, down, width, number = row
    x, y = (map_ @ [across - 0.5, down - 0.5, 1.0]).tolist()
    headers, pose = search.headers, replace(start, x=x, y=y, pitch=width / side)
    return Candidate(pose, score, headers.cells[int(number)], headers.hypotheses[int(number)], region)


def _draw_upright(region: SearchRegion, turn: Floats) -> tuple[SearchRegion, Floats]:
    """Draw a region with arrays of the axes `turn` (2, 2) upright; return the map (2, 3) to the sensor too."""
    rows, columns = region.change.shape
    # about the middles of both
    size = [ceil(n) for n in np.abs(np.linalg.inv(turn)) @ [columns, rows]]
    middle, drawn_middle = np.array([columns - 1, rows - 1]) / 2, (np.array(size) - 1) / 2
    map_ = np.column_stack([turn, middle - turn @ drawn_middle])
    change = cv2.warpAffine(region.change, map_, size, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
    down, across = np.indices((-(-size[1] // BLOCK_PX), -(-size[0] // BLOCK_PX))) * BLOCK_PX + (BLOCK_PX - 1) / 2
    x, y = np.tensordot(map_, [across, down, np.ones_like(across)], 1) // BLOCK_PX
    is_within = (x >= 0) & (y >= 0) & (x < region.busy.shape[1]) & (y < region.busy.shape[0])
    busy = is_within & region.busy[np.where(is_within, y, 0).astype(int), np.where(is_within, x, 0).astype(int)]
    on_sensor = map_ + np.column_stack([np.zeros((2, 2)), region.first.origin])
    return SearchRegion(np.asarray(change, np.float32), busy, replace(region.first, origin=(0, 0))), on_sensor


class RegionSearch:
    """Search of a given region of the frames, and of the surroundings of tracked arrays."""

    def __init__(self, search: HeaderSearch, region: Window, side: int):
        self._search, self._given, self._side = search, region, side
        x, y, width, height = region
        # the ring about an array as large as the region
        margin = ceil(COARSE.ring * max(width, height) + FIT.margin_px) + BLOCK_PX
        self._region: Window = x - margin, y - margin, width + 2 * margin, height + 2 * margin
        self._whole: list[Frame] = []

    def start(self, period_s: float) -> None:
        """Prepare for frames of a period; see `HeaderSearch`."""
        self._search.start(period_s)

    def set_orientation(self, orientation: Orientation) -> None:
        """Search for a single orientation from now on; see `HeaderSearch`."""
        self._search.set_orientation(orientation)

    @property
    def load(self) -> SearchLoad:
        """Work of the searches, with the skipped candidates and blocks."""
        return self._search.load

    @property
    def recent(self) -> Sequence[Frame]:
        """Last frames in full size, oldest first; see `HeaderSearch`."""
        full = {frame.time_s: frame for frame in self._whole}
        return [full.get(frame.time_s, frame) for frame in self._search.recent]

    def push(self, frame: Frame, tracked: Sequence[Pose] = ()) -> list[Detection]:
        """Search with the next frame; see `HeaderSearch`."""
        if not self._whole and _crop(frame, self._given) is None:
            (x, y), (rows, columns) = frame.origin, frame.pixels.shape
            where = f" from {x},{y} on" if frame.origin != (0, 0) else ""
            raise HeliographError(
                f"the region {','.join(map(str, self._given))} that was given lies beyond the frames, which are "
                f"{columns}x{rows}{where}"
            )
        for pose in tracked:
            self._region = _union(self._region, around(pose, self._side))
        part = _crop(frame, self._region)
        # a camera's window may be elsewhere for a while
        detections = self._search.push(part, tracked) if part is not None else []
        recent = {kept.time_s for kept in self._search.recent}
        self._whole = [kept for kept in (*self._whole, frame) if kept.time_s in recent]
        return detections


def around(pose: Pose, side: int) -> Window:
    """Return the searched surroundings of an array: half a side on each side, for shake between packets."""
    return window_around(pose, side, 0.5 * side * pose.pitch)


def _union(a: Window, b: Window) -> Window:
    left, top = min(a[0], b[0]), min(a[1], b[1])
    right, low = max(a[0] + a[2], b[0] + b[2]), max(a[1] + a[3], b[1] + b[3])
    return left, top, right - left, low - top


def _crop(frame: Frame, region: Window) -> Frame | None:
    """Crop a frame to a region; None if they are disjoint."""
    (x, y), (rows, columns) = frame.origin, frame.pixels.shape
    left, top = max(0, region[0] - x), max(0, region[1] - y)
    right, low = min(columns, region[0] + region[2] - x), min(rows, region[1] + region[3] - y)
    if right <= left or low <= top:
        return None
    return replace(frame, pixels=frame.pixels[top:low, left:right], origin=(x + left, y + top))
