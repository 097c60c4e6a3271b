"""Detection: arrays found by the header that only they show.

The header and its inverse alternate, so four frames in a row combined as f0 - 3 f1 + 3 f2 - f3 keep the header and
cancel what stands still, drifts or accelerates evenly. The result is correlated with the M-sequences of all identities
over scale and position. The best candidates are fitted to a fraction of a pixel, and must alternate in step from frame
to frame.
"""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import TINY
from heliograph.base.frames import Frame
from heliograph.receive.acquire.candidate import HIDING_BLUR, LEVEL, TILTED, UPRIGHT, cell_weights, fit_near
from heliograph.receive.acquire.coarse import (
    SIDE_STEP,
    SearchParameters,
    alternation_of,
    busy_blocks,
    coarse_candidates,
)
from heliograph.receive.acquire.header_fit import CLEAR, fit_first_pair, fit_header
from heliograph.receive.image.fit import Fit, header_amplitude
from heliograph.receive.image.pose import Pose
from heliograph.receive.image.window import common
from heliograph.signal.settings import SignalSettings

GAINED = 0.03
"""How much better a tilted candidate must be: an upright array with a hidden side looks a little tilted.

Chosen; docs/constants.md says what half and twice of it cost.
"""

MOST_TILT = 0.2
"""Largest tilt taken for an array's: that of 48 degrees, beyond which LEDs of 22.6 degrees half angle hardly shine."""

HIDDEN_SCORE, HIDDEN_REGULARITY = 0.8, 0.85
"""Least score of an array before which a thin post is, and least regularity of one of which a part is hidden.

It correlates less, but alternates evenly; without hidden cells it must correlate as a whole one does.
"""

OVERLAP = 0.1
"""Fraction of their sides by which two arrays may seem to overlap: a candidate's place and size err by half of it."""

FAR_PAST_S = 1e9
"""Seconds between frames that stand for those before the film: 30 years, so that no clock takes them for frames."""

MISSING_FRAMES = 0.25
"""Fraction of a header's frames that may be missing: without two of four, data before or after might stand for it."""

Shown = TypeVar("Shown")

SLACK = 2
"""Frames by which the start of the header may differ from the window searched, either way: every second is searched."""


@dataclass(frozen=True, slots=True)
class Detection:
    """An array found by its header.

    Attributes
    ----------
    identity
        Its number, 0 to 29.
    start_time_s
        Start of the header's first pattern in seconds.
    fit
        Pose and gain at `time_s`.
    time_s
        Middle of the frames fitted, in seconds.
    score
        Correlation with the header's image, 0 to 1.
    regularity
        Weakest over mean alternation of the header's frames, at most 1.
    led_gains
        (n, n), 1, or 0 in cells of the header that are hidden.
    """

    identity: int
    start_time_s: float
    fit: Fit
    time_s: float
    score: float
    regularity: float
    led_gains: NDArray[np.float64]

    @property
    def clear(self) -> bool:
        """Whether its header leaves no doubt that it is an array."""
        return self.score >= CLEAR and self.regularity >= HIDDEN_REGULARITY


class HeaderSearch(Protocol):
    """Looks for headers in a stream of frames."""

    def start(self, period_s: float) -> None:
        """Begin to search frames; it comes before the first of them.

        Parameters
        ----------
        period_s
            Frame period in seconds, above 0.
        """

    @property
    def candidates_fitted(self) -> int:
        """Candidates fitted so far."""

    @property
    def recent(self) -> Sequence[Frame]:
        """The last frames, oldest first: enough to hold the header of an array just found."""

    def push(self, frame: Frame, taken: Sequence[Pose] = ()) -> list[Detection]:
        """Take the next frame.

        Parameters
        ----------
        frame
            Next frame of the camera, in the order of time.
        taken
            Poses of arrays already followed; no array is looked for where they are.

        Returns
        -------
        Arrays whose header lies in the last frames.
        """


class Detector:
    """Looks for headers in a stream of one frame per pattern.

    Parameters
    ----------
    parameters
        What it takes for an array.
    signal
        The light's signal: side of the array and header pairs.
    """

    def __init__(self, parameters: SearchParameters, signal: SignalSettings):
        self._parameters, self._side = parameters, signal.side
        # a lit square may be anything's; a tilted one all the more
        tilted = parameters.impaired and not parameters.all_on
        self._tilts = (UPRIGHT, TILTED) if tilted else (UPRIGHT,)
        self._header = 2 * signal.header_pairs
        self._period_s = signal.pattern_period_s
        self._every = 2 if self._header >= 4 else 1
        self._cells, self._sides = parameters.templates(), parameters.sides()
        self._span = min(self._header, 4)
        self._window = self._header + 2 * SLACK
        self._frames: deque[Frame | None] = deque(maxlen=self._window)
        self._next = 0
        self._fitted = 0

    def start(self, period_s: float) -> None:
        """Begin; the frames are taken to come one per pattern, whatever the period; see `HeaderSearch`."""

    @property
    def candidates_fitted(self) -> int:
        """Candidates fitted so far."""
        return self._fitted

    @property
    def recent(self) -> Sequence[Frame]:
        """The last frames, oldest first: enough to hold the header of an array just found."""
        return [frame for frame in self._frames if frame is not None]

    def push(self, frame: Frame, taken: Sequence[Pose] = ()) -> list[Detection]:
        """Take the next frame; see `HeaderSearch`.

        Parameters
        ----------
        frame
            Next frame, one per pattern; a gap in their numbers is of frames that are missing.
        taken
            Poses of arrays already followed.
        """
        lost = frame.index - self._next
        recent = self.recent
        if recent and not (alike(recent[-1], frame) and 0 <= lost <= self._window):
            self._frames.clear()
        if not self._frames:
            lost = 0
            # a header may begin with the first frame: let that frame stand for those before it
            self._frames.extend(_before(frame, SLACK))
        found = list[Detection]()
        for one in [*([None] * lost), frame]:
            self._frames.append(one)
            self._next = frame.index + 1 if one is frame else self._next + 1
            if len(self._frames) == self._window and (self._next - 1) % self._every == 0:
                found += self._search(list(self._frames), [*taken, *(one.fit.pose for one in found)])
        return found

    def _search(self, slots: list[Frame | None], taken: Sequence[Pose]) -> list[Detection]:
        """Search the frames of successive patterns; None stands for those that are missing."""
        shown = iter(common([frame for frame in slots if frame is not None]))
        slots = [None if frame is None else next(shown) for frame in slots]
        header = _filled(slots[SLACK : SLACK + self._span])
        if header is None or min(header[0].pixels.shape) < self._sides[0]:
            return []
        change = alternation_of(header)
        busy = busy_blocks(change, header[0], taken, self._side, self._parameters.min_contrast)
        if not busy.any():
            return []
        rows = coarse_candidates(change, busy, header[0], self._parameters, self._cells, self._sides)
        found = [self._refine(slots, change, row, taken) for row in rows]
        return distinct([d for d in found if d is not None], self._side)

    def _refine(
        self, slots: list[Frame | None], change: NDArray[np.float32], row: NDArray[np.float64], taken: Sequence[Pose]
    ) -> Detection | None:
        """Fit a candidate's pose, then ask when its header began and whether it alternates in step."""
        self._fitted += 1
        number, sign, origin = int(row[4]), float(np.sign(row[0])), _origin(slots)
        weights, blur = cell_weights(self._cells[number], self._side), self._parameters.blur_px
        start = Pose(row[1] - 0.5 + origin[0], row[2] - 0.5 + origin[1], row[3] / self._side, 0.0, blur)
        if any(np.hypot(start.x - p.x, start.y - p.y) < 0.5 * self._side * p.pitch for p in taken):
            return None
        best: Detection | None = None
        for tilt in self._tilts:
            rough = fit_near(change, origin, start, sign * weights, tilt, HIDING_BLUR)
            if rough is None or rough.score < self._parameters.coarse_score:
                break
            found = self._timed(slots, replace(rough.pose, blur=blur), weights, number, tilt)
            if found is not None and (best is None or found.score > best.score + GAINED):
                best = found
            if best is not None and best.score >= CLEAR:
                break
        return best

    def _timed(
        self, slots: list[Frame | None], pose: Pose, weights: NDArray[np.float64], number: int, tilt: float
    ) -> Detection | None:
        """Where the header begins, the start at which its frames alternate most; and the pose in just those frames."""
        shown = [None if frame is None else header_amplitude(frame, pose, weights) for frame in slots]
        sign = 1 - 2 * (np.arange(self._header) % 2)
        windows = [_filled(shown[k : k + self._header]) for k in range(len(slots) - self._header + 1)]
        sums = [-np.inf if window is None else float(sign @ window) for window in windows]
        start = int(np.argmax(sums))
        seen, header = windows[start], _filled(slots[start : start + self._span])
        if start == len(sums) - 1 or seen is None or header is None:
            # it may begin later still, and a pair of data like it stand for its first: the next search has more of it
            return None
        change = -np.diff(seen) * sign[:-1]
        regularity = float(change.min() / max(change.mean(), TINY))
        there = slots[start : start + self._header]
        # what is filled in alternates by itself: a pair of data must not pass for a header that is half hidden
        even = self._parameters.impaired and None not in there and regularity >= HIDDEN_REGULARITY
        fit, led_gains, level = fit_header(header, pose, weights, tilt, self._parameters.score, even)
        least = HIDDEN_SCORE if level and led_gains.all() else self._parameters.score
        if fit is None or not self._convincing(fit, regularity, least, header[0].full_scale):
            return None
        start_s = self._start_s(there)
        if None not in there[:2] and self._parameters.impaired and self._span > 2:
            fit, header = fit_first_pair(header, fit, led_gains * weights, LEVEL if level else tilt)
        middle = 0.5 * (header[0].time_s + header[-1].time_s)
        return Detection(number, start_s, fit, middle, fit.score, regularity, led_gains)

    def _start_s(self, header: Sequence[Frame | None]) -> float:
        """Time of a header's first frame, by the first that is there."""
        first, frame = next((k, frame) for k, frame in enumerate(header) if frame is not None)
        return frame.time_s - first * self._period_s

    def _convincing(self, fit: Fit, regularity: float, least: float, full_scale: int) -> bool:
        if not plausible(fit, self._parameters, self._side, full_scale):
            return False
        # what is fitted as hidden alternates evenly, or is not fitted as such
        return fit.score >= least and regularity >= self._parameters.regularity


def plausible(fit: Fit, parameters: SearchParameters, side: int, full_scale: int) -> bool:
    """Whether brightness, size and tilt of a fit are those of an array looked for.

    Parameters
    ----------
    fit
        Fit of a candidate to its header.
    parameters
        What is looked for.
    side
        LEDs in a row.
    full_scale
        Largest gray level of the camera.
    """
    size, half_step = side * fit.pose.pitch, SIDE_STEP**0.5
    bright = fit.gain >= parameters.min_contrast * full_scale
    sized = parameters.min_side_px / half_step <= size <= parameters.max_side_px * half_step
    turned = np.hypot(fit.pose.stretch, fit.pose.shear) <= MOST_TILT
    return bool(bright and sized and turned)


def apart(a: Pose, b: Pose, side: int) -> bool:
    """Whether two arrays do not overlap; parts of a header look like smaller ones.

    Parameters
    ----------
    a, b
        Poses of the two arrays on the sensor.
    side
        LEDs in a row.
    """
    # |a - b| > (n p_a + n p_b) / 2, less what the poses may err by
    reach = (1 - OVERLAP) / 2 * side * (a.pitch + b.pitch)
    return bool(np.hypot(a.x - b.x, a.y - b.y) > reach)


def alike(last: Frame, frame: Frame) -> bool:
    """Whether two frames have the same kind of pixels.

    Parameters
    ----------
    last, frame
        Two frames of a film, in the order of time.
    """
    return last.pixels.dtype == frame.pixels.dtype and last.bits == frame.bits


def _filled(header: Sequence[Shown | None]) -> list[Shown] | None:
    """What a header's frames show, a missing one as the nearest before or after that shows the same.

    None where more than `MISSING_FRAMES` are missing, or all of a kind.
    """
    missing = [k for k, one in enumerate(header) if one is None]
    if len(missing) > MISSING_FRAMES * len(header):
        return None
    filled = [*header]
    for k in missing:
        alike = [header[j] for j in sorted(range(k % 2, len(header), 2), key=lambda j: abs(j - k))]
        filled[k] = next((one for one in alike if one is not None), None)
    return None if None in filled else [one for one in filled if one is not None]


def _origin(slots: Sequence[Frame | None]) -> tuple[int, int]:
    """Place of the first pixel, which all frames have in common."""
    return next(frame.origin for frame in slots if frame is not None)


def _before(frame: Frame, count: int) -> list[Frame]:
    """`count` copies of a frame with earlier, negative times and numbers."""
    return [replace(frame, index=frame.index - k, time_s=frame.time_s - FAR_PAST_S * k) for k in range(count, 0, -1)]


def distinct(detections: list[Detection], side: int) -> list[Detection]:
    """One detection a place, the best.

    Parameters
    ----------
    detections
        Detections of the same frames, in any order.
    side
        LEDs in a row.
    """
    kept: list[Detection] = []
    for one in sorted(detections, key=lambda d: -d.score):
        if all(apart(one.fit.pose, other.fit.pose, side) for other in kept):
            kept.append(one)
    return kept
