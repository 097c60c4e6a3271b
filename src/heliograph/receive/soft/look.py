"""Looks: what a pattern and its inverse say about the cells of their data, reduced to a matrix and two vectors.

With A_1 and A_2 what each LED gives each pixel in the two frames, x the LEDs' levels 0 to 1 and the background equal in
both frames, the difference of the frames is

    d = g (A_1 x - A_2 (1 - x)) + n = g (B c + o) + n,   B = (A_1 + A_2) / 2 T,   o = (A_1 - A_2) 1 / 2

where 2 x - 1 = T c, T the Haar transform of equation (8) as 1/4 H^T D H and c the data +-1 in the order of the cells.
A single frame of known background b is the same with 2 (r - b) = g (B c + o) + n, B = A T and o = A 1.
With W the pixels' weights, all that remains of them is B^T W d, beside B^T W B and B^T W o which the poses decide.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

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

BESIDE = 1e-3
"""Share of it below which a pixel lies beside the array."""

LEAST_NOISE = 1 / 6
"""Variance in squared gray levels that rounding alone gives a difference of two frames."""


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
    """

    total: Floats
    change: Floats
    corner: tuple[int, int]
    poses: tuple[Pose, ...]
    still: Pose | None = None
    mix: Mix | None = None

    @property
    def middle(self) -> Pose:
        """The pose between the two."""
        return Pose.between(self.poses[0], self.poses[-1])


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
    power: float = 0.0
    pixels: int = 0
    mix: Mix | None = None

    def scaled(self, weight: float) -> "Look":
        """The same with a weight, as if its noise were larger."""
        return Look(
            np.float32(weight) * self.gram,
            weight * self.seen,
            weight * self.offset,
            weight * self.cross,
            weight * self.drift,
            weight * self.power,
            self.pixels,
            self.mix,
        )

    def plus(self, other: "Look") -> "Look":
        """Two looks at one pattern."""
        return Look(
            self.gram + other.gram,
            self.seen + other.seen,
            self.offset + other.offset,
            self.cross + other.cross,
            self.drift + other.drift,
            self.power + other.power,
            self.pixels + other.pixels,
            self.mix,
        )


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
    return Glance(up + down, up - down, (x0, y0), poses, mix=mix)


def of_squares(grid: Floats) -> Floats:
    """Values of LEDs (n, n) in the order of the squares of 2 x 2, (n n,)."""
    half = len(grid) // 2
    return np.ascontiguousarray(grid.reshape(half, 2, half, 2).transpose(0, 2, 1, 3)).ravel()


def measure_noise(glances: Sequence[Glance], gain: float, side: int, shares: Floats | None = None) -> Noise:
    """Noise of a packet's glances.

    Inside the array the sum of a pair is even but for noise, which is that of the difference, and for what motion
    between the two frames leaves of the data; LEDs that failed stay where they are from one sum to the next, so that
    successive sums are compared. Beside the array the difference is noise and what has changed there.

    Parameters
    ----------
    glances
        Of the packet.
    gain
        Gray levels of a wide array with all LEDs on.
    side
        LEDs in a row.
    shares
        (n, n) share of its light that each LED gives; all of it by default.
    """
    uneven = [_unevenness(glance, gain, side, shares) for glance in glances]
    if not uneven:
        return Noise(LEAST_NOISE, LEAST_NOISE)
    if len(uneven) > 1:
        parts = [_variance(_apart(*two) / np.sqrt(2)) for two in pairwise(uneven)]
    else:
        parts = [_variance(one.residual) for one in uneven]
    total, count = np.array(parts).sum(0)
    lit = float(total) / max(float(count), 1.0) - float(np.mean([one.moved for one in uneven]))
    beside = np.concatenate([one.beside for one in uneven])
    dark = float((beside**2).mean()) if beside.size else 0.0
    return Noise(max(lit, LEAST_NOISE), max(dark, LEAST_NOISE))


def take_look(glance: Glance, noise: Noise, side: int, shares: Floats | None = None) -> Look:
    """Reduce a glance, its pixels weighted by their noise relative to that inside the array.

    LEDs that give only a share (n, n) of their light count by that; all give all by default.

    The noise of a pixel follows its light: s^2 = dark + (lit - dark) f(x) f(y), f the profile of the array from 0 to 1.
    W is taken as a product of a function of x and one of y, so that LEDs weighted by its root are such products too.
    """
    look = weigh(glance, noise, side, shares).look(glance.mix)
    # combined frames have another noise than a difference of two
    return look if glance.mix is None else look.scaled(1 / glance.mix.noise)


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
        Light of the LEDs in each of the glance's frames, weighted alike.
    between
        The same at the pose between the frames, its blur wider by the motion.
    """

    root: Floats
    change: Floats
    still: Floats
    shares: tuple[Shares, ...]
    between: Shares

    def look(self, mix: Mix | None = None) -> Look:
        """What remains of it for the equaliser, combined of frames by a mix."""
        size = len(self.between[0])
        gram = np.empty((size, size), np.float32)
        kernels.gram(*self.between, gram)
        d, o = self.change, self.still
        return Look(
            gram,
            self.correlated(d),
            self.correlated(o),
            cross=float((d * o).sum()),
            drift=float((o * o).sum()),
            power=float((d * d).sum()),
            pixels=int((self.root > 0).sum()),
            mix=mix,
        )

    def correlated(self, image: Floats) -> Floats:
        """B^T W^(1/2) image, (cells,)."""
        parts = np.empty((len(self.shares), len(self.shares[0][0])))
        for share, part in zip(self.shares, parts, strict=True):
            kernels.seen_by_cells(image, *share, part)
        return np.asarray(parts.mean(0))

    def residual(self, gain: float, cells: Floats) -> Floats:
        """W^(1/2) (d - g (B c + o)), (rows, columns)."""
        light = np.zeros_like(self.change)
        for share in self.shares:
            kernels.shine(kernels.leds(cells) / len(self.shares), *share, light)
        return self.change - gain * (light + self.still)


def weigh(glance: Glance, noise: Noise, side: int, shares: Floats | None = None) -> Weighted:
    """Weight a glance's pixels, and the light that LEDs give them, by the pixels' noise."""
    shape, corner = glance.change.shape, glance.corner
    # B^T W B is taken at the pose between the two, its blur wider by the motion: sigma^2 + (half the motion)^2
    first, last = glance.poses[0], glance.poses[-1]
    motion = 0.5 * (last.x - first.x), 0.5 * (last.y - first.y)
    between = _placed(glance.middle, corner, shape, side, motion)
    weights = _weights(between, noise, shape)
    root = weights[1][:, None] * weights[0]
    lights = tuple(_dimmed(_weighted(_placed(pose, corner, shape, side), weights), shares) for pose in glance.poses)
    if glance.still is None:
        # the mean light of combined frames is not half of the array's
        levels = (0.5, 0.5) if glance.mix is None else glance.mix.levels
        still = levels[0] * _all_on(lights[0], shape) - levels[1] * _all_on(lights[-1], shape)
    else:
        still = root * image_of(np.ones((side, side)) if shares is None else shares, glance.still, corner, shape)
    return Weighted(root, root * glance.change, still, lights, _dimmed(_weighted(between, weights), shares))


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
    kernels.shine(of_squares(levels), *_placed(pose, corner, shape, len(levels)), image)
    return image


def noise_beside(glances: Sequence[Glance], side: int) -> float:
    """Variance of a pixel of single frames' glances beside the array, what is not known of the background included."""
    ones = np.ones((side, side))
    squares, count = 0.0, 0
    for glance in glances:
        lit = image_of(ones, glance.middle, glance.corner, glance.change.shape)
        beside = glance.change[lit < BESIDE]
        squares, count = squares + float((beside**2).sum()), count + beside.size
    return max(squares / max(count, 1), LEAST_NOISE)


def _dimmed(share: Shares, shares: Floats | None) -> Shares:
    """Shares of the LEDs' light with what each LED gives of it."""
    return share if shares is None else (share[0] * of_squares(shares)[:, None], *share[1:])


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


@dataclass(frozen=True, slots=True)
class _Uneven:
    """What of a sum inside the array is not even, (rows, columns), NaN elsewhere; and the difference beside it.

    `moved` is the variance that motion between the two frames leaves of the data.
    """

    residual: Floats
    corner: tuple[int, int]
    beside: Floats
    moved: float


def _unevenness(glance: Glance, gain: float, side: int, shares: Floats | None) -> _Uneven:
    """Residuals of a sum inside the array, scaled by their degrees of freedom."""
    placed = [_placed(pose, glance.corner, glance.change.shape, side) for pose in glance.poses]
    whole = _all_on(placed[0], glance.change.shape)
    first, second = (_all_on(_dimmed(share, shares), glance.change.shape) for share in placed)
    lit = 0.5 * (first + second)
    inside = whole > INSIDE * whole.max()
    y, x = np.nonzero(inside)
    columns = np.stack([lit[inside], np.ones(len(x)), x - x.mean(), y - y.mean()], axis=1)
    fitted = columns @ np.linalg.lstsq(columns, glance.total[inside], rcond=1e-6)[0]
    residual = np.full(glance.total.shape, np.nan)
    residual[inside] = (glance.total[inside] - fitted) * np.sqrt(len(x) / max(len(x) - columns.shape[1], 1))
    # of the sum A_1 x + A_2 (1 - x) motion leaves (A_1 - A_2) (x - 1/2), and random data have the variance 1/16
    moved = gain**2 / 16 * kernels.difference(*placed[0], *placed[1]) / (side * glance.middle.pitch) ** 2
    beside = glance.change[whole < BESIDE]
    if glance.mix is None:
        return _Uneven(residual, glance.corner, beside, float(moved))
    # as if of two frames; of combined ones only a header's sum is even, in which nothing moves
    return _Uneven(residual / np.sqrt(glance.mix.total_noise), glance.corner, beside / np.sqrt(glance.mix.noise), 0.0)


def _apart(one: _Uneven, other: _Uneven) -> Floats:
    """Difference of two residuals where both are known."""
    left, top = (max(a, b) for a, b in zip(one.corner, other.corner, strict=True))
    a, b = (u.residual[top - u.corner[1] :, left - u.corner[0] :] for u in (one, other))
    rows, cols = (min(m, n) for m, n in zip(a.shape, b.shape, strict=True))
    return np.asarray(a[:rows, :cols] - b[:rows, :cols])


def _variance(residual: Floats) -> tuple[float, int]:
    """Variance by the median magnitude, for LEDs that failed are no noise, times the number of pixels; and that."""
    known = np.abs(residual[np.isfinite(residual)])
    return ((1.4826 * float(np.median(known))) ** 2 * known.size, known.size) if known.size else (0.0, 0)


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
    where = np.array([pose.x - corner[0], pose.y - corner[1], *pose.axes.ravel(), pose.pitch, *sigma])
    kernels.place(where, *shape, across, down, first)
    return across, down, first
