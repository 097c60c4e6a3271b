"""Detection: arrays found by the header that only they show.

The header and its inverse alternate, so four frames in a row combined as r_0 - 3 r_1 + 3 r_2 - r_3 keep the header and
cancel what stands still, drifts or accelerates evenly. The result is correlated with the M-sequences of all identities
over scale and position. The best candidates are fitted to a fraction of a pixel, and must alternate in step from frame
to frame.

Headers of a camera as fast as the light whose exposures straddle two patterns each.

Half a pattern out of step a frame shows half of a pattern and half of the next. Within a header of N patterns that is
the same light from every LED: nothing alternates, and `detector` finds nothing. But the frame over its beginning shows
half of the header, and the frame over its end half of the inverse. With w = N / (N - 2),

    2 (r_0 - w r_1 + w r_(N-1) - r_N)

is the header less its inverse, and light of the data before and after, which is random. What stands still, drifts or
accelerates evenly cancels. The frames between are quiet, as those of data never are.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.receive.detect.alternation import (
    DIFFERENCE,
    SearchParameters,
    SearchRegion,
    alternation_means,
    alternation_of,
    busy_blocks,
    combined,
    combined_means,
    search_regions,
)
from heliograph.receive.detect.budget import (
    FIT_WORK,
    LITTLE_SCORE,
    Budget,
    BudgetedSearch,
    NoveltyFilter,
    RunningBaseline,
    SearchLoad,
)
from heliograph.receive.detect.candidate import (
    CANDIDATE_MARGIN_PX,
    CLEAR,
    HIDING_BLUR,
    LEVEL_SPREAD,
    TILTED_SPREAD,
    UPRIGHT_SPREAD,
    apart,
    cell_light,
    cell_weights,
    drift_of,
    fit_first_pair,
    fit_header,
    fit_moving,
    fit_near,
    followed,
    is_in_size_range,
    plausible,
)
from heliograph.receive.detect.detection import HIDDEN_REGULARITY, Detection, distinct
from heliograph.receive.detect.frame_window import (
    FrameWindow,
    FrameWindowBuffer,
    SearchJob,
    alike,
    filled,
    find_header_start,
    first_present,
)
from heliograph.receive.detect.header_bank import ALL_ON, Headers, Hypothesis, headers
from heliograph.receive.detect.region import Candidate, candidates_of
from heliograph.receive.geometry.fit import Fit, header_amplitudes
from heliograph.receive.geometry.pose import ORIENTATIONS, UPRIGHT, Orientation, Pose
from heliograph.receive.geometry.window import common, cut_out, window_around
from heliograph.signal.header import IDENTITIES
from heliograph.signal.settings import SignalSettings

GAINED = 0.03
"""How much better a tilted candidate must be: an upright array with a hidden side looks a little tilted.

Scores are correlations: 0.03 more than 0.9 are 2 * 0.9 * 0.03 = 5 % of the pixels' power. Half and twice of it lose
none of 192 codewords.
"""

HIDDEN_SCORE = 0.8
"""Least score of an array before which a thin post is.

With the fraction f hidden the whole header correlates by sqrt(1 - f), so 0.8 is reached with 36 % hidden: about as much
as may be hidden of cells (`HIDDEN` of `header_fit`). Its cost was not measured.
"""

MIXED = 0.65
"""Regularity below which a header is mixed with light of data, which looks like a tilt: it is fitted as level.

A camera x T_b out of step sees |1 - 2 x| of the header within, and a part of the data before it: at 0.44 T_b the
regularity is 0.62. At 0.47 T_b headers are too weak to put the tilt right later. Of an upright array a shear of 0.03
stayed, and all codewords of the middle and low layers were lost at 80 m.
"""

LEAST_TURN = 0.05
"""Least tilt that a mixed header shows: that of 25 degrees of yaw. Data light made up to 0.039 of an upright array."""

WORTH = 0.55
"""Least score of a candidate's first fit, as of an upright array, for more fits.

In 550 films of random places, tilts, phases and rates, of arrays partly hidden or dead too, 771 candidates became
detections and 21,325 did not. None and 51 % of them had less; 0.6 would refuse 2 and 70 %, 0.7 would refuse 5 and 91 %.
"""

ROLLED_FITS = 4
"""Fits in a row of a rolled candidate: its roll is up to 12 degrees off, and each fit moves it by some degrees."""

SHORT_WORTH = 0.7
"""The same where searches have used up more than half of what they may cost."""


class Detector:
    """Looks for headers in a stream of one frame per pattern."""

    def __init__(self, parameters: SearchParameters, signal: SignalSettings, budget: Budget | None = None):
        self._parameters, self._side = parameters, signal.side
        self.budget, self._earns = budget or Budget(parameters.cpu_share, signal.pattern_period_s), budget is None
        # a lit square may be anything's; a tilted one all the more
        tilted = parameters.impaired and not parameters.all_on
        # corners by hand are off by some px, which is a tilt of a far array
        tilted |= parameters.start is not None
        self._tilts = (UPRIGHT_SPREAD, TILTED_SPREAD) if tilted else (UPRIGHT_SPREAD,)
        self._header = 2 * signal.header_pairs
        self._period_s = signal.pattern_period_s
        self._sides = parameters.sides()
        # turned headers are looked for where there is no upright one: an array that is hard to see might be either
        turned = headers(ORIENTATIONS[1:])
        sought = (ALL_ON,) if parameters.all_on else (headers((UPRIGHT,), ORIENTATIONS[1:]), turned)
        self._coarse = tuple(BudgetedSearch(parameters, one, self.budget) for one in sought)
        self._rolled = self._at_rolls(sought)
        # data look otherwise to a search that begins with an inverse
        self._usual = tuple(NoveltyFilter(signal.modulation, signal.packet_patterns / 2) for _ in range(2))
        self._span = min(self._header, 4)
        self._frames = FrameWindowBuffer(self._header, self._span, signal.packet_patterns)

    def start(self, period_s: float) -> None:
        """Begin; the frames are taken to come one per pattern, whatever the period; see `HeaderSearch`."""

    def settle(self, orientation: Orientation) -> None:
        """Look for one orientation alone from now on; see `HeaderSearch`."""
        if not self._parameters.all_on:
            self._coarse = (BudgetedSearch(self._parameters, headers((orientation,)), self.budget),)
            self._rolled = self._at_rolls((headers((orientation,)),))

    @property
    def load(self) -> SearchLoad:
        """What the searches did and left out so far."""
        return self.budget.load

    @property
    def recent(self) -> Sequence[Frame]:
        """The last frames, oldest first: enough to hold the header of an array just found."""
        return self._frames.there

    def push(self, frame: Frame, taken: Sequence[Pose] = ()) -> list[Detection]:
        """Take the next frame; see `HeaderSearch`."""
        found = list[Detection]()
        for due in self.due(frame):
            change, known = self.change(due.slots), [*taken, *(one.fit.pose for one in found)]
            if change is None:
                continue
            busy, strikes = self.select_blocks(due.slots, change, self.busy(due.slots, change, known))
            if self.budget.begins(busy, strikes):
                found += self.search(due.slots, busy, known, due.turned)
        return found

    def due(self, frame: Frame) -> list[SearchJob]:
        """Take the next frame; give the last ones as often as they are to be searched now."""
        if self._earns:
            self.budget.earn()
        return self._frames.push(frame)

    def change(self, slots: FrameWindow) -> NDArray[np.float32] | None:
        """How much alternates in frames to be searched."""
        header = self._frames.header_of(slots)
        if header is None or min(header[0].pixels.shape) < self._sides[0]:
            return None
        return alternation_means(header)

    def busy(self, slots: FrameWindow, change: NDArray[np.float32], taken: Sequence[Pose]) -> NDArray[np.bool_]:
        """Where something alternates beside the arrays followed, (blocks down, blocks across)."""
        first = first_present(slots)
        parameters = self._parameters
        return busy_blocks(change, first, taken, self._side, parameters.min_contrast, parameters.everywhere)

    def select_blocks(
        self, slots: FrameWindow, change: NDArray[np.float32], busy: NDArray[np.bool_]
    ) -> tuple[NDArray[np.bool_], bool]:
        """Busy blocks but those that are left out to save time; to be asked once for frames."""
        if not self.budget.bounded:
            return busy, False
        first = first_present(slots)
        usual = self._usual[first.index % 2]
        if not busy.any():
            usual.record_quiet()
            return busy, False
        novel_blocks, strikes, novelty, waits = usual.novel_blocks(change, first.origin, self.budget.scarcity)
        searched = self.budget.choose(busy, novel_blocks, novelty, waits)
        usual.searched(searched)
        return searched, bool((searched & strikes).any())

    def parts(self, turned: bool) -> int:
        """Coarse searches of frames."""
        return len(self._coarse) if turned else 1

    def alternating(self, slots: FrameWindow, busy: NDArray[np.bool_], around_px: float) -> list[NDArray[np.float32]]:
        """What alternates in frames that are due, where it does."""
        header = self._frames.header_of(slots)
        return [one.change for one in search_regions(header, busy, around_px, alternation_of)] if header else []

    def search(
        self, slots: FrameWindow, busy: NDArray[np.bool_], taken: Sequence[Pose], turned: bool
    ) -> list[Detection]:
        """Look for headers in frames."""
        header = self._frames.header_of(slots)
        if header is None or not busy.any():
            return []
        parts = search_regions(header, busy, self._sides[-1], alternation_of)
        found = list[Detection]()
        stages = [[(coarse, 0.0)] for coarse in self._coarse[: self.parts(turned)]]
        for k, searches in enumerate([*stages, *(self._rolled if turned else ())]):
            rolled = k >= len(stages)
            if rolled and not self.budget.ample:
                break
            fitted = list[Detection]()
            for one, part, sought in self._candidates(parts, searches):
                # what overlaps an array in clear sight would be left out as the less clear one
                fits = all(not d.clear or apart(one.start, d.fit.pose, self._side) for d in [*found, *fitted])
                if not fits:
                    continue
                if self.budget.fit(one.score):
                    fitted += self._refine(slots, part, one, sought, taken)
            if k and self.budget.short:
                # an upright one may lie in blocks that were left out, and look like a turned one partly hidden
                fitted = [one for one in fitted if one.clear]
            # what seems an upright array partly hidden may be a turned one in clear sight
            # and a rolled one must be in clear sight, as clutter has so many rolls to resemble a header
            fitted = [d for d in fitted if d.clear or not (found or rolled)]
            found = distinct([*found, *fitted], self._side)
            compared = any(coarse.compared for coarse, _ in searches)
            if (found and all(one.clear for one in found)) or not compared:
                break
        sized = [one for one in found if is_in_size_range(one.fit, self._parameters, self._side)]
        if len(sized) < len(found):
            # one in clear sight that is none of these sizes is looked for on another level
            self.budget.expect()
        return sized

    def _candidates(
        self, parts: Sequence[SearchRegion], searches: Sequence[tuple[BudgetedSearch, float]]
    ) -> list[tuple[Candidate, SearchRegion, Headers]]:
        """The best candidates of several searches, each with its part and the headers that it may be."""
        found = [
            (one, part, coarse.headers)
            for coarse, roll in searches
            for one, part in candidates_of(parts, coarse, self._side, roll)
        ]
        if len(searches) == 1:
            return found
        # clutter has so many rolls to resemble a header
        found = [one for one in found if abs(one[0].score) >= LITTLE_SCORE]
        return sorted(found, key=lambda one: -abs(one[0].score))[: self._parameters.candidates]

    def _at_rolls(self, sought: Sequence[Headers]) -> list[list[tuple[BudgetedSearch, float]]]:
        """Searches for rolled arrays, each with its roll in rad; none of a pose that was given or of squares."""
        parameters = self._parameters
        if parameters.all_on or parameters.start is not None:
            return []
        # a turned header that is rolled one way is another turned one, rolled the other way
        return [
            [
                (BudgetedSearch(parameters, one, self.budget), math.radians(roll))
                for roll in parameters.rolls_deg
                if roll > 0 or len(one.cells) == IDENTITIES
            ]
            for one in sought
        ]

    def _refine(
        self,
        slots: FrameWindow,
        part: SearchRegion,
        candidate: Candidate,
        searched: Headers,
        taken: Sequence[Pose],
    ) -> list[Detection]:
        """Fit a candidate, ask when its header began and whether it alternates in step; one array or none."""
        start, number, score = candidate
        weights, blur = cell_weights(searched.cells[number], self._side), self._parameters.blur_px
        if followed(start, taken, self._side):
            return []
        best, least = None, WORTH
        for tilt in self._tilts:
            self.budget.spend(FIT_WORK)
            rough = fit_near(
                part.change, part.first.origin, start, math.copysign(1.0, score) * weights, tilt, HIDING_BLUR
            )
            if rough is None or rough.score < least:
                break
            if tilt == UPRIGHT_SPREAD and self.budget.short and rough.score < SHORT_WORTH:
                self.budget.drop()
                break
            least = self._parameters.coarse_score
            pose = replace(rough.pose, blur=blur)
            if start.roll and self._parameters.start is None:
                pose = self._rolled_pose(part, pose, math.copysign(1.0, score) * weights, tilt)
            begun = find_header_start(slots, pose, weights, self._header)
            if begun is None:
                # whatever its tilt
                break
            found = self._fitted(slots, begun, pose, weights, searched.hypotheses[number], tilt)
            if found is not None and (best is None or found.score > best.score + GAINED):
                best = found
            if best is not None and best.score >= CLEAR:
                break
        return [] if best is None else [best]

    def _rolled_pose(self, part: SearchRegion, pose: Pose, weights: NDArray[np.float64], tilt: float) -> Pose:
        """Pose of a rolled candidate, by fits that each start from the last one."""
        for _ in range(ROLLED_FITS):
            self.budget.spend(FIT_WORK)
            fit = fit_near(part.change, part.first.origin, pose, weights, tilt, HIDING_BLUR)
            if fit is None:
                break
            pose = replace(fit.pose, blur=pose.blur)
        return pose

    def _fitted(
        self,
        slots: FrameWindow,
        begun: tuple[int, float],
        pose: Pose,
        weights: NDArray[np.float64],
        hypotheses: tuple[Hypothesis, ...],
        tilt: float,
    ) -> Detection | None:
        """The array in just the frames of a header; None where they show none that is convincing."""
        start, regularity = begun
        header, there = filled(slots[start : start + self._span]), slots[start : start + self._header]
        if header is None:
            return None
        # what is filled in alternates by itself: a pair of data must not pass for a header that is half hidden
        whole = None not in there
        if regularity < (self._parameters.regularity if whole else HIDDEN_REGULARITY):
            return None
        if regularity < MIXED and tilt == UPRIGHT_SPREAD:
            pose, tilt = replace(pose, stretch=0.0, shear=0.0), LEVEL_SPREAD
        self.budget.spend(FIT_WORK)
        even = self._parameters.impaired and whole and regularity >= HIDDEN_REGULARITY
        fit, led_gains, level = fit_header(header, pose, weights, tilt, self._parameters.score, even)
        least = HIDDEN_SCORE if level and led_gains.all() else self._parameters.score
        if fit is not None and tilt > UPRIGHT_SPREAD and regularity < MIXED and _tilt(fit.pose) < LEAST_TURN:
            return None
        if fit is None or not self._convincing(fit, least if whole else CLEAR, header[0].full_scale):
            return None
        start_s, middle = self._start_s(there), 0.5 * (header[0].time_s + header[-1].time_s)
        (number, seen_as), *others = hypotheses
        found = Detection(number, start_s, fit, middle, fit.score, regularity, led_gains, seen_as, tuple(others))
        if not is_in_size_range(fit, self._parameters, self._side):
            return found
        if None not in there[:2] and self._parameters.impaired and self._span > 2:
            fit, header = fit_first_pair(header, fit, led_gains * weights, LEVEL_SPREAD if level else tilt)
        # its drift is fitted too, and the header once more
        self.budget.spend(2 * FIT_WORK)
        middle = 0.5 * (header[0].time_s + header[-1].time_s)
        frames = [frame for frame in there if frame is not None]
        drift = drift_of(frames, fit.pose, middle, led_gains * weights, self._period_s)
        moved = drift[0] * self._period_s, drift[1] * self._period_s
        fit = fit_moving(header, fit, led_gains * weights, LEVEL_SPREAD if level else tilt, moved)
        return replace(found, fit=fit, time_s=middle, score=fit.score, drift=drift)

    def _start_s(self, header: FrameWindow) -> float:
        """Time of a header's first frame, by the first that is there."""
        first, frame = next((k, frame) for k, frame in enumerate(header) if frame is not None)
        return frame.time_s - first * self._period_s

    def _convincing(self, fit: Fit, least: float, full_scale: int) -> bool:
        sized = fit.score >= CLEAR or is_in_size_range(fit, self._parameters, self._side)
        return sized and plausible(fit, self._parameters, full_scale) and fit.score >= least


def _tilt(pose: Pose) -> float:
    """Stretch and shear together."""
    return math.hypot(pose.stretch, pose.shear)


QUIET = 0.3
"""Most that changes within a header, as a fraction of what changes over it.

A camera out of step by x T_b sees |1 - 2 x| of the header change within it. Of one header at each of 30, 50 and 90 m
`HalfPeriodDetector` found all where |1 - 2 x| was 0.2 or less, and `Detector` all, once each, from 0.12 on.
Frames of data change as much from one to the next as over N patterns. Of noise alone it would be 0.45 for N = 4.
"""

DATA_SCORE = 0.78
"""What the light of data leaves of the correlation with a header.

Of resolved LEDs it is 1 / sqrt(1 + 2 * 0.36 / 16 / 0.25) = 0.92: levels of data cut at 2 have the variance 0.36, and
two of them, 1/4 each, stand beside a header of +-1/2. Of far arrays the high layer alone is left of the data, and
weighs more: eight headers scored 0.85 to 0.86 at 25 m, 0.88 to 0.90 at 50 m, 0.86 at 100 m and 0.76 to 0.82 at 130 m.
"""


STRADDLED_SURGE, STRADDLED_BLOCKS = 1.3, 3
"""Least that changes over a header, in parts of what usually does over as many patterns of data; and the blocks of a
side over which that is asked.

Of patterns p, q and so on, 0 to 1, and two header pairs, what changes over them is q - p + s - t where the first frame
shows the end of an inverse, as that of a header does, and 2 (2 q - p - s) where it shows an inverse's beginning. So
each of the two is compared with its own. A header with data about it is 2 - p - q. In the mean that is 1.8 times what
changes over data of five even levels, 2.6 times of levels as the Haar transform has them, and 1.3 times of data that
are on or off. Of 200 headers that were found, 12 to 150 m away and 0.38 to 0.62 patterns out of step, the least had
1.38, and that 100 m away; of blocks of data that were quiet 3 to 13 % had 1.3. Data on or off were not measured: no
receiver reads them out of step.
"""


SHARE = 0.25
"""Share of the work of one search that a search half a pattern out of step may do, as it comes twice as often."""

LIT_WITHIN, UNEVEN_WITHIN, HIDDEN_CELLS = 0.3, 0.5, 3
"""Least light of a cell in the frames within a header and largest difference of two cells, relative to the light of the
array with all LEDs on; and the number of extreme cells ignored at either end. Each LED is lit for half of such a frame.
Lamps that change before and after are uneven within, and mostly dark."""


class HalfPeriodDetector:
    """Looks for headers whose frames straddle two patterns each, in a stream of one frame per pattern."""

    def __init__(self, parameters: SearchParameters, signal: SignalSettings, budget: Budget | None = None):
        self._parameters, self._side = parameters, signal.side
        self._light_s = signal.pattern_period_s
        self._header = 2 * signal.header_pairs
        self._sides = parameters.sides()
        # turned ones are looked for only once the camera is known to see them so
        upright = headers((UPRIGHT,), ORIENTATIONS[1:])
        self._budget, self._earns = budget or Budget(parameters.cpu_share, signal.pattern_period_s), budget is None
        self._coarse = BudgetedSearch(parameters, ALL_ON if parameters.all_on else upright, self._budget)
        self._usual = tuple(RunningBaseline(STRADDLED_BLOCKS, signal.packet_patterns / 2) for _ in range(2))
        self._frames: deque[Frame] = deque(maxlen=self._header + 1)

    @property
    def load(self) -> SearchLoad:
        """What the searches did and left out so far."""
        return self._budget.load

    def settle(self, orientation: Orientation) -> None:
        """Look for one orientation alone from now on; see `HeaderSearch`."""
        if not self._parameters.all_on:
            self._coarse = BudgetedSearch(self._parameters, headers((orientation,)), self._budget)

    def push(self, frame: Frame, taken: Sequence[Pose] = ()) -> list[Detection]:
        """Take the next frame; see `HeaderSearch`."""
        if self._earns:
            self._budget.earn()
        if self._frames and not (alike(self._frames[-1], frame) and frame.index == self._frames[-1].index + 1):
            self._frames.clear()
        self._frames.append(frame)
        if len(self._frames) <= self._header:
            return []
        frames = common(list(self._frames))
        if min(frames[0].pixels.shape) < self._sides[0]:
            return []
        # 2 (r_0 - w r_1 + w r_(N-1) - r_N), w = N / (N - 2): the header less its inverse, its levels being +-1/2
        ends, weight = [frames[k] for k in (0, 1, -2, -1)], 2 * self._header / (self._header - 2)
        weights = (2.0, -weight, weight, -2.0)
        means = combined_means(ends, weights)
        busy = busy_blocks(
            means, frames[0], taken, self._side, self._parameters.min_contrast, self._parameters.everywhere
        )
        usual = self._usual[frames[0].index % 2]
        if not busy.any():
            usual.record_quiet()
            return []
        within = combined_means([*frames[1:3], *frames[1:3]], DIFFERENCE)
        # the latter are of twice what changes
        quiet = within < 0.5 * QUIET * means
        if self._budget.bounded:
            now, _, early, waits = usual.novelty_of(means, frames[0].origin)
            busy = self._budget.choose(busy & quiet, (now > STRADDLED_SURGE) | early, now, waits, SHARE)
            usual.searched(busy)
        else:
            busy &= quiet
        if not self._budget.begins(busy, share=SHARE):
            return []
        parts = search_regions(ends, busy, self._sides[-1], lambda part: combined(part, weights))
        found = list[Detection | None]()
        for one, part in candidates_of(parts, self._coarse, self._side):
            if one.score > 0 and self._budget.fit():
                found.append(self._fit(frames, part, one, taken))
        return distinct([one for one in found if one is not None], self._side)

    def _fit(
        self,
        frames: Sequence[Frame],
        part: SearchRegion,
        candidate: Candidate,
        taken: Sequence[Pose],
    ) -> Detection | None:
        """Fit a candidate's pose; its start is that of the first frame and half a pattern."""
        (start, number, _), parameters, sought = candidate, self._parameters, self._coarse.headers
        weights = cell_weights(sought.cells[number], self._side)
        if followed(start, taken, self._side):
            return None
        self._budget.spend(FIT_WORK)
        fit = fit_near(part.change, part.first.origin, start, weights, LEVEL_SPREAD)
        if fit is None or fit.score < DATA_SCORE * parameters.score:
            return None
        if not (plausible(fit, parameters, frames[0].full_scale) and is_in_size_range(fit, parameters, self._side)):
            return None
        regularity = self._regularity(frames, fit, weights)
        if regularity < parameters.regularity or not self._lit_within(frames, fit):
            return None
        time_s = 0.5 * (frames[0].time_s + frames[-1].time_s)
        start_s = frames[0].time_s + 0.5 * self._light_s
        (identity, seen_as), *others = sought.hypotheses[number]
        sound = np.ones(weights.shape)
        return Detection(identity, start_s, fit, time_s, fit.score, regularity, sound, seen_as, tuple(others))

    def _lit_within(self, frames: Sequence[Frame], fit: Fit) -> bool:
        """True if the frames within the header show the array evenly lit."""
        self._budget.spend(FIT_WORK)
        window = window_around(fit.pose, self._side, CANDIDATE_MARGIN_PX)
        cutouts = [cut_out(frame, window) for frame in frames[1:-1]]
        seen = np.asarray(np.mean(cutouts, axis=0, dtype=np.float32))
        light = np.sort(cell_light(seen, window[:2], fit.pose, np.ones((self._side, self._side))))
        low, high = light[HIDDEN_CELLS], light[-1 - HIDDEN_CELLS]
        return bool(low >= LIT_WITHIN * fit.gain and high - low <= UNEVEN_WITHIN * fit.gain)

    def _regularity(self, frames: Sequence[Frame], fit: Fit, weights: NDArray[np.float64]) -> float:
        """Weaker over mean amplitude of the frames over the beginning and the end, about the mean of those within."""
        seen = header_amplitudes(frames, fit.pose, weights)
        ends = np.array([1, -1]) * (seen[[0, -1]] - seen[1:-1].mean())
        return float(ends.min() / ends.mean()) if ends.mean() > 0 else 0.0
