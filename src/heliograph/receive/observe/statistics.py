"""Sufficient statistics of a pattern and the inverse for the symbols: a matrix and two vectors.

Let A_1 and A_2 be the blur matrices of the two frames, x the LEDs' levels 0 to 1, and the background the same in both.
The difference of the frames is

    d = g (A_1 x - A_2 (1 - x)) + n = g (B c + o) + n,   B = (A_1 + A_2) / 2 T,   o = (A_1 - A_2) 1 / 2,

where 2 x - 1 = T c, T is the Haar transform of equation (8) as 1/4 H^T D H, and c the symbols, +-1. A single frame of
known background b is the same with 2 (r - b) = g (B c + o) + n, B = A T and o = A 1.

With the pixels' weights W, the symbols depend on d only by B^T W d; B^T W B and B^T W o follow from the poses.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import blas

from heliograph.base.arrays import Floats
from heliograph.receive.geometry import kernels as geometry_kernels
from heliograph.receive.geometry.footprint import Footprints, by_squares, footprints, image_of
from heliograph.receive.observe import kernels
from heliograph.receive.observe.cutout import RING_PX, Cutout
from heliograph.receive.observe.noise import Noise
from heliograph.receive.sync.combine import Combination


@dataclass(frozen=True, slots=True)
class PairStatistics:
    """Sufficient statistics of a pair for the symbols, before gain and noise are known."""

    # G = B^T W B, (symbols, symbols) float32
    gram: NDArray[np.float32]
    # B^T W d, output of the matched filter, (symbols,) in gray levels
    matched: Floats
    # B^T W o, correlation of the offset with the symbols' images, (symbols,)
    offset: Floats
    # d^T W o, in gray levels
    cross: float
    # o^T W o
    offset_power: float
    # d^T W d, in squared gray levels
    power: float = 0.0
    # Number of pixels of weight above 0
    pixels: int = 0
    # Combination of frames; None for two synchronous frames
    combination: Combination | None = None

    def scaled(self, weight: float, gain: float = 1.0) -> "PairStatistics":
        """Scale the weights and the light of the LEDs."""
        return PairStatistics(
            np.float32(weight * gain**2) * self.gram,
            weight * gain * self.matched,
            weight * gain**2 * self.offset,
            weight * gain * self.cross,
            weight * gain**2 * self.offset_power,
            weight * self.power,
            self.pixels,
            self.combination,
        )

    def plus(self, other: "PairStatistics") -> "PairStatistics":
        """Add the statistics of another observation of the same pattern."""
        return PairStatistics(
            self.gram + other.gram,
            self.matched + other.matched,
            self.offset + other.offset,
            self.cross + other.cross,
            self.offset_power + other.offset_power,
            self.power + other.power,
            self.pixels + other.pixels,
            self.combination,
        )


@dataclass(frozen=True, slots=True)
class WhitenedCutout:
    """A cut-out with pixels divided by relative noise: white noise of the variance inside the array."""

    # W^(1/2), the roots of the pixels' weights, (rows, columns)
    root: Floats
    # W^(1/2) d, (rows, columns)
    difference: Floats
    # W^(1/2) o, (rows, columns)
    offset: Floats
    # W^(1/2) A of each frame, one or two
    frames: tuple[Footprints, ...]
    # The same at the pose between the frames, with the blur widened by the motion
    between: Footprints
    # True if the array moves too far for this to stand for both frames
    apart: bool = False
    # Combination of frames; None for two synchronous frames
    combination: Combination | None = None

    def statistics(self) -> PairStatistics:
        """Compute the sufficient statistics for the symbols."""
        matched, offset = np.empty((2, len(self.between.across)))
        first, last = (*self.frames[0],), (*self.frames[-1],)
        powers = kernels.match_symbols(self.difference, self.offset, self.root, first, last, matched, offset)
        return self._statistics(self._gram(), matched, offset, powers)

    def marginalised(self, slopes: Floats, precision: Floats) -> PairStatistics:
        """Compute the statistics with other images of unknown amplitudes marginalised."""
        # d = g (B c + o + F e) + n: G - C K C^T and B^T d - C K F^T d, C = B^T F, K = (F^T F + P^-1)^-1
        f, images = slopes.reshape(len(slopes), -1), [*slopes, self.difference, self.offset]
        observed = np.stack([self.difference.ravel(), self.offset.ravel()], axis=1)
        # with the same B as in G: otherwise the difference of two large matrices would not be positive definite
        correlations = _correlate(np.array(images), self.frames if self.apart else (self.between,))
        c = correlations[:, :-2]
        part = np.linalg.solve(f @ f.T + precision, np.column_stack([c.T, f @ observed]))
        d, o = (correlations[:, -2:] - c @ part[:, -2:]).T
        white, offset = self.difference, self.offset
        powers = (white * offset).sum(), (offset**2).sum(), (white**2).sum(), (self.root > 0).sum()
        gram = self._gram()
        gram -= c.astype(np.float32) @ part[:, :-2].astype(np.float32)
        return self._statistics(gram, d, o, powers)

    def correlate(self, images: Floats) -> Floats:
        """Correlate images (k, rows, columns) with the symbols' images: B^T W^(1/2), (symbols, k)."""
        return _correlate(images, self.frames)

    def residual(self, gain: float, symbols: Floats) -> Floats:
        """Compute W^(1/2) (d - g (B c + o)), (rows, columns)."""
        light = np.zeros_like(self.difference)
        for frame in self.frames:
            geometry_kernels.add_image(kernels.leds_of(symbols) / len(self.frames), *frame, light)
        return self.difference - gain * (light + self.offset)

    def _statistics(
        self, gram: NDArray[np.float32], matched: Floats, offset: Floats, powers: tuple[float, float, float, int]
    ) -> PairStatistics:
        cross, offset_power, power, pixels = powers
        statistics = PairStatistics(
            gram, matched, offset, float(cross), float(offset_power), float(power), int(pixels), self.combination
        )
        # relative to the noise of a difference of two frames
        return statistics if self.combination is None else statistics.scaled(1 / self.combination.noise)

    def _gram(self) -> NDArray[np.float32]:
        """Compute G, (symbols, symbols)."""
        rows, cols = self.difference.shape
        if not self.apart:
            return gram_of(self.between, (rows, cols))
        light = np.zeros((rows, cols, len(self.between.across)), np.float32)
        for frame in self.frames:
            kernels.add_light(*frame, light)
        b = light.reshape(rows * cols, -1) / np.float32(len(self.frames))
        return np.asarray(b.T @ b, np.float32)


def whiten(cutout: Cutout, noise: Noise, side: int, led_gains: Floats | None = None) -> WhitenedCutout:
    """Divide the pixels of a cut-out, and the light of LEDs on each, by the noise relative to inside the array.

    The noise follows the light: s^2 = dark + (lit - dark) f(x) f(y), f the profile of the array from 0 to 1. W is
    approximated by a product of a function of x and a function of y, so footprints times its root stay products.
    """
    shape, corner = cutout.shape, cutout.corner
    if cutout.in_sight is not None:
        led_gains = cutout.shining(np.ones((side, side)) if led_gains is None else led_gains)
    # B^T W B at the pose between the two, the blur widened by the motion: sigma^2 + (half the motion)^2
    first, last = cutout.poses[0], cutout.poses[-1]
    motion = 0.5 * (last.x - first.x), 0.5 * (last.y - first.y)
    middle = footprints(cutout.middle, corner, shape, side, motion)
    single = len(cutout.poses) == 1
    ends = [middle] * 2 if single else [footprints(pose, corner, shape, side) for pose in cutout.poses]
    # the mean light of combined frames differs from a half
    levels = (0.5, 0.5) if cutout.combination is None else cutout.combination.levels
    root, white, offset = np.empty((3, *shape))
    between, start, end = (
        Footprints(np.empty_like(light.across), np.empty_like(light.down), light.first) for light in (middle, *ends)
    )
    kernels.whiten(
        noise.lit,
        noise.dark,
        int(RING_PX),
        1 / cutout.noise**0.5,
        *cutout.factors,
        np.ones(0) if led_gains is None else by_squares(led_gains),
        levels,
        cutout.difference,
        (*middle,),
        (*ends[0],),
        (*ends[1],),
        (root, white, offset, *between[:2], *start[:2], *end[:2]),
    )
    if cutout.mean_light_pose is not None:
        gains = np.ones((side, side)) if led_gains is None else led_gains
        offset = root * image_of(gains, cutout.mean_light_pose, corner, shape)
    frames = (between,) if single else (start, end)
    return WhitenedCutout(root, white, offset, frames, between, cutout.apart, cutout.combination)


def _correlate(images: Floats, light: tuple[Footprints, ...]) -> Floats:
    """Compute B^T of images (k, rows, columns), B being the mean of footprints, (symbols, k)."""
    stack = np.ascontiguousarray(np.moveaxis(images, 0, -1))
    parts = np.empty((len(light), len(light[0].across), len(images)))
    for footprint, part in zip(light, parts, strict=True):
        kernels.correlate_all(stack, *footprint, part)
    return np.asarray(parts.mean(0))


def gram_of(light: Footprints, shape: tuple[int, int]) -> NDArray[np.float32]:
    """Compute B^T B, (symbols, symbols) float32."""
    products = []
    for axis, part in ((0, light.across), (1, light.down)):
        wide = np.empty((len(part), shape[1 - axis]), np.float32)
        kernels.spread(part, light.first[:, axis], wide)
        # X X^T of NumPy takes six times as long; the transpose has the order of BLAS
        products.append(blas.sgemm(1.0, wide.T, wide.T, trans_a=1).T)
    across, down = products
    kernels.gram(across, down, gram := np.empty_like(across))
    return gram
