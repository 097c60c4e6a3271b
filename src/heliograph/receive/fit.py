"""Fit of the array's image to pixels: position, pitch, rotation and blur to a hundredth of a pixel."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from heliograph.receive.pose import Pose

Floats = NDArray[np.float64]

BIWEIGHT = 4.685
"""Residuals beyond this many standard deviations are taken for something else than the array (Tukey's biweight)."""

PANEL_MARGINS = (0.75, 2.0)
"""Rims in pitches of two squares around the LEDs: together they stand for a panel of unknown width and gray."""


@dataclass(frozen=True, slots=True)
class Fit:
    """The array's image found in pixels.

    Attributes
    ----------
    vector
        (x, y, ln pitch, roll, ln blur) of the pose, (5,), or with the tilt, (7,), as the prior.
    covariance
        Of what was fitted, (5, 5) or (7, 7), the prior's knowledge included.
    gain
        Luminance of the array with all weights 1, where it is not resolved, as gray levels.
    score
        Correlation of pixels and fitted image, -1 to 1; the image is that before the last step, if that was small.
    """

    vector: Floats
    covariance: Floats
    gain: float
    score: float

    @property
    def pose(self) -> Pose:
        """The pose."""
        return Pose.of(self.vector)


@dataclass(frozen=True, slots=True)
class Prior:
    """What is expected before a fit.

    Attributes
    ----------
    vector, covariance
        Pose vector (5,) or, with the tilt, (7,), and its covariance; the fit starts there. With a (5, 5) covariance
        the tilt is held.
    gain
        Expected gain, or 0 where it is unknown.
    """

    vector: Floats
    covariance: Floats
    gain: float = 0.0


CLOSE_PX, CLOSE, CLOSE_GAIN = 0.02, 0.02, 0.1
"""Steps of the array's rim, of ln blur and of the gain, as a share of it, up to which a fit has come to its end.

The next are a tenth of them; while the gain is wrong steps are too short or too long.
"""

GAIN_SPREAD = 0.15
"""Standard deviation of an expected gain, as a share of it."""


def fit_array(
    image: Floats,
    corner: tuple[int, int],
    prior: Prior,
    weights: Floats,
    iterations: int,
    panel: bool = False,
    start: Floats | None = None,
    resolved: bool = True,
) -> Fit:
    """Most probable pose of LEDs of known weights, by Gauss-Newton with robust weights.

    Parameters
    ----------
    image
        Pixels, (rows, columns): gain * array(pose) + a plane of background + noise.
    corner
        (x, y) on the sensor of ``image[0, 0]``.
    prior
        What is expected.
    weights
        (n, n) luminance of each LED: 1 for all on, +-1 for a header minus its inverse.
    iterations
        Most Gauss-Newton steps.
    panel
        Whether a panel darker or brighter than the background may surround the LEDs: it does in a sum of frames, it
        cancels in a difference.
    start
        Pose vector to start from; the prior's if None.
    resolved
        Whether LEDs may show singly. If not, all are taken as lit and the array as an even square, which is faster.

    Returns
    -------
    Fit
    """
    free = len(prior.covariance)
    scene = _Scene(image, corner, weights, panel, resolved, free)
    vector, precision = (prior.vector if start is None else start).copy(), np.linalg.inv(prior.covariance)
    scene.place(vector)
    linear = scene.coefficients(prior.gain)
    for _ in range(iterations):
        matrix, rhs = scene.equations(linear)
        # prior: (theta - theta_0)^T P^-1 (theta - theta_0), and the gain's
        matrix[:free, :free] += precision
        rhs[:free] += precision @ (prior.vector - vector)[:free]
        if prior.gain:
            weight = (GAIN_SPREAD * prior.gain) ** -2
            matrix[free, free] += weight
            rhs[free] += weight * (prior.gain - linear[0])
        step = np.asarray(np.linalg.solve(matrix + 1e-9 * np.diag(np.diag(matrix) + 1e-3), rhs), np.float64)
        limit = _step_limits(vector)[:free]
        vector[:free] += np.clip(step[:free], -limit, limit)
        linear = linear + step[free:]
        near = _rim_px(step[:free], vector, len(weights)) < CLOSE_PX and abs(step[4]) < CLOSE
        # pitch and blur of a header, by which distances are told, go on in small steps
        if panel and near and abs(step[free]) < CLOSE_GAIN * abs(linear[0]):
            break
        scene.place(vector)
    covariance = np.linalg.inv(matrix + 1e-9 * np.diag(np.diag(matrix) + 1e-3))[:free, :free]
    return Fit(
        vector,
        np.asarray(covariance, np.float64),
        float(linear[0]),
        correlation(image, image - scene.residual(linear)),
    )


class _Scene:
    """The images whose combination is the pixels, at a pose."""

    def __init__(self, image: Floats, corner: tuple[int, int], weights: Floats, panel: bool, resolved: bool, free: int):
        from heliograph.receive import kernels  # Numba is slow to import

        self._kernels, self._image, self._corner, self._weights = kernels, image, corner, weights
        self._resolved = resolved
        self._margins = PANEL_MARGINS if panel else ()
        shaped = 1 + len(self._margins)
        self._shapes = np.empty((shaped, 1 + free, *image.shape))
        self._plane = plane(*image.shape)
        self._residual = np.empty(image.shape)

    def place(self, vector: Floats) -> None:
        """Work the images out at a pose."""
        x0, y0 = float(self._corner[0]), float(self._corner[1])
        half = 0.5 * self._weights.shape[0]
        if self._resolved:
            self._kernels.render(vector, self._weights, x0, y0, self._shapes[0])
        else:
            self._kernels.render_box(vector, half, x0, y0, self._shapes[0])
        for shape, margin in zip(self._shapes[1:], self._margins, strict=True):
            self._kernels.render_box(vector, half + margin, x0, y0, shape)

    def coefficients(self, gain: float) -> Floats:
        """Least squares coefficients of the images, near an expected gain if there is one."""
        columns = np.concatenate([self._shapes[:, 0], self._plane])
        a = columns.reshape(len(columns), -1)
        matrix, rhs = a @ a.T, a @ self._image.ravel()
        if gain:
            weight = 1e3 * matrix[0, 0]
            matrix[0, 0] += weight
            rhs[0] += weight * gain
        return np.asarray(np.linalg.solve(matrix + 1e-6 * np.diag(np.diag(matrix) + 1e-3), rhs))

    def equations(self, linear: Floats) -> tuple[Floats, Floats]:
        """Normal equations of steps in pose and coefficients, in units of the noise found."""
        size = self._shapes.shape[1] - 1 + len(linear)
        matrix, rhs = np.empty((size, size)), np.empty(size)
        rough = BIWEIGHT * _noise_of(self.residual(linear))
        mass, loss = self._kernels.normal_equations(self._image, self._shapes, self._plane, linear, rough, matrix, rhs)
        noise = max(loss / max(mass - size, 1.0), 0.08)
        return matrix / noise, rhs / noise

    def residual(self, linear: Floats) -> Floats:
        """Pixels less the images, (rows, columns); overwritten by the next call."""
        self._kernels.residuals(self._image, self._shapes, self._plane, linear, self._residual)
        return self._residual


def window_around(pose: Pose, side: int, margin: float) -> tuple[int, int, int, int]:
    """Corner and size (x, y, columns, rows) of the pixels around an array and `margin` px more."""
    across, down = 0.5 * side * np.abs(pose.axes).sum(1) + margin
    x0, y0 = int(np.floor(pose.x - across)), int(np.floor(pose.y - down))
    return x0, y0, int(np.ceil(pose.x + across)) - x0 + 1, int(np.ceil(pose.y + down)) - y0 + 1


@lru_cache(maxsize=64)  # windows about arrays have few sizes
def plane(rows: int, cols: int) -> Floats:
    """A constant and slopes in x and y, (3, rows, columns), not to be written to."""
    y = ((np.arange(rows) - (rows - 1) / 2) / rows)[:, None] + np.zeros(cols)
    x = ((np.arange(cols) - (cols - 1) / 2) / cols)[None, :] + np.zeros((rows, 1))
    return np.stack([np.ones((rows, cols)), x, y])


def spread_of(values: Floats) -> float:
    """Standard deviation of values about 0, by their median magnitude; NumPy's own median takes many times as long."""
    middle = [(values.size - 1) // 2, values.size // 2]
    low, high = np.partition(np.abs(values).ravel(), middle)[middle]
    return 0.7413 * float(low + high)


def _noise_of(residual: Floats) -> float:
    """Standard deviation of residuals, at least half a gray level."""
    return max(spread_of(residual), 0.5)


def _step_limits(vector: Floats) -> Floats:
    """Longest steps that keep the image's linear expansion true: about half a blur or a pitch."""
    reach = max(0.8, 0.5 * float(np.exp(vector[2])))
    return np.array([reach, reach, 0.1, 0.05, 0.2, 0.05, 0.05])


def _rim_px(step: Floats, vector: Floats, side: int) -> float:
    """How far a step moves the rim of an array."""
    half = 0.5 * side * float(np.exp(vector[2]))
    return float(np.abs(step[:2]).max() + half * np.abs(step[[2, 3, *range(5, len(step))]]).max())


def correlation(a: Floats, b: Floats) -> float:
    """Correlation of two images, -1 to 1."""
    x, y = (a - a.mean()).ravel(), (b - b.mean()).ravel()
    return float(x @ y / np.sqrt(max((x @ x) * (y @ y), 1e-12)))
