"""Whether an array is in sight where it should be: pattern and inverse differ there; a hidden array stands still."""

from math import erf, exp, hypot, pi, sqrt

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.receive.image.pose import Pose
from heliograph.receive.track import kernels

PIXEL_STD_PX = 12**-0.5
"""Standard deviation in pixels of a pixel's own width."""

NOISY = 1.5
"""Factor on the noise variance that a change must exceed: the variance of some hundred pixels is known to a fifth."""

ACTIVITY = 0.06
"""Least rms change from pattern to inverse of an array in sight, as a fraction of its light and of `contrast`.

Random data change the light by half of it; an eighth of that leaves room for dim LEDs and a gain that is too large.
"""

INSIDE_EDGE_PX, BESIDE_EDGE_PX = 0.5, 1.0
"""Pixels inside and beside an array's edge that are left out where its change is compared with that beside it.

A pixel whose centre is 0.5 px inside is inside as a whole. A blur of 0.5 px leaves 2 % of the light 1 px beside an
edge.
"""

LEAST_HALF_PX = 1.5
"""Half the side in px, at least, of the square whose change counts: 3 px, however small an array seems."""

MOST_BLUR_SIDES, MOST_FRAMES = 0.5, 2.0
"""Widest blur of what is followed, in its sides, and widest side, in those of a frame: beyond them nothing is read.

Of what flickered and was taken for an array the blur came to 170,000 px, and no memory held its image.
"""


def check_pose(pose: Pose, side: int, shape: tuple[int, ...]) -> None:
    """Check that what is followed may still be an array."""
    width = side * pose.pitch
    if not width <= MOST_FRAMES * max(shape):
        raise np.linalg.LinAlgError(f"a width of {width:.3g} px is none of an array in a frame of {max(shape)} px")
    if not pose.blur <= MOST_BLUR_SIDES * width:
        raise np.linalg.LinAlgError(f"a blur of {pose.blur:.3g} px of {width:.3g} px is none of an array")


def is_active(change: Floats, noise: float, pose: Pose, corner: tuple[int, int], side: int, gain: float) -> bool:
    """Whether pattern and inverse differ where the array should be: a hidden or dark array shows no change."""
    half = max(0.5 * side * pose.pitch - INSIDE_EDGE_PX, LEAST_HALF_PX)
    power, count = kernels.power_within(change, pose.x - corner[0], pose.y - corner[1], half)
    least = ACTIVITY * contrast(pose) * gain
    return bool(count and power >= count * (least**2 + NOISY * noise**2))


def noise_around(change: Floats, pose: Pose, corner: tuple[int, int], side: int) -> float:
    """Standard deviation of a difference around the array, in gray levels; 0 where nothing is around it."""
    half = 0.5 * side * pose.pitch + BESIDE_EDGE_PX
    return float(kernels.noise_beside(change, pose.x - corner[0], pose.y - corner[1], half))


def contrast(pose: Pose) -> float:
    """Fraction of the contrast of squares of 2 x 2 LEDs that blur and pixels leave, 0 to 1."""
    # along x and y alike: int (box * Gaussian)^2 / w = erf u - (1 - exp(-u^2)) / (sqrt(pi) u), u = w / 2 s
    u = pose.pitch / hypot(pose.blur, PIXEL_STD_PX)
    return erf(u) - (1 - exp(-(u**2))) / (sqrt(pi) * u)
