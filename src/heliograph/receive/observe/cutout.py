"""Cut-outs: pairs of frames cropped to the array."""

from dataclasses import dataclass, replace
from math import hypot

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.receive.geometry.footprint import kept_image, render_with_slopes, to_quarters
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.geometry.window import RIM_PX, covered, cut_out, window_around
from heliograph.receive.sync.combine import Combination
from heliograph.receive.sync.pairing import FramePair

RING_PX = 2.0  # pixels beyond the rim, where the difference shows changes of the background


@dataclass(frozen=True, slots=True)
class Cutout:
    """A pair of frames cropped to the array, or a single frame of data without inverses."""

    # Sum of pattern and inverse in gray levels, (rows, columns); for a single frame twice the frame less the background
    total: Floats
    # Pattern less inverse, (rows, columns); for a single frame the same as `total`
    difference: Floats
    # (x, y) on the sensor of the first pixel
    corner: tuple[int, int]
    # Pose of the data's light in each frame, near the middle of the exposure; one or two
    poses: tuple[Pose, ...]
    # For a single frame, the pose of the light of the levels' mean, which is earlier; None for a pair
    mean_light_pose: Pose | None = None
    # Combination of frames; None for two synchronous frames
    combination: Combination | None = None
    # 1 for columns (columns,) and rows (rows,) inside all frames, 0 outside; None if all are inside
    covered: tuple[Floats, Floats] | None = None
    # (n, n) 1 for visible LEDs, 0 for occluded LEDs; None if all are visible
    in_sight: Floats | None = None

    @property
    def apart(self) -> bool:
        """True if the array moves too far between the frames for a wider Gaussian to stand for both."""
        first, last = self.poses[0], self.poses[-1]
        # at 0.3 px the error of G is 6e-4, at 0.6 px 2e-2; two images take twenty times as long
        return hypot(last.x - first.x, last.y - first.y) > 0.25

    @property
    def middle(self) -> Pose:
        """The pose between two, or the only pose."""
        return self.poses[0] if len(self.poses) == 1 else Pose.midway(self.poses[0], self.poses[-1])

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        rows, cols = self.difference.shape
        return rows, cols

    def shining(self, led_gains: Floats) -> Floats:
        """Gains of LEDs (n, n), 0 for occluded LEDs."""
        return led_gains if self.in_sight is None else led_gains * self.in_sight

    def slopes(self, levels: Floats) -> Floats:
        """Derivatives of the image of LEDs by x, y, ln pitch and roll, (4, rows, columns)."""
        return render_with_slopes(self.middle, levels, self.corner, self.shape)[1:5]

    def image_of(self, levels: Floats, pose: Pose) -> Floats:
        """Render LEDs at a pose, (rows, columns), read-only."""
        return kept_image(to_quarters(levels).tobytes(), pose, self.corner, self.shape)

    def motion_compensated(self, gain: float, led_gains: Floats) -> "Cutout":
        """Subtract the light of the background that does not cancel because the array moves between the frames."""
        if len(self.poses) != 2 or self.combination is not None:
            return self
        first, second = self.poses
        lit = sum(self.image_of(self.shining(led_gains), pose) for pose in self.poses)
        # b(x - p_1) - b(x - p_2) = (p_2 - p_1) grad b, b = (r + r' - g (A_1 + A_2) 1 / 2) / 2
        down, right = np.gradient(0.5 * (self.total - 0.5 * gain * lit))
        return replace(self, difference=self.difference - (second.x - first.x) * right - (second.y - first.y) * down)

    def moved(self, error: Floats) -> "Cutout":
        """Correct all poses by an error of x, y, ln pitch and roll."""
        step = np.append(error, np.zeros(3))
        return replace(self, poses=tuple(Pose.from_vector(pose.full_vector() + step) for pose in self.poses))


def take_cutout(pair: FramePair, poses: tuple[Pose, Pose], side: int) -> Cutout:
    """Crop a pair of frames to the array."""
    frames, window = (pair.pattern, pair.inverted), window_around(Pose.midway(*poses), side, RIM_PX + RING_PX)
    up, down = (cut_out(frame, window) for frame in frames)
    corner = window[0], window[1]
    inside = covered(frames, corner, (window[3], window[2]))
    return Cutout(up + down, up - down, corner, poses, combination=pair.combination, covered=inside)
