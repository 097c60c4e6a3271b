"""Sufficient statistics: what a pattern and its inverse show of the symbols, as a matrix and two vectors.

Let A_1 and A_2 be the blur matrices of the two frames, x the LEDs' levels 0 to 1, and the background the same in both.
The difference of the frames is

    d = g (A_1 x - A_2 (1 - x)) + n = g (B c + o) + n,   B = (A_1 + A_2) / 2 T,   o = (A_1 - A_2) 1 / 2,

where 2 x - 1 = T c, T is the Haar transform of equation (8) as 1/4 H^T D H, and c the symbols, +-1. A single frame of
known background b is the same with 2 (r - b) = g (B c + o) + n, B = A T and o = A 1.

With the pixels' weights W, the symbols depend on d by B^T W d alone, beside B^T W B and B^T W o, which follow from the
poses.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import blas

from heliograph.base.arrays import Floats
from heliograph.receive.geometry import kernels as image_kernels
from heliograph.receive.geometry.footprint import Footprints, by_squares, footprints, image_of
from heliograph.receive.observe import kernels
from heliograph.receive.observe import kernels as noise_kernels
from heliograph.receive.observe.cutout import ALL_SHOWN, RING_PX, Cutout
from heliograph.receive.observe.noise import Noise
from heliograph.receive.sync.combine import Combination


@dataclass(frozen=True, slots=True)
class PairStatistics:
    """Sufficient statistics of a pair for its symbols; gain and noise stay open."""

    # G = B^T W B, (symbols, symbols) float32
    gram: NDArray[np.float32]
    # B^T W d, the matched filter's output, (symbols,) in gray levels
    matched: Floats
    # B^T W o, the offset's correlation with the symbols' images, (symbols,)
    offset: Floats
    # D^T W o, the correlation of difference and offset, in gray levels
    cross: float
    # O^T W o, the offset's weighted sum of squares
    offset_power: float
    # D^T W d, the difference's weighted sum of squares, in squared gray levels
    power: float = 0.0
    # Number of pixels of weight above 0
    pixels: int = 0
    # How the pair was combined; None for two frames in step
    combination: Combination | None = None

    def scaled(self, weight: float, gain: float = 1.0) -> "PairStatistics":
        """Statistics of the same pair in other units."""
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

    def along(self, start: Floats, slope: Floats) -> "PairStatistics":
        """Statistics for other symbols u, one for each square of 2 x 2 LEDs: c = start + slope u."""
        # B (start + D u) + o: D^T G D, D^T B^T d and D^T (B^T o + G start)
        gram, kinds = self.gram.reshape(4, len(start) // 4, 4, -1), slope.reshape(4, -1)
        narrow, lit = kinds.astype(np.float32), self.gram @ start.astype(np.float32)
        return PairStatistics(
            np.einsum("qkr,kr->qr", np.einsum("iq,iqkr->qkr", narrow, gram), narrow),
            (kinds * self.matched.reshape(4, -1)).sum(0),
            (kinds * (self.offset + lit).reshape(4, -1)).sum(0),
            self.cross + float(start @ self.matched),
            self.offset_power + float(start @ (2 * self.offset + lit)),
            self.power,
            self.pixels,
            self.combination,
        )

    def plus(self, other: "PairStatistics") -> "PairStatistics":
        """Statistics of two observations of one pattern together."""
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
    """A cut-out whose pixels are divided by their noise, so that it is white with the variance inside the array."""

    # W^(1/2), the roots of the pixels' weights, (rows, columns)
    root: Floats
    # W^(1/2) d, (rows, columns)
    difference: Floats
    # W^(1/2) o, (rows, columns)
    offset: Floats
    # W^(1/2) A of each frame, one or two
    frames: tuple[Footprints, ...]
    # The same at the pose between the frames, its blur wider by the motion
    between: Footprints
    # Whether the array moves so far from one frame to the other that this does not stand for both
    apart: bool = False
    # How the pair was combined; None for two frames in step
    combination: Combination | None = None

    def statistics(self) -> PairStatistics:
        """Sufficient statistics for the symbols."""
        matched, shown = np.empty((2, len(self.between.across)))
        first, last = self.frames[0], self.frames[-1]
        powers = kernels.seen_by_symbols(self.difference, self.offset, self.root, (*first,), (*last,), matched, shown)
        return self._statistics(self._gram(), matched, shown, powers)

    def without(self, slopes: Floats, precision: Floats) -> PairStatistics:
        """Statistics where the image may also hold some of other images, whose amplitudes are marginalised."""
        # d = g (B c + o + F e) + n: G - C K C^T and B^T d - C K F^T d, C = B^T F, K = (F^T F + P^-1)^-1
        f, images = slopes.reshape(len(slopes), -1), [*slopes, self.difference, self.offset]
        seen = np.stack([self.difference.ravel(), self.offset.ravel()], axis=1)
        # all by the one B of G: else the difference of two large matrices would not be positive definite
        found = _correlated(np.array(images), self._parts)
        c = found[:, :-2]
        part = np.linalg.solve(f @ f.T + precision, np.column_stack([c.T, f @ seen]))
        d, o = (found[:, -2:] - c @ part[:, -2:]).T
        white, offset = self.difference, self.offset
        powers = (white * offset).sum(), (offset**2).sum(), (white**2).sum(), (self.root > 0).sum()
        gram = self._gram()
        gram -= c.astype(np.float32) @ part[:, :-2].astype(np.float32)
        return self._statistics(gram, d, o, powers)

    def correlated(self, image: Floats) -> Floats:
        """B^T W^(1/2) of an image, (symbols,)."""
        parts = np.empty((len(self.frames), len(self.frames[0].across)))
        for frame, part in zip(self.frames, parts, strict=True):
            kernels.correlate(image, *frame, part)
        return parts[0] if len(parts) == 1 else np.asarray(0.5 * (parts[0] + parts[1]))

    def all_correlated(self, images: Floats) -> Floats:
        """`correlated` of many images, (symbols, k); faster where k is more than four."""
        return _correlated(images, self.frames)

    def residual(self, gain: float, symbols: Floats) -> Floats:
        """W^(1/2) (d - g (B c + o)), (rows, columns)."""
        light = np.zeros_like(self.difference)
        for frame in self.frames:
            image_kernels.add_image(kernels.leds_of(symbols) / len(self.frames), *frame, light)
        return self.difference - gain * (light + self.offset)

    @property
    def _shape(self) -> tuple[int, int]:
        rows, cols = self.difference.shape
        return rows, cols

    def _statistics(
        self, gram: NDArray[np.float32], matched: Floats, offset: Floats, powers: tuple[float, float, float, int]
    ) -> PairStatistics:
        """Statistics of B^T W B, (symbols, symbols), B^T W d and B^T W o, (symbols,), and `seen_by_symbols`'s sums."""
        cross, offset_power, power, pixels = powers
        found = PairStatistics(
            gram,
            matched,
            offset,
            cross=float(cross),
            offset_power=float(offset_power),
            power=float(power),
            pixels=int(pixels),
            combination=self.combination,
        )
        # combined frames have another noise than a difference of two
        return found if self.combination is None else found.scaled(1 / self.combination.noise)

    @property
    def _parts(self) -> tuple[Footprints, ...]:
        """Footprints whose mean is the W^(1/2) B of G."""
        return self.frames if self.apart else (self.between,)

    def _gram(self) -> NDArray[np.float32]:
        """G, (symbols, symbols)."""
        if not self.apart:
            return gram_of(self.between, self._shape)
        light = np.zeros((*self.difference.shape, len(self.between.across)), np.float32)
        for part in self._parts:
            kernels.add_light(*part, light)
        b = light.reshape(self.difference.size, -1) / np.float32(len(self._parts))
        return np.asarray(b.T @ b, np.float32)


def whiten(cutout: Cutout, noise: Noise, side: int, led_gains: Floats | None = None) -> WhitenedCutout:
    """Divide a cut-out's pixels, and the light that LEDs give them, by their noise relative to that inside the array.

    A pixel's noise follows its light: s^2 = dark + (lit - dark) f(x) f(y), f the array's profile from 0 to 1. W is
    taken as a product of a function of x and one of y, so that LEDs' light times its root stays such a product.
    """
    shape, corner = cutout.shape, cutout.corner
    if cutout.in_sight is not None:
        led_gains = cutout.shining(np.ones((side, side)) if led_gains is None else led_gains)
    # B^T W B is taken at the pose between the two, its blur wider by the motion: sigma^2 + (half the motion)^2; where
    # that is far the sum of two images is no wider one
    first, last = cutout.poses[0], cutout.poses[-1]
    motion = 0.5 * (last.x - first.x), 0.5 * (last.y - first.y)
    middle = footprints(cutout.middle, corner, shape, side, motion)
    single = len(cutout.poses) == 1
    ends = [middle] * 2 if single else [footprints(pose, corner, shape, side) for pose in cutout.poses]
    # the mean light of combined frames is not half of the array's
    levels = (0.5, 0.5) if cutout.combination is None else cutout.combination.levels
    covered = cutout.covered or (ALL_SHOWN, ALL_SHOWN)
    root, white, offset = np.empty((3, *shape))
    between, start, end = (_alike(light) for light in (middle, *ends))
    noise_kernels.whitened(
        noise.lit,
        noise.dark,
        int(RING_PX),
        1 / cutout.noise**0.5,
        *covered,
        ALL_SHOWN if led_gains is None else by_squares(led_gains),
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


def _alike(light: Footprints) -> Footprints:
    """Footprints of the same places, not filled."""
    return Footprints(np.empty_like(light.across), np.empty_like(light.down), light.first)


def _correlated(images: Floats, light: tuple[Footprints, ...]) -> Floats:
    """B^T of images (k, rows, columns), B being the mean of footprints, (symbols, k)."""
    stack = np.ascontiguousarray(np.moveaxis(images, 0, -1))
    parts = np.empty((len(light), len(light[0].across), len(images)))
    for footprint, part in zip(light, parts, strict=True):
        kernels.correlate_all(stack, *footprint, part)
    return np.asarray(parts.mean(0))


def gram_of(light: Footprints, shape: tuple[int, int]) -> NDArray[np.float32]:
    """B^T B, (symbols, symbols) float32."""
    products = []
    for axis, part in ((0, light.across), (1, light.down)):
        whole = np.empty((len(part), shape[1 - axis]), np.float32)
        kernels.spread(part, light.first[:, axis], whole)
        # NumPy's own X X^T takes six times as long; transposed it is as BLAS wants it
        products.append(blas.sgemm(1.0, whole.T, whole.T, trans_a=1).T)
    across, down = products
    kernels.gram(across, down, gram := np.empty_like(across))
    return gram
