"""Reference for the rendering kernels in `kernels.py`: plain NumPy, unbounded PSF."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from heliograph.base.arrays import Floats
from heliograph.receive.geometry.pose import Pose

Corner = tuple[float, float]
"""Sensor position (x, y) of a window's first pixel."""

Smear = tuple[float, float]
"""Standard deviations in px along x and y for motion blur."""


def render(
    vector: Floats, weights: Floats, corner: Corner, shape: tuple[int, int], smear: Smear = (0.0, 0.0)
) -> Floats:
    """Return LED image and pose derivatives, (6 or 8, rows, columns)."""

    def image(vector: Floats) -> Floats:
        # image = pitch^2 sum_uv w_uv g(column - x_uv) g(row - y_uv)
        pose = Pose.from_vector(vector)
        across, down = _led_light(pose, len(weights), corner, shape, smear)
        return np.asarray(pose.pitch**2 * (weights.reshape(-1, 1) * down).T @ across)

    return _with_derivatives(image, vector)


def render_box(
    vector: Floats, half_leds: float, corner: Corner, shape: tuple[int, int], smear: Smear = (0.0, 0.0)
) -> Floats:
    """Return a blurred square and derivatives, (6 or 8, rows, columns); blur and tilt derivatives stay 0."""

    def image(vector: Floats) -> Floats:
        pose = Pose.from_vector(vector)
        # pixel integration adds variance 1/12
        half, sigma = half_leds * pose.pitch, np.sqrt(pose.blur**2 + 1 / 12 + np.square(smear))
        dy, dx = np.mgrid[: shape[0], : shape[1]] + np.reshape([corner[1] - pose.y, corner[0] - pose.x], (2, 1, 1))
        back = pose.pitch * np.linalg.inv(pose.axes)
        along, across = np.tensordot(back, np.stack([dx, dy]), 1)
        widths = np.linalg.norm(back * sigma, axis=1)
        # strip(t) = Phi((half - t) / sigma) - Phi((-half - t) / sigma); square = strip(along) strip(across)
        strips = [ndtr((half - t) / w) - ndtr((-half - t) / w) for t, w in zip((along, across), widths, strict=True)]
        return np.asarray(strips[0] * strips[1])

    out = _with_derivatives(image, vector)
    out[5:] = 0.0
    return out


def _with_derivatives(image: Callable[[Floats], Floats], vector: Floats) -> Floats:
    """Append central differences (f(v + h) - f(v - h)) / 2 h by each parameter."""
    # in px, rad or log units; rounding and truncation errors are both near 1e-10
    step = 1e-5
    steps = step * np.eye(len(vector))
    return np.stack([image(vector), *((image(vector + h) - image(vector - h)) / (2 * step) for h in steps)])


def pixel_light(pixels: NDArray[Any], centres: Floats, sigma: float) -> Floats:
    """Return the fraction of each Gaussian on each pixel, (centres, pixels)."""
    # g(t) = Phi((t + 1/2) / sigma) - Phi((t - 1/2) / sigma)
    t = pixels - centres[:, None]
    return np.asarray(ndtr((t + 0.5) / sigma) - ndtr((t - 0.5) / sigma))


def _led_light(pose: Pose, side: int, corner: Corner, shape: tuple[int, int], smear: Smear) -> tuple[Floats, Floats]:
    """Return the fraction of each LED's light on each column and row, (n n, columns) and (n n, rows)."""
    points, (wide, high) = pose.leds(side).reshape(-1, 2), np.hypot(pose.blur, smear)
    across = pixel_light(np.arange(shape[1]) + corner[0], points[:, 0], float(wide))
    return across, pixel_light(np.arange(shape[0]) + corner[1], points[:, 1], float(high))


def blur_matrix(
    pose: Pose, side: int, corner: tuple[int, int], shape: tuple[int, int], motion: tuple[float, float] = (0.0, 0.0)
) -> Floats:
    """Return A, (pixels, n n LEDs row by row): each LED's Gaussian integrated over window pixels."""
    across, down = _led_light(pose, side, corner, shape, motion)
    # each LED emits pitch^2, so that an unresolved array with all LEDs on has image 1
    return np.asarray(pose.pitch**2 * np.einsum("ki,kj->ijk", down, across).reshape(-1, side * side))
