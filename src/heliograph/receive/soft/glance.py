"""Glances: pairs of frames cut out about the array, and the light its LEDs give the pixels of such a window."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.receive import kernels as plain
from heliograph.receive.detect import cut_out
from heliograph.receive.fit import window_around
from heliograph.receive.pose import Pose
from heliograph.receive.soft import kernels
from heliograph.receive.soft.mix import Mix

Floats = NDArray[np.float64]
Shares = tuple[Floats, Floats, NDArray[np.int64]]
"""Of each LED by column and by row, (n n, width) each, and its first column and row (n n, 2)."""

MARGIN_PX = 2.0
"""Pixels beyond the array that are used: LEDs on the rim shine there."""

RING_PX = 2.0
"""Pixels beyond those that tell what changes behind the array."""


@dataclass(frozen=True, slots=True)
class Glance:
    """A pair of frames about the array, kept until its packet is whole.

    Attributes
    ----------
    total, change
        Sum and difference of pattern and inverse in gray levels, (rows, columns); of a single frame both are twice what
        it shows above the background.
    corner
        (x, y) on the sensor of the first pixel.
    poses
        Where the light of the data was in each frame: in the middle of the exposure; one or two.
    still
        Of a single frame, where the light of the levels' mean was, which is earlier.
    mix
        What the pair was combined of; None if it is two frames in step.
    inside
        1 in columns, and rows, that all frames have, 0 in those that repeat a frame's border; None if they have all.
    """

    total: Floats
    change: Floats
    corner: tuple[int, int]
    poses: tuple[Pose, ...]
    still: Pose | None = None
    mix: Mix | None = None
    inside: tuple[Floats, Floats] | None = None

    @property
    def middle(self) -> Pose:
        """The pose between the two; of one its own."""
        return self.poses[0] if len(self.poses) == 1 else Pose.between(self.poses[0], self.poses[-1])

    def slopes(self, levels: Floats) -> Floats:
        """Derivatives of the image of LEDs of given levels (n, n) by x, y, ln pitch and roll, (4, rows, columns)."""
        image = np.empty((6, *self.change.shape))
        plain.render(self.middle.full_vector(), levels, float(self.corner[0]), float(self.corner[1]), image)
        return image[1:5]

    def steadied(self, gain: float, shares: Floats) -> "Glance":
        """The glance without the light from behind that does not cancel: it moves with the array between the frames.

        The sum of a pair is twice what is behind, and the array with all LEDs on, of a gain and shares (n, n) of each
        LED's light.
        """
        if len(self.poses) != 2 or self.mix is not None:
            return self
        first, second = self.poses
        steady = np.empty_like(self.change)
        lit = image_of(shares, first, self.corner, steady.shape) + image_of(shares, second, self.corner, steady.shape)
        # b(x - p_1) - b(x - p_2) = (p_2 - p_1) grad b, b = (r + r' - g (A_1 + A_2) 1 / 2) / 2
        kernels.steadied(self.change, self.total, lit, 0.5 * gain, second.x - first.x, second.y - first.y, steady)
        return replace(self, change=steady)

    def moved(self, error: Floats) -> "Glance":
        """The glance with its poses off by `error` in x, y, ln pitch and roll."""
        step = np.append(error, np.zeros(3))
        return replace(self, poses=tuple(Pose.of(pose.full_vector() + step) for pose in self.poses))


def take_glance(pattern: Frame, inverted: Frame, poses: tuple[Pose, Pose], side: int, mix: Mix | None = None) -> Glance:
    """Cut a pair of frames out.

    Parameters
    ----------
    pattern, inverted
        The two frames.
    poses
        See `Glance`.
    side
        LEDs in a row.
    mix
        See `Glance`.
    """
    middle = Pose.between(*poses)
    x0, y0, cols, rows = window_around(middle, side, MARGIN_PX + RING_PX)
    up, down = (cut_out(frame, x0, y0, cols, rows) for frame in (pattern, inverted))
    return Glance(
        up + down, up - down, (x0, y0), poses, mix=mix, inside=within((pattern, inverted), (x0, y0), up.shape)
    )


def within(frames: Sequence[Frame], corner: tuple[int, int], shape: tuple[int, int]) -> tuple[Floats, Floats] | None:
    """See `Glance.inside`; of a window with a corner (x, y) and a shape (rows, columns)."""
    sides = []
    for axis in (0, 1):
        first = max(frame.origin[axis] for frame in frames)
        end = min(frame.origin[axis] + frame.pixels.shape[1 - axis] for frame in frames)
        place = corner[axis] + np.arange(shape[1 - axis])
        sides.append(((place >= first) & (place < end)).astype(np.float64))
    return None if sides[0].all() and sides[1].all() else (sides[0], sides[1])


def of_squares(grid: Floats) -> Floats:
    """Values of LEDs (n, n) in the order of the squares of 2 x 2, (n n,)."""
    half = len(grid) // 2
    return np.ascontiguousarray(grid.reshape(half, 2, half, 2).transpose(0, 2, 1, 3)).ravel()


def to_grid(values: Floats) -> Floats:
    """Values of LEDs (n n,) in the order of the squares of 2 x 2 back in their places, (n, n)."""
    half = round(len(values) ** 0.5) // 2
    return np.ascontiguousarray(values.reshape(half, half, 2, 2).transpose(0, 2, 1, 3)).reshape(2 * half, 2 * half)


def image_of(levels: Floats, pose: Pose, corner: tuple[int, int], shape: tuple[int, int]) -> Floats:
    """Image of LEDs of given levels, (rows, columns): 1 where a wide array of levels 1 is.

    Parameters
    ----------
    levels
        (n, n) of the LEDs.
    pose
        The array's.
    corner, shape
        (x, y) on the sensor of the first pixel, rows and columns.
    """
    image = np.zeros(shape)
    kernels.shine(of_squares(levels), *placed(pose, corner, shape, len(levels)), image)
    return image


def dimmed(share: Shares, shares: Floats | None) -> Shares:
    """Shares of the LEDs' light with what each LED gives of it."""
    return share if shares is None else (share[0] * of_squares(shares)[:, None], *share[1:])


def all_on(share: Shares, shape: tuple[int, int]) -> Floats:
    """A 1, the image of all LEDs, (rows, columns)."""
    image = np.zeros(shape)
    kernels.shine(np.ones(len(share[0])), *share, image)
    return image


@lru_cache(maxsize=512)  # a packet's poses are asked for again and again
def placed(
    pose: Pose, corner: tuple[int, int], shape: tuple[int, int], side: int, spread: tuple[float, float] = (0.0, 0.0)
) -> Shares:
    """Light of each LED by column and row of a window; `spread` is a standard deviation added to the blur's."""
    sigma = np.hypot(pose.blur, spread)
    width = kernels.support(float(sigma.max()))
    across, down = np.empty((side * side, width)), np.empty((side * side, width))
    first = np.empty((side * side, 2), np.int64)
    where = np.array([pose.x - corner[0], pose.y - corner[1], *pose.axes.ravel(), pose.pitch, *sigma])
    kernels.place(where, *shape, across, down, first)
    return across, down, first
