"""Detector ablation: four variants of the detector with no score threshold."""

from collections.abc import Sequence
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


@dataclass(frozen=True, slots=True)
class DetectorVariant:
    """Variant of the detector."""

    name: str
    # Header of the search: the lit array, or the M-sequences
    detector: Literal["all_on", "m_sequence"]
    # Combined frames, 2 or 4
    frames: int


VARIANTS = (
    DetectorVariant("all on, 2 frames", "all_on", 2),
    DetectorVariant("all on, 4 frames", "all_on", 4),
    DetectorVariant("M-sequence, 2 frames", "m_sequence", 2),
    DetectorVariant("M-sequence, 4 frames", "m_sequence", 4),
)
"""The first is the reference of the paper, the third the detector of the paper, the fourth that of the receiver."""


@dataclass(frozen=True, slots=True)
class HeaderCandidate:
    """Candidate of a header in the image."""

    # Correlation of the pixels with the fitted header, 0 to 1
    score: float
    pose: Pose
    # Identity of the header; 0 for a lit array
    identity: int


class VariantDetector:
    """Search of the receiver with no score threshold and no check of adjacent frames."""

    def __init__(self, variant: DetectorVariant):
        settings, signal = ReceiveSettings(), SignalSettings()
        usual = search_parameters(settings, signal, PLAIN_REGULARITY)
        all_on = variant.detector == "all_on"
        # candidates of each size range
        self._parameters = replace(usual, coarse_score=0.2, score=0.0, candidates=5, all_on=all_on)
        self._frames_used, self._side = variant.frames, signal.side
        self._cells = (ALL_ON if all_on else headers((UPRIGHT,))).cells
        # separate size ranges, as parts of a lit square are lit squares
        self._size_ranges = np.array_split(self._parameters.sides(), 3)

    def candidates(self, film: ClutterFilm) -> list[HeaderCandidate]:
        """Candidates in the header frames of a film; with an array in the film, only at its place."""
        window = film.frames[film.first : film.first + self._frames_used]
        change, first = alternation_of(window), window[0]
        busy = busy_blocks(alternation_means(window), first, (), self._side, self._parameters.min_contrast)
        if film.truth is not None:
            busy &= _blocks_near(film.truth, busy.shape)
        if not busy.any():
            return []
        region = SearchRegion(change, busy, first)
        rows = [coarse_search(region, self._parameters, self._cells, sides)[0] for sides in self._size_ranges]
        fitted = [self._fit(change, row, first.full_scale) for row in np.concatenate(rows)]
        return [candidate for candidate in fitted if candidate is not None]

    def _fit(self, change: NDArray[np.float32], row: NDArray[np.float64], full_scale: int) -> HeaderCandidate | None:
        """Fit a candidate like the detector: first with a blur that hides single LEDs, then with the nominal blur."""
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


def _blocks_near(truth: Pose, blocks: tuple[int, ...]) -> NDArray[np.bool_]:
    """Blocks of the search, (rows, columns), within half the side of an array from its centre."""
    reach = 8 * truth.pitch + BLOCK_PX
    y, x = ((np.arange(n) + 0.5) * BLOCK_PX for n in blocks)
    return np.asarray((abs(y - truth.y) < reach)[:, None] & (abs(x - truth.x) < reach))


def best_false(found: Sequence[HeaderCandidate]) -> HeaderCandidate | None:
    """Candidate with the highest score."""
    return max(found, key=lambda candidate: candidate.score, default=None)


def score_of_array(found: Sequence[HeaderCandidate], truth: Pose, identity: int | None) -> float:
    """Highest score of candidates at the array, 0 for none."""
    return max((c.score for c in found if is_same(c.pose, truth) and identity in (None, c.identity)), default=0.0)


def is_same(pose: Pose, truth: Pose) -> bool:
    """True if a pose is within a quarter of the side and a factor 1.25 in size of the true pose."""
    distance = np.hypot(pose.x - truth.x, pose.y - truth.y)
    return bool(distance < 0.25 * 16 * truth.pitch and 1 / 1.25 < pose.pitch / truth.pitch < 1.25)


def threshold_for_false(false: NDArray[np.float64], fraction: float) -> float:
    """Lowest threshold that at most a fraction of the scores of films with no array exceeds."""
    allowed = int(fraction * false.size)
    return float(np.sort(false)[::-1][allowed]) if false.size > allowed else 0.0


def threshold_for_found(true: NDArray[np.float64], fraction: float) -> float:
    """Highest threshold that at least a fraction of the scores of arrays exceeds."""
    needed = int(np.ceil(fraction * true.size))
    return float(np.nextafter(np.sort(true)[::-1][needed - 1], -1)) if needed else 1.0


def curve(false: NDArray[np.float64], true: NDArray[np.float64]) -> tuple[list[float], list[float]]:
    """Fractions of false alarms and of arrays found for falling thresholds."""
    thresholds = np.unique(np.concatenate([false, true, [0.0, 1.0]]))[::-1]
    alarms, found = ([float((scores > t).mean()) for t in thresholds] for scores in (false, true))
    return alarms, found
