"""Header of a region: the best correlation with any header in any orientation, and the times of the headers.

The detector reports arrays with high certainty. This search uses its parts with low thresholds near the size of the
region, to show how far the region is from an array.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from heliograph.base.arrays import TINY, Floats
from heliograph.base.frames import Frame
from heliograph.probe.regions import alternation
from heliograph.receive.detect.alternation import DETECT, Change, SearchParameters, alternation_of, coarse_search
from heliograph.receive.detect.candidate import cell_weights, fit_near
from heliograph.receive.detect.detection import Hypothesis, headers
from heliograph.receive.detect.kernels import BLOCK_PX
from heliograph.receive.geometry import kernels
from heliograph.receive.geometry.fit import Fit
from heliograph.receive.geometry.pose import ORIENTATIONS, Pose
from heliograph.receive.geometry.view import View, halved, reduced_blur
from heliograph.receive.geometry.window import CombinedFrame, cut_out, window_around

# Initial blurs in px: a fit of a defocused array converges only from nearby
BLURS_PX = (0.55, 1.3, 2.5, 5.0)


@dataclass(frozen=True, slots=True)
class HeaderMatch:
    """Best match of a region with a header."""

    # Assumed LEDs per row; a header has 4 x 4 cells for any number
    side: int
    # Pose on the sensor, gain, and correlation with the header's image
    fit: Fit
    # Identities and orientations with this header, the most plausible first
    hypotheses: tuple[Hypothesis, ...]
    # First frames of the headers with this pose
    starts: tuple[int, ...] = ()
    # Pairs of a header; 0 if unknown
    pairs: int = 0
    # Frames from one header to the next by frame numbers; 0 if fewer than two were found
    period: int = 0

    @property
    def score(self) -> float:
        """Correlation with the header's image, 0 to 1."""
        return self.fit.score

    @property
    def size_px(self) -> float:
        """Side of the array in px."""
        return self.side * self.fit.pose.pitch


class _Place(NamedTuple):
    """Candidate: first frame, signed correlation, centre (x, y) and side in px of the reduced frames, header number."""

    frame: int
    score: float
    x: float
    y: float
    size: float
    header: int


def find_header(
    frames: Sequence[Frame], centre: tuple[float, float], size_px: float, side: int,
    speed: tuple[float, float] = (0.0, 0.0),
) -> HeaderMatch | None:  # fmt: skip
    """Search for the best header of a region in frames with a pattern each."""
    # frames are reduced to a side of 48 px at most
    level = max(0, int(np.ceil(np.log2(max(size_px, 1.0) / 48))))
    frames = frames[:256]
    for _ in range(level):
        frames = [halved(frame) for frame in frames]
    scale = 2**level
    size, speed = size_px / scale, (speed[0] / scale, speed[1] / scale)
    pad = int(np.ceil(size * (0.6 + DETECT.ring))) + 2
    late = np.arange(len(frames) - 3) + 1.5 - 0.5 * (len(frames) - 1)
    places = _search(frames, np.array(centre) / scale + late[:, None] * np.array(speed), size, pad)
    candidates = [(place, _fit(frames, place, side, level, pad, speed)) for place in places]
    fits = [(place, fit) for place, fit in candidates if fit and 0.55 * size < fit.pose.pitch * side < 1.8 * size]
    if not fits:
        return None
    place, fit = max(fits, key=lambda found: found[1].score)
    best = HeaderMatch(side, fit, headers(ORIENTATIONS).hypotheses[place.header])
    best = _find_starts(frames, best, place, speed) if best.score >= 0.6 else best
    return replace(best, fit=View(level).map_fit(best.fit, inverse=True))


def _search(frames: Sequence[Frame], centres: Floats, size: float, pad: int) -> list[_Place]:
    """Search near the centres (times, 2); return the best places, each of another time."""
    parameters = SearchParameters(
        min_side_px=3.0, max_side_px=max(2 * size, 6.0), min_contrast=0.002, coarse_score=0.2,
        score=0.0, regularity=0.0, candidates=1, blur_px=BLURS_PX[0],
    )  # fmt: skip
    # hidden and blurred arrays are smaller or larger than the region
    cells, sizes = headers(ORIENTATIONS).cells, np.maximum(size * np.geomspace(0.7, 1.45, 8), 2.5)
    side, found = max(round(size), 1), list[_Place]()
    boxes = [(round(x - 0.5 * size), round(y - 0.5 * size), side, side) for x, y in centres]
    power = [np.square(alternation(frames[k : k + 4], box)).mean() for k, box in enumerate(boxes)]
    # a header has more than twice the light of data
    for k in np.argsort(-np.array(power))[:48]:
        change, corner = _padded_alternation(frames, int(k), pad)
        busy = np.zeros([-(-length // BLOCK_PX) + 1 for length in change.shape], bool)
        # the centre of an array that is hidden in part may be 0.4 sides off
        ends = [(centres[k] - corner + reach) // BLOCK_PX for reach in (-0.4 * size, 0.4 * size)]
        (left, top), (right, low) = np.maximum(ends, 0).astype(int)
        busy[top : low + 1, left : right + 1] = True
        padded = CombinedFrame(frames[k].index, frames[k].time_s, change, corner, frames[k].full_scale)
        rows, *_ = coarse_search(padded, busy, parameters, cells, sizes)
        found += [_Place(int(k), row[0], row[1] + corner[0], row[2] + corner[1], row[3], int(row[4])) for row in rows]
    best = list[_Place]()
    for place in sorted(found, key=lambda place: -abs(place.score)):
        if len(best) < 4 and all(abs(place.frame - other.frame) > 3 for other in best):
            best.append(place)
    return best


def _padded_alternation(frames: Sequence[Frame], first: int, pad: int) -> tuple[Change, tuple[int, int]]:
    """Return the alternation of four frames with a dark margin, as an array may lie at the border, and the corner."""
    x, y = frames[first].origin
    return np.pad(alternation_of(frames[first : first + 4]), pad), (x - pad, y - pad)


def _fit(
    frames: Sequence[Frame], place: _Place, side: int, level: int, pad: int, speed: tuple[float, float]
) -> Fit | None:
    """Fit a header near a place, from several blurs."""
    weights = np.sign(place.score) * cell_weights(headers(ORIENTATIONS).cells[place.header], side)
    change, corner = _padded_alternation(frames, place.frame, pad)
    # motion blur of the alternation of four frames
    smear = abs(speed[0]) * (0.35 + 1 / 12) ** 0.5, abs(speed[1]) * (0.35 + 1 / 12) ** 0.5
    best: Fit | None = None
    for tilt in (DETECT.upright_sigma, DETECT.tilted_sigma):
        for blur in BLURS_PX:
            start = Pose(place.x - 0.5, place.y - 0.5, place.size / side, 0.0, reduced_blur(blur, level))
            fit = fit_near(change, corner, start, weights, tilt, smear=smear)
            if fit is not None and (best is None or fit.score > best.score + (tilt > DETECT.upright_sigma) * 0.03):
                best = fit
        if best is not None and best.score > 0.95:
            break
    return best


def _find_starts(
    frames: Sequence[Frame], match: HeaderMatch, place: _Place, speed: tuple[float, float]
) -> HeaderMatch:  # fmt: skip
    """Find the first frames, the number of pairs and the period of headers: runs of header and inverse."""
    late = np.arange(len(frames)) - (place.frame + 1.5)
    poses = [match.fit.pose.moved(speed[0] * t, speed[1] * t) for t in late]
    shown = _amplitudes(frames, poses, cell_weights(headers(ORIENTATIONS).cells[place.header], match.side))
    # a format dims some headers to 0.75
    threshold = 0.6 * float(np.abs(shown[place.frame : place.frame + 4]).max())
    lit = np.minimum(np.abs(shown[1:]), np.abs(shown[:-1])) > threshold
    ends = [0, *(np.flatnonzero(~(lit & (shown[1:] * shown[:-1] < 0))) + 1).tolist(), len(shown)]
    # a single pair of data may resemble the header; headers begin with the pattern, not with the inverse
    runs = [(a, b - a) for a, b in itertools.pairwise(ends) if b - a >= 2 and shown[a] > 0]
    if not runs:
        return match
    usual = max({size for _, size in runs}, key=lambda size: sum(size == other for _, other in runs) * size)
    starts = tuple(start for start, size in runs if size == usual)
    steps = [frames[b].index - frames[a].index for a, b in itertools.pairwise(starts)]
    return replace(match, starts=starts, pairs=usual // 2, period=int(np.median(steps)) if steps else 0)


def _amplitudes(frames: Sequence[Frame], poses: Sequence[Pose], weights: Floats) -> Floats:
    """Measure the amplitude of a pattern in each frame above the median frame, (frames,) in gray levels."""
    x0, y0, width, height = window_around(poses[0], len(weights), 1.0)
    corners = [(x0 + round(pose.x - poses[0].x), y0 + round(pose.y - poses[0].y)) for pose in poses]
    pixels = np.array([cut_out(frame, (*at, width, height)) for frame, at in zip(frames, corners, strict=True)])
    pixels -= np.median(pixels, axis=0)
    model, out = np.empty((6, height, width)), np.empty(len(frames))
    for k, (pose, at) in enumerate(zip(poses, corners, strict=True)):
        kernels.render(pose.full_vector(), weights, float(at[0]), float(at[1]), model, 0.0, 0.0)
        shape = model[0] - model[0].mean()
        out[k] = float((pixels[k] * shape).sum() / max(float((shape * shape).sum()), TINY))
    return out
