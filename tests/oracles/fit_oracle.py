"""Reference for `gauss_newton.py`: pose fit in plain NumPy, one matrix row per pixel."""

from collections.abc import Sequence

import numpy as np
from render_oracle import Corner, render, render_box

from heliograph.base.arrays import Floats


def fit(
    image: Floats,
    corner: Corner,
    weights: Floats,
    margins: Sequence[float],
    prior: Floats,
    precision: Floats,
    gain: float,
    steps: int,
) -> tuple[Floats, Floats, Floats]:
    """Return the most probable pose by robust Gauss-Newton."""
    vector, free, size = prior.copy(), len(precision), (image.shape[0], image.shape[1])
    shapes = _shapes(vector, weights, margins, corner, size)
    linear = _first(image, shapes, gain)
    for _ in range(steps):
        values, slopes = shapes[:, 0], np.tensordot(linear[: len(shapes)], shapes[:, 1:], 1)
        columns = np.concatenate([values, _plane(image.shape)])
        # one row per pixel: derivatives by pose, then by coefficients
        rows = np.concatenate([slopes, columns]).reshape(free + len(columns), -1).T
        residual = (image - np.tensordot(linear, columns, 1)).ravel()
        spread = max(float(np.median(np.abs(residual))) / 0.674490, 0.5)
        # Tukey's biweight with 95 % efficiency
        weight = np.clip(1 - (residual / (4.685 * spread)) ** 2, 0, None) ** 2
        # lower bound: rounding noise
        noise = max(float(weight @ residual**2) / max(float(weight.sum()) - rows.shape[1], 1.0), 0.08)
        matrix, rhs = (rows.T * weight) @ rows / noise, (rows.T * weight) @ residual / noise
        # (J^T W J + P^-1) step = J^T W r + P^-1 (theta_0 - theta), and the same for the gain
        matrix[:free, :free] += precision
        rhs[:free] += precision @ (prior - vector)[:free]
        if gain:
            matrix[free, free] += (0.5 * gain) ** -2
            rhs[free] += (0.5 * gain) ** -2 * (gain - linear[0])
        matrix += 1e-9 * np.diag(np.diag(matrix) + 1e-3)
        step = np.linalg.solve(matrix, rhs)
        linear = linear + step[free:]
        reach = max(0.8, 0.5 * np.exp(vector[2]))
        longest = np.array([reach, reach, 0.1, 0.05, 0.2, 0.05, 0.05])[:free]
        vector[:free] += np.clip(step[:free], -longest, longest)
        rim = 0.5 * len(weights) * np.exp(vector[2]) * np.abs(np.delete(step[2:free], 2)).max()
        moved = (np.abs(step[:2]).max() + rim, abs(step[4]), abs(step[free] / linear[0]))
        if margins and np.less(moved, (0.02, 0.02, 0.1)).all():
            break
        shapes = _shapes(vector, weights, margins, corner, size)
    return vector, matrix, linear


def _shapes(vector: Floats, weights: Floats, margins: Sequence[float], corner: Corner, size: tuple[int, int]) -> Floats:
    """Return images and derivatives for LEDs and enclosing squares."""
    boxes = [render_box(vector, 0.5 * len(weights) + margin, corner, size) for margin in margins]
    return np.stack([render(vector, weights, corner, size), *boxes])


def _plane(shape: tuple[int, ...]) -> Floats:
    """Return a constant and slopes in x and y."""
    y, x = np.mgrid[: shape[0], : shape[1]]
    return np.stack([np.ones(shape), (x - x.mean()) / shape[1], (y - y.mean()) / shape[0]])


def _first(image: Floats, shapes: Floats, gain: float) -> Floats:
    """Return least-squares coefficients; a gain prior constrains the LED coefficient."""
    a = np.concatenate([shapes[:, 0], _plane(image.shape)]).reshape(len(shapes) + 3, -1)
    matrix, rhs = a @ a.T, a @ image.ravel()
    if gain:
        rhs[0] += 1e3 * matrix[0, 0] * gain
        matrix[0, 0] *= 1 + 1e3
    return np.asarray(np.linalg.solve(matrix + 1e-6 * np.diag(np.diag(matrix) + 1e-3), rhs))
