"""Extraction: the luminance at each LED's image position, pattern minus inverse, or the blur undone."""

import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.receive.detect import cut_out
from heliograph.receive.fit import window_around
from heliograph.receive.pose import Pose
from heliograph.receive.settings import Equaliser


def pair_luminances(
    pattern: Frame,
    inverted: Frame,
    poses: tuple[Pose, Pose],
    gain: float,
    side: int,
    equaliser: Equaliser = "none",
) -> NDArray[np.float64]:
    """Normalised luminances x' = level - 2 of a data pair.

    Parameters
    ----------
    pattern, inverted
        The two frames.
    poses
        The array's pose in each.
    gain
        Gray levels of the sum of the pair, all LEDs on.
    side
        LEDs in a row.
    equaliser
        "none" reads the luminance at each LED's position, "inverse" undoes the blur.

    Returns
    -------
    (side, side) float64, about -2 to 2; the background cancels in the difference.
    """
    if equaliser == "inverse":
        from heliograph.receive.inverse import unblurred  # SciPy is slow to import

        return unblurred(pattern, inverted, poses, gain, side)
    up, down = (luminances(frame, pose, side) for frame, pose in zip((pattern, inverted), poses, strict=True))
    # r - r_inverted = gain (x - (1 - x)) = gain (2 x - 1) = gain x' / 2
    return 2 * (up - down) / max(gain, 1e-6)


def luminances(frame: Frame, pose: Pose, side: int) -> NDArray[np.float64]:
    """Gray level at each LED's image position, (side, side) float64, by cubic interpolation."""
    from heliograph.receive import kernels  # Numba is slow to import

    x0, y0, width, height = window_around(pose, side, 2.0)
    points = pose.leds(side).reshape(-1, 2) - (x0, y0)
    out = np.empty(len(points))
    kernels.sample_cubic(cut_out(frame, x0, y0, width, height), points, out)
    return out.reshape(side, side)
