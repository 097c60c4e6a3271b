"""Header of a region: the best correlation with any header in any orientation, and the times of the headers.

The detector reports arrays with high certainty. This search uses its parts with low thresholds near the size of the
region, to show how far the region is from an array.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import TINY, Floats
from heliograph.base.frames import Frame
from heliograph.probe.regions import alternation
from heliograph.receive.detect.alternation import DETECT, SearchParameters, SearchRegion, alternation_of, coarse_search
from heliograph.receive.detect.candidate import cell_weights, fit_near
from heliograph.receive.detect.header_bank import Hypothesis, headers
from heliograph.receive.detect.kernels import BLOCK_PX
from heliograph.receive.geometry import kernels
from heliograph.receive.geometry.fit import Fit
from heliograph.receive.geometry.pose import ORIENTATIONS, Pose
from heliograph.receive.geometry.view import View, halved, reduced_blur
from heliograph.receive.geometry.window import cut_out, window_around


@dataclass(frozen=True, slots=True)
class HeaderTuning:
    """Grid and limits of the search for a header."""

    # Sizes over the size of the region: hidden and blurred arrays appear smaller or larger
    sizes: tuple[float, ...] = tuple(np.geomspace(0.7, 1.45, 8))
    # Initial blurs in px: a fit of a defocused array converges only from nearby
    blurs: tuple[float, ...] = (0.55, 1.3, 2.5, 5.0)
    # Side in px up to which frames are reduced
    reduced_side_px: float = 48.0
    # Maximum frames
    max_frames: int = 256
    # Number of searched, and of fitted times with the most alternation
    n_searched: int = 48
    n_fitted: int = 4
    # Maximum offset of an array's centre over the region's side: the array may be hidden in part
    max_offset: float = 0.4
    # Size of the fitted header over the size of the region
    min_size: float = 0.55
    max_size: float = 1.8
    # Minimum correlation for the times of headers
    min_timed: float = 0.6
    # Minimum amplitude over the amplitude of the best header: a format dims some to 0.75
    min_amplitude: float = 0.6


TUNING = HeaderTuning()


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
    level = max(0, int(np.ceil(np.log2(max(size_px, 1.0) / TUNING.reduced_side_px))))
    frames = frames[: TUNING.max_frames]
    for _ in range(level):
        frames = [halved(frame) for frame in frames]
    scale = 2**level
    size, speed = size_px / scale, (speed[0] / scale, speed[1] / scale)
    pad = int(np.ceil(size * (0.6 + DETECT.ring))) + 2
    late = np.arange(len(frames) - 3) + 1.5 - 0.5 * (len(frames) - 1)
    places = _search(frames, np.array(centre) / scale + late[:, None] * np.array(speed), size, pad)
    candidates = [(place, _fit(frames, place, side, level, pad, speed)) for place in places]
    limits = TUNING.min_size * size / side, TUNING.max_size * size / side
    fits = [(place, fit) for place, fit in candidates if fit is not None and limits[0] < fit.pose.pitch < limits[1]]
    if not fits:
        return None
    place, fit = max(fits, key=lambda found: found[1].score)
    best = HeaderMatch(side, fit, headers(ORIENTATIONS).hypotheses[place.header])
    if best.score >= TUNING.min_timed:
        best = _find_starts(frames, best, place, speed)
    return replace(best, fit=View(level).fit_out(best.fit))


def _search(frames: Sequence[Frame], centres: Floats, size: float, pad: int) -> list[_Place]:
    """Search near the centres (times, 2); return the best places, each of another time."""
    parameters = SearchParameters(
        min_side_px=3.0, max_side_px=max(2 * size, 6.0), min_contrast=0.002, coarse_score=0.2,
        score=0.0, regularity=0.0, candidates=1, blur_px=TUNING.blurs[0],
    )  # fmt: skip
    cells, sizes = headers(ORIENTATIONS).cells, np.maximum(size * np.array(TUNING.sizes), 2.5)
    side, found = max(round(size), 1), list[_Place]()
    boxes = [(round(x - 0.5 * size), round(y - 0.5 * size), side, side) for x, y in centres]
    power = [np.square(alternation(frames[k : k + 4], box)).mean() for k, box in enumerate(boxes)]
    # a header has more than twice the light of data
    for k in np.argsort(-np.array(power))[: TUNING.n_searched]:
        change = _padded(alternation_of(frames[k : k + 4]), pad)
        x, y = frames[k].origin[0] - pad, frames[k].origin[1] - pad
        busy = np.zeros([-(-length // BLOCK_PX) + 1 for length in change.shape], bool)
        reach = TUNING.max_offset * size
        first, last = ((centres[k] - (x, y) + sign * reach) // BLOCK_PX for sign in (-1, 1))
        (left, top), (right, low) = np.maximum(first, 0).astype(int), np.maximum(last, 0).astype(int)
        busy[top : low + 1, left : right + 1] = True
        region = SearchRegion(change, busy, replace(frames[k], origin=(x, y)))
        rows, *_ = coarse_search(region, parameters, cells, sizes)
        found += [_Place(int(k), row[0], row[1] + x, row[2] + y, row[3], int(row[4])) for row in rows]
    best = list[_Place]()
    for place in sorted(found, key=lambda place: -abs(place.score)):
        if len(best) < TUNING.n_fitted and all(abs(place.frame - other.frame) > 3 for other in best):
            best.append(place)
    return best


def _padded(change: NDArray[np.float32], pad: int) -> NDArray[np.float32]:
    """Add a dark margin: an array may lie at the frame's border."""
    return np.asarray(cv2.copyMakeBorder(change, pad, pad, pad, pad, cv2.BORDER_CONSTANT, value=0), np.float32)


def _fit(
    frames: Sequence[Frame], place: _Place, side: int, level: int, pad: int, speed: tuple[float, float]
) -> Fit | None:
    """Fit a header near a place, from several blurs."""
    weights = np.sign(place.score) * cell_weights(headers(ORIENTATIONS).cells[place.header], side)
    four, origin = frames[place.frame : place.frame + 4], frames[place.frame].origin
    change, corner = _padded(alternation_of(four), pad), (origin[0] - pad, origin[1] - pad)
    # motion blur of the alternation of four frames
    smear = abs(speed[0]) * (0.35 + 1 / 12) ** 0.5, abs(speed[1]) * (0.35 + 1 / 12) ** 0.5
    best: Fit | None = None
    for tilt in (DETECT.upright_sigma, DETECT.tilted_sigma):
        for blur in TUNING.blurs:
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
    threshold = TUNING.min_amplitude * float(np.abs(shown[place.frame : place.frame + 4]).max())
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
