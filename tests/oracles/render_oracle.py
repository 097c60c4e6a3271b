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
        x, y, log_pitch, roll, log_blur = vector[:5]
        stretch, shear = vector[5:] if len(vector) == 7 else (0.0, 0.0)
        pitch, blur = np.exp(log_pitch), np.exp(log_blur)
        grid = (np.arange(len(weights)) - (len(weights) - 1) / 2) * pitch
        v, u = np.meshgrid(grid, grid)
        # (x, y)_uv = (x, y) + pitch R(roll) [[1 + stretch, shear], [shear, 1 - stretch]] (v, u)
        v, u = (1 + stretch) * v + shear * u, shear * v + (1 - stretch) * u
        led_x = x + np.cos(roll) * v - np.sin(roll) * u
        led_y = y + np.sin(roll) * v + np.cos(roll) * u
        # image = pitch^2 sum_uv w_uv g(column - x_uv) g(row - y_uv)
        wide, high = np.hypot(blur, smear)
        across = pixel_light(np.arange(shape[1]) + corner[0], led_x.ravel(), float(wide))
        down = pixel_light(np.arange(shape[0]) + corner[1], led_y.ravel(), float(high))
        return np.asarray(pitch**2 * (weights.reshape(-1, 1) * down).T @ across)

    return _with_derivatives(image, vector)


def render_box(
    vector: Floats, half_leds: float, corner: Corner, shape: tuple[int, int], smear: Smear = (0.0, 0.0)
) -> Floats:
    """Return a blurred square and derivatives, (6 or 8, rows, columns); blur and tilt derivatives stay 0."""

    def image(vector: Floats) -> Floats:
        half, roll = half_leds * np.exp(vector[2]), vector[3]
        # pixel integration adds variance 1/12
        sigma = np.sqrt(np.exp(vector[4]) ** 2 + 1 / 12 + np.square(smear))
        offset = np.reshape([corner[1] - vector[1], corner[0] - vector[0]], (2, 1, 1))
        dy, dx = np.mgrid[: shape[0], : shape[1]] + offset
        stretch, shear = vector[5:] if len(vector) == 7 else (0.0, 0.0)
        back = np.linalg.inv([[1 + stretch, shear], [shear, 1 - stretch]])
        back = back @ np.array([[np.cos(roll), np.sin(roll)], [-np.sin(roll), np.cos(roll)]])
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


def blur_matrix(
    pose: Pose, side: int, corner: tuple[int, int], shape: tuple[int, int], motion: tuple[float, float] = (0.0, 0.0)
) -> Floats:
    """Return A, (pixels, n n LEDs row by row): each LED's Gaussian integrated over window pixels."""
    points = pose.leds(side).reshape(-1, 2)
    across = pixel_light(np.arange(shape[1]) + corner[0], points[:, 0], float(np.hypot(pose.blur, motion[0])))
    down = pixel_light(np.arange(shape[0]) + corner[1], points[:, 1], float(np.hypot(pose.blur, motion[1])))
    # each LED emits pitch^2, so that an unresolved array with all LEDs on has image 1
    return np.asarray(pose.pitch**2 * np.einsum("ki,kj->ijk", down, across).reshape(-1, side * side))
