"""Reference for the LED image kernels in `kernels.py`, in plain NumPy."""

import numpy as np

from heliograph.base.arrays import Floats


def shapes(point: Floats, sigma: float, reach: float, size: tuple[int, int]) -> Floats:
    """Return a unit LED image and derivatives, (4, rows, columns).

    The image is g = exp(-r^2 / 2 sigma^2) / (2 pi sigma^2), truncated at `reach` px along x and y. Derivatives follow
    by x, y and ln sigma.
    """
    y, x = np.mgrid[: size[0], : size[1]] - point[::-1, None, None]
    g = np.exp(-(x**2 + y**2) / (2 * sigma**2)) / (2 * np.pi * sigma**2)
    near = (np.abs(x) <= reach) & (np.abs(y) <= reach)
    return np.asarray(np.stack([g, g * x / sigma**2, g * y / sigma**2, g * ((x**2 + y**2) / sigma**2 - 2)]) * near)


def gathered(image: Floats, points: Floats, sigma: float, reach: float) -> Floats:
    """Return inner products between an image and each LED image with derivatives, (n, 4)."""
    return np.array([(shapes(one, sigma, reach, image.shape) * image).sum(axis=(1, 2)) for one in points])


def drawn(amounts: Floats, points: Floats, sigma: float, reach: float, size: tuple[int, int]) -> Floats:
    """Return the weighted sum of LED images and derivatives; `amounts` holds weights (n, 4)."""
    pairs = zip(amounts, points, strict=True)
    return np.asarray(sum(np.tensordot(amount, shapes(one, sigma, reach, size), 1) for amount, one in pairs))
