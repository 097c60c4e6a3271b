"""The light that each LED gives the pixels of a window.

An LED's image is a Gaussian integrated over pixels: the product of a function of x and one of y, whatever the roll. A
blur matrix A, (pixels, LEDs), is therefore kept as two narrow arrays, an LED's light by column and by row.
"""

from functools import lru_cache
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

    def scaled(self, led_gains: Floats | None) -> "Footprints":
        """Footprints times the LEDs' gains."""
        if led_gains is None:
            return self
        return Footprints(self.across * by_squares(led_gains)[:, None], self.down, self.first)

    def dense(self, shape: tuple[int, int]) -> tuple[Floats, Floats]:
        """Light by column (n n, columns) and by row (n n, rows) over a whole window."""
        parts = []
        for narrow, first, count in (
            (self.across, self.first[:, 0], shape[1]),
            (self.down, self.first[:, 1], shape[0]),
        ):
            place = first[:, None] + np.arange(narrow.shape[1])
            inside = (place >= 0) & (place < count)
            whole = np.zeros((len(narrow), count))
            leds, columns = np.nonzero(inside)
            whole[leds, place[inside]] = narrow[leds, columns]
            parts.append(whole)
        return parts[0], parts[1]

    def all_on(self, shape: tuple[int, int]) -> Floats:
        """A 1, the image with all LEDs on, (rows, columns)."""
        image = np.zeros(shape)
        self.add_all_on(1.0, image)
        return image

    def add_all_on(self, level: float, image: Floats) -> None:
        """Add the image with all LEDs at one level to another."""
        kernels.add_image(np.full(len(self.across), level), *self, image)


def by_squares(grid: NDArray[Any]) -> NDArray[Any]:
    """Put values of LEDs in the order of `footprints`, square by square of 2 x 2, (n n,)."""
    half = len(grid) // 2
    return np.ascontiguousarray(grid.reshape(half, 2, half, 2).transpose(0, 2, 1, 3)).ravel()


def to_grid(values: Floats) -> Floats:
    """Put values of LEDs at their places, (n, n); the inverse of `by_squares`."""
    half = round(len(values) ** 0.5) // 2
    return np.ascontiguousarray(values.reshape(half, half, 2, 2).transpose(0, 2, 1, 3)).reshape(2 * half, 2 * half)


def image_of(levels: Floats, pose: Pose, corner: tuple[int, int], shape: tuple[int, int]) -> Floats:
    """Image of LEDs; an unresolved array of levels 1 has the image 1. Returns (rows, columns)."""
    image = np.zeros(shape)
    kernels.add_image(by_squares(levels), *_footprints(pose, corner, shape, len(levels)), image)
    return image


def images_of(
    levels: Floats, parts: NDArray[Any], count: int, pose: Pose, corner: tuple[int, int], shape: tuple[int, int]
) -> Floats:
    """Images of the parts of an array, each without the light of the others. Returns (count, rows, columns)."""
    images, numbers = np.zeros((count, *shape)), by_squares(parts).astype(np.int64)
    kernels.add_parts(by_squares(levels), numbers, *_footprints(pose, corner, shape, len(levels)), images)
    return images


@lru_cache(maxsize=512)  # a packet's poses are asked for again and again
def footprints(
    pose: Pose, corner: tuple[int, int], shape: tuple[int, int], side: int, motion: tuple[float, float] = (0.0, 0.0)
) -> Footprints:
    """Footprints of an array's LEDs."""
    return _footprints(pose, corner, shape, side, motion)


def _footprints(
    pose: Pose, corner: tuple[int, int], shape: tuple[int, int], side: int, motion: tuple[float, float] = (0.0, 0.0)
) -> Footprints:
    """`footprints` that nobody asks for again."""
    # sigma^2 = blur^2 + motion^2
    sigma = np.hypot(pose.blur, motion)
    width = kernels.footprint_width(float(sigma.max()))
    across, down = np.empty((side * side, width)), np.empty((side * side, width))
    first = np.empty((side * side, 2), np.int64)
    where = np.array([pose.x - corner[0], pose.y - corner[1], *pose.axes.ravel(), pose.pitch, *sigma])
    kernels.footprints(where, *shape, across, down, first)
    for part in (across, down, first):
        part.setflags(write=False)
    return Footprints(across, down, first)
