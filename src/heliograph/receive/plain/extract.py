"""Extraction: the luminance at each LED's image position, pattern minus inverse, or the blur undone."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import TINY
from heliograph.receive.image.pose import Pose
from heliograph.receive.image.window import PlacedPixels
from heliograph.receive.settings import Equaliser


def pair_luminances(
    frames: tuple[PlacedPixels, PlacedPixels],
    poses: tuple[Pose, Pose],
    gain: float,
    side: int,
    equaliser: Equaliser = "none",
) -> NDArray[np.float64]:
    """Normalised luminances x' = level - 2 of a data pair."""
    if equaliser == "inverse":
        from heliograph.receive.plain.inverse import unblurred  # SciPy is slow to import

        return unblurred(frames, poses, gain, side)
    up, down = (luminances(frame, pose, side) for frame, pose in zip(frames, poses, strict=True))
    return normalised(up - down, gain)


def normalised(change: NDArray[np.float64], gain: float) -> NDArray[np.float64]:
    """Normalised luminances x' = level - 2 by what LEDs show of a pattern less its inverse."""
    # r - r_inverted = gain (x - (1 - x)) = gain (2 x - 1) = gain x' / 2
    return 2 * change / max(gain, TINY)


def luminances(frame: PlacedPixels, pose: Pose, side: int) -> NDArray[np.float64]:
    """Gray level at each LED's image position, by cubic interpolation. Returns (side, side) float64."""
    return at_leds(frame.pixels, frame.origin, pose, side)


def at_leds(pixels: NDArray[Any], corner: tuple[int, int], pose: Pose, side: int) -> NDArray[np.float64]:
    """Value of an image at each LED's position, by cubic interpolation."""
    from heliograph.receive.plain import kernels  # Numba is slow to import

    out = np.empty((side, side))
    kernels.cubic_at_leds(pixels, pose.x - corner[0], pose.y - corner[1], pose.axes, out)
    return out
