"""Cut-outs: pairs of frames cropped to the array, and their noise.

The noise inside the array shows in the unevenness of sums, that in the background in differences.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import hypot

import numpy as np

from heliograph.base.arrays import RCOND, Floats
from heliograph.receive.geometry.fit import robust_std
from heliograph.receive.geometry.footprint import Footprints, footprints, kept_image, render_with_slopes, to_quarters
from heliograph.receive.geometry.pose import Corner, Pose, Shape
from heliograph.receive.geometry.window import RIM_PX, covered, cut_out, window_around
from heliograph.receive.sync.combine import Combination
from heliograph.receive.sync.pairing import FramePair

RING_PX = 2.0  # pixels beyond the rim, where the difference shows changes of the background
MAX_BACKGROUND = 1e-3  # relative light of the array below which a pixel is background: a fraction of a gray level
LEAST_NOISE = 1 / 6  # variance of a difference of two frames by rounding alone, 2 / 12


@dataclass(frozen=True, slots=True)
class Cutout:
    """A pair of frames cropped to the array, or a single frame of data without inverses."""

    # Sum of pattern and inverse in gray levels, (rows, columns); for a single frame twice the frame less the background
    total: Floats
    # Pattern less inverse, (rows, columns); for a single frame the same as `total`
    difference: Floats
    # (x, y) on the sensor of the first pixel
    corner: Corner
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
    def shape(self) -> Shape:
        """Rows and columns."""
        return self.difference.shape

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


# cut-outs of the pairs of a packet, in the single mode of the patterns; None for missing pairs
Cutouts = Sequence[Cutout | None]


def take_cutout(pair: FramePair, poses: tuple[Pose, Pose], side: int) -> Cutout:
    """Crop a pair of frames to the array."""
    frames, window = (pair.pattern, pair.inverted), window_around(Pose.midway(*poses), side, RIM_PX + RING_PX)
    up, down = (cut_out(frame, window) for frame in frames)
    corner = window[0], window[1]
    inside = covered(frames, corner, (window[3], window[2]))
    return Cutout(up + down, up - down, corner, poses, combination=pair.combination, covered=inside)


@dataclass(frozen=True, slots=True)
class Noise:
    """Variance of a pixel of a difference of two frames, in squared gray levels."""

    # Inside the array: mostly photons
    lit: float
    # In the background: noise of the sensor and changes of the scene
    dark: float


def measure_noise(cutouts: Sequence[Cutout], gain: float, side: int, led_gains: Floats | None = None) -> Noise:
    """Measure the noise of cut-outs.

    Inside the array the sum of a pair is even except for noise, with the variance of the difference, and for data left
    by motion between the frames. The difference of successive sums removes failed LEDs.
    """
    if not cutouts:
        return Noise(LEAST_NOISE, LEAST_NOISE)
    successive = [*pairwise(range(len(cutouts)))] or [(0, 0)]
    inside = max((side * cutouts[0].middle.pitch - 2) ** 2, 1.0)
    # with 4000 pixels the spread of the noise is 3 %
    successive = successive[:: max(1, int(len(successive) * inside / 4000))]
    sums = {k: _unevenness(cutouts[k], gain, side, led_gains) for k in sorted({k for two in successive for k in two})}
    if len(sums) > 1:
        # successive sums have independent noise, so the difference has twice the variance
        parts = [_variance(_subtract(sums[i], sums[j]) / np.sqrt(2)) for i, j in successive]
    else:
        parts = [_variance(residual) for residual, _, _ in sums.values()]
    total, count = np.array(parts).sum(0)
    motion = float(np.mean([by_motion for _, _, by_motion in sums.values()]))
    # the motion of LEDs that shine in a part of the exposure errs by a fifth
    lit = max(float(total) / max(float(count), 1.0) - motion, 0.2 * motion, LEAST_NOISE)
    return Noise(lit, noise_beside(cutouts, side))


def noise_beside(cutouts: Sequence[Cutout], side: int) -> float:
    """Measure the variance of a background pixel in a difference of two frames."""
    squares, count = 0.0, 0
    for cutout in cutouts:
        dark = cutout.image_of(np.ones((side, side)), cutout.poses[0]) < MAX_BACKGROUND
        power, pixels = float((cutout.difference[dark] ** 2).sum()), int(dark.sum())
        squares += power if cutout.combination is None else power / cutout.combination.noise
        count += pixels
    return max(squares / max(count, 1), LEAST_NOISE)


# Residual of a sum inside the array, (rows, columns), NaN elsewhere; its corner; its variance by motion
_Unevenness = tuple[Floats, Corner, float]


def _unevenness(cutout: Cutout, gain: float, side: int, led_gains: Floats | None) -> _Unevenness:
    """Residual of a sum about the array with all LEDs on and a plane, scaled by the degrees of freedom."""
    place = cutout.corner, cutout.shape
    visible = np.ones((side, side)) if cutout.in_sight is None else cutout.in_sight
    gains = visible if led_gains is None else cutout.shining(led_gains)
    lit = np.mean([cutout.image_of(gains, pose) for pose in cutout.poses], axis=0)
    light = cutout.image_of(visible, cutout.poses[0])
    if cutout.covered is not None:
        light = light * np.outer(*cutout.covered[::-1])
    # without the slope of a blurred rim
    rows, columns = np.nonzero(light > 0.8 * light.max())
    images = np.stack([np.ones(rows.size), rows, columns, lit[rows, columns]], axis=1)
    sums, residual = cutout.total[rows, columns], np.full(cutout.shape, np.nan)
    left = sums - images @ np.linalg.lstsq(images, sums, rcond=RCOND)[0]
    # the fit takes four degrees of freedom
    residual[rows, columns] = left * np.sqrt(rows.size / max(rows.size - 4, 1))
    first, last = (footprints(pose, *place, side) for pose in cutout.poses)
    # of the sum A_1 x + A_2 (1 - x) motion leaves (A_1 - A_2) (x - 1/2), and random data have the variance 1/16
    power = _overlap(first, first) - 2 * _overlap(first, last) + _overlap(last, last)
    motion = gain**2 / 16 * power / (side * cutout.middle.pitch) ** 2
    if cutout.combination is None:
        return residual, cutout.corner, float(motion)
    # in units of a sum of two frames; only a header's combined sum is even, and motion leaves no data in it
    return residual / np.sqrt(0.5 * (cutout.combination.total**2).sum()), cutout.corner, 0.0


def _overlap(light: Footprints, other: Footprints) -> float:
    """Compute the inner product of two blur matrices over all LEDs and pixels."""
    return float(np.prod([np.einsum("kj,kj->k", *parts) for parts in zip(light, other, strict=True)], axis=0).sum())


def _subtract(sum_1: _Unevenness, sum_2: _Unevenness) -> Floats:
    """Subtract two residuals on the common pixels."""
    left, top = (max(a, b) for a, b in zip(sum_1[1], sum_2[1], strict=True))
    a, b = (residual[top - corner[1] :, left - corner[0] :] for residual, corner, _ in (sum_1, sum_2))
    rows, cols = (min(m, n) for m, n in zip(a.shape, b.shape, strict=True))
    return np.asarray(a[:rows, :cols] - b[:rows, :cols])


def _variance(residual: Floats) -> tuple[float, int]:
    """Variance times the number of pixels, robust to failed LEDs, and the number."""
    known = residual[np.isfinite(residual)]
    return (robust_std(known) ** 2 * known.size, known.size) if known.size else (0.0, 0)
