"""What an array's pairs give of a packet beside its data: when and where it was seen, and how well."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from heliograph.receive.coming import HEADER_SEEN
from heliograph.receive.image.pose import Pose
from heliograph.receive.image.view import View
from heliograph.receive.packets import Packet
from heliograph.receive.settings import CalibrationSettings
from heliograph.receive.track.track import TrackedPair


@dataclass(slots=True)
class Gathered:
    """What has been read of the current packet."""

    # (pairs,) pairs of data in which the array was seen
    seen: NDArray[np.bool_]
    # Numbers of its frames
    frames: list[int] = field(default_factory=list)
    # Correlation of each pair's sum with the array, -1 to 1
    scores: list[float] = field(default_factory=list)
    # The array's pose in each pair
    poses: list[Pose] = field(default_factory=list)
    # Score of each pair of its header
    header: list[float] = field(default_factory=list)
    # Whether the light's clock measured its header
    clocked: bool = False

    @classmethod
    def nothing(cls, pairs: int) -> "Gathered":
        """Nothing yet."""
        return cls(np.zeros(pairs, dtype=bool))

    def note(self, frames: tuple[int, int], tracked: TrackedPair) -> None:
        """Gather what every pair gives."""
        self.frames += frames
        self.scores.append(tracked.fit.score)
        self.poses.append(tracked.state.pose)

    @property
    def header_score(self) -> float:
        """Amplitude of the header as a fraction of the array's light; 0 where no pair of it was read."""
        return float(np.mean(self.header or [0.0]))

    @property
    def header_seen(self) -> bool:
        """Whether the header was seen."""
        # about half a pattern out of step none of its pairs alternates
        return self.header_score >= HEADER_SEEN or (self.clocked and not self.header)

    def packet(self, identity: int, start_time_s: float, view: View, calibration: CalibrationSettings) -> Packet:
        """The packet gathered, without its codewords; a pair of it must have been seen."""
        pose = view.pose_out(self.poses[len(self.poses) // 2])
        return Packet(
            identity=identity,
            status="crc_fail",
            start_time_s=start_time_s,
            first_frame=self.frames[0],
            last_frame=self.frames[-1],
            pose=pose,
            # pinhole: pitch_px = f p / (Z pixel)
            distance_m=calibration.focal_m * calibration.pitch_m / (pose.frontal_pitch * calibration.pixel_m),
            header_score=self.header_score,
            track_score=float(np.mean(self.scores)),
            pairs_seen=float(self.seen.mean()),
            layers={},
            orientation=view.orientation,
        )
