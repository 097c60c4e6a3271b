"""The interface of a tracker, the one that does nothing, and the receiver's own."""

from typing import Protocol

from heliograph.base.frames import Frame
from heliograph.link.settings import LinkSettings
from heliograph.receive import Pose
from heliograph.receive.detect.detection import Detection
from heliograph.receive.sync.pairing import FramePair, sum_late_s
from heliograph.receive.track.kalman import MotionModel
from heliograph.receive.track.tracker import Tracker
from heliograph.signal.header import header_levels


class Follower(Protocol):
    """Follows one array from pair to pair of frames."""

    # Whether its poses have the array's pitch; else the pitch is that of the start
    sized: bool

    def start(self, found: Detection, pattern: Frame, inverted: Frame) -> None:
        """Begin where the array was found."""
        ...

    def update(self, pattern: Frame, inverted: Frame) -> Pose:
        """The pose in the middle of the next pair, `pattern` and `inverted`."""
        ...


class NoTracking:
    """No tracking: the array stays where it was found."""

    sized = False

    def start(self, found: Detection, pattern: Frame, inverted: Frame) -> None:  # noqa: ARG002 - as all trackers
        """Keep the pose; see `Follower`."""
        self._pose = found.fit.pose

    def update(self, pattern: Frame, inverted: Frame) -> Pose:  # noqa: ARG002 - as all trackers
        """The pose kept; see `Follower`."""
        return self._pose


class InvertedSignals:
    """The paper's way, as in the receiver: the sum of a pattern and its inverse shows every LED."""

    sized = True

    def __init__(self, settings: LinkSettings):
        self._settings = settings
        model = MotionModel(settings.signal.pattern_period_s, settings.receive.track.acceleration_px)
        self._tracker = Tracker(settings.signal.side, model)

    def start(self, found: Detection, pattern: Frame, inverted: Frame) -> None:  # noqa: ARG002 - as all trackers
        """Start the receiver's tracker; see `Follower`."""
        side = self._settings.signal.side
        self._weights = header_levels(found.identity, side) / 2.0 - 1.0
        self._track = self._tracker.start(found)
        self._start_s = found.start_time_s

    def update(self, pattern: Frame, inverted: Frame) -> Pose:
        """Follow a pair; a header's pair refines the pose for the next; see `Follower`."""
        header = in_header(self._settings, pattern.time_s - self._start_s)
        pair = FramePair(pattern, inverted, 0.0 if header else sum_late_s(self._settings.signal))
        tracked = self._tracker.follow(self._track, pair)
        self._track = tracked.track
        if tracked.seen and header:
            self._track = self._tracker.refine(self._track, pair, self._weights)
        return tracked.state.pose


def in_header(settings: LinkSettings, since_s: float) -> bool:
    """Whether the pattern shown at a time belongs to a header."""
    signal = settings.signal
    return round(since_s / signal.pattern_period_s) % signal.packet_patterns < 2 * signal.header_pairs
