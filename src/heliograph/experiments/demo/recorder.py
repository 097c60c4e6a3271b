"""An observer of the receiver that keeps the track and some cut-outs of the first array."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from heliograph.base.frames import Frame
from heliograph.receive import Pose


@dataclass(slots=True)
class TrackRecorder:
    """Observer that keeps the track and some pairs of frames of the array that was found first.

    Attributes
    ----------
    moments
        Numbers of the frames from which on the next pair is kept; those done are taken out.
    track
        Time in s, number of the first frame and pose of each pair.
    cuts
        Number of the first frame, pose and both frames of the pairs kept.
    identity
        The array's; None before it is found.
    """

    moments: list[int]
    track: list[tuple[float, int, Pose]] = field(default_factory=list)
    cuts: list[tuple[int, Pose, Frame, Frame]] = field(default_factory=list)
    identity: int | None = None

    def __call__(self, stage: str, data: Mapping[str, Any], /) -> None:
        """Take the data of a stage."""
        if stage == "detect" and self.identity is None:
            self.identity = data["detection"].identity
        if stage == "track" and data["identity"] == self.identity:
            state = data["tracked"].state
            self.track.append((state.time_s, data["frame"], state.pose))
        if stage == "extract" and data["identity"] == self.identity:
            self._cut(data)

    def _cut(self, data: Mapping[str, Any]) -> None:
        pattern, inverted = data["frames"]
        if self.moments and pattern.index >= self.moments[0]:
            self.moments.pop(0)
            self.cuts.append((pattern.index, data["poses"][0], pattern, inverted))
