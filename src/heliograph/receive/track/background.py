"""Background of an array in single frames: a panel of unknown width and gray before an even background.

In a pair of pattern and inverse the background cancels. A single frame shows it, and the panel's rim lies within the
blur of the outer LEDs. The model is a combination of a square, whose size the headers tell, and a plane.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from heliograph.base.arrays import RCOND, Floats
from heliograph.receive.image import kernels
from heliograph.receive.image.footprint import image_of
from heliograph.receive.image.pose import Pose
from heliograph.receive.image.window import RIM_PX, PlacedPixels, cut_out, plane, window_around
from heliograph.receive.observe.cutout import RING_PX
from heliograph.receive.observe.noise import BESIDE
from heliograph.receive.timing.frame_pair import FramePair

IMAGE_COUNT = 4
"""Images that are combined: a square, and the three of a plane."""

MARGINS = np.arange(0.25, 3.01, 0.25)
"""Rims of a panel tried first, in pitches beyond half a pitch about the outer LEDs; the best is then refined."""

RIM_TOLERANCE = 5e-3
"""Accuracy of the rim in pitches: 0.004 px at 80 m."""


@dataclass(frozen=True, slots=True)
class SeenHeader:
    """A header pair, and the array's pose in each frame."""

    # Frames of the header and its inverse
    pair: FramePair
    # The array's pose in each of them
    poses: tuple[Pose, Pose]


@dataclass(frozen=True, slots=True)
class Background:
    """What is behind an array."""

    # Half of the panel's side, in pitches
    half: float
    # (4,) of the square and the plane, in gray levels
    coefficients: Floats
    # Variance that the model leaves beside the array, in squared gray levels
    variance: float


def surroundings(frame: PlacedPixels, pose: Pose, side: int) -> tuple[tuple[int, int], Floats]:
    """Window about an array: its corner (x, y), and its pixels (rows, columns) in gray levels."""
    window = window_around(pose, side, RIM_PX + RING_PX)
    return (window[0], window[1]), cut_out(frame, window)


def background_images(pose: Pose, corner: tuple[int, int], shape: tuple[int, int], half: float) -> Floats:
    """Images of the background, with derivatives by (x, y, ln pitch, roll, ln blur)."""
    out = np.zeros((IMAGE_COUNT, 6, *shape))
    kernels.render_box(pose.full_vector(), half, float(corner[0]), float(corner[1]), out[0])
    out[1:, 0] = plane(*shape)
    return out


def fit_background(headers: list[SeenHeader], gain: float, led_gains: Floats) -> Background:
    """Background by header pairs.

    The sum of a header and its inverse is the array with all LEDs on: r + r' = g (A + A') 1 / 2 + 2 b. The pose is
    known from their difference, in which the panel cancels, so the sum shows how wide the panel is.
    """
    views = [_behind(header, gain, led_gains) for header in headers]

    def loss(half: float) -> float:
        return sum(float(_fitted(view, half)[1].sum()) for view in views)

    halves = 0.5 * len(led_gains) + MARGINS
    near = float(halves[int(np.argmin([loss(half) for half in halves]))])
    step = float(MARGINS[1] - MARGINS[0])
    bounds = (near - step, near + step)
    half = float(minimize_scalar(loss, bounds=bounds, method="bounded", options={"xatol": RIM_TOLERANCE}).x)
    found = [_fitted(view, half) for view in views]
    beside = np.concatenate([squares[view.beside] for view, (_, squares) in zip(views, found, strict=True)])
    variance = float(beside.mean()) if beside.size else 0.0
    return Background(half, np.mean([one for one, _ in found], axis=0), variance)


@dataclass(frozen=True, slots=True)
class _Behind:
    """A header pair less the array's light: (rows, columns), the pose, the corner, and which pixels are beside it."""

    background: Floats
    pose: Pose
    corner: tuple[int, int]
    beside: NDArray[np.bool_]


def _behind(header: SeenHeader, gain: float, led_gains: Floats) -> _Behind:
    middle, side = Pose.midway(*header.poses), len(led_gains)
    corner, up = surroundings(header.pair.pattern, middle, side)
    _, down = surroundings(header.pair.inverted, middle, side)
    rows, cols = up.shape
    lit = sum((image_of(led_gains, pose, corner, (rows, cols)) for pose in header.poses), np.zeros(up.shape))
    beside = image_of(np.ones((side, side)), middle, corner, (rows, cols)) < BESIDE
    return _Behind(0.5 * (up + down - 0.5 * gain * lit), middle, corner, beside)


def _fitted(view: _Behind, half: float) -> tuple[Floats, Floats]:
    """Least squares coefficients of the images, and the squared residuals (rows, columns)."""
    rows, cols = view.background.shape
    columns = background_images(view.pose, view.corner, (rows, cols), half)[:, 0].reshape(IMAGE_COUNT, -1).T
    coefficients = np.asarray(np.linalg.lstsq(columns, view.background.ravel(), rcond=RCOND)[0], np.float64)
    return coefficients, (view.background - (columns @ coefficients).reshape(rows, cols)) ** 2
