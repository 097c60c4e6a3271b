"""What is behind an array: a panel of unknown width and gray before an even background.

In a pair of pattern and inverse it cancels; a single frame shows it, and the panel's rim lies within the blur of the
outer LEDs. It is a combination of the images of two squares, as in the fit of a sum, and a plane.
"""

import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.receive import kernels
from heliograph.receive.detect import cut_out
from heliograph.receive.fit import PANEL_MARGINS, plane, window_around
from heliograph.receive.pose import Pose
from heliograph.receive.soft.look import BESIDE, MARGIN_PX, RING_PX, image_of

Floats = NDArray[np.float64]

Header = tuple[Frame, Frame, tuple[Pose, Pose]]
"""A header, its inverse, and the array's poses in them."""

COUNT = len(PANEL_MARGINS) + 3
"""Images that are combined."""


def surroundings(frame: Frame, pose: Pose, side: int) -> tuple[tuple[int, int], Floats]:
    """Corner (x, y) and pixels (rows, columns) of the window about an array."""
    x0, y0, cols, rows = window_around(pose, side, MARGIN_PX + RING_PX)
    return (x0, y0), cut_out(frame, x0, y0, cols, rows)


def images_behind(pose: Pose, corner: tuple[int, int], shape: tuple[int, int], side: int) -> Floats:
    """Images behind an array, with derivatives by (x, y, ln pitch, roll, ln blur): (COUNT, 6, rows, columns)."""
    out = np.zeros((COUNT, 6, *shape))
    for box, margin in zip(out, PANEL_MARGINS, strict=False):
        kernels.render_box(pose.vector(), 0.5 * side + margin, float(corner[0]), float(corner[1]), box)
    out[len(PANEL_MARGINS) :, 0] = plane(*shape)
    return out


def learn_behind(headers: list[Header], gain: float, side: int) -> tuple[Floats, float]:
    """Coefficients (COUNT,) of the images behind an array, and the variance of what they leave beside it.

    The sum of a header and its inverse is the array with all LEDs on: r + r' = g (A + A') 1 / 2 + 2 b.
    """
    found = np.zeros(COUNT)
    squares, count = 0.0, 0
    for pattern, inverted, poses in headers:
        middle = Pose.of(0.5 * (poses[0].vector() + poses[1].vector()))
        corner, up = surroundings(pattern, middle, side)
        _, down = surroundings(inverted, middle, side)
        ones = np.ones((side, side))
        lit = 0.5 * sum((image_of(ones, pose, corner, up.shape) for pose in poses), np.zeros(up.shape))
        behind = 0.5 * (up + down - gain * lit).ravel()
        columns = images_behind(middle, corner, up.shape, side)[:, 0].reshape(COUNT, -1).T
        coefficients = np.linalg.lstsq(columns, behind, rcond=1e-6)[0]
        left = (behind - columns @ coefficients)[lit.ravel() < BESIDE]
        found += coefficients / len(headers)
        squares, count = squares + float((left**2).sum()), count + left.size
    return found, squares / max(count, 1)
