"""Looks: what a pattern and its inverse say about the cells of their data, reduced to a matrix and two vectors.

With A_1 and A_2 what each LED gives each pixel in the two frames, x the LEDs' levels 0 to 1 and the background equal in
both frames, the difference of the frames is

    d = g (A_1 x - A_2 (1 - x)) + n = g (B c + o) + n,   B = (A_1 + A_2) / 2 T,   o = (A_1 - A_2) 1 / 2

where 2 x - 1 = T c, T the Haar transform of equation (8) as 1/4 H^T D H and c the data +-1 in the order of the cells.
With W the pixels' weights, all that remains of them is B^T W d, beside B^T W B and B^T W o which the poses decide.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.receive.detect import cut_out
from heliograph.receive.fit import window_around
from heliograph.receive.pose import Pose
from heliograph.receive.soft import kernels

Floats = NDArray[np.float64]
Shares = tuple[Floats, Floats, NDArray[np.int64]]
"""Of each LED by column and by row, (n n, width) each, and its first column and row (n n, 2)."""

MARGIN_PX = 2.0
"""Pixels beyond the array that are used: LEDs on the rim shine there."""

RING_PX = 2.0
"""Pixels beyond those that tell what changes behind the array."""

INSIDE = 0.8
"""Share of the array's light from which on a pixel lies inside the array."""

LEAST_NOISE = 1 / 6
"""Variance in squared gray levels that rounding alone gives a difference of two frames."""


@dataclass(frozen=True, slots=True)
class Glance:
    """A pair of frames about the array, kept until its packet is whole.

    Attributes
    ----------
    total, change
        Sum and difference of pattern and inverse in gray levels, (rows, columns).
    corner
        (x, y) on the sensor of the first pixel.
    poses
        Where the light of the data was in each frame: in the middle of the exposure.
    """

    total: Floats
    change: Floats
    corner: tuple[int, int]
    poses: tuple[Pose, Pose]

    @property
    def middle(self) -> Pose:
        """The pose between the two."""
        return Pose.of(0.5 * (self.poses[0].vector() + self.poses[1].vector()))


@dataclass(frozen=True, slots=True)
class Noise:
    """Variance of a pixel of a difference of two frames in squared gray levels.

    Attributes
    ----------
    lit
        Inside the array: mostly photons.
    dark
        Beside it: the sensor's own, and what changes behind the array.
    """

    lit: float
    dark: float


@dataclass(frozen=True, slots=True)
class Look:
    """A pair of frames as the equaliser sees it; gain and noise are left open.

    Attributes
    ----------
    gram
        B^T W B, (cells, cells) float32.
    seen
        B^T W d, (cells,) in gray levels.
    offset
        B^T W o, (cells,).
    cross, drift
        d^T W o and o^T W o.
    """

    gram: NDArray[np.float32]
    seen: Floats
    offset: Floats
    cross: float
    drift: float


def take_glance(pattern: Frame, inverted: Frame, poses: tuple[Pose, Pose], side: int) -> Glance:
    """Cut a pair of frames out.

    Parameters
    ----------
    pattern, inverted
        The two frames.
    poses
        See `Glance`.
    side
        LEDs in a row.
    """
    middle = Pose.of(0.5 * (poses[0].vector() + poses[1].vector()))
    x0, y0, cols, rows = window_around(middle, side, MARGIN_PX + RING_PX)
    up, down = (cut_out(frame, x0, y0, cols, rows) for frame in (pattern, inverted))
    return Glance(up + down, up - down, (x0, y0), poses)


def measure_noise(glances: Sequence[Glance], gain: float, side: int) -> Noise:
    """Noise of a packet's glances.

    Inside the array the sum of a pair is even but for noise, which is that of the difference, and for what motion
    between the two frames leaves of the data. Beside the array the difference is noise and what has changed there.

    Parameters
    ----------
    glances
        Of the packet.
    gain
        Gray levels of a wide array with all LEDs on.
    side
        LEDs in a row.
    """
    parts = np.array([_unevenness(glance, gain, side) for glance in glances]).sum(0)
    lit = max(parts[0] / max(parts[1], 1.0), LEAST_NOISE)
    dark = max(parts[2] / max(parts[3], 1.0), LEAST_NOISE)
    return Noise(float(lit), float(dark))


def take_look(glance: Glance, noise: Noise, side: int) -> Look:
    """Reduce a glance, its pixels weighted by their noise relative to that inside the array.

    The noise of a pixel follows its light: s^2 = dark + (lit - dark) f(x) f(y), f the profile of the array from 0 to 1.
    W is taken as a product of a function of x and one of y, so that LEDs weighted by its root are such products too.
    """
    weighted = weigh(glance, noise, side)
    gram = np.empty((side * side, side * side), np.float32)
    kernels.gram(*weighted.between, gram)
    d, o = weighted.change, weighted.still
    return Look(gram, weighted.correlated(d), weighted.correlated(o), float((d * o).sum()), float((o * o).sum()))


@dataclass(frozen=True, slots=True)
class Weighted:
    """A glance whose pixels are weighted by their noise, white with the variance of those inside the array.

    Attributes
    ----------
    root
        Roots of the weights, (rows, columns).
    change, still
        W^(1/2) d and W^(1/2) o.
    shares
        Light of the LEDs in the two frames, weighted alike.
    between
        The same at the pose between the two, its blur wider by the motion.
    """

    root: Floats
    change: Floats
    still: Floats
    shares: tuple[Shares, Shares]
    between: Shares

    def correlated(self, image: Floats) -> Floats:
        """B^T W^(1/2) image, (cells,)."""
        parts = np.empty((2, len(self.shares[0][0])))
        for share, part in zip(self.shares, parts, strict=True):
            kernels.seen_by_cells(image, *share, part)
        return np.asarray(parts.mean(0))

    def residual(self, gain: float, cells: Floats) -> Floats:
        """W^(1/2) (d - g (B c + o)), (rows, columns)."""
        light = np.zeros_like(self.change)
        for share in self.shares:
            kernels.shine(0.5 * kernels.leds(cells), *share, light)
        return self.change - gain * (light + self.still)


def weigh(glance: Glance, noise: Noise, side: int) -> Weighted:
    """Weight a glance's pixels, and the light that LEDs give them, by the pixels' noise."""
    shape = glance.change.shape
    # B^T W B is taken at the pose between the two, its blur wider by the motion: sigma^2 + (half the motion)^2
    motion = 0.5 * (glance.poses[1].x - glance.poses[0].x), 0.5 * (glance.poses[1].y - glance.poses[0].y)
    between = _placed(glance.middle, glance.corner, shape, side, motion)
    weights = _weights(between, noise, shape)
    root = weights[1][:, None] * weights[0]
    first, second = (_weighted(_placed(pose, glance.corner, shape, side), weights) for pose in glance.poses)
    still = 0.5 * (_all_on(first, shape) - _all_on(second, shape))
    return Weighted(root, root * glance.change, still, (first, second), _weighted(between, weights))


def _weights(share: Shares, noise: Noise, shape: tuple[int, int]) -> tuple[Floats, Floats]:
    """Roots of the weights by column and by row: W = lit / s^2, 0 in the ring."""
    columns, rows = np.empty(shape[1]), np.empty(shape[0])
    kernels.roots(share[0], share[2][:, 0], noise.lit, noise.dark, int(RING_PX), columns)
    kernels.roots(share[1], share[2][:, 1], noise.lit, noise.dark, int(RING_PX), rows)
    return columns, rows


def _weighted(share: Shares, weights: tuple[Floats, Floats]) -> Shares:
    """Shares of the LEDs' light with each pixel's weight on them."""
    across, down = np.empty_like(share[0]), np.empty_like(share[1])
    kernels.weighted(share[0], share[2][:, 0], weights[0], across)
    kernels.weighted(share[1], share[2][:, 1], weights[1], down)
    return across, down, share[2]


def _unevenness(glance: Glance, gain: float, side: int) -> tuple[float, float, float, float]:
    """Squared residuals of a sum inside the array and their degrees of freedom; squares beside it and their number."""
    shares = [_placed(pose, glance.corner, glance.change.shape, side) for pose in glance.poses]
    first, second = (_all_on(share, glance.change.shape) for share in shares)
    lit = 0.5 * (first + second)
    matrix, vector = np.empty((4, 4)), np.empty(4)
    inside = INSIDE * lit.max()
    count, power, beside, dark = kernels.evenness(glance.total, glance.change, lit, inside, matrix, vector)
    # where light is even it is the constant: the ridge lets that be
    left = power - vector @ np.linalg.solve(matrix + 1e-9 * np.diag(np.diag(matrix) + 1e-3), vector)
    freedom = max(count - 4, 0)
    # of the sum A_1 x + A_2 (1 - x) motion leaves (A_1 - A_2) (x - 1/2), and random data have the variance 1/16
    moved = gain**2 / 16 * kernels.difference(*shares[0], *shares[1]) / (side * glance.middle.pitch) ** 2
    return float(left) - freedom * moved, freedom, dark, beside


def _all_on(share: Shares, shape: tuple[int, int]) -> Floats:
    """A 1, the image of all LEDs, (rows, columns)."""
    image = np.zeros(shape)
    kernels.shine(np.ones(len(share[0])), *share, image)
    return image


@lru_cache(maxsize=512)  # a packet's poses are asked for again and again
def _placed(
    pose: Pose, corner: tuple[int, int], shape: tuple[int, int], side: int, spread: tuple[float, float] = (0.0, 0.0)
) -> Shares:
    """Light of each LED by column and row of a window; `spread` is a standard deviation added to the blur's."""
    sigma = np.hypot(pose.blur, spread)
    width = kernels.support(float(sigma.max()))
    across, down = np.empty((side * side, width)), np.empty((side * side, width))
    first = np.empty((side * side, 2), np.int64)
    where = np.array([pose.x - corner[0], pose.y - corner[1], pose.pitch, pose.roll, *sigma])
    kernels.place(where, *shape, across, down, first)
    return across, down, first
