"""Cut-outs: pairs of frames about the array, kept until their packet is whole."""

from dataclasses import dataclass, replace
from math import hypot

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.receive.geometry import kernels as image_kernels
from heliograph.receive.geometry.footprint import by_squares, footprints
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.geometry.window import RIM_PX, covered, cut_out, window_around
from heliograph.receive.observe import kernels as noise_kernels
from heliograph.receive.sync.combine import Combination
from heliograph.receive.sync.pairing import FramePair

RING_PX = 2.0
"""Pixels beyond the rim whose difference shows what changes in the background."""

APART_PX = 0.25
"""Motion in px from one frame to the other above which one wider Gaussian does not stand for both.

At 0.3 px it makes an error of 6e-4 in G, at 0.6 px of 2e-2, at 1.1 px, as in a pothole, of 0.15. A G of both frames
takes twenty times as long.
"""


ALL_SHOWN = np.ones(0)
"""Stands for factors of 1 on all columns, rows or LEDs."""


@dataclass(frozen=True, slots=True)
class Cutout:
    """A pair of frames about the array, a single frame of data without inverses, or what is left of a pair."""

    # Sum of pattern and inverse in gray levels, (rows, columns); of a single frame twice what it shows above the
    # background
    total: Floats
    # Pattern less inverse, (rows, columns); of a single frame the same as `total`
    difference: Floats
    # (x, y) on the sensor of the first pixel
    corner: tuple[int, int]
    # Where the data's light was in each frame, at the middle of the exposure or about it; one or two
    poses: tuple[Pose, ...]
    # Of a single frame, where the light of the levels' mean was, which is earlier; None of a pair
    mean_light_pose: Pose | None = None
    # How the pair was combined; None for two frames in step
    combination: Combination | None = None
    # 1 for columns (columns,) and rows (rows,) that all frames have, 0 for those that repeat a frame's border; None if
    # the frames have all
    covered: tuple[Floats, Floats] | None = None
    # Variance of a pixel of the difference, in units of that of a difference of two frames; above 0
    noise: float = 1.0
    # (n, n) 1 for LEDs in sight, 0 for those that something hides; None if all are in sight
    in_sight: Floats | None = None
    # Gray levels of the sum of a pair with all LEDs on, and (n, n) gains of these, by which `steady` takes the moving
    # background off; None where that is done, or not to be done
    background: tuple[float, Floats] | None = None

    @property
    def steady(self) -> "Cutout":
        """The cut-out without the background's light that moves with the array, as `motion_compensated` takes it off.

        That takes as long as to follow the array, and LEDs that are read one by one need none of it.
        """
        if self.background is None:
            return self
        return replace(self.motion_compensated(*self.background), background=None)

    @property
    def apart(self) -> bool:
        """Whether the array moves farther than `APART_PX` from one frame to the other."""
        first, last = self.poses[0], self.poses[-1]
        return hypot(last.x - first.x, last.y - first.y) > APART_PX

    @property
    def middle(self) -> Pose:
        """The pose between the two; of one its own."""
        return self.poses[0] if len(self.poses) == 1 else Pose.midway(self.poses[0], self.poses[-1])

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        rows, cols = self.difference.shape
        return rows, cols

    def shining(self, led_gains: Floats) -> Floats:
        """Gains of LEDs (n, n), 0 where something hides them."""
        return led_gains if self.in_sight is None else led_gains * self.in_sight

    def slopes(self, levels: Floats) -> Floats:
        """Derivatives of the image of LEDs by x, y, ln pitch and roll, (4, rows, columns)."""
        image = np.empty((6, *self.shape))
        image_kernels.render(self.middle.full_vector(), levels, float(self.corner[0]), float(self.corner[1]), image)
        return image[1:5]

    def motion_compensated(self, gain: float, led_gains: Floats) -> "Cutout":
        """Take off the background's light that does not cancel because it moves with the array between the frames."""
        if len(self.poses) != 2 or self.combination is not None:
            return self
        first, second = self.poses
        ends = [footprints(pose, self.corner, self.shape, len(led_gains)) for pose in self.poses]
        # b(x - p_1) - b(x - p_2) = (p_2 - p_1) grad b, b = (r + r' - g (A_1 + A_2) 1 / 2) / 2
        steady, shining = np.empty_like(self.difference), by_squares(self.shining(led_gains))
        x, y = second.x - first.x, second.y - first.y
        noise_kernels.motion_compensated(
            self.difference, self.total, (*ends[0],), (*ends[1],), shining, 0.5 * gain, x, y, steady
        )
        return replace(self, difference=steady)

    def moved(self, error: Floats) -> "Cutout":
        """Correct its poses by an error that all of them have."""
        step = np.append(error, np.zeros(3))
        return replace(self, poses=tuple(Pose.from_vector(pose.full_vector() + step) for pose in self.poses))


def take_cutout(
    pair: FramePair, poses: tuple[Pose, Pose], side: int, background: tuple[float, Floats] | None = None
) -> Cutout:
    """Cut a pair of frames out."""
    frames, window = (pair.pattern, pair.inverted), window_around(Pose.midway(*poses), side, RIM_PX + RING_PX)
    up, down = (cut_out(frame, window) for frame in frames)
    corner = window[0], window[1]
    inside = covered(frames, corner, (window[3], window[2]))
    total, difference, combination = up + down, up - down, pair.combination
    return Cutout(total, difference, corner, poses, combination=combination, covered=inside, background=background)
