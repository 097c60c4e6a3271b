"""Measures of images: the median, a spread that outliers do not move, and correlation.

Fit of the array's image to pixels: position, pitch, rotation and blur to a hundredth of a pixel.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite

import numpy as np

from heliograph.base.arrays import TINY, Floats
from heliograph.receive.geometry import kernels as gauss_newton
from heliograph.receive.geometry.footprint import image_of
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.geometry.window import ImagePatch, Window, cut_out, plane, window_around


def robust_std(values: Floats) -> float:
    """Standard deviation of values about 0, by their median magnitude."""
    # median |x| / Phi^-1(3/4)
    return 1.4826 * median_of(np.abs(values))


def median_of(values: Floats) -> float:
    """Median of values, in a seventh of the time of NumPy's own for 256 of them; all must be numbers."""
    middle = [(values.size - 1) // 2, values.size // 2]
    low, high = np.partition(values, middle, axis=None)[middle]
    return 0.5 * float(low + high)


def correlation(a: Floats, b: Floats) -> float:
    """Correlation of two images."""
    x, y = (a - a.mean()).ravel(), (b - b.mean()).ravel()
    return float(x @ y / np.sqrt(max((x @ x) * (y @ y), TINY)))


PANEL_MARGINS = (0.75, 2.0)
"""Rims in pitches of two squares around the LEDs; their combination stands for a panel of unknown width and gray."""

_PANEL, _NO_PANEL, _ALL_COUNT = np.array(PANEL_MARGINS), np.empty(0), np.empty((0, 0))

HELD_PX = 0.2
"""Pixels by which an array's rim may leave its place in a window before another one is cut out.

It is twice `redraw.NEAR_PX`, where images are drawn anew in any case.
"""
SMEAR_ALIKE = 0.005
"""Variance in px^2 by which the motion may differ for which images were drawn: 1 % of a blur of 0.6 px and a pixel."""

AMPLITUDE_MARGIN_PX = 1.0
"""Pixels beyond the array in which a header's amplitude is measured.

More of them add background, fewer lose its rim.
"""


@dataclass(frozen=True, slots=True)
class Fit:
    """The array's image found in pixels."""

    # (x, y, ln pitch, roll, ln blur) of the pose, (5,), or with the tilt, (7,), as the prior
    vector: Floats
    # Posterior covariance of what was fitted, (5, 5) or (7, 7)
    covariance: Floats
    # Gray levels of the unresolved array with all weights 1
    gain: float
    # Correlation of pixels and fitted image, -1 to 1; after a small last step, of the image before that step
    score: float

    @property
    def pose(self) -> Pose:
        """The pose."""
        return Pose.from_vector(self.vector)


@dataclass(frozen=True, slots=True)
class Prior:
    """What is expected before a fit."""

    # Pose vector, (5,) or, with the tilt, (7,); the fit starts there
    vector: Floats
    # Its covariance, (5, 5) or (7, 7); with (5, 5) the tilt is held
    covariance: Floats
    # Expected gain in gray levels, or 0 where it is unknown
    gain: float = 0.0


class RenderCache:
    """Images of an array as they were last drawn, for fits of poses nearby."""

    def __init__(self) -> None:
        self.anchor, self.at = np.full(7, np.nan), np.full(7, np.nan)
        self._corner, self._smear, self._weights = (0, 0), (0.0, 0.0), np.empty((0, 0))
        self._shapes = np.empty((0, 0, 0, 0))
        self._window: Window = (0, 0, 0, 0)
        self._middle: tuple[float, float, float] | None = None

    def window(self, pose: Pose, side: int, margin: float) -> Window:
        """Pixels around an array: those of an earlier pose while they hold it, so that images are not redrawn."""
        x, y, half = pose.x, pose.y, 0.5 * side * pose.pitch
        middle = self._middle
        if middle is None or max(abs(x - middle[0]), abs(y - middle[1])) + abs(half - middle[2]) > HELD_PX:
            self._window, self._middle = window_around(pose, side, margin), (x, y, half)
        return self._window

    def images(
        self, corner: tuple[int, int], smear: tuple[float, float], weights: Floats, shape: tuple[int, ...]
    ) -> Floats:
        """Images for a fit: those that were drawn, or others that are still to be."""
        wider = max(abs(a**2 - b**2) for a, b in zip(smear, self._smear, strict=True))
        same = self._corner == corner and self._shapes.shape == shape and _equal(weights, self._weights)
        if not same or wider > SMEAR_ALIKE:
            self._shapes, self._corner, self._smear, self._weights = np.empty(shape), corner, smear, weights
            self.forget()
        return self._shapes

    def forget(self) -> None:
        """Have the images drawn anew by the next fit."""
        self.anchor.fill(np.nan)


def _equal(one: Floats, other: Floats) -> bool:
    # mostly they are the very same
    return one is other or np.array_equal(one, other)


def fit_array(
    image: Floats,
    corner: tuple[int, int],
    prior: Prior,
    weights: Floats,
    iterations: int,
    panel: bool = False,
    start: Floats | None = None,
    resolved: bool = True,
    open_pixels: Floats | None = None,
    smear: tuple[float, float] = (0.0, 0.0),
    drawn: RenderCache | None = None,
) -> Fit:
    """Most probable pose of LEDs of known luminances, by Gauss-Newton with robust weights."""
    # a sum is finite where all of it is; `sum` takes a microsecond more to come to this
    if not isfinite(np.add.reduce(image, axis=None)):
        raise np.linalg.LinAlgError("the fit of an array's pose has no solution: pixels are not finite")
    free, margins = len(prior.covariance), _PANEL if panel else _NO_PANEL
    background = plane(*image.shape)
    if open_pixels is not None:
        # a pixel that is 0 in all images says nothing
        image, background = image * open_pixels, background * open_pixels
    drawn = RenderCache() if drawn is None else drawn
    shapes = drawn.images(corner, smear, weights, (1 + len(margins), 1 + free, *image.shape))
    if open_pixels is not None:
        # of hidden pixels images are 0, and others are hidden in each pair
        drawn.forget()
    vector = (prior.vector if start is None else start).copy()
    covariance, linear, score = gauss_newton.fit(
        _kernels_kind(image),
        background,
        _ALL_COUNT if open_pixels is None else _kernels_kind(open_pixels),
        np.array(corner, np.float64),
        _kernels_kind(weights),
        margins,
        resolved,
        np.array(smear, np.float64),
        _kernels_kind(prior.vector),
        _kernels_kind(prior.covariance),
        float(prior.gain),
        iterations,
        vector,
        shapes,
        drawn.anchor,
        drawn.at,
    )
    if open_pixels is not None:
        drawn.forget()
    if not all(map(isfinite, linear.tolist())):
        raise np.linalg.LinAlgError("the fit of an array's pose has no solution")
    return Fit(vector, covariance, float(linear[0]), float(score))


def _kernels_kind(values: Floats) -> Floats:
    """An array as the kernels are compiled for: each other kind would be compiled anew."""
    return np.ascontiguousarray(values, np.float64)


def header_amplitudes(frames: Sequence[ImagePatch], pose: Pose, weights: Floats) -> Floats:
    """Amplitude with which each of some frames shows a pattern."""
    window = window_around(pose, weights.shape[0], AMPLITUDE_MARGIN_PX)
    model = image_of(weights, pose, window[:2], window[:1:-1]).ravel()
    shape = model - model.mean()
    shown = np.array([cut_out(frame, window).ravel() @ shape for frame in frames])
    return shown / max(float(shape @ shape), TINY)


def header_amplitude(frame: ImagePatch, pose: Pose, weights: Floats) -> float:
    """Amplitude with which one frame shows a pattern, as `header_amplitudes` has it."""
    return float(header_amplitudes([frame], pose, weights)[0])
