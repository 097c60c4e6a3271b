"""Detector ablation: four variants of the detector, scored without thresholds."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from heliograph.experiments.detection.clutter import ClutterFilm
from heliograph.receive import Pose
from heliograph.receive.build import PLAIN_REGULARITY, search_parameters
from heliograph.receive.detect.alternation import (
    DETECT,
    SearchRegion,
    alternation_means,
    alternation_of,
    busy_blocks,
    coarse_search,
)
from heliograph.receive.detect.candidate import cell_weights, fit_near, is_in_size_range, is_plausible
from heliograph.receive.detect.header_bank import ALL_ON, headers
from heliograph.receive.detect.kernels import BLOCK_PX
from heliograph.receive.geometry.pose import UPRIGHT
from heliograph.receive.settings import ReceiveSettings
from heliograph.signal.settings import SignalSettings

NEAR = 0.25
"""Fraction of the array's side by which a candidate may lie beside the array and still count as it."""

LIKE = 1.25
"""Ratio of sizes up to which a candidate counts as the array."""

CANDIDATES, BANDS = 5, 3
"""Candidates of each range of sizes that are fitted, and ranges."""


@dataclass(frozen=True, slots=True)
class DetectorVariant:
    """A variant of the detector."""

    # Its name in tables
    name: str
    # The header's shape that it looks for: the lit array, or the M-sequences
    detector: Literal["all_on", "m_sequence"]
    # Frames that it combines, 2 or 4
    frames: int


VARIANTS = (
    DetectorVariant("all on, 2 frames", "all_on", 2),
    DetectorVariant("all on, 4 frames", "all_on", 4),
    DetectorVariant("M-sequence, 2 frames", "m_sequence", 2),
    DetectorVariant("M-sequence, 4 frames", "m_sequence", 4),
)
"""The first is the one the paper compares with, the third the paper's own, the fourth the receiver's."""


@dataclass(frozen=True, slots=True)
class HeaderCandidate:
    """A place in the image that looks like a header."""

    # Correlation of the pixels with the fitted header, 0 to 1
    score: float
    # Pose of the fitted header in the image
    pose: Pose
    # Identity whose header it shows, 0 to 29; 0 where only a lit array is looked for
    identity: int


class VariantDetector:
    """The receiver's search without thresholds on its scores, and without its check of the frames around."""

    def __init__(self, variant: DetectorVariant):
        settings, signal = ReceiveSettings(), SignalSettings()
        usual = search_parameters(settings, signal, PLAIN_REGULARITY)
        all_on = variant.detector == "all_on"
        self._parameters = replace(usual, coarse_score=0.2, score=0.0, candidates=CANDIDATES, all_on=all_on)
        self._frames_used, self._side = variant.frames, signal.side
        self._cells = (ALL_ON if self._parameters.all_on else headers((UPRIGHT,))).cells
        self._bands = np.array_split(self._parameters.sides(), BANDS)

    def candidates(self, film: ClutterFilm) -> list[HeaderCandidate]:
        """Candidates in the header's frames of a film; where there is an array, those at its place only."""
        window = film.frames[film.first : film.first + self._frames_used]
        change, first = alternation_of(window), window[0]
        busy = busy_blocks(alternation_means(window), first, (), self._side, self._parameters.min_contrast)
        if film.truth is not None:
            busy &= _around(film.truth, busy.shape)
        if not busy.any():
            return []
        # of each range of sizes: a square's parts are like it, and would be kept in place of it
        region = SearchRegion(change, busy, first)
        rows = [coarse_search(region, self._parameters, self._cells, sides)[0] for sides in self._bands]
        found = [self._fitted(change, row, first.full_scale) for row in np.concatenate(rows)]
        return [one for one in found if one is not None]

    def _fitted(self, change: NDArray[np.float32], row: NDArray[np.float64], full_scale: int) -> HeaderCandidate | None:
        """A candidate's pose as the detector fits it: first under a blur that hides single LEDs, then as it is."""
        number, blur = int(row[4]), self._parameters.blur_px
        weights = float(np.sign(row[0])) * cell_weights(self._cells[number], self._side)
        start = Pose(row[1] - 0.5, row[2] - 0.5, row[3] / self._side, 0.0, blur)
        rough = fit_near(change, (0, 0), start, weights, DETECT.upright_sigma, DETECT.hiding_blur)
        if rough is None:
            return None
        fit = fit_near(change, (0, 0), replace(rough.pose, blur=blur), weights, DETECT.upright_sigma)
        if fit is None or fit.score < 0 or not is_plausible(fit, self._parameters, full_scale):
            return None
        if not is_in_size_range(fit, self._parameters, self._side):
            return None
        return HeaderCandidate(fit.score, fit.pose, number)


@dataclass(slots=True)
class DetectionScores:
    """Best scores of a variant."""

    # By scene: score of the best candidate of each film without an array, 0 for none
    false: dict[str, list[float]]
    # By scene and distance in m: score of the array's own candidate in each film with one, 0 where it is missed
    true: dict[tuple[str, float], list[float]]

    def all_false(self) -> NDArray[np.float64]:
        """Scores of all films without an array, (n,)."""
        return np.array([score for scores in self.false.values() for score in scores])

    def all_true(self, distance_m: float) -> NDArray[np.float64]:
        """Scores of all films with an array at a distance, (n,)."""
        return np.array([s for (_, z), scores in self.true.items() if z == distance_m for s in scores])


def _around(truth: Pose, blocks: tuple[int, ...]) -> NDArray[np.bool_]:
    """Blocks of the search, (rows, columns), within half the array's side of its centre."""
    reach = 8 * truth.pitch + BLOCK_PX
    y, x = ((np.arange(n) + 0.5) * BLOCK_PX for n in blocks)
    return np.asarray((abs(y - truth.y) < reach)[:, None] & (abs(x - truth.x) < reach))


def best_false(found: Sequence[HeaderCandidate]) -> HeaderCandidate | None:
    """The candidate with the highest score; None where there is none."""
    return max(found, key=lambda one: one.score, default=None)


def score_of_array(found: Sequence[HeaderCandidate], truth: Pose, identity: int | None) -> float:
    """Score of the candidate that is the array, 0 if none is."""
    return max((c.score for c in found if same(c.pose, truth) and identity in (None, c.identity)), default=0.0)


def same(pose: Pose, truth: Pose) -> bool:
    """Whether a pose is about that of the array, by `NEAR` and `LIKE`."""
    beside = np.hypot(pose.x - truth.x, pose.y - truth.y)
    return bool(beside < NEAR * 16 * truth.pitch and 1 / LIKE < pose.pitch / truth.pitch < LIKE)


def threshold_for_false(false: NDArray[np.float64], fraction: float) -> float:
    """Least threshold (a score above it counts) that at most a fraction of the films without an array exceed."""
    allowed = int(fraction * false.size)
    return float(np.sort(false)[::-1][allowed]) if false.size > allowed else 0.0


def threshold_for_found(true: NDArray[np.float64], fraction: float) -> float:
    """Largest threshold above which at least a fraction of the arrays lie; 0 where fewer are even candidates."""
    needed = int(np.ceil(fraction * true.size))
    return float(np.nextafter(np.sort(true)[::-1][needed - 1], -1)) if needed else 1.0


def curve(false: NDArray[np.float64], true: NDArray[np.float64]) -> tuple[list[float], list[float]]:
    """Fractions of false alarms and of arrays found as the threshold falls; both rise, to the end of all candidates."""
    thresholds = np.unique(np.concatenate([false, true, [0.0, 1.0]]))[::-1]
    alarms = [float((false > t).mean()) for t in thresholds]
    return alarms, [float((true > t).mean()) for t in thresholds]


def plain(scores: Mapping[str, DetectionScores]) -> dict[str, dict[str, dict[str, list[float]]]]:
    """Scores by variant as plain values, rounded to 4 digits."""
    return {
        name: {
            "false": {scene: [round(s, 4) for s in found] for scene, found in one.false.items()},
            "true": {f"{scene}, {z:g} m": [round(s, 4) for s in found] for (scene, z), found in one.true.items()},
        }
        for name, one in scores.items()
    }
