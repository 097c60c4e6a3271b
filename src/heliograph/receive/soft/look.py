"""Looks: what a pattern and its inverse say about the cells of their data, reduced to a matrix and two vectors.

With A_1 and A_2 what each LED gives each pixel in the two frames, x the LEDs' levels 0 to 1 and the background equal in
both frames, the difference of the frames is

    d = g (A_1 x - A_2 (1 - x)) + n = g (B c + o) + n,   B = (A_1 + A_2) / 2 T,   o = (A_1 - A_2) 1 / 2

where 2 x - 1 = T c, T the Haar transform of equation (8) as 1/4 H^T D H and c the data +-1 in the order of the cells.
A single frame of known background b is the same with 2 (r - b) = g (B c + o) + n, B = A T and o = A 1.
With W the pixels' weights, all that remains of them is B^T W d, beside B^T W B and B^T W o which the poses decide.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import blas

from heliograph.receive.soft import kernels
from heliograph.receive.soft.glance import RING_PX, Glance, Shares, all_on, dimmed, image_of, placed
from heliograph.receive.soft.mix import Mix
from heliograph.receive.soft.noise import Noise

Floats = NDArray[np.float64]


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

    def scaled(self, weight: float, gain: float = 1.0) -> "Look":
        """The same with a weight, as if its noise were larger, and for a light so many times dimmer."""
        # B and o are gain times what they are, d is what it is
        return Look(
            np.float32(weight * gain**2) * self.gram,
            weight * gain * self.seen,
            weight * gain**2 * self.offset,
            weight * gain * self.cross,
            weight * gain**2 * self.drift,
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
    mix
        See `Glance`.
    """

    root: Floats
    change: Floats
    still: Floats
    shares: tuple[Shares, ...]
    between: Shares
    mix: Mix | None = None

    def look(self) -> Look:
        """What remains of it for the equaliser."""
        return self._reduced(
            gram_of(self.between, self.change.shape), self.correlated(self.change), self.correlated(self.still)
        )

    def _reduced(self, gram: NDArray[np.float32], seen: Floats, offset: Floats) -> Look:
        """A look of a B^T W B, (cells, cells), B^T W d and B^T W o, (cells,)."""
        d, o = self.change, self.still
        look = Look(
            gram,
            seen,
            offset,
            cross=float((d * o).sum()),
            drift=float((o * o).sum()),
            power=float((d * d).sum()),
            pixels=int((self.root > 0).sum()),
            mix=self.mix,
        )
        # combined frames have another noise than a difference of two
        return look if self.mix is None else look.scaled(1 / self.mix.noise)

    def _light(self) -> NDArray[np.float32]:
        """W^(1/2) B, (pixels, cells)."""
        light = np.zeros((*self.change.shape, len(self.between[0])), np.float32)
        kernels.light(*self.between, light)
        return light.reshape(self.change.size, -1)

    def without(self, slopes: Floats, precision: Floats) -> Look:
        """What remains where the image may have any share of slopes (k, rows, columns) as well, W^(1/2) on them.

        Their shares e are marginalised, of a precision (k, k) beforehand in units of g^2 / s^2.
        """
        # d = g (B c + o + H e) + n: G - C K C^T and B^T d - C K H^T d, C = B^T H, K = (H^T H + P^-1)^-1
        b, h = self._light().astype(np.float64), slopes.reshape(len(slopes), -1)
        seen = np.stack([self.change.ravel(), self.still.ravel()], axis=1)
        c = b.T @ h.T
        part = np.linalg.solve(h @ h.T + precision, np.column_stack([c.T, h @ seen]))
        d, o = (b.T @ seen - c @ part[:, -2:]).T
        # all by one B, else the difference of two large matrices would be no matrix of squares
        return self._reduced((b.T @ b - c @ part[:, :-2]).astype(np.float32), d, o)

    def correlated(self, image: Floats) -> Floats:
        """B^T W^(1/2) image, (cells,)."""
        parts = np.empty((len(self.shares), len(self.shares[0][0])))
        for share, part in zip(self.shares, parts, strict=True):
            kernels.seen_by_cells(image, *share, part)
        return parts[0] if len(parts) == 1 else np.asarray(0.5 * (parts[0] + parts[1]))

    def all_correlated(self, images: Floats) -> Floats:
        """The same of images (k, rows, columns), (cells, k): takes less time where they are more than four."""
        stack = np.ascontiguousarray(np.moveaxis(images, 0, -1))
        parts = np.empty((len(self.shares), len(self.shares[0][0]), len(images)))
        for share, part in zip(self.shares, parts, strict=True):
            kernels.all_seen_by_cells(stack, *share, part)
        return np.asarray(parts.mean(0))

    def residual(self, gain: float, cells: Floats) -> Floats:
        """W^(1/2) (d - g (B c + o)), (rows, columns)."""
        light = np.zeros_like(self.change)
        for share in self.shares:
            kernels.shine(kernels.leds(cells) / len(self.shares), *share, light)
        return self.change - gain * (light + self.still)


def weigh(glance: Glance, noise: Noise, side: int, shares: Floats | None = None) -> Weighted:
    """Weight a glance's pixels, and the light that LEDs give them, by their noise relative to that inside the array.

    LEDs that give only a share (n, n) of their light count by that; all give all by default.

    The noise of a pixel follows its light: s^2 = dark + (lit - dark) f(x) f(y), f the profile of the array from 0 to 1.
    W is taken as a product of a function of x and one of y, so that LEDs weighted by its root are such products too.
    """
    shape, corner = glance.change.shape, glance.corner
    # B^T W B is taken at the pose between the two, its blur wider by the motion: sigma^2 + (half the motion)^2
    first, last = glance.poses[0], glance.poses[-1]
    motion = 0.5 * (last.x - first.x), 0.5 * (last.y - first.y)
    between = placed(glance.middle, corner, shape, side, motion)
    weights = _weights(between, noise, shape)
    if glance.inside is not None:
        weights = weights[0] * glance.inside[0], weights[1] * glance.inside[1]
    root = weights[1][:, None] * weights[0]
    behind = dimmed(_weighted(between, weights), shares)
    lights: tuple[Shares, ...] = (behind,)
    if len(glance.poses) > 1:
        lights = tuple(dimmed(_weighted(placed(pose, corner, shape, side), weights), shares) for pose in glance.poses)
    if glance.still is None:
        # the mean light of combined frames is not half of the array's
        levels = (0.5, 0.5) if glance.mix is None else glance.mix.levels
        still = levels[0] * all_on(lights[0], shape) - levels[1] * all_on(lights[-1], shape)
    else:
        still = root * image_of(np.ones((side, side)) if shares is None else shares, glance.still, corner, shape)
    return Weighted(root, root * glance.change, still, lights, behind, glance.mix)


def gram_of(lights: Shares, shape: tuple[int, int]) -> NDArray[np.float32]:
    """B^T B, (cells, cells), of LEDs' light on a window (rows, columns)."""
    products = []
    for axis in (0, 1):
        whole = np.empty((len(lights[axis]), shape[1 - axis]), np.float32)
        kernels.spread(lights[axis], lights[2][:, axis], whole)
        # NumPy's own X X^T takes six times as long; transposed it is as BLAS wants it
        products.append(blas.sgemm(1.0, whole.T, whole.T, trans_a=1).T)
    across, down = products
    kernels.gram(across, down, gram := np.empty_like(across))
    return gram


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
