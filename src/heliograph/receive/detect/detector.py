"""Detectors of the headers of arrays: in step with the light, and half a pattern out of step.

A header and the inverse alternate. Of four frames in a row, r_0 - 3 r_1 + 3 r_2 - r_3 keeps the header and cancels
light at rest or in even motion or acceleration. The detector correlates the result with the M-sequences of all
identities over scale and position, and fits the best candidates to a fraction of a pixel. Candidates must alternate in
step from frame to frame.

Half a pattern out of step each frame shows half of a pattern and half of the next. Within a header of N patterns every
LED then shows the same light, and the frames do not alternate. But the frame over the beginning shows half of the
header, and the frame over the end half of the inverse. With w = N / (N - 2),

    2 (r_0 - w r_1 + w r_(N-1) - r_N)

is the header less the inverse, and random light of the data before and after. Light at rest or in even motion or
acceleration cancels. The frames between are quiet, as frames of data never are.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.base.frames import Frame
from heliograph.receive.detect.alternation import (
    Blocks,
    Change,
    SearchParameters,
    SearchRegion,
    alternation_means,
    alternation_of,
    busy_blocks,
    search_regions,
)
from heliograph.receive.detect.budget import BlockSelector, BudgetedSearch, NoveltyParameters, TokenBucket
from heliograph.receive.detect.candidate import (
    FIT,
    are_disjoint,
    cell_weights,
    estimate_drift,
    fit_first_pair,
    fit_header,
    fit_moving,
    fit_near,
    is_in_size_range,
    is_plausible,
    is_tracked,
    measure_cells,
)
from heliograph.receive.detect.detection import Detection, distinct
from heliograph.receive.detect.frame_window import (
    FrameWindow,
    FrameWindowBuffer,
    fill_missing,
    find_header_start,
    first_present,
    have_same_format,
)
from heliograph.receive.detect.header_bank import ALL_ON, Headers, Hypothesis, headers
from heliograph.receive.detect.region import Candidate, find_candidates
from heliograph.receive.geometry.fit import Fit, header_amplitudes
from heliograph.receive.geometry.pose import ORIENTATIONS, UPRIGHT, Orientation, Pose
from heliograph.receive.geometry.window import common, cut_out, window_around
from heliograph.signal.header import IDENTITIES
from heliograph.signal.settings import SignalSettings


@dataclass(frozen=True, kw_only=True)
class DetectorParameters:
    """Thresholds of a detector in step."""

    # Least score of a candidate's first fit, and the same at a low level of the budget
    min_rough_score: float = 0.55
    min_rough_score_low: float = 0.7
    # Least gain in score of a tilted fit: an upright array with a hidden side looks a little tilted
    min_tilt_gain: float = 0.03
    # Least score of an array behind a thin post, which hides up to 36 %
    min_post_score: float = 0.8
    # Regularity below which light of data looks like a tilt, and the least tilt of such a header
    min_level_regularity: float = 0.65
    min_tilt: float = 0.05
    # Fits in a row of a rolled candidate: the roll is up to 12 degrees off
    rolled_fits: int = 4


@dataclass(frozen=True, kw_only=True)
class HalfPeriodParameters:
    """Thresholds of a detector half a pattern out of step."""

    # Largest change within a header over the change across: data reach 1, noise 0.45
    max_quiet: float = 0.3
    # Share of a header's correlation under the light of data
    data_score: float = 0.78
    # Least change across a header over the change across as many patterns of data, 1.8 on average, and blocks of a
    # side of the mean
    min_novelty: float = 1.3
    novelty_window: int = 3
    # Share of the work of a search, as these searches come twice as often
    work_share: float = 0.25
    # Least light of a cell within a header, and largest difference of two cells, over the light of the array: each LED
    # is lit for half of such a frame, and lamps are not
    min_light: float = 0.3
    max_light_difference: float = 0.5
    # Extreme cells ignored at either end
    ignored_cells: int = 3


class _BaseDetector:
    """Common parts of the detectors."""

    def __init__(
        self,
        parameters: SearchParameters,
        signal: SignalSettings,
        budget: TokenBucket | None,
        novelty: NoveltyParameters,
    ):
        self._parameters, self._side, self._period_s = parameters, signal.side, signal.pattern_period_s
        self._header = 2 * signal.header_pairs
        self._sides = parameters.sides()
        self.budget = budget or TokenBucket(parameters.cpu_share, signal.pattern_period_s)
        self.selector = BlockSelector(self.budget, novelty, signal.packet_patterns)

    def busy_blocks(self, means: Change, frame: Frame, tracked: Sequence[Pose]) -> Blocks:
        """Find the busy blocks outside tracked arrays."""
        parameters = self._parameters
        return busy_blocks(means, frame, tracked, self._side, parameters.min_contrast, parameters.everywhere)

    def _search_for(self, sought: Headers) -> BudgetedSearch:
        return BudgetedSearch(self._parameters, sought, self.budget)

    def _fit(self, candidate: Candidate, start: Pose, tilt: float, blur: float = 0.0) -> Fit | None:
        """Fit a candidate from a pose to the alternation of the region."""
        region = candidate.region
        weights = math.copysign(1.0, candidate.score) * cell_weights(candidate.cells, self._side)
        self.budget.charge_fits()
        return fit_near(region.change, region.first.origin, start, weights, tilt, blur)


class Detector(_BaseDetector):
    """Detector of headers in a stream of one frame per pattern."""

    def __init__(
        self,
        parameters: SearchParameters,
        signal: SignalSettings,
        budget: TokenBucket | None = None,
        thresholds: DetectorParameters = DetectorParameters(),
    ):
        # a header may have 1.2 times the alternation of on-off data, and no more
        is_ook = signal.modulation == "ook"
        novelty = NoveltyParameters(min_ratio=1.1, max_ratio=1.1) if is_ook else NoveltyParameters()
        super().__init__(parameters, signal, budget, novelty)
        self._thresholds = thresholds
        # a lit square may belong to anything, a tilted one all the more; corners are off by some px, which is a tilt
        tilted = (parameters.impaired and not parameters.all_on) or parameters.start is not None
        self._tilts = (FIT.upright_sigma, FIT.tilted_sigma) if tilted else (FIT.upright_sigma,)
        # the search for turned headers follows if no upright header is clear: an array in poor sight may resemble both
        turned = headers(ORIENTATIONS[1:])
        self._set_headers([ALL_ON] if parameters.all_on else [headers((UPRIGHT,), ORIENTATIONS[1:]), turned])
        self.buffer = FrameWindowBuffer(self._header, signal.packet_patterns)

    def _set_headers(self, banks: Sequence[Headers]) -> None:
        """Prepare the searches: the banks in turn, then for each bank the rolls, in rad."""
        self._stages = [[(self._search_for(bank), 0.0)] for bank in banks]
        is_fixed = self._parameters.all_on or self._parameters.start is not None
        # a turned header rolled one way is another turned header rolled the other way
        self._rolled_stages = [
            [
                (self._search_for(bank), math.radians(roll))
                for roll in self._parameters.rolls_deg
                if roll > 0 or len(bank.cells) == IDENTITIES
            ]
            for bank in ([] if is_fixed else banks)
        ]

    def set_orientation(self, orientation: Orientation) -> None:
        """Search for a single orientation from now on; see `HeaderSearch`."""
        if not self._parameters.all_on:
            self._set_headers([headers((orientation,))])

    def push(self, frame: Frame, tracked: Sequence[Pose] = ()) -> list[Detection]:
        """Search with the next frame; see `HeaderSearch`."""
        self.budget.refill()
        detections = list[Detection]()
        for slots, with_turned in self.buffer.push(frame):
            means, known = self.block_means(slots), [*tracked, *(found.fit.pose for found in detections)]
            if means is None:
                continue
            first = first_present(slots)
            busy, is_novel = self.selector.select(means, self.busy_blocks(means, first, known), first)
            if self.budget.try_start(busy, is_novel):
                detections += self.search(slots, busy, known, with_turned)
        return detections

    def block_means(self, slots: FrameWindow) -> Change | None:
        """Compute the mean alternation of blocks; None if frames are missing or too small."""
        header = self.buffer.header_of(slots)
        if header is None or min(header[0].pixels.shape) < self._sides[0]:
            return None
        return alternation_means(header)

    def regions(self, slots: FrameWindow, busy: Blocks, max_side_px: float) -> list[SearchRegion]:
        """Return the alternation about busy blocks."""
        header = self.buffer.header_of(slots)
        return search_regions(header, busy, max_side_px, alternation_of) if header and busy.any() else []

    def search(self, slots: FrameWindow, busy: Blocks, tracked: Sequence[Pose], with_turned: bool) -> list[Detection]:
        """Search busy blocks for headers: upright, then turned, then rolled, until an array is clear."""
        regions = self.regions(slots, busy, self._sides[-1])
        if not regions:
            return []
        detections = list[Detection]()
        stages = self._stages if with_turned else self._stages[:1]
        for k, stage in enumerate([*stages, *(self._rolled_stages if with_turned else ())]):
            is_rolled = k >= len(stages)
            if is_rolled and not self.budget.is_full:
                break
            fitted = list[Detection]()
            for candidate in self._candidates(regions, stage):
                # of overlapping arrays the less clear is dropped
                known = [found.fit.pose for found in (*detections, *fitted) if found.is_clear]
                is_free = all(are_disjoint(candidate.start, pose, self._side) for pose in known)
                if is_free and self.budget.try_fit(candidate.score):
                    fitted += self._refine(slots, candidate, tracked)
            if k and self.budget.is_low:
                # an upright array in a skipped block may look like a turned array partly hidden
                fitted = [found for found in fitted if found.is_clear]
            # an apparent upright array partly hidden may be a clear turned array; of so many rolls clutter
            # resembles some header
            fitted = [found for found in fitted if found.is_clear or not (detections or is_rolled)]
            detections = distinct([*detections, *fitted], self._side)
            has_compared = any(search.has_compared for search, _ in stage)
            if (detections and all(found.is_clear for found in detections)) or not has_compared:
                break
        in_range = [found for found in detections if is_in_size_range(found.fit, self._parameters, self._side)]
        if len(in_range) < len(detections):
            # another level searches for a clear array of another size
            self.budget.expect_array()
        return in_range

    def _candidates(
        self, regions: Sequence[SearchRegion], stage: Sequence[tuple[BudgetedSearch, float]]
    ) -> list[Candidate]:
        """Return the best candidates of the searches of a stage."""
        candidates = [
            candidate for search, roll in stage for candidate in find_candidates(regions, search, self._side, roll)
        ]
        if len(stage) == 1:
            return candidates
        # of so many rolls clutter resembles some header
        candidates = [candidate for candidate in candidates if abs(candidate.score) >= self.budget.parameters.min_score]
        return sorted(candidates, key=lambda candidate: -abs(candidate.score))[: self._parameters.candidates]

    def _refine(self, slots: FrameWindow, candidate: Candidate, tracked: Sequence[Pose]) -> list[Detection]:
        """Fit a candidate upright and, if in doubt, tilted; return at most one detection."""
        thresholds, parameters = self._thresholds, self._parameters
        if is_tracked(candidate.start, tracked, self._side):
            return []
        weights = cell_weights(candidate.cells, self._side)
        best, min_score = None, thresholds.min_rough_score
        for tilt in self._tilts:
            rough = self._fit(candidate, candidate.start, tilt, FIT.hiding_blur)
            if rough is None or rough.score < min_score:
                break
            if tilt == FIT.upright_sigma and self.budget.is_low and rough.score < thresholds.min_rough_score_low:
                self.budget.skip_candidate()
                break
            min_score = parameters.coarse_score
            pose = replace(rough.pose, blur=parameters.blur_px)
            if candidate.start.roll and parameters.start is None:
                for _ in range(thresholds.rolled_fits):
                    rolled = self._fit(candidate, pose, tilt, FIT.hiding_blur)
                    if rolled is None:
                        break
                    pose = replace(rolled.pose, blur=pose.blur)
            begun = find_header_start(slots, pose, weights, self._header)
            if begun is None:
                # at any tilt
                break
            found = self._detect(slots, begun, pose, weights, candidate.hypotheses, tilt)
            if found is not None and (best is None or found.score > best.score + thresholds.min_tilt_gain):
                best = found
            if best is not None and best.score >= FIT.clear_score:
                break
        return [] if best is None else [best]

    def _detect(
        self,
        slots: FrameWindow,
        begun: tuple[int, float],
        pose: Pose,
        weights: Floats,
        hypotheses: tuple[Hypothesis, ...],
        tilt: float,
    ) -> Detection | None:
        """Fit the frames of a header; None if they show no convincing array."""
        parameters, thresholds, (start, regularity) = self._parameters, self._thresholds, begun
        frames = slots[start : start + self._header]
        header = fill_missing(frames[:4])
        if header is None:
            return None
        # a copy for a missing frame alternates by itself: a pair of data must not pass for a half hidden header
        is_whole, is_mixed = None not in frames, regularity < thresholds.min_level_regularity
        if regularity < (parameters.regularity if is_whole else FIT.min_hidden_regularity):
            return None
        if is_mixed and tilt == FIT.upright_sigma:
            pose, tilt = replace(pose, stretch=0.0, shear=0.0), FIT.level_sigma
        self.budget.charge_fits()
        is_even = parameters.impaired and is_whole and regularity >= FIT.min_hidden_regularity
        fit, led_gains, is_level = fit_header(header, pose, weights, tilt, parameters.score, is_even)
        if fit is None or not is_plausible(fit, parameters, header[0].full_scale):
            return None
        fitted_tilt = math.hypot(fit.pose.stretch, fit.pose.shear)
        if is_mixed and tilt > FIT.upright_sigma and fitted_tilt < thresholds.min_tilt:
            return None
        min_score = thresholds.min_post_score if is_level and led_gains.all() else parameters.score
        if fit.score < (min_score if is_whole else FIT.clear_score):
            return None
        is_in_range = is_in_size_range(fit, parameters, self._side)
        if not is_in_range and fit.score < FIT.clear_score:
            return None
        first, frame = next((k, frame) for k, frame in enumerate(frames) if frame is not None)
        start_s, time_s = frame.time_s - first * self._period_s, 0.5 * (header[0].time_s + header[-1].time_s)
        (identity, orientation), *others = hypotheses
        found = Detection(identity, start_s, fit, time_s, fit.score, regularity, led_gains, orientation, tuple(others))
        if not is_in_range:
            return found
        tilt = FIT.level_sigma if is_level else tilt
        if None not in frames[:2] and parameters.impaired and len(header) > 2:
            fit, header = fit_first_pair(header, fit, led_gains * weights, tilt)
        # the drift is fitted too, and the header with the smear
        self.budget.charge_fits(2)
        time_s = 0.5 * (header[0].time_s + header[-1].time_s)
        present = [frame for frame in frames if frame is not None]
        drift = estimate_drift(present, fit.pose, time_s, led_gains * weights, self._period_s)
        fit = fit_moving(header, fit, led_gains * weights, tilt, (drift[0] * self._period_s, drift[1] * self._period_s))
        return replace(found, fit=fit, time_s=time_s, score=fit.score, drift=drift)


class HalfPeriodDetector(_BaseDetector):
    """Detector of headers half a pattern out of step, in a stream of one frame per pattern; it does not refill."""

    def __init__(
        self,
        parameters: SearchParameters,
        signal: SignalSettings,
        budget: TokenBucket | None = None,
        thresholds: HalfPeriodParameters = HalfPeriodParameters(),
    ):
        ratio, window = thresholds.min_novelty, thresholds.novelty_window
        novelty = NoveltyParameters(min_ratio=ratio, max_ratio=ratio, window=window, repeats=False)
        super().__init__(parameters, signal, budget, novelty)
        self._thresholds = thresholds
        # turned headers are searched for once the orientation is known
        self._search = self._search_for(ALL_ON if parameters.all_on else headers((UPRIGHT,), ORIENTATIONS[1:]))
        self._frames: deque[Frame] = deque(maxlen=self._header + 1)

    def set_orientation(self, orientation: Orientation) -> None:
        """Search for a single orientation from now on; see `HeaderSearch`."""
        if not self._parameters.all_on:
            self._search = self._search_for(headers((orientation,)))

    def push(self, frame: Frame, tracked: Sequence[Pose] = ()) -> list[Detection]:
        """Search with the next frame; see `HeaderSearch`."""
        last = self._frames[-1] if self._frames else None
        if last is not None and not (have_same_format(last, frame) and frame.index == last.index + 1):
            self._frames.clear()
        self._frames.append(frame)
        if len(self._frames) <= self._header:
            return []
        frames, thresholds = common(list(self._frames)), self._thresholds
        if min(frames[0].pixels.shape) < self._sides[0]:
            return []
        # 2 (r_0 - w r_1 + w r_(N-1) - r_N), w = N / (N - 2): the header less the inverse, with levels of +-1/2
        ends, weight = [frames[k] for k in (0, 1, -2, -1)], 2 * self._header / (self._header - 2)
        weights = (2.0, -weight, weight, -2.0)
        means = alternation_means(ends, weights)
        busy = eligible = self.busy_blocks(means, frames[0], tracked)
        if busy.any():
            # the means are twice the change
            within = alternation_means(frames[1:3])
            eligible = busy & (within < 0.5 * thresholds.max_quiet * means)
        chosen, _ = self.selector.select(means, busy, frames[0], eligible, thresholds.work_share)
        if not busy.any() or not self.budget.try_start(chosen, share=thresholds.work_share):
            return []
        regions = search_regions(ends, chosen, self._sides[-1], lambda part: alternation_of(part, weights))
        detections = [
            self._detect(frames, candidate)
            for candidate in find_candidates(regions, self._search, self._side)
            if candidate.score > 0 and self.budget.try_fit() and not is_tracked(candidate.start, tracked, self._side)
        ]
        return distinct([found for found in detections if found is not None], self._side)

    def _detect(self, frames: Sequence[Frame], candidate: Candidate) -> Detection | None:
        """Fit a candidate as level, as the light of data looks like a tilt; None if it is not convincing."""
        parameters = self._parameters
        fit = self._fit(candidate, candidate.start, FIT.level_sigma)
        if fit is None or fit.score < self._thresholds.data_score * parameters.score:
            return None
        if not is_plausible(fit, parameters, frames[0].full_scale) or not is_in_size_range(fit, parameters, self._side):
            return None
        weights = cell_weights(candidate.cells, self._side)
        # amplitudes over the beginning and the end, less the mean within
        amplitudes = header_amplitudes(frames, fit.pose, weights)
        ends = np.array([1, -1]) * (amplitudes[[0, -1]] - amplitudes[1:-1].mean())
        regularity = float(ends.min() / ends.mean()) if ends.mean() > 0 else 0.0
        if regularity < parameters.regularity or not self._is_lit_within(frames, fit):
            return None
        time_s, start_s = 0.5 * (frames[0].time_s + frames[-1].time_s), frames[0].time_s + 0.5 * self._period_s
        (identity, orientation), *others = candidate.hypotheses
        sound = np.ones(weights.shape)
        return Detection(identity, start_s, fit, time_s, fit.score, regularity, sound, orientation, tuple(others))

    def _is_lit_within(self, frames: Sequence[Frame], fit: Fit) -> bool:
        """Return True if the frames within the header show the array evenly lit."""
        self.budget.charge_fits()
        window, thresholds = window_around(fit.pose, self._side, FIT.margin_px), self._thresholds
        cutouts = [cut_out(frame, window) for frame in frames[1:-1]]
        image = np.asarray(np.mean(cutouts, axis=0, dtype=np.float32))
        light = np.sort(measure_cells(image, window[:2], fit.pose, np.ones((self._side, self._side))))
        low, high = light[thresholds.ignored_cells], light[-1 - thresholds.ignored_cells]
        is_even = high - low <= thresholds.max_light_difference * fit.gain
        return bool(low >= thresholds.min_light * fit.gain and is_even)
