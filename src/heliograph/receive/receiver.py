"""The receiver "plain": camera frames to packets."""

from collections.abc import Iterator, Sequence
from typing import Protocol

from heliograph.base.errors import HeliographError
from heliograph.base.frames import Frame
from heliograph.receive.array import ArrayReceiver
from heliograph.receive.detect import Detection, Detector, apart
from heliograph.receive.packets import Observer, Packet, ignore
from heliograph.receive.pose import Pose
from heliograph.receive.reading import PlainReading, Reading, Setup
from heliograph.receive.settings import ReceiveSettings
from heliograph.signal.packet import PacketFormat
from heliograph.signal.settings import SignalSettings

STEP_TOLERANCE = 0.02
"""Largest departure of the camera's rate from the light's that the plain receiver takes, as a share."""


class HeaderSearch(Protocol):
    """Looks for headers in a stream of frames; see `Detector`."""

    @property
    def candidates_fitted(self) -> int:
        """Candidates fitted so far."""

    @property
    def recent(self) -> Sequence[Frame]:
        """The last frames, oldest first: enough to hold the header of an array just found."""

    def push(self, frame: Frame, taken: Sequence[Pose] = (), /) -> list[Detection]:
        """Take a frame; return the arrays whose header lies in the last frames."""


class Receiver:
    """The paper's own receiver, "plain": one frame a pattern, in step with the light.

    Detects arrays by their header, follows each by the sum of pattern and inverse, reads the luminance at each LED's
    image position, and decodes.

    Parameters
    ----------
    signal
        What the light speaks.
    settings
        The receiver's settings.
    observe
        Gets (stage, data) of each stage.
    """

    array: type[ArrayReceiver] = ArrayReceiver

    def __init__(self, signal: SignalSettings, settings: ReceiveSettings | None = None, observe: Observer = ignore):
        self._setup = Setup(PacketFormat(signal), settings or ReceiveSettings(), observe)
        self._detector: HeaderSearch = Detector(self._setup.settings, signal)
        self._arrays: list[ArrayReceiver] = []
        self._last: Frame | None = None
        self.detections = 0

    def push(self, frame: Frame) -> Iterator[Packet]:
        """Take the next frame; yield the packets it completes."""
        self._check(frame)
        for array in self._arrays:
            yield from array.push(frame)
        for array in [a for a in self._arrays if a.done]:
            yield from self._drop(array)
        taken = [array.tracker.state.pose for array in self._arrays if array.sure]
        for detection in self._detector.push(frame, taken):
            rivals = [array for array in self._arrays if not self._apart(array, detection)]
            # what was taken for an array may stand in the way of one: the better header wins
            if all(detection.score > rival.found.score and not rival.expects(detection) for rival in rivals):
                for rival in rivals:
                    self._forget(rival)
                yield from self._take_up(detection)
        self._last = frame

    def finish(self) -> Iterator[Packet]:
        """End of the film: yield the packets in progress of which enough was seen."""
        for array in self._arrays:
            yield from array.flush()
        self._arrays = []

    def _apart(self, array: ArrayReceiver, detection: Detection) -> bool:
        """Whether a detection lies beside an array that is followed."""
        return apart(array.tracker.state.pose, detection.fit.pose, self._setup.form.settings.side)

    def _take_up(self, detection: Detection) -> Iterator[Packet]:
        """Begin to follow an array, its header's frames first."""
        self.detections += 1
        self._setup.observe("detect", {"detection": detection, "frames": tuple(self._detector.recent)})
        array = self.array(detection, self._setup, self._reading(detection.identity))
        self._arrays.append(array)
        for frame in self._detector.recent:
            yield from array.push(frame)

    def _reading(self, identity: int) -> Reading:
        """What reads the packets of an array."""
        return PlainReading(identity, self._setup)

    def _drop(self, array: ArrayReceiver) -> Iterator[Packet]:
        yield from array.flush()
        self._forget(array)

    def _forget(self, array: ArrayReceiver) -> None:
        self._setup.observe("lost", {"identity": array.identity, "time_s": array.tracker.state.time_s})
        self._arrays.remove(array)

    def _check(self, frame: Frame) -> None:
        if self._last is None:
            return
        steps, gap = frame.index - self._last.index, frame.time_s - self._last.time_s
        if steps < 1 or gap <= 0:
            raise HeliographError(
                f"frames must follow in time: frame {frame.index} at {frame.time_s:.6f} s came after "
                f"frame {self._last.index} at {self._last.time_s:.6f} s"
            )
        period = self._setup.form.settings.pattern_period_s
        if abs(gap / steps - period) > STEP_TOLERANCE * period:
            raise HeliographError(
                f"the plain receiver needs one frame a pattern: the film has {steps / gap:.1f} frames/s, the light "
                f"{1 / period:.1f} patterns/s; film at that rate or set signal.pattern_period_s"
            )
