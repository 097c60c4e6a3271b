"""Fit of the array's image to pixels: position, pitch, rotation and blur to a hundredth of a pixel."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.receive.pose import Pose

BIWEIGHT = 4.685
"""Residuals beyond this many standard deviations are taken for something else than the array (Tukey's biweight)."""


@dataclass(frozen=True, slots=True)
class Fit:
    """The array's image found in pixels.

    Attributes
    ----------
    vector
        (x, y, ln pitch, roll, ln blur) of the pose, (5,).
    covariance
        Of the vector, (5, 5).
    gain
        Luminance of the array with all weights 1, where it is not resolved, as gray levels.
    score
        Correlation of pixels and fitted image, -1 to 1.
    noise
        Standard deviation of the residuals in gray levels.
    """

    vector: NDArray[np.float64]
    covariance: NDArray[np.float64]
    gain: float
    score: float
    noise: float

    @property
    def pose(self) -> Pose:
        """The pose."""
        return Pose.of(self.vector)


def fit_array(
    image: NDArray[np.float64],
    corner: tuple[int, int],
    start: NDArray[np.float64],
    spread: NDArray[np.float64],
    weights: NDArray[np.float64],
    iterations: int,
) -> Fit:
    """Most probable pose of LEDs of known weights, by Gauss-Newton with robust weights.

    Parameters
    ----------
    image
        Pixels, (rows, columns): gain * array(pose) + a plane of background + noise.
    corner
        (x, y) on the sensor of ``image[0, 0]``.
    start, spread
        Expected pose vector (5,) and its covariance (5, 5): prior and start at once.
    weights
        (n, n) luminance of each LED: 1 for all on, +-1 for a header minus its inverse.
    iterations
        Gauss-Newton steps.

    Returns
    -------
    Fit
        Its covariance includes the prior's.
    """
    from heliograph.receive import kernels  # Numba is slow to import

    model = np.empty((6, *image.shape))
    precision = np.linalg.inv(spread)
    vector = start.copy()
    linear = _linear(image, _model(kernels, vector, weights, corner, model))
    rough = 0.0
    for _ in range(iterations):
        residual = image - np.tensordot(linear, _columns(model[0]), 1)
        rough = BIWEIGHT * _spread_of(residual)
        matrix, rhs = np.empty((9, 9)), np.concatenate([np.zeros(5), linear])
        mass, loss = kernels.normal_equations(image, model, linear[0], rough, matrix, rhs)
        noise = max(loss / max(mass - 9, 1.0), 0.08)
        matrix /= noise
        rhs /= noise
        matrix[:5, :5] += precision
        rhs[:5] += precision @ (start - vector)
        step = np.linalg.solve(matrix + 1e-9 * np.diag(np.diag(matrix)), rhs)
        vector = vector + np.clip(step[:5], *_step_limits(vector))
        linear = linear + step[5:]
        _model(kernels, vector, weights, corner, model)
    residual = image - np.tensordot(linear, _columns(model[0]), 1)
    covariance = np.linalg.inv(matrix)[:5, :5]
    return Fit(vector, covariance, float(linear[0]), _correlation(image, model[0]), _spread_of(residual))


def window_around(pose: Pose, side: int, margin: float) -> tuple[int, int, int, int]:
    """Corner and size (x, y, columns, rows) of the pixels around an array and `margin` px more."""
    half = 0.5 * side * pose.pitch * (abs(np.cos(pose.roll)) + abs(np.sin(pose.roll))) + margin
    x0, y0 = int(np.floor(pose.x - half)), int(np.floor(pose.y - half))
    return x0, y0, int(np.ceil(pose.x + half)) - x0 + 1, int(np.ceil(pose.y + half)) - y0 + 1


def _model(kernels, vector, weights, corner, model):  # type: ignore[no-untyped-def]
    kernels.render(vector, weights, float(corner[0]), float(corner[1]), model)
    return model[0]


def _columns(shape: NDArray[np.float64]) -> NDArray[np.float64]:
    """Images whose combination is the pixels: the array, a constant, slopes in x and y, (4, rows, columns)."""
    rows, cols = shape.shape
    y = ((np.arange(rows) - (rows - 1) / 2) / rows)[:, None] + np.zeros(cols)
    x = ((np.arange(cols) - (cols - 1) / 2) / cols)[None, :] + np.zeros((rows, 1))
    return np.stack([shape, np.ones_like(shape), x, y])


def _linear(image: NDArray[np.float64], shape: NDArray[np.float64]) -> NDArray[np.float64]:
    """Least squares gain and background plane, (4,)."""
    a = _columns(shape).reshape(4, -1)
    return np.linalg.solve(a @ a.T + 1e-9 * np.eye(4), a @ image.ravel())


def _spread_of(residual: NDArray[np.float64]) -> float:
    """Standard deviation by the median magnitude, at least half a gray level."""
    return max(1.4826 * float(np.median(np.abs(residual))), 0.5)


def _step_limits(vector: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Longest steps that keep the image's linear expansion true: about half a blur or a pitch."""
    reach = max(0.8, 0.5 * float(np.exp(vector[2])))
    limit = np.array([reach, reach, 0.1, 0.05, 0.2])
    return -limit, limit


def _correlation(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    x, y = a - a.mean(), b - b.mean()
    return float((x * y).sum() / np.sqrt(max((x * x).sum() * (y * y).sum(), 1e-12)))
