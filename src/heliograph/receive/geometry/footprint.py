"""Footprints of LEDs: the light of each LED on the pixels of a window.

An LED's image is a Gaussian integrated over pixels: the product of a function of x and a function of y, for any roll.
Two arrays, the light by column and by row, therefore represent a blur matrix A, (pixels, LEDs).
"""

from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import Floats
from heliograph.receive.geometry import kernels
from heliograph.receive.geometry.pose import Corner, Pose, Shape

# a blur matrix A: light of each LED by column (n n, columns) and by row (n n, rows), whose product is its image
Footprints = tuple[Floats, Floats]


def to_quarters(grid: NDArray[Any]) -> NDArray[Any]:
    """Order LEDs like symbols, (n n,): those at (0, 0), (0, 1), (1, 0) and (1, 1) of all squares of 2 x 2."""
    half = len(grid) // 2
    return np.ascontiguousarray(grid.reshape(half, 2, half, 2).transpose(1, 3, 0, 2)).ravel()


def to_grid(values: Floats) -> Floats:
    """Arrange values of LEDs as a grid, (n, n); the inverse of `to_quarters`."""
    half = round(len(values) ** 0.5) // 2
    return np.ascontiguousarray(values.reshape(2, 2, half, half).transpose(2, 0, 3, 1)).reshape(2 * half, 2 * half)


def image_of(levels: Floats, pose: Pose, corner: Corner, shape: Shape) -> Floats:
    """Render LEDs, (rows, columns); an unresolved array of levels 1 has the image 1."""
    # not kept: an array is hardly twice at the same pose
    return sum_of_leds(to_quarters(levels), footprints.__wrapped__(pose, corner, shape, len(levels)))


@lru_cache(maxsize=160)  # decoding needs the images of a packet several times
def kept_image(levels: bytes, pose: Pose, corner: Corner, shape: Shape) -> Floats:
    """Render LEDs as `image_of`, of given bytes of the levels in quarters; read-only."""
    values = np.frombuffer(levels)
    image = sum_of_leds(values, footprints(pose, corner, shape, round(len(values) ** 0.5)))
    image.setflags(write=False)
    return image


def sum_of_leds(levels: Floats, light: Footprints) -> Floats:
    """Add up the light of LEDs (n n,) in quarters, (rows, columns)."""
    across, down = light
    return np.asarray((levels[:, None] * down).T @ across)


def images_of(levels: Floats, leds: NDArray[Any], pose: Pose, corner: Corner, shape: Shape) -> Floats:
    """Render each of equal parts of an array, (parts, rows, columns), from places in quarters (parts, LEDs)."""
    across, down = footprints.__wrapped__(pose, corner, shape, len(levels))
    return np.asarray((to_quarters(levels)[leds][:, :, None] * down[leds]).transpose(0, 2, 1) @ across[leds])


def render_with_slopes(pose: Pose, levels: Floats, corner: Corner, shape: Shape) -> Floats:
    """Render LEDs and the derivatives by (x, y, ln pitch, roll, ln blur), (6, rows, columns)."""
    images = np.empty((6, *shape))
    kernels.render(pose.full_vector(), levels, float(corner[0]), float(corner[1]), images, 0.0, 0.0)
    return images


@lru_cache(maxsize=160)  # decoding needs the poses of a packet several times
def footprints(
    pose: Pose, corner: Corner, shape: Shape, side: int, motion: tuple[float, float] = (0.0, 0.0)
) -> Footprints:
    """Compute the footprints of an array's LEDs, in quarters."""
    # sigma^2 = blur^2 + motion^2
    sigma = np.hypot(pose.blur, motion)
    across, down = np.empty((side * side, shape[1])), np.empty((side * side, shape[0]))
    where = np.array([pose.x - corner[0], pose.y - corner[1], *pose.axes.ravel(), pose.pitch, *sigma])
    kernels.footprints(where, across, down)
    for part in (across, down):
        part.setflags(write=False)
    return across, down
