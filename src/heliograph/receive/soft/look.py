"""Looks: what a pattern and its inverse say about the cells of their data, reduced to a matrix and two vectors.

With A_1 and A_2 what each LED gives each pixel in the two frames, x the LEDs' levels 0 to 1 and the background equal in
both frames, the difference of the frames is

    d = g (A_1 x - A_2 (1 - x)) + n = g (B c + o) + n,   B = (A_1 + A_2) / 2 T,   o = (A_1 - A_2) 1 / 2

where 2 x - 1 = T c, T the Haar transform of equation (8) as 1/4 H^T D H and c the data +-1 in the order of the cells.
With W the pixels' weights, all that remains of them is B^T W d, beside B^T W B and B^T W o which the poses decide.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame
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
    mix
        What the pair was combined of; None if it is two frames in step.
    """

    total: Floats
    change: Floats
    corner: tuple[int, int]
    poses: tuple[Pose, Pose]
    mix: Mix | None = None

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
    power, pixels
        d^T W d and the number of pixels.
    mix
        What the pair was combined of; None if it is two frames in step.
    """

    gram: NDArray[np.float32]
    seen: Floats
    offset: Floats
    cross: float
    drift: float
    power: float
    pixels: int
    mix: Mix | None = None


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
    middle = Pose.of(0.5 * (poses[0].vector() + poses[1].vector()))
    x0, y0, cols, rows = window_around(middle, side, MARGIN_PX + RING_PX)
    up, down = (cut_out(frame, x0, y0, cols, rows) for frame in (pattern, inverted))
    return Glance(up + down, up - down, (x0, y0), poses, mix)


def measure_noise(glances: Sequence[Glance], side: int) -> Noise:
    """Noise of a packet's glances.

    Inside the array the sum of a pair is even but for noise, which is that of the difference. Beside the array the
    difference is noise and what has changed there.
    """
    parts = np.array([_unevenness(glance, side) for glance in glances]).reshape(-1, 4).sum(0)
    lit = max(parts[0] / max(parts[1], 1.0), LEAST_NOISE)
    dark = max(parts[2] / max(parts[3], 1.0), LEAST_NOISE)
    return Noise(float(lit), float(dark))


def take_look(glance: Glance, noise: Noise, side: int) -> Look:
    """Reduce a glance, its pixels weighted by their noise relative to that inside the array.

    The noise of a pixel follows its light: s^2 = dark + (lit - dark) f(x) f(y), f the profile of the array from 0 to 1.
    W is taken as a product of a function of x and one of y, so that LEDs weighted by its root are such products too.
    """
    shape = glance.change.shape
    middle = glance.middle
    motion = 0.5 * (glance.poses[1].x - glance.poses[0].x), 0.5 * (glance.poses[1].y - glance.poses[0].y)
    # B^T W B at the pose between the two, its blur wider by the motion: sigma^2 + (half the motion)^2
    between = _placed(middle, glance.corner, shape, side, motion)
    weights = _weights(between, noise, shape, side)
    gram = np.empty((side * side, side * side), np.float32)
    kernels.gram(*_weighted(between, weights), gram)
    root = weights[1][:, None] * weights[0]
    shares = [_weighted(_placed(pose, glance.corner, shape, side), weights) for pose in glance.poses]
    first, second = (_all_on(share, shape) for share in shares)
    # the mean light of the virtual frames is not half of the array's
    levels, scale = ((0.5, 0.5), 1.0) if glance.mix is None else (glance.mix.levels, 1 / glance.mix.noise)
    d, o = root * glance.change, levels[0] * first - levels[1] * second
    return Look(
        gram=np.float32(scale) * gram,
        seen=scale * _correlated(d, shares),
        offset=scale * _correlated(o, shares),
        cross=scale * float((d * o).sum()),
        drift=scale * float((o * o).sum()),
        power=scale * float((d * d).sum()),
        pixels=int((root > 0).sum()),
        mix=glance.mix,
    )


def _weights(share: Shares, noise: Noise, shape: tuple[int, int], side: int) -> tuple[Floats, Floats]:
    """Roots of the weights by column and by row: W = lit / s^2, 0 in the ring."""
    weights = []
    for shares, count, axis in zip(share[:2], (shape[1], shape[0]), (0, 1), strict=True):
        profile = np.zeros(count + 2 * shares.shape[1])
        places = share[2][:, axis, None] + np.arange(shares.shape[1]) + shares.shape[1]
        np.add.at(profile, np.clip(places, 0, profile.size - 1), shares / side)
        f = np.clip(profile[shares.shape[1] : shares.shape[1] + count], 0, 1)
        root = np.sqrt(noise.lit / (noise.dark + (noise.lit - noise.dark) * f))
        root[: int(RING_PX)] = root[count - int(RING_PX) :] = 0.0
        weights.append(root)
    return weights[0], weights[1]


def _weighted(share: Shares, weights: tuple[Floats, Floats]) -> Shares:
    """Shares of the LEDs' light with each pixel's weight on them."""
    parts = []
    for shares, weight, axis in zip(share[:2], weights, (0, 1), strict=True):
        places = share[2][:, axis, None] + np.arange(shares.shape[1])
        inside = (places >= 0) & (places < weight.size)
        parts.append(shares * np.where(inside, weight[np.clip(places, 0, weight.size - 1)], 0.0))
    return parts[0], parts[1], share[2]


def _unevenness(glance: Glance, side: int) -> tuple[float, float, float, float]:
    """Squared residuals of a sum inside the array and their degrees of freedom; squares beside it and their number."""
    shares = [_placed(pose, glance.corner, glance.change.shape, side) for pose in glance.poses]
    first, second = (_all_on(share, glance.change.shape) for share in shares)
    lit = 0.5 * (first + second)
    inside = lit > INSIDE * lit.max()
    y, x = np.nonzero(inside)
    columns = np.stack([lit[inside], np.ones(len(x)), x - x.mean(), y - y.mean()], axis=1)
    fitted = columns @ np.linalg.lstsq(columns, glance.total[inside], rcond=1e-6)[0]
    beside = glance.change[lit < 1e-3]
    freedom = max(len(x) - columns.shape[1], 0)
    inner, outer = (1.0, 1.0) if glance.mix is None else (1 / glance.mix.total_noise, 1 / glance.mix.noise)
    residual = glance.total[inside] - fitted
    return inner * float((residual**2).sum()), freedom, outer * float((beside**2).sum()), beside.size


def _all_on(share: Shares, shape: tuple[int, int]) -> Floats:
    """A 1, the image of all LEDs, (rows, columns)."""
    image = np.zeros(shape)
    kernels.shine(np.ones(len(share[0])), *share, image)
    return image


def _correlated(image: Floats, shares: Sequence[Shares]) -> Floats:
    """B^T image, (cells,)."""
    parts = np.empty((2, len(shares[0][0])))
    for share, part in zip(shares, parts, strict=True):
        kernels.seen_by_cells(image, *share, part)
    return np.asarray(parts.mean(0))


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
