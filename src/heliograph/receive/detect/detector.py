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
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import cv2
import numpy as np

from heliograph.base.arrays import TINY, Floats
from heliograph.base.frames import Frame
from heliograph.receive.detect import alternation
from heliograph.receive.detect.alternation import DETECT, Blocks, Change, SearchParameters, SearchRegion, alternation_of
from heliograph.receive.detect.budget import FIT_WORK, NoveltyFilter, TokenBucket
from heliograph.receive.detect.candidate import (
    are_disjoint,
    cell_weights,
    estimate_drift,
    find_window,
    fit_first_pair,
    fit_header,
    fit_moving,
    fit_near,
    is_tracked,
    measure_cells,
)
from heliograph.receive.detect.detection import ALL_ON, Detection, Headers, Hypothesis, distinct, headers
from heliograph.receive.detect.frame_window import FrameWindow, fill_missing, find_header_start, header_frames
from heliograph.receive.detect.kernels import BLOCK_PX
from heliograph.receive.geometry.fit import Fit, header_amplitudes
from heliograph.receive.geometry.pose import ORIENTATIONS, UPRIGHT, Orientation, Pose
from heliograph.receive.geometry.window import CombinedFrame, common, cut_out, window_around
from heliograph.signal.header import IDENTITIES
from heliograph.signal.settings import SignalSettings


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
    # Alternation around the candidate
    change: CombinedFrame


class Detector:
    """Detector of headers on a level of a pyramid, in step with the light."""

    def __init__(self, parameters: SearchParameters, signal: SignalSettings, budget: TokenBucket):
        self.parameters, self.budget, self.side = parameters, budget, signal.side
        self.period_s, self.header_length = signal.pattern_period_s, 2 * signal.header_pairs
        self.sides = parameters.sides()
        # a lit square may belong to anything, a tilted one all the more; corners are off by some px, which is a tilt
        tilted = (parameters.impaired and not parameters.all_on) or parameters.start is not None
        self._tilts = (DETECT.upright_sigma, DETECT.tilted_sigma) if tilted else (DETECT.upright_sigma,)
        # the search for turned headers follows if no upright header is clear: an array in poor sight may resemble both
        turned = headers(ORIENTATIONS[1:])
        self.banks = [ALL_ON] if parameters.all_on else [headers((UPRIGHT,), ORIENTATIONS[1:]), turned]
        # blocks, row and column on the sensor, at which coarse searches broke off, by headers, roll and region
        self._begins = dict[tuple[int, float, int], tuple[int, int]]()

    def set_orientation(self, orientation: Orientation) -> None:
        """Search for a single orientation from now on; see `HeaderSearch`."""
        if not self.parameters.all_on:
            self.banks = [headers((orientation,))]

    def busy_blocks(self, means: Change, frame: Frame, tracked: Sequence[Pose]) -> Blocks:
        """Find the busy blocks outside tracked arrays."""
        parameters = self.parameters
        return alternation.busy_blocks(means, frame, tracked, self.side, parameters.min_contrast, parameters.everywhere)

    def block_means(self, slots: FrameWindow) -> Change | None:
        """Compute the mean alternation of blocks; None if frames are missing or too small."""
        header = header_frames(slots, self.header_length)
        if header is None or min(header[0].pixels.shape) < self.sides[0]:
            return None
        return alternation.alternation_means(header)

    def regions(self, slots: FrameWindow, busy: Blocks, max_side_px: float) -> list[SearchRegion]:
        """Return the alternation about busy blocks."""
        header = header_frames(slots, self.header_length)
        if not header or not busy.any():
            return []
        return alternation.search_regions(header, busy, max_side_px, alternation_of)

    def search(self, slots: FrameWindow, busy: Blocks, tracked: Sequence[Pose], with_turned: bool) -> list[Detection]:
        """Search busy blocks for headers: upright, then turned, then rolled, until an array is clear."""
        regions = self.regions(slots, busy, self.sides[-1])
        if not regions:
            return []
        banks = self.banks if with_turned else self.banks[:1]
        stages: list[tuple[Headers, tuple[float, ...]]] = [(bank, (0.0,)) for bank in banks]
        if with_turned and not self.parameters.all_on and self.parameters.start is None:
            # a turned header rolled one way is another turned header rolled the other way
            rolls = self.parameters.rolls_deg
            one_way = tuple(roll for roll in rolls if roll > 0)
            stages += [(bank, rolls if len(bank.cells) == IDENTITIES else one_way) for bank in banks]
        detections = list[Detection]()
        for k, (bank, rolls_deg) in enumerate(stages):
            is_rolled = k >= len(banks)
            if is_rolled and not self.budget.is_high:
                break
            candidates, has_compared = self.find_candidates(regions, bank, rolls_deg)
            if is_rolled:
                # of so many rolls clutter resembles some header
                candidates = [candidate for candidate in candidates if abs(candidate.score) >= 0.6]
            fitted = list[Detection]()
            for candidate in candidates:
                # of overlapping arrays the less clear is dropped
                known = [found.fit.pose for found in (*detections, *fitted) if found.is_clear]
                is_free = all(are_disjoint(candidate.start, pose, self.side) for pose in known)
                if is_free and self.budget.try_fit(candidate.score):
                    fitted += self._refine(slots, candidate, tracked)
            # an upright array in a skipped block may look like a turned array partly hidden, and an apparent upright
            # array partly hidden may be a clear turned array; of so many rolls clutter resembles some header
            is_doubtful = is_rolled or bool(detections) or (k > 0 and self.budget.is_low)
            fitted = [found for found in fitted if found.is_clear or not is_doubtful]
            detections = distinct([*detections, *fitted], self.side)
            if (detections and all(found.is_clear for found in detections)) or not has_compared:
                break
        # another level searches for arrays of another size
        return [found for found in detections if self.parameters.is_in_size_range(found.fit.pose, self.side)]

    def find_candidates(
        self, regions: Sequence[SearchRegion], bank: Headers, rolls_deg: Sequence[float] = (0.0,)
    ) -> tuple[list[Candidate], bool]:
        """Return the best candidates of some rolls, or of a given pose; and True if any place was compared."""
        parameters, given = self.parameters, self.parameters.start
        candidates, has_compared = list[Candidate](), False
        for roll in np.radians(rolls_deg).tolist():
            start = replace(given, blur=parameters.blur_px) if given else Pose(0.0, 0.0, 1.0, roll, parameters.blur_px)
            found, has_now = self._coarse_search(regions, bank, start)
            candidates, has_compared = candidates + found, has_compared or has_now
        candidates.sort(key=lambda candidate: -abs(candidate.score))
        candidates = candidates[: parameters.candidates]
        if given:
            candidates += filter(None, (self._given_candidate(change, bank, given) for change, _ in regions))
        return candidates, has_compared

    def _coarse_search(
        self, regions: Sequence[SearchRegion], bank: Headers, start: Pose
    ) -> tuple[list[Candidate], bool]:
        """Search regions, drawn as if arrays with the axes of a pose were upright, within the budget.

        A search that breaks off goes on from there in the next search. Returns also True if any place was compared
        with the headers.
        """
        candidates, has_compared, left = list[Candidate](), False, self.budget.coarse_work
        max_imbalance = DETECT.max_imbalance if self.budget.is_scarce else 2.0
        for k, region in enumerate(regions):
            change, busy, map_ = _draw_upright(*region, start.axes / start.pitch)
            # the user chose the size of a given place, so the budget does not apply
            max_work = 1 << 60 if self.parameters.everywhere else left / (len(regions) - k)
            if max_work <= 0:
                self.budget.skip(blocks=int(np.count_nonzero(busy)))
                continue
            if self.parameters.start is not None:
                busy = np.ones_like(busy)
            key, (x, y) = (len(bank.cells), start.roll, k), change.origin
            columns, down, across = busy.shape[1], y // BLOCK_PX, x // BLOCK_PX
            row, column = self._begins.pop(key, (down, across))
            begin = ((row - down) * columns + column - across) % busy.size
            best, places, passed, compared = alternation.coarse_search(
                change, busy, self.parameters, bank.cells, self.sides, bank.min_distance, begin, max_work, max_imbalance
            )
            # a pixel costs less than a place
            work = places + 0.4 * change.pixels.size
            self.budget.charge(work)
            left -= work
            if passed < busy.size:
                skipped = (begin + np.arange(passed, busy.size)) % busy.size
                self.budget.skip(blocks=int(np.count_nonzero(busy.flat[skipped])))
                self._begins[key] = int(skipped[0]) // columns + down, int(skipped[0]) % columns + across
            has_compared |= compared > 0 or passed < busy.size
            for score, across_px, down_px, width, number in best.tolist():
                x, y = (map_ @ [across_px - 0.5, down_px - 0.5, 1.0]).tolist()
                pose, n = replace(start, x=x, y=y, pitch=width / self.side), int(number)
                candidates.append(Candidate(pose, score, bank.cells[n], bank.hypotheses[n], region[0]))
        return candidates, has_compared

    def _given_candidate(self, change: CombinedFrame, bank: Headers, given: Pose) -> Candidate | None:
        """Return a given pose with the most similar header."""
        pixels, origin, side = change.pixels, change.origin, self.side
        is_searched = self.sides[0] <= side * given.pitch <= self.sides[-1]
        if not is_searched or find_window(pixels, origin, given, side) is None:
            return None
        light = measure_cells(pixels, origin, given, np.ones((side, side)))
        # each header has 16 cells of +-1
        scores = bank.cells @ light / max(4 * float(np.linalg.norm(light)), TINY)
        best = int(np.argmax(np.abs(scores)))
        start = replace(given, blur=self.parameters.blur_px)
        return Candidate(start, float(scores[best]), bank.cells[best], bank.hypotheses[best], change)

    def fit(self, candidate: Candidate, start: Pose, tilt: float, blur: float = 0.0) -> Fit | None:
        """Fit a candidate from a pose to the alternation."""
        weights = math.copysign(1.0, candidate.score) * cell_weights(candidate.cells, self.side)
        self.budget.charge(FIT_WORK)
        return fit_near(candidate.change.pixels, candidate.change.origin, start, weights, tilt, blur)

    def _refine(self, slots: FrameWindow, candidate: Candidate, tracked: Sequence[Pose]) -> list[Detection]:
        """Fit a candidate upright and, if in doubt, tilted; return at most one detection."""
        parameters = self.parameters
        if is_tracked(candidate.start, tracked, self.side):
            return []
        weights = cell_weights(candidate.cells, self.side)
        best, min_score = None, 0.55
        for tilt in self._tilts:
            rough = self.fit(candidate, candidate.start, tilt, DETECT.hiding_blur)
            if rough is None or rough.score < min_score:
                break
            if tilt == DETECT.upright_sigma and self.budget.is_low and rough.score < 0.7:
                self.budget.skip(candidates=1)
                break
            min_score = parameters.coarse_score
            pose = replace(rough.pose, blur=parameters.blur_px)
            if candidate.start.roll and parameters.start is None:
                # the roll is up to 12 degrees off
                for _ in range(4):
                    rolled = self.fit(candidate, pose, tilt, DETECT.hiding_blur)
                    if rolled is None:
                        break
                    pose = replace(rolled.pose, blur=pose.blur)
            begun = find_header_start(slots, pose, weights, self.header_length)
            if begun is None:
                # at any tilt
                break
            found = self._detect(slots, candidate, begun, pose, tilt)
            # an upright array with a hidden side looks a little tilted
            if found is not None and (best is None or found.score > best.score + 0.03):
                best = found
            if best is not None and best.score >= DETECT.clear_score:
                break
        return [] if best is None else [best]

    def _detect(
        self, slots: FrameWindow, candidate: Candidate, begun: tuple[int, float], pose: Pose, tilt: float
    ) -> Detection | None:
        """Fit the frames of a header; None if they show no convincing array."""
        parameters, (start, regularity), weights = self.parameters, begun, cell_weights(candidate.cells, self.side)
        frames = slots[start : start + self.header_length]
        header = fill_missing(frames[:4])
        if header is None:
            return None
        # a copy for a missing frame alternates by itself: a pair of data must not pass for a half hidden header; light
        # of data looks like a tilt
        is_whole, is_mixed = None not in frames, regularity < 0.65
        if regularity < (parameters.regularity if is_whole else DETECT.min_hidden_regularity):
            return None
        if is_mixed and tilt == DETECT.upright_sigma:
            pose, tilt = replace(pose, stretch=0.0, shear=0.0), DETECT.level_sigma
        self.budget.charge(FIT_WORK)
        is_even = parameters.impaired and is_whole and regularity >= DETECT.min_hidden_regularity
        fit, led_gains, is_level = fit_header(header, pose, weights, tilt, parameters.score, is_even)
        if fit is None or not parameters.is_plausible(fit, header[0].full_scale):
            return None
        fitted_tilt = math.hypot(fit.pose.stretch, fit.pose.shear)
        if is_mixed and tilt > DETECT.upright_sigma and fitted_tilt < 0.05:
            return None
        # a thin post hides up to 36 %
        min_score = 0.8 if is_level and led_gains.all() else parameters.score
        if fit.score < (min_score if is_whole else DETECT.clear_score):
            return None
        is_in_range = parameters.is_in_size_range(fit.pose, self.side)
        if not is_in_range and fit.score < DETECT.clear_score:
            return None
        first, frame = next((k, frame) for k, frame in enumerate(frames) if frame is not None)
        start_s, time_s = frame.time_s - first * self.period_s, 0.5 * (header[0].time_s + header[-1].time_s)
        (identity, orientation), *others = candidate.hypotheses
        found = Detection(identity, start_s, fit, time_s, fit.score, regularity, led_gains, orientation, tuple(others))
        if not is_in_range:
            return found
        tilt = DETECT.level_sigma if is_level else tilt
        if None not in frames[:2] and parameters.impaired and len(header) > 2:
            fit, header = fit_first_pair(header, fit, led_gains * weights, tilt)
        # the drift is fitted too, and the header with the smear
        self.budget.charge(2 * FIT_WORK)
        time_s = 0.5 * (header[0].time_s + header[-1].time_s)
        present = [frame for frame in frames if frame is not None]
        drift = estimate_drift(present, fit.pose, time_s, led_gains * weights, self.period_s)
        fit = fit_moving(header, fit, led_gains * weights, tilt, (drift[0] * self.period_s, drift[1] * self.period_s))
        return replace(found, fit=fit, time_s=time_s, score=fit.score, drift=drift)


def _draw_upright(change: CombinedFrame, busy: Blocks, turn: Floats) -> tuple[CombinedFrame, Blocks, Floats]:
    """Draw a region with arrays of the axes `turn` (2, 2) upright; return the map (2, 3) to the sensor too."""
    if np.array_equal(turn, np.eye(2)):
        return change, busy, np.column_stack([turn, change.origin])
    rows, columns = change.pixels.shape
    # about the middles of both
    size = [math.ceil(n) for n in np.abs(np.linalg.inv(turn)) @ [columns, rows]]
    middle, drawn_middle = np.array([columns - 1, rows - 1]) / 2, (np.array(size) - 1) / 2
    map_ = np.column_stack([turn, middle - turn @ drawn_middle])
    drawn = cv2.warpAffine(change.pixels, map_, size, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
    down, across = np.indices((-(-size[1] // BLOCK_PX), -(-size[0] // BLOCK_PX))) * BLOCK_PX + (BLOCK_PX - 1) / 2
    x, y = np.tensordot(map_, [across, down, np.ones_like(across)], 1) // BLOCK_PX
    is_within = (x >= 0) & (y >= 0) & (x < busy.shape[1]) & (y < busy.shape[0])
    drawn_busy = is_within & busy[np.where(is_within, y, 0).astype(int), np.where(is_within, x, 0).astype(int)]
    on_sensor = map_ + np.column_stack([np.zeros((2, 2)), change.origin])
    return replace(change, pixels=np.asarray(drawn, np.float32), origin=(0, 0)), drawn_busy, on_sensor


class HalfPeriodDetector:
    """Detector of headers half a pattern out of step, in a stream of one frame per pattern.

    The fits, the headers and the budget are those of a detector in step; turned headers are searched for once the
    orientation is known.
    """

    def __init__(self, detector: Detector, min_novelty: float = 1.3):
        self._detector = detector
        # data alternate up to 1.3 times the mean, headers 1.8 times on average; blocks of data are often quiet
        self._baselines = [NoveltyFilter(min_novelty, min_novelty, window=3, repeats=False) for _ in range(2)]
        self._frames: deque[Frame] = deque(maxlen=detector.header_length + 1)

    def search(self, frame: Frame, tracked: Sequence[Pose] = ()) -> list[Detection]:
        """Search with the next frame; see `HeaderSearch`."""
        detector, length = self._detector, self._detector.header_length
        if self._frames and frame.index != self._frames[-1].index + 1:
            self._frames.clear()
        self._frames.append(frame)
        if len(self._frames) <= length:
            return []
        frames = common(list(self._frames))
        if min(frames[0].pixels.shape) < detector.sides[0]:
            return []
        # 2 (r_0 - w r_1 + w r_(N-1) - r_N), w = N / (N - 2): the header less the inverse, with levels of +-1/2
        ends, weight = [frames[k] for k in (0, 1, -2, -1)], 2 * length / (length - 2)
        weights = (2.0, -weight, weight, -2.0)
        means = alternation.alternation_means(ends, weights)
        busy = eligible = detector.busy_blocks(means, frames[0], tracked)
        if busy.any():
            # the change within a header is quiet: data reach 1, noise 0.45; the means are twice the change
            eligible = busy & (alternation.alternation_means(frames[1:3]) < 0.15 * means)
        chosen = detector.budget.start_search(self._baselines[frames[0].index % 2], means, busy, frames[0], eligible)
        if not chosen.any():
            return []
        combine = partial(alternation_of, weights=weights)
        regions = alternation.search_regions(ends, chosen, detector.sides[-1], combine)
        candidates, _ = detector.find_candidates(regions, detector.banks[0])
        detections = [
            self._detect(frames, candidate)
            for candidate in candidates
            if candidate.score > 0
            and detector.budget.try_fit()
            and not is_tracked(candidate.start, tracked, detector.side)
        ]
        return distinct([found for found in detections if found is not None], detector.side)

    def _detect(self, frames: Sequence[Frame], candidate: Candidate) -> Detection | None:
        """Fit a candidate as level, as the light of data looks like a tilt; None if it is not convincing."""
        parameters, side = self._detector.parameters, self._detector.side
        fit = self._detector.fit(candidate, candidate.start, DETECT.level_sigma)
        # the light of data takes a part of the correlation
        if fit is None or fit.score < 0.78 * parameters.score:
            return None
        if not parameters.is_plausible(fit, frames[0].full_scale) or not parameters.is_in_size_range(fit.pose, side):
            return None
        weights = cell_weights(candidate.cells, side)
        # amplitudes over the beginning and the end, less the mean within
        amplitudes = header_amplitudes(frames, fit.pose, weights)
        ends = np.array([1, -1]) * (amplitudes[[0, -1]] - amplitudes[1:-1].mean())
        regularity = float(ends.min() / ends.mean()) if ends.mean() > 0 else 0.0
        if regularity < parameters.regularity or not self._is_lit_within(frames, fit):
            return None
        start_s = frames[0].time_s + 0.5 * self._detector.period_s
        time_s, sound = 0.5 * (frames[0].time_s + frames[-1].time_s), np.ones(weights.shape)
        (identity, orientation), *others = candidate.hypotheses
        return Detection(identity, start_s, fit, time_s, fit.score, regularity, sound, orientation, tuple(others))

    def _is_lit_within(self, frames: Sequence[Frame], fit: Fit) -> bool:
        """Return True if the frames within the header show the array evenly lit: lamps are dark there."""
        self._detector.budget.charge(FIT_WORK)
        side = self._detector.side
        window = window_around(fit.pose, side, DETECT.margin_px)
        image = np.asarray(np.mean([cut_out(frame, window) for frame in frames[1:-1]], axis=0, dtype=np.float32))
        light = np.sort(measure_cells(image, window[:2], fit.pose, np.ones((side, side))))
        # each LED is lit for half of such a frame; three cells at either end are ignored
        low, high = light[3], light[-4]
        return bool(low >= 0.3 * fit.gain and high - low <= 0.5 * fit.gain)
