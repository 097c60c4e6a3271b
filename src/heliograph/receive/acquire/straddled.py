"""Headers of a camera as fast as the light whose exposures straddle two patterns each.

Half a pattern out of step a frame shows half of a pattern and half of the next. Within a header of N patterns that is
the same light from every LED: nothing alternates, and `detector` finds nothing. But the frame over its beginning shows
half of the header, and the frame over its end half of the inverse. With w = N / (N - 2),

    2 (r_0 - w r_1 + w r_(N-1) - r_N)

is the header less its inverse, and light of the data before and after, which is random. What stands still, drifts or
accelerates evenly cancels. The frames between are quiet, as those of data never are.
"""

from collections import deque
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.receive.acquire.budget import FIT_WORK, BoundedSearch, Budget, SearchLoad
from heliograph.receive.acquire.candidate import (
    CANDIDATE_MARGIN_PX,
    LEVEL_SPREAD,
    cell_light,
    cell_weights,
    fit_near,
    followed,
    of_size,
    plausible,
)
from heliograph.receive.acquire.coarse import (
    DIFFERENCE,
    SearchParameters,
    busy_blocks,
    combined,
    combined_means,
)
from heliograph.receive.acquire.detection import Detection, distinct
from heliograph.receive.acquire.given import Candidate, candidates_of
from heliograph.receive.acquire.hypotheses import ALL_ON, headers
from heliograph.receive.acquire.parts import SearchedPart, searched_parts
from heliograph.receive.acquire.slots import alike
from heliograph.receive.acquire.usual import Usual
from heliograph.receive.image.fit import Fit, header_amplitudes
from heliograph.receive.image.orientation import ORIENTATIONS, UPRIGHT, Orientation
from heliograph.receive.image.pose import Pose
from heliograph.receive.image.window import common, cut_out, window_around
from heliograph.signal.settings import SignalSettings

QUIET = 0.3
"""Most that changes within a header, as a fraction of what changes over it.

A camera out of step by x T_b sees |1 - 2 x| of the header change within it. Of one header at each of 30, 50 and 90 m
`StraddledDetector` found all where |1 - 2 x| was 0.2 or less, and `Detector` all, once each, where it was 0.12 or more.
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


class StraddledDetector:
    """Looks for headers whose frames straddle two patterns each, in a stream of one frame per pattern."""

    def __init__(self, parameters: SearchParameters, signal: SignalSettings, budget: Budget | None = None):
        self._parameters, self._side = parameters, signal.side
        self._light_s = signal.pattern_period_s
        self._header = 2 * signal.header_pairs
        self._sides = parameters.sides()
        # turned ones are looked for only once the camera is known to see them so
        upright = headers((UPRIGHT,), ORIENTATIONS[1:])
        self._budget, self._earns = budget or Budget(parameters.busy_part, signal.pattern_period_s), budget is None
        self._coarse = BoundedSearch(parameters, ALL_ON if parameters.all_on else upright, self._budget)
        self._usual = tuple(Usual(STRADDLED_BLOCKS, signal.packet_patterns / 2) for _ in range(2))
        self._frames: deque[Frame] = deque(maxlen=self._header + 1)

    @property
    def load(self) -> SearchLoad:
        """What the searches did and left out so far."""
        return self._budget.load

    def settle(self, orientation: Orientation) -> None:
        """Look for one orientation alone from now on; see `HeaderSearch`."""
        if not self._parameters.all_on:
            self._coarse = BoundedSearch(self._parameters, headers((orientation,)), self._budget)

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
            usual.calm()
            return []
        within = combined_means([*frames[1:3], *frames[1:3]], DIFFERENCE)
        # the latter are of twice what changes
        quiet = within < 0.5 * QUIET * means
        if self._budget.bounded:
            now, _, early, waits = usual.surge(means, frames[0].origin)
            busy = self._budget.choose(busy & quiet, (now > STRADDLED_SURGE) | early, now, waits, SHARE)
            usual.searched(busy)
        else:
            busy &= quiet
        if not self._budget.begins(busy, share=SHARE):
            return []
        parts = searched_parts(ends, busy, self._sides[-1], lambda part: combined(part, weights))
        found = list[Detection | None]()
        for one, part in candidates_of(parts, self._coarse, self._side):
            if one.score > 0 and self._budget.fit():
                found.append(self._fit(frames, part, one, taken))
        return distinct([one for one in found if one is not None], self._side)

    def _fit(
        self,
        frames: Sequence[Frame],
        part: SearchedPart,
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
        if not (plausible(fit, parameters, frames[0].full_scale) and of_size(fit, parameters, self._side)):
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
