"""Fit of an array's image to pixels: position, pitch, roll and blur to a hundredth of a pixel."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite

import numpy as np

from heliograph.base.arrays import TINY, Floats
from heliograph.receive.geometry import kernels
from heliograph.receive.geometry.footprint import image_of
from heliograph.receive.geometry.kernels import PANEL_MARGINS
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.geometry.window import ImagePatch, cut_out, plane, window_around


def robust_std(values: Floats) -> float:
    """Estimate the standard deviation of values about 0 from the median magnitude."""
    # median |x| / Phi^-1(3/4)
    return 1.4826 * median_of(np.abs(values))


def median_of(values: Floats) -> float:
    """Compute the median of numbers, for 256 values in a seventh of the time of `numpy.median`."""
    middle = [(values.size - 1) // 2, values.size // 2]
    low, high = np.partition(values, middle, axis=None)[middle]
    return 0.5 * float(low + high)


@dataclass(frozen=True, slots=True)
class Fit:
    """Fitted image of an array."""

    # Pose vector, (5,) or with the tilt (7,)
    vector: Floats
    # Posterior covariance of the fitted parameters, (5, 5) or (7, 7)
    covariance: Floats
    # Gray levels of the unresolved array with all weights 1
    gain: float
    # Correlation of pixels and fitted image, -1 to 1
    score: float

    @property
    def pose(self) -> Pose:
        """The pose."""
        return Pose.from_vector(self.vector)


@dataclass(frozen=True, slots=True)
class Prior:
    """Expected pose and gain before a fit."""

    # Pose vector, (5,) or, with the tilt, (7,); the fit starts there
    vector: Floats
    # Covariance of the vector, (5, 5) or (7, 7); with (5, 5) the tilt is fixed
    covariance: Floats
    # Expected gain in gray levels, or 0 if unknown
    gain: float = 0.0


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
) -> Fit:
    """Fit the pose of LEDs of known luminances by Gauss-Newton with robust weights."""
    if not isfinite(np.add.reduce(image, axis=None)):
        raise np.linalg.LinAlgError("the fit of an array's pose has no solution: pixels are not finite")
    margins = np.array(PANEL_MARGINS if panel else ())
    vector = (prior.vector if start is None else start).copy()
    rows = np.empty((len(prior.covariance) + 1 + len(margins) + 3, image.size))
    rows[-3:] = plane(*image.shape).reshape(3, -1)
    covariance, linear, score = kernels.fit(
        _contiguous(image),
        np.ones(image.size, bool) if open_pixels is None else open_pixels.ravel() > 0,
        np.array(corner, np.float64),
        _contiguous(weights),
        margins,
        resolved,
        np.array(smear, np.float64),
        _contiguous(prior.vector[: len(prior.covariance)]),
        _contiguous(prior.covariance),
        float(prior.gain),
        iterations,
        vector,
        rows,
    )
    if not all(map(isfinite, linear.tolist())):
        raise np.linalg.LinAlgError("the fit of an array's pose has no solution")
    return Fit(vector, covariance, float(linear[0]), float(score))


def _contiguous(values: Floats) -> Floats:
    """Convert to the type of array for which the kernels are compiled."""
    return np.ascontiguousarray(values, np.float64)


def header_amplitudes(frames: Sequence[ImagePatch], pose: Pose, weights: Floats) -> Floats:
    """Measure the amplitude of a pattern in each of some frames."""
    # a margin of 1 px: more adds background, less loses the rim
    window = window_around(pose, weights.shape[0], 1.0)
    model = image_of(weights, pose, window[:2], window[:1:-1]).ravel()
    shape = model - model.mean()
    products = np.array([cut_out(frame, window).ravel() @ shape for frame in frames])
    return products / max(float(shape @ shape), TINY)
