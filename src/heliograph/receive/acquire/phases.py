"""Search for headers in the frames of a camera of any rate and phase."""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from heliograph.base.errors import HeliographError
from heliograph.base.frames import Frame
from heliograph.receive.acquire.budget import Budget, SearchLoad
from heliograph.receive.acquire.coarse import SearchParameters
from heliograph.receive.acquire.detection import Detection
from heliograph.receive.acquire.pyramid import PyramidSearch, level_parameters
from heliograph.receive.acquire.straddled import StraddledDetector
from heliograph.receive.image.orientation import Orientation
from heliograph.receive.image.pose import Pose
from heliograph.receive.timing.camera_clock import STEP_TOLERANCE
from heliograph.signal.settings import SignalSettings

PATTERNS_KEPT = 4
"""Patterns around a header whose frames are kept too.

The light's clock asks for two on either side, and two to spare.
"""

SLOW_PHASES = 4
"""Phases tried for a camera of fewer than two frames per pattern: one of them is within 1/8 pattern of any header's."""


@dataclass(frozen=True, slots=True)
class PhaseLimits:
    """Limits of a search by phases."""

    # Most frames a pattern: all frames of a header are kept, and each phase has a search of its own
    max_frames: int = 1000


LIMITS = PhaseLimits()


class PhasedSearch:
    """Thins frames out to streams of one frame per pattern at several phases, each with a detector of its own."""

    def __init__(self, parameters: SearchParameters, signal: SignalSettings):
        self._parameters, self._signal = parameters, signal
        # shared by the two detectors of a camera of the light's rate
        self._budget = Budget(parameters.busy_part, signal.pattern_period_s)
        self._streams: list[_Stream] = []
        self._kept: deque[Frame] = deque()

    @property
    def recent(self) -> Sequence[Frame]:
        """The last frames, oldest first: enough to hold the header of an array just found."""
        return self._kept

    @property
    def load(self) -> SearchLoad:
        """What the searches of all streams did and left out so far."""
        streams = [detector.load for stream in self._streams if len(self._streams) > 1 for detector in stream.detectors]
        return sum(streams, self._budget.load)

    def start(self, period_s: float) -> None:
        """Begin to search frames of a camera as fast as the light or faster; see `HeaderSearch`."""
        light_s = self._signal.pattern_period_s
        if period_s > light_s * (1 + STEP_TOLERANCE):
            raise HeliographError(
                f"the soft receiver needs at least one frame a pattern: the film has {1 / period_s:.1f} frames/s, the "
                f"light {1 / light_s:.1f} patterns/s; film faster, give times in seconds, or say by --fps what the "
                "camera did where the film misstates it"
            )
        if period_s * LIMITS.max_frames < light_s:
            raise HeliographError(
                f"the soft receiver takes at most {LIMITS.max_frames} frames a pattern: the film has "
                f"{1 / period_s:.3g} frames/s, the light {1 / light_s:.1f} patterns/s; give times in seconds, say by "
                "--fps what the camera did where the film misstates it, or leave out frames"
            )
        alike = period_s > light_s * (1 - STEP_TOLERANCE)
        if alike:
            detectors: list[_FrameDetector] = [PyramidSearch(self._parameters, self._signal, self._budget)]
            if self._signal.header_pairs > 1:
                # of the finest level alone: larger arrays are not looked for half a pattern out of step
                finest = level_parameters(self._parameters, self._signal.side)[0]
                detectors.append(StraddledDetector(finest, self._signal, self._budget))
            self._streams = [_EveryFrame(detectors, period_s)]
        else:
            phases = _phases(light_s / period_s)
            # each with a budget of its own: one of them alone may be in step with an array
            searches = [PyramidSearch(self._parameters, self._signal) for _ in range(phases)]
            self._streams = [_Nearest(one, light_s, k / phases) for k, one in enumerate(searches)]
        patterns = 2 * self._signal.header_pairs + 2 * PATTERNS_KEPT
        self._kept = deque(maxlen=math.ceil(patterns * light_s / period_s))

    def settle(self, orientation: Orientation) -> None:
        """Look for one orientation alone from now on; see `HeaderSearch`."""
        for stream in self._streams:
            for detector in stream.detectors:
                detector.settle(orientation)

    def push(self, frame: Frame, taken: Sequence[Pose] = ()) -> list[Detection]:
        """Take the next frame; see `HeaderSearch`."""
        self._kept.append(frame)
        self._budget.earn()
        known, found = list(taken), list[Detection]()
        for stream in self._streams:
            shown = stream.push(frame)
            if shown is None:
                continue
            for detector in stream.detectors:
                there = detector.push(shown, known)
                known += [one.fit.pose for one in there]
                found += there
        return found


class _FrameDetector(Protocol):
    """Looks for headers in a stream of one frame per pattern."""

    @property
    def load(self) -> SearchLoad:
        """What the searches did and left out so far."""

    def settle(self, orientation: Orientation) -> None:
        """Look for one orientation alone from now on; see `HeaderSearch`."""

    def push(self, frame: Frame, taken: Sequence[Pose] = ()) -> list[Detection]:
        """Take the next frame; return the arrays whose header lies in the last ones."""


class _Stream(Protocol):
    """Thins frames out for detectors."""

    @property
    def detectors(self) -> Sequence[_FrameDetector]:
        """The detectors, all of which get the same frames."""

    def push(self, frame: Frame) -> Frame | None:
        """Take a frame; return the one that a pattern is known to be seen in, with the pattern's number."""


class _EveryFrame:
    """All frames of a camera of the light's rate."""

    def __init__(self, detectors: Sequence[_FrameDetector], period_s: float):
        self.detectors, self._period_s = detectors, period_s
        self._number, self._time_s = 0, 0.0

    def push(self, frame: Frame) -> Frame:
        """Number the frame; one that was dropped leaves a gap."""
        self._number += max(1, round((frame.time_s - self._time_s) / self._period_s))
        self._time_s = frame.time_s
        return frame.numbered(self._number)


class _Nearest:
    """One frame per pattern: those that begin nearest to even times."""

    def __init__(self, detector: _FrameDetector, step_s: float, phase: float):
        self.detectors, self._step_s, self._phase = (detector,), step_s, phase
        self._best: Frame | None = None
        self._off = 0.0

    def push(self, frame: Frame) -> Frame | None:
        """Take a frame; return the last pattern's once it is known which one is nearest."""
        place = frame.time_s / self._step_s - self._phase
        number = round(place)
        off, kept = abs(place - number), self._best
        another = kept is None or kept.index != number
        if another or off < self._off:
            self._best, self._off = frame.numbered(number), off
        return kept if another else None


def _phases(rate: float) -> int:
    """Streams for a camera of `rate` frames per pattern: the fewer frames to choose from, the more phases are tried."""
    return SLOW_PHASES if rate < 2 else max(2, math.floor(rate))
