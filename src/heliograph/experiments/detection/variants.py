"""Detectors: four variants with no score threshold, and that of the receiver."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import Floats
from heliograph.experiments.detection.clutter import ClutterFilm, HeaderKind
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
from heliograph.receive.detect.detection import Detection
from heliograph.receive.detect.header_bank import ALL_ON, headers
from heliograph.receive.detect.kernels import BLOCK_PX
from heliograph.receive.detect.search import PyramidSearch
from heliograph.receive.geometry.pose import UPRIGHT
from heliograph.receive.settings import ReceiveSettings
from heliograph.signal.settings import SignalSettings

REFERENCE, PAPER = "all on, 2 frames", "M-sequence, 2 frames"

VARIANTS: dict[str, tuple[HeaderKind, int]] = {
    REFERENCE: ("all_on", 2),
    "all on, 4 frames": ("all_on", 4),
    PAPER: ("m_sequence", 2),
    "M-sequence, 4 frames": ("m_sequence", 4),
}
"""Searched header and number of combined frames by variant: the reference and the detector of the paper; the last is
that of the receiver."""


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

    def __init__(self, header: HeaderKind, frames: int):
        settings, signal = ReceiveSettings(), SignalSettings()
        all_on = header == "all_on"
        usual = search_parameters(settings, signal, PLAIN_REGULARITY)
        # candidates of each size range
        self._parameters = replace(usual, coarse_score=0.2, score=0.0, candidates=5, all_on=all_on)
        self._frames_used, self._side = frames, signal.side
        self._cells = (ALL_ON if all_on else headers((UPRIGHT,))).cells
        # separate size ranges, as parts of a lit square are lit squares
        self._size_ranges = np.array_split(self._parameters.sides(), 3)

    def candidates(self, film: ClutterFilm) -> list[HeaderCandidate]:
        """Candidates in the header frames of a film; with an array in the film, only at its place."""
        window = film.frames[film.first : film.first + self._frames_used]
        change, first = alternation_of(window), window[0]
        busy = busy_blocks(alternation_means(window), first, (), self._side, self._parameters.min_contrast)
        for truth in film.truths:
            busy &= _blocks_near(truth, busy.shape)
        if not busy.any():
            return []
        region = SearchRegion(change, busy, first)
        rows = [coarse_search(region, self._parameters, self._cells, sides)[0] for sides in self._size_ranges]
        fitted = [self._fit(change, row, first.full_scale) for row in np.concatenate(rows)]
        return [candidate for candidate in fitted if candidate is not None]

    def _fit(self, change: NDArray[np.float32], row: Floats, full_scale: int) -> HeaderCandidate | None:
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


def detections(film: ClutterFilm, min_side_px: float | None = None) -> list[Detection]:
    """Detections of the receiver in a film."""
    settings, signal = ReceiveSettings(), SignalSettings()
    if min_side_px:
        settings = replace(settings, detect=replace(settings.detect, min_side_px=min_side_px))
    detector = PyramidSearch(search_parameters(settings, signal, PLAIN_REGULARITY), signal)
    return [detection for frame in film.frames for detection in detector.search(frame)]


def is_same(pose: Pose, truth: Pose) -> bool:
    """True if a pose is within a quarter of the side and a factor 1.25 in size of the true pose."""
    distance = np.hypot(pose.x - truth.x, pose.y - truth.y)
    return bool(distance < 0.25 * 16 * truth.pitch and 1 / 1.25 < pose.pitch / truth.pitch < 1.25)
