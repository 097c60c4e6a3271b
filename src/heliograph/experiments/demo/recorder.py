"""An observer of the receiver that keeps the track and some cut-outs of the first array."""

from dataclasses import dataclass, field

from heliograph.base.frames import Frame
from heliograph.receive import Pose
from heliograph.receive.events import DetectEvent, Event, ExtractEvent, TrackEvent


@dataclass(slots=True)
class TrackRecorder:
    """Observer that keeps the track and some pairs of frames of the array that was found first."""

    # Numbers of the frames from which on the next pair is kept; those done are taken out
    moments: list[int]
    # Time in s, number of the first frame and pose of each pair
    track: list[tuple[float, int, Pose]] = field(default_factory=list)
    # Number of the first frame, pose and both frames of the pairs kept
    cuts: list[tuple[int, Pose, Frame, Frame]] = field(default_factory=list)
    # Number of that array, 0 to 29; None before it is found
    identity: int | None = None

    def __call__(self, event: Event) -> None:
        """Take an event."""
        if isinstance(event, DetectEvent) and self.identity is None:
            self.identity = event.detection.identity
        if isinstance(event, TrackEvent) and event.identity == self.identity:
            state = event.tracked.state
            self.track.append((state.time_s, event.frame, state.pose))
        if isinstance(event, ExtractEvent) and event.identity == self.identity:
            self._cut(event)

    def _cut(self, event: ExtractEvent) -> None:
        pattern, inverted = event.frames
        # combined frames show the array's surroundings alone
        if not isinstance(pattern, Frame) or not isinstance(inverted, Frame):
            return
        if self.moments and pattern.index >= self.moments[0]:
            self.moments.pop(0)
            self.cuts.append((pattern.index, event.poses[0], pattern, inverted))
