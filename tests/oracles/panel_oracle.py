"""The images of LEDs written for reading: plain NumPy, no tricks.

Nothing runs on these but the tests that hold `kernels.py` to them.
"""

import numpy as np

from heliograph.base.arrays import Floats


def shapes(point: Floats, sigma: float, reach: float, size: tuple[int, int]) -> Floats:
    """Image of an LED of the light 1, and its derivatives.

    Parameters
    ----------
    point
        (2,) place (x, y) of the LED in px.
    sigma
        Standard deviation of its image in px.
    reach
        Distance in px along x and y beyond which it is 0.
    size
        Rows and columns of the image.

    Returns
    -------
    (4, rows, columns): g = exp(-r^2 / 2 sigma^2) / (2 pi sigma^2), its derivatives by x and y of the place, and by
    ln sigma.
    """
    y, x = np.mgrid[: size[0], : size[1]] - point[::-1, None, None]
    g = np.exp(-(x**2 + y**2) / (2 * sigma**2)) / (2 * np.pi * sigma**2)
    near = (np.abs(x) <= reach) & (np.abs(y) <= reach)
    return np.asarray(np.stack([g, g * x / sigma**2, g * y / sigma**2, g * ((x**2 + y**2) / sigma**2 - 2)]) * near)


def gathered(image: Floats, points: Floats, sigma: float, reach: float) -> Floats:
    """Inner products of an image with each LED's image and its derivatives.

    Parameters
    ----------
    image
        (rows, columns) gray levels.
    points
        (n, 2) places of the LEDs in px.
    sigma, reach
        Standard deviation of an LED's image, and how far it is taken, in px.

    Returns
    -------
    (n, 4).
    """
    return np.array([(shapes(one, sigma, reach, image.shape) * image).sum(axis=(1, 2)) for one in points])


def drawn(amounts: Floats, points: Floats, sigma: float, reach: float, size: tuple[int, int]) -> Floats:
    """Sum of the images of LEDs and of their derivatives.

    Parameters
    ----------
    amounts
        (n, 4) how much of each.
    points
        (n, 2) places of the LEDs in px.
    sigma, reach
        Standard deviation of an LED's image, and how far it is taken, in px.
    size
        Rows and columns of the image.

    Returns
    -------
    (rows, columns).
    """
    pairs = zip(amounts, points, strict=True)
    return np.asarray(sum(np.tensordot(amount, shapes(one, sigma, reach, size), 1) for amount, one in pairs))
