"""What a region shows of a header: the best correlation with any, in any orientation; and when headers come.

The detector gives arrays that it is sure of. Here its own parts are asked with hardly any threshold, and about the
size that the region has, so that it can be told how far it is from being one.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import TINY, Floats
from heliograph.base.frames import Frame
from heliograph.receive.detect.alternation import (
    ALTERNATION,
    DETECT,
    SearchParameters,
    SearchRegion,
    alternation_of,
    coarse_search,
)
from heliograph.receive.detect.candidate import cell_weights, fit_near
from heliograph.receive.detect.header_bank import Hypothesis, headers
from heliograph.receive.detect.kernels import BLOCK_PX
from heliograph.receive.geometry import kernels
from heliograph.receive.geometry.fit import Fit
from heliograph.receive.geometry.pose import ORIENTATIONS, Pose
from heliograph.receive.geometry.view import View, halved, reduced_blur
from heliograph.receive.geometry.window import cut_out, window_around

SIZES = np.geomspace(0.7, 1.45, 8)
"""Sizes that are tried, over that of the region: hidden or blurred arrays seem smaller or larger."""

BLURS = (0.55, 1.3, 2.5, 5.0)
"""First guesses of the blur in px: an array out of focus is found only from near its own."""

LIKE, UNLIKE = 0.55, 1.8
"""Least and largest size of a header's fit over the region's: what is smaller or larger is another thing."""


@dataclass(frozen=True, slots=True)
class HeaderSeen:
    """What of a header a region shows at best."""

    # Correlation with the header's image, 0 to 1
    score: float
    # LEDs in a row that were assumed; the header's cells are 4 x 4 whatever they are
    side: int
    # Pose on the sensor, and gain
    fit: Fit
    # Identities and orientations that have this header, the most plausible first
    hypotheses: tuple[Hypothesis, ...]
    # Number in the frames looked at of the one with which it begins, or of one of its later ones
    place: int
    # Numbers in those frames of the first frames of headers that are seen with its pose
    starts: tuple[int, ...] = ()
    # Pairs of a header, as they are seen; 0 where none is seen whole
    pairs: int = 0
    # Frames from one header to the next, as far as numbers of frames tell; 0 where fewer than two are seen
    period: int = 0

    @property
    def size_px(self) -> float:
        """Side of the array in px."""
        return self.side * self.fit.pose.pitch


def header_seen(
    frames: Sequence[Frame],
    centre: tuple[float, float],
    size_px: float,
    side: int,
    speed: tuple[float, float] = (0.0, 0.0),
) -> HeaderSeen | None:
    """Look for the header that a region shows best."""
    # largest side in px in which a header is looked for: larger regions are looked at in reduced frames
    level = max(0, int(np.ceil(np.log2(max(size_px, 1.0) / 48.0))))
    # most frames that are looked through
    frames = frames[:256]
    reduced = list(frames)
    for _ in range(level):
        reduced = [halved(one) for one in reduced]
    size, pad = size_px / 2**level, int(np.ceil(size_px / 2**level * (0.6 + DETECT.ring))) + 2
    late = np.arange(len(frames) - 3) + 1.5 - 0.5 * (len(frames) - 1)
    centres = (np.array(centre) + late[:, None] * np.array(speed)) / 2**level
    rows = _coarse(reduced, centres, size, pad)
    best: HeaderSeen | None = None
    for row in rows:
        one = _fitted(reduced, row, side, level, pad, speed)
        like = one is not None and LIKE < one.fit.pose.pitch * side / size < UNLIKE
        if one is not None and like and (best is None or one.score > best.score):
            best = one
    if best is None:
        return None
    # least correlation with a header from which on it is asked when headers come
    if best.score >= 0.6:
        best = _timed(reduced, best, side, (speed[0] / 2**level, speed[1] / 2**level))
    return replace(best, fit=View(level).fit_out(best.fit))


@dataclass(frozen=True, slots=True)
class _Row:
    """A place found: when, correlation with its sign, centre (x, y) and side in px of the reduced frames, header."""

    place: int
    score: float
    x: float
    y: float
    size: float
    header: int


def _coarse(frames: Sequence[Frame], centres: Floats, size: float, pad: int) -> list[_Row]:
    """The best places near centres (times, 2), each of another time."""
    # least correlation of a place that is fitted
    # least contrast of a place that is looked at as a fraction of full scale: half a gray level of 8 bits
    parameters = SearchParameters(
        min_side_px=3.0, max_side_px=max(2 * size, 6.0), min_contrast=0.002, coarse_score=0.2,
        score=0.0, regularity=0.0, candidates=1, blur_px=BLURS[0],
    )  # fmt: skip
    cells, sizes = headers(ORIENTATIONS).cells, np.maximum(size * SIZES, 2.5)
    half = 0.5 * size
    strength = np.zeros(len(centres))
    for k, (x, y) in enumerate(centres):
        box = round(x - half), round(y - half), max(round(size), 1), max(round(size), 1)
        four = zip(ALTERNATION, frames[k : k + 4], strict=True)
        strength[k] = float(np.square(sum(weight * cut_out(one, box) for weight, one in four)).mean())
    found = list[_Row]()
    # times that are searched, those at which most alternates: a header has more than twice the light of data
    for k in np.argsort(-strength)[:48]:
        change = _padded(alternation_of(frames[k : k + 4]), pad)
        x, y = frames[k].origin[0] - pad, frames[k].origin[1] - pad
        busy = np.zeros([-(-length // BLOCK_PX) + 1 for length in change.shape], bool)
        # part of the region's side by which an array's centre may lie off its own: it may be hidden in part
        reach = 0.4 * size
        first, last = (centres[k] - (x, y) - reach) // BLOCK_PX, (centres[k] - (x, y) + reach) // BLOCK_PX
        busy[_from(first[1]) : _from(last[1]) + 1, _from(first[0]) : _from(last[0]) + 1] = True
        rows, *_ = coarse_search(
            SearchRegion(change, busy, replace(frames[k], origin=(x, y))), parameters, cells, sizes
        )
        found += [_Row(int(k), row[0], row[1] + x, row[2] + y, row[3], int(row[4])) for row in rows]
    kept = list[_Row]()
    for row in sorted(found, key=lambda one: -abs(one.score)):
        # times whose best places are fitted
        # frames by which these times differ
        if len(kept) < 4 and all(abs(row.place - other.place) > 3 for other in kept):
            kept.append(row)
    return kept


def _from(place: float) -> int:
    """Number of a block, of those that there are."""
    return max(int(place), 0)


def _padded(change: NDArray[np.float32], pad: int) -> NDArray[np.float32]:
    """What alternates with nothing about it: an array may lie at the frame's border, and what is beyond is not seen."""
    return np.asarray(cv2.copyMakeBorder(change, pad, pad, pad, pad, cv2.BORDER_CONSTANT, value=0), np.float32)


def _fitted(
    frames: Sequence[Frame], row: _Row, side: int, level: int, pad: int, speed: tuple[float, float]
) -> HeaderSeen | None:
    """Fit a place, from several blurs."""
    known = headers(ORIENTATIONS)
    weights = cell_weights(known.cells[row.header], side)
    four, origin = frames[row.place : row.place + 4], frames[row.place].origin
    change = _padded(alternation_of(four), pad)
    corner = origin[0] - pad, origin[1] - pad
    # the four frames' motion smears their combination
    smear = tuple(abs(v) / 2**level * (0.35 + 1 / 12) ** 0.5 for v in speed)
    best: Fit | None = None
    for tilt in (DETECT.upright_sigma, DETECT.tilted_sigma):
        for blur in BLURS:
            start = Pose(row.x - 0.5, row.y - 0.5, row.size / side, 0.0, reduced_blur(blur, level))
            fit = fit_near(change, corner, start, np.sign(row.score) * weights, tilt, smear=(smear[0], smear[1]))
            if fit is not None and (best is None or fit.score > best.score + (tilt > DETECT.upright_sigma) * 0.03):
                best = fit
        if best is not None and best.score > 0.95:
            break
    return best if best is None else HeaderSeen(best.score, side, best, known.hypotheses[row.header], row.place)


def _timed(frames: Sequence[Frame], seen: HeaderSeen, side: int, speed: tuple[float, float]) -> HeaderSeen:
    """When headers begin, and how long they are: runs of frames that show it and its inverse in turn."""
    cells = next(c for c, h in zip(*_by_hypotheses(), strict=True) if h == seen.hypotheses)
    weights, middle = cell_weights(cells, side), seen.place + 1.5
    poses = [seen.fit.pose.moved(speed[0] * (k - middle), speed[1] * (k - middle)) for k in range(len(frames))]
    shown = _amplitudes(frames, poses, weights)
    best = float(np.abs(shown[seen.place : seen.place + 4]).max())
    runs, first = list[tuple[int, int]](), 0
    for k in range(1, len(shown) + 1):
        # least amplitude of a header over that of its best frames, for a frame to belong to it: a format dims some to
        # 0.75
        on = k < len(shown) and min(abs(shown[k]), abs(shown[k - 1])) > 0.6 * best and shown[k] * shown[k - 1] < 0
        if not on:
            if k - first >= 2:
                runs.append((first, k - first))
            first = k
    # a pair of data may be like the header by chance; headers begin with the pattern, not with its inverse
    runs = [(at, size) for at, size in runs if size >= 2 and shown[at] > 0]
    if not runs:
        return seen
    usual = max({size for _, size in runs}, key=lambda size: sum(size == other for _, other in runs) * size)
    whole = [at for at, size in runs if size == usual]
    steps = [frames[b].index - frames[a].index for a, b in itertools.pairwise(whole)]
    period = int(np.median(steps)) if steps else 0
    return replace(seen, starts=tuple(whole), pairs=usual // 2, period=period)


def _amplitudes(frames: Sequence[Frame], poses: Sequence[Pose], weights: Floats) -> Floats:
    """How much of a pattern each frame shows about what frames usually show, (frames,) in gray levels."""
    # pixels about an array in which a header's amplitude is measured, as the receivers do
    x0, y0, width, height = window_around(poses[0], len(weights), 1.0)
    corners = [(x0 + round(one.x - poses[0].x), y0 + round(one.y - poses[0].y)) for one in poses]
    pixels = np.array([cut_out(one, (*at, width, height)) for one, at in zip(frames, corners, strict=True)])
    pixels -= np.median(pixels, axis=0)
    model, out = np.empty((6, height, width)), np.empty(len(frames))
    for k, (pose, at) in enumerate(zip(poses, corners, strict=True)):
        kernels.render(pose.full_vector(), weights, float(at[0]), float(at[1]), model, 0.0, 0.0)
        shape = model[0] - model[0].mean()
        out[k] = float((pixels[k] * shape).sum() / max(float((shape * shape).sum()), TINY))
    return out


def _by_hypotheses() -> tuple[Floats, tuple[tuple[Hypothesis, ...], ...]]:
    known = headers(ORIENTATIONS)
    return known.cells, known.hypotheses
