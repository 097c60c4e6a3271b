"""Search for headers in the frames of a camera that is not in step with the light."""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from typing import Protocol

from heliograph.base.errors import HeliographError
from heliograph.base.frames import Frame
from heliograph.receive.detect import Detection, Detector
from heliograph.receive.pose import Pose
from heliograph.receive.settings import ReceiveSettings
from heliograph.signal.settings import SignalSettings

IN_STEP = 0.02
"""Departure of the camera's rate from the light's, as a share, up to which all frames are searched as they come."""

AROUND = 4
"""Patterns around a header that are kept as well."""


class Search:
    """Looks for headers in streams of one frame a pattern, thinned out of the camera's at several phases.

    Parameters
    ----------
    settings
        The receiver's.
    signal
        What the light speaks.
    """

    def __init__(self, settings: ReceiveSettings, signal: SignalSettings):
        self._settings, self._signal = settings, signal
        self._streams: list[_Stream] = []
        self._kept: deque[Frame] = deque()

    @property
    def recent(self) -> Sequence[Frame]:
        """The last frames, oldest first: enough to hold the header of an array just found."""
        return self._kept

    @property
    def candidates_fitted(self) -> int:
        """Candidates fitted so far in all streams."""
        return sum(stream.detector.candidates_fitted for stream in self._streams)

    @property
    def started(self) -> bool:
        """Whether the camera's rate is known."""
        return bool(self._streams)

    def start(self, period_s: float) -> None:
        """Begin, the camera's frame period being known.

        Raises
        ------
        HeliographError
            The camera is slower than the light.
        """
        light_s = self._signal.pattern_period_s
        if period_s > light_s * (1 + IN_STEP):
            raise HeliographError(
                f"the soft receiver needs at least one frame a pattern: the film has {1 / period_s:.1f} frames/s, the "
                f"light {1 / light_s:.1f} patterns/s; film faster or set signal.pattern_period_s"
            )
        if period_s > light_s * (1 - IN_STEP):
            self._streams = [_EveryFrame(self._detector(), period_s)]
        else:
            phases = _phases(light_s / period_s)
            self._streams = [_Nearest(self._detector(), light_s, k / phases) for k in range(phases)]
        patterns = 2 * self._signal.header_pairs + 2 * AROUND
        self._kept = deque(maxlen=math.ceil(patterns * light_s / period_s))

    def _detector(self) -> Detector:
        return Detector(self._settings, self._signal)

    def push(self, frame: Frame, taken: Sequence[Pose] = ()) -> list[Detection]:
        """Take a frame; return the arrays whose header lies in the last frames; see `Detector.push`."""
        self._kept.append(frame)
        known, found = list(taken), list[Detection]()
        for stream in self._streams:
            for detection in stream.push(frame, known):
                known.append(detection.fit.pose)
                found.append(detection)
        return found


class _Stream(Protocol):
    """Thins frames out for a detector."""

    detector: Detector

    def push(self, frame: Frame, taken: Sequence[Pose]) -> list[Detection]:
        """Take a frame; return the arrays whose header lies in the last frames of the stream."""


class _EveryFrame:
    """All frames of a camera of the light's rate."""

    def __init__(self, detector: Detector, period_s: float):
        self.detector, self._period_s = detector, period_s
        self._number, self._time_s = 0, 0.0

    def push(self, frame: Frame, taken: Sequence[Pose]) -> list[Detection]:
        """Search with every frame; one that was dropped leaves a gap."""
        self._number += max(1, round((frame.time_s - self._time_s) / self._period_s))
        self._time_s = frame.time_s
        return self.detector.push(replace(frame, index=self._number), taken)


class _Nearest:
    """One frame a pattern: those that begin nearest to even times."""

    def __init__(self, detector: Detector, step_s: float, phase: float):
        self.detector, self._step_s, self._phase = detector, step_s, phase
        self._best: Frame | None = None
        self._off = 0.0

    def push(self, frame: Frame, taken: Sequence[Pose]) -> list[Detection]:
        """Take a frame; search once it is known which one is nearest."""
        place = frame.time_s / self._step_s - self._phase
        number = round(place)
        off, kept = abs(place - number), self._best
        another = kept is None or kept.index != number
        if another or off < self._off:
            self._best, self._off = replace(frame, index=number), off
        return self.detector.push(kept, taken) if another and kept is not None else []


def _phases(rate: float) -> int:
    """Streams for a camera of `rate` frames a pattern: the fewer frames to choose from, the more phases are tried."""
    return 4 if rate < 2 else max(2, math.floor(rate))
