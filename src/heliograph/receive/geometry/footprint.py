"""Footprints of LEDs: the light of each LED on the pixels of a window.

An LED's image is a Gaussian integrated over pixels: the product of a function of x and a function of y, for any roll.
Two narrow arrays, the light by column and by row, therefore represent a blur matrix A, (pixels, LEDs).
"""

from functools import lru_cache
from math import ceil
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import Floats
from heliograph.receive.geometry import kernels
from heliograph.receive.geometry.pose import Pose


class Footprints(NamedTuple):
    """A blur matrix A as products: LED k gives pixel (i, j) of the window ``down[k, i'] * across[k, j']``."""

    # (n n, width) light by column, from ``first[k, 0]`` on
    across: Floats
    # (n n, width) light by row, from ``first[k, 1]`` on
    down: Floats
    # (n n, 2) int64, first column and row
    first: NDArray[np.int64]

    def dense(self, shape: tuple[int, int]) -> tuple[Floats, Floats]:
        """Expand to the light by column (n n, columns) and by row (n n, rows) of a window."""
        count = len(self.across)
        across, down = np.zeros((count, shape[1])), np.zeros((count, shape[0]))
        for wide, narrow, first in ((across, self.across, self.first[:, :1]), (down, self.down, self.first[:, 1:])):
            index = first + np.arange(narrow.shape[1])
            leds, pixels = np.nonzero((index >= 0) & (index < wide.shape[1]))
            wide[leds, index[leds, pixels]] = narrow[leds, pixels]
        return across, down


def by_squares(grid: NDArray[Any]) -> NDArray[Any]:
    """Sort values of LEDs like `footprints`, by squares of 2 x 2, (n n,)."""
    half = len(grid) // 2
    return np.ascontiguousarray(grid.reshape(half, 2, half, 2).transpose(0, 2, 1, 3)).ravel()


def to_grid(values: Floats) -> Floats:
    """Arrange values of LEDs as a grid, (n, n); the inverse of `by_squares`."""
    half = round(len(values) ** 0.5) // 2
    return np.ascontiguousarray(values.reshape(half, half, 2, 2).transpose(0, 2, 1, 3)).reshape(2 * half, 2 * half)


def image_of(levels: Floats, pose: Pose, corner: tuple[int, int], shape: tuple[int, int]) -> Floats:
    """Render LEDs, (rows, columns); an unresolved array of levels 1 has the image 1."""
    image = np.zeros(shape)
    kernels.add_image(by_squares(levels), *footprints(pose, corner, shape, len(levels)), image)
    return image


def images_of(
    levels: Floats, parts: NDArray[Any], count: int, pose: Pose, corner: tuple[int, int], shape: tuple[int, int]
) -> Floats:
    """Render each part of an array separately, (count, rows, columns)."""
    return np.stack([image_of(np.where(parts == part, levels, 0.0), pose, corner, shape) for part in range(count)])


def render_with_slopes(pose: Pose, levels: Floats, corner: tuple[int, int], shape: tuple[int, int]) -> Floats:
    """Render LEDs and the derivatives by (x, y, ln pitch, roll, ln blur), (6, rows, columns)."""
    images = np.empty((6, *shape))
    kernels.render(pose.full_vector(), levels, float(corner[0]), float(corner[1]), images, 0.0, 0.0)
    return images


@lru_cache(maxsize=512)  # decoding needs the poses of a packet many times
def footprints(
    pose: Pose, corner: tuple[int, int], shape: tuple[int, int], side: int, motion: tuple[float, float] = (0.0, 0.0)
) -> Footprints:
    """Compute the footprints of an array's LEDs."""
    # sigma^2 = blur^2 + motion^2
    sigma = np.hypot(pose.blur, motion)
    # beyond 3.7 standard deviations lies 2e-4 of an LED's light
    width = 2 * ceil(3.7 * float(sigma.max()) + 0.5) + 1
    across, down = np.empty((side * side, width)), np.empty((side * side, width))
    first = np.empty((side * side, 2), np.int64)
    where = np.array([pose.x - corner[0], pose.y - corner[1], *pose.axes.ravel(), pose.pitch, *sigma])
    kernels.footprints(where, *shape, across, down, first)
    for part in (across, down, first):
        part.setflags(write=False)
    return Footprints(across, down, first)
