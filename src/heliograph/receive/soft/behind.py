"""What is behind an array: a panel of unknown width and gray before an even background.

In a pair of pattern and inverse it cancels; a single frame shows it, and the panel's rim lies within the blur of the
outer LEDs. It is a combination of the images of a square, whose size the header tells, and a plane.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from heliograph.base.frames import Frame
from heliograph.receive import kernels
from heliograph.receive.detect import cut_out
from heliograph.receive.fit import plane, window_around
from heliograph.receive.pose import Pose
from heliograph.receive.soft.glance import MARGIN_PX, RING_PX, image_of
from heliograph.receive.soft.noise import BESIDE

Floats = NDArray[np.float64]

Header = tuple[Frame, Frame, tuple[Pose, Pose]]
"""A header, its inverse, and the array's poses in them."""

COUNT = 4
"""Images that are combined: a square and a plane."""

MARGINS = np.arange(0.25, 3.01, 0.25)
"""Rims of a panel that are tried at first, in pitches beyond half a pitch about the outer LEDs."""


def surroundings(frame: Frame, pose: Pose, side: int) -> tuple[tuple[int, int], Floats]:
    """Corner (x, y) and pixels (rows, columns) of the window about an array."""
    x0, y0, cols, rows = window_around(pose, side, MARGIN_PX + RING_PX)
    return (x0, y0), cut_out(frame, x0, y0, cols, rows)


def images_behind(pose: Pose, corner: tuple[int, int], shape: tuple[int, int], half: float) -> Floats:
    """Images behind an array, with derivatives by (x, y, ln pitch, roll, ln blur): (COUNT, 6, rows, columns).

    `half` is half the panel's side in pitches.
    """
    out = np.zeros((COUNT, 6, *shape))
    kernels.render_box(pose.full_vector(), half, float(corner[0]), float(corner[1]), out[0])
    out[1:, 0] = plane(*shape)
    return out


def learn_behind(headers: list[Header], gain: float, shares: Floats) -> tuple[float, Floats, float]:
    """Half the panel's side in pitches, coefficients (COUNT,) of the images, the variance they leave beside the array.

    The sum of a header and its inverse is the array with all LEDs on: r + r' = g (A + A') 1 / 2 + 2 b. The pose is
    known from their difference, in which the panel cancels, so that the sum tells how wide the panel is. Of its light
    each LED gives a share (n, n).
    """
    views = [_view(header, gain, shares) for header in headers]

    def loss(half: float) -> float:
        return sum(float(_fitted(*view[:3], half)[1].sum()) for view in views)

    halves = 0.5 * len(shares) + MARGINS
    near = float(halves[int(np.argmin([loss(half) for half in halves]))])
    step = float(MARGINS[1] - MARGINS[0])
    half = float(minimize_scalar(loss, bounds=(near - step, near + step), method="bounded", options={"xatol": 5e-3}).x)
    found = [_fitted(*view[:3], half) for view in views]
    beside = np.concatenate([squares[view[3]] for view, (_, squares) in zip(views, found, strict=True)])
    return half, np.mean([one for one, _ in found], axis=0), float(beside.mean()) if beside.size else 0.0


View = tuple[Floats, Pose, tuple[int, int], NDArray[np.bool_]]
"""What is behind an array in a header pair, its pose there, the corner, and which pixels are beside it."""


def _view(header: Header, gain: float, shares: Floats) -> View:
    pattern, inverted, poses = header
    middle, side = Pose.between(*poses), len(shares)
    corner, up = surroundings(pattern, middle, side)
    _, down = surroundings(inverted, middle, side)
    lit = sum((image_of(shares, pose, corner, up.shape) for pose in poses), np.zeros(up.shape))
    beside = image_of(np.ones((side, side)), middle, corner, up.shape) < BESIDE
    return 0.5 * (up + down - 0.5 * gain * lit), middle, corner, beside


def _fitted(behind: Floats, pose: Pose, corner: tuple[int, int], half: float) -> tuple[Floats, Floats]:
    """Least squares coefficients of the images, and the squares of what they leave."""
    columns = images_behind(pose, corner, behind.shape, half)[:, 0].reshape(COUNT, -1).T
    coefficients = np.asarray(np.linalg.lstsq(columns, behind.ravel(), rcond=1e-6)[0], np.float64)
    return coefficients, (behind - (columns @ coefficients).reshape(behind.shape)) ** 2
