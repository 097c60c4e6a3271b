"""Fit of an array's image to pixels: position, pitch, roll and blur to a hundredth of a pixel."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite

import numpy as np

from heliograph.base.arrays import TINY, Floats
from heliograph.receive.geometry import kernels
from heliograph.receive.geometry.footprint import image_of
from heliograph.receive.geometry.kernels import FIT
from heliograph.receive.geometry.pose import Corner, Pose
from heliograph.receive.geometry.window import AnyFrame, Window, cut_out, plane, window_around


def robust_std(values: Floats) -> float:
    """Estimate the standard deviation of values about 0 from the median magnitude."""
    # median |x| / Phi^-1(3/4)
    return 1.4826 * float(np.median(np.abs(values)))


def correlation(a: Floats, b: Floats) -> float:
    """Compute the correlation of two images."""
    x, y = (a - a.mean()).ravel(), (b - b.mean()).ravel()
    return float(x @ y / np.sqrt(max((x @ x) * (y @ y), TINY)))


@dataclass(frozen=True, slots=True)
class Fit:
    """Image of an array, as expected before a fit or as fitted."""

    # Pose vector, (5,) or with the tilt (7,); a fit starts at the expected one
    vector: Floats
    # Covariance of the vector, (5, 5) or (7, 7); with (5, 5) a fit leaves the tilt
    covariance: Floats
    # Gray levels of the unresolved array with all weights 1; 0 if unknown before a fit
    gain: float = 0.0
    # Correlation of pixels and fitted image, -1 to 1
    score: float = 0.0

    @property
    def pose(self) -> Pose:
        """The pose."""
        return Pose.from_vector(self.vector)


class RenderCache:
    """Rendered images of an array, which fits of nearby poses reuse."""

    def __init__(self) -> None:
        self.anchor, self.at = np.full(7, np.nan), np.full(7, np.nan)
        self._corner, self._smear, self._weights = (0, 0), (0.0, 0.0), np.empty((0, 0))
        self._shapes = np.empty((0, 0, 0, 0))
        self._window: Window = (0, 0, 0, 0)
        self._middle: tuple[float, float, float] | None = None

    def window(self, pose: Pose, side: int, margin: float) -> Window:
        """Window around an array; it stays while it holds the array, so that images are reused."""
        x, y, half = pose.x, pose.y, 0.5 * side * pose.pitch
        middle = self._middle
        # twice the distance up to which images are moved by their slopes
        if middle is None or max(abs(x - middle[0]), abs(y - middle[1])) + abs(half - middle[2]) > 0.2:
            self._window, self._middle = window_around(pose, side, margin), (x, y, half)
        return self._window

    def images(self, corner: Corner, smear: tuple[float, float], weights: Floats, shape: tuple[int, ...]) -> Floats:
        """Images for a fit: cached, or empty if the fit has to render."""
        wider = max(abs(a**2 - b**2) for a, b in zip(smear, self._smear, strict=True))
        same = self._corner == corner and self._shapes.shape == shape
        same = same and (weights is self._weights or np.array_equal(weights, self._weights))
        # 1 % of a blur of 0.6 px
        if not same or wider > 0.005:
            self._shapes, self._corner, self._smear, self._weights = np.empty(shape), corner, smear, weights
            self.anchor.fill(np.nan)  # the next fit renders the images
        return self._shapes


def fit_array(
    image: Floats,
    corner: Corner,
    prior: Fit,
    weights: Floats,
    iterations: int,
    panel: bool = False,
    start: Floats | None = None,
    resolved: bool = True,
    open_pixels: Floats | None = None,
    smear: tuple[float, float] = (0.0, 0.0),
    drawn: RenderCache | None = None,
) -> Fit:
    """Fit the pose of LEDs of known luminances by Gauss-Newton with robust weights."""
    if not isfinite(np.add.reduce(image, axis=None)):
        raise np.linalg.LinAlgError("the fit of an array's pose has no solution: pixels are not finite")
    free, margins = len(prior.covariance), np.array(FIT.panel_margins if panel else ())
    background = plane(*image.shape)
    if open_pixels is not None:
        # a pixel that is 0 in all images has no effect
        image, background = image * open_pixels, background * open_pixels
        background.flags.writeable = False  # as that of `plane`: another type would compile a second kernel
    # images are 0 in hidden pixels, which differ from pair to pair
    drawn = RenderCache() if drawn is None or open_pixels is not None else drawn
    shapes = drawn.images(corner, smear, weights, (1 + len(margins), 1 + free, *image.shape))
    vector = (prior.vector if start is None else start).copy()
    mask = np.empty((0, 0)) if open_pixels is None else _contiguous(open_pixels)
    scene = np.array(corner, np.float64), _contiguous(weights), margins, resolved, np.array(smear, np.float64)
    expected = _contiguous(prior.vector), _contiguous(prior.covariance), float(prior.gain)
    covariance, linear, score = kernels.fit(
        _contiguous(image), background, mask, scene, expected, iterations, vector, (shapes, drawn.anchor, drawn.at)
    )
    if not all(map(isfinite, linear.tolist())):
        raise np.linalg.LinAlgError("the fit of an array's pose has no solution")
    return Fit(vector, covariance, float(linear[0]), float(score))


def _contiguous(values: Floats) -> Floats:
    """Convert to the type of array for which the kernels are compiled."""
    return np.ascontiguousarray(values, np.float64)


def header_amplitudes(frames: Sequence[AnyFrame], pose: Pose, weights: Floats) -> Floats:
    """Measure the amplitude of a pattern in each of some frames."""
    # a margin of 1 px: more adds background, less loses the rim
    window = window_around(pose, weights.shape[0], 1.0)
    model = image_of(weights, pose, window[:2], window[:1:-1]).ravel()
    shape = model - model.mean()
    return np.array([cut_out(frame, window).ravel() @ shape for frame in frames]) / max(float(shape @ shape), TINY)
