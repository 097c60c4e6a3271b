"""Sufficient statistics of a pattern and the inverse for the symbols: a matrix and two vectors.

Let A_1 and A_2 be the blur matrices of the two frames, x the LEDs' levels 0 to 1, and the background the same in both.
The difference of the frames is

    d = g (A_1 x - A_2 (1 - x)) + n = g (B c + o) + n,   B = (A_1 + A_2) / 2 T,   o = (A_1 - A_2) 1 / 2,

where 2 x - 1 = T c, T is the Haar transform of equation (8) as 1/4 H^T D H, and c the symbols, +-1. A single frame of
known background b is the same with 2 (r - b) = g (B c + o) + n, B = A T and o = A 1.

With the pixels' weights W, the symbols depend on d only by B^T W d; B^T W B and B^T W o follow from the poses.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import blas

from heliograph.base.arrays import Floats
from heliograph.receive.geometry.footprint import Footprints, footprints, sum_of_leds, to_quarters
from heliograph.receive.observe.cutout import RING_PX, Cutout, Noise
from heliograph.receive.sync.combine import SIGNS, Combination


@dataclass(frozen=True, slots=True)
class PairStatistics:
    """Sufficient statistics of a pair for the symbols, before gain and noise are known."""

    # G = B^T W B, (symbols, symbols), of data float32
    gram: NDArray[np.float32] | Floats
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
        linear, square = weight * gain, weight * gain**2
        gram, matched, offset = np.float32(square) * self.gram, linear * self.matched, square * self.offset
        cross, offset_power, power = linear * self.cross, square * self.offset_power, weight * self.power
        return PairStatistics(gram, matched, offset, cross, offset_power, power, self.pixels, self.combination)

    def plus(self, other: "PairStatistics") -> "PairStatistics":
        """Add the statistics of another observation of the same pattern."""
        sums = {name: getattr(self, name) + getattr(other, name) for name in self.__slots__ if name != "combination"}
        return replace(self, **sums)


@dataclass(frozen=True)  # without slots, for the cached property
class WhitenedCutout:
    """A cut-out with pixels divided by relative noise: white noise of the variance inside the array."""

    # The cut-out
    cutout: Cutout
    # W^(1/2), the roots of the pixels' weights, (rows, columns)
    root: Floats
    # W^(1/2) d, (rows, columns)
    difference: Floats
    # W^(1/2) o, (rows, columns)
    offset: Floats
    # W^(1/2) A of the frames: at the pose between both, the blur widened by the motion; of each in fast motion
    frames: tuple[Footprints, ...]

    @cached_property
    def statistics(self) -> PairStatistics:
        """Sufficient statistics for the symbols."""
        return self._statistics(self._gram(), self.correlate(np.stack([self.difference, self.offset])))

    def marginalised(self, slopes: Floats, precision: Floats) -> PairStatistics:
        """Compute the statistics with other images of unknown amplitudes marginalised."""
        # d = g (B c + o + F e) + n: G - C K C^T and B^T d - C K F^T d, C = B^T F, K = (F^T F + P^-1)^-1
        f, images = slopes.reshape(len(slopes), -1), np.stack([*slopes, self.difference, self.offset])
        observed = images[-2:].reshape(2, -1).T
        correlations = self.correlate(images)
        c = correlations[:, :-2]
        part = np.linalg.solve(f @ f.T + precision, np.column_stack([c.T, f @ observed]))
        gram = self._gram()
        gram -= c.astype(np.float32) @ part[:, :-2].astype(np.float32)
        return self._statistics(gram, correlations[:, -2:] - c @ part[:, -2:])

    def correlate(self, images: Floats) -> Floats:
        """Correlate images (k, rows, columns) with the symbols' images: B^T W^(1/2), (symbols, k)."""
        quarters = (np.einsum("knj,nj->nk", down @ images, across) for across, down in self.frames)
        return np.asarray(np.mean([0.25 * transform_quarters(part) for part in quarters], axis=0))

    def residual(self, gain: float, symbols: Floats) -> Floats:
        """Compute W^(1/2) (d - g (B c + o)), (rows, columns)."""
        light = np.mean([sum_of_leds(leds_of(symbols), frame) for frame in self.frames], axis=0)
        return np.asarray(self.difference - gain * (light + self.offset))

    def _statistics(self, gram: NDArray[np.float32], matched: Floats) -> PairStatistics:
        """Statistics with the correlations of difference and offset, (symbols, 2)."""
        d, o, combination = self.difference.ravel(), self.offset.ravel(), self.cutout.combination
        powers = float(d @ o), float(o @ o), float(d @ d), int(np.count_nonzero(self.root))
        statistics = PairStatistics(gram, matched[:, 0].copy(), matched[:, 1].copy(), *powers, combination)
        # relative to the noise of a difference of two frames
        return statistics if combination is None else statistics.scaled(1 / combination.noise)

    def _gram(self) -> NDArray[np.float32]:
        """Compute G, (symbols, symbols)."""
        if not self.cutout.apart:
            return gram_of(self.frames[0])
        b = np.mean([light_of_symbols(frame) for frame in self.frames], axis=0)
        return np.asarray(b @ b.T, np.float32)


def whiten(cutout: Cutout, noise: Noise, side: int, led_gains: Floats | None = None) -> WhitenedCutout:
    """Divide the pixels of a cut-out, and the light of LEDs on each, by the noise relative to inside the array.

    The noise follows the light: s^2 = dark + (lit - dark) f(x) f(y), f the profile of the array from 0 to 1. W is
    approximated by a product of a function of x and a function of y, so footprints times its root stay products.
    """
    shape, corner = cutout.shape, cutout.corner
    gains = cutout.shining(np.ones((side, side)) if led_gains is None else led_gains)
    leds, first, last = to_quarters(gains)[:, None], cutout.poses[0], cutout.poses[-1]
    # B^T W B at the pose between the two, the blur widened by the motion: sigma^2 + (half the motion)^2
    middle = footprints(cutout.middle, corner, shape, side, (0.5 * (last.x - first.x), 0.5 * (last.y - first.y)))
    across, down = (_weight_roots(part, noise) for part in middle)
    if cutout.covered is not None:
        across, down = across * cutout.covered[0], down * cutout.covered[1]
    root = np.outer(down, across)
    if cutout.mean_light_pose is None:
        # o = l_1 A_1 1 - l_2 A_2 1, 0 for an array at rest; the mean light of combined frames differs from a half
        before, after = (0.5, 0.5) if cutout.combination is None else cutout.combination.levels
        offset = before * cutout.image_of(gains, first) - after * cutout.image_of(gains, last)
    else:
        offset = cutout.image_of(gains, cutout.mean_light_pose)
    light = [footprints(pose, corner, shape, side) for pose in cutout.poses] if cutout.apart else [middle]
    frames = tuple((leds * columns * across, rows * down) for columns, rows in light)
    return WhitenedCutout(cutout, root, root * cutout.difference, root * offset, frames)


def _weight_roots(light: Floats, noise: Noise) -> Floats:
    """Compute roots of weights of columns or rows, W = lit / s^2, s^2 = dark + (lit - dark) f, f the light 0 to 1."""
    f = np.minimum(light.sum(0) / len(light) ** 0.5, 1.0)
    roots = np.sqrt(noise.lit / (noise.dark + (noise.lit - noise.dark) * f))
    ring = int(RING_PX)
    roots[:ring] = roots[-ring:] = 0.0
    return np.asarray(roots)


def transform_quarters(values: NDArray[Any]) -> NDArray[Any]:
    """Transform quarters of LEDs to quarters of symbols along the first axis, H t H^T, or back."""
    return np.asarray((SIGNS.astype(values.dtype) @ values.reshape(4, -1)).reshape(values.shape))


def leds_of(symbols: NDArray[Any]) -> NDArray[Any]:
    """Transform symbols to levels of LEDs about the mean, (n n, ...): t = 1/4 H^T D H."""
    return transform_quarters(0.25 * symbols)


def transform_gram(gram: NDArray[np.float32]) -> NDArray[np.float32]:
    """Transform the inner products of LEDs to those of symbols on both sides, times 1/16, or back, (n n, n n)."""
    one_side = leds_of(gram).reshape(len(gram), 4, -1)
    return np.asarray((np.float32(0.25) * SIGNS.astype(np.float32) @ one_side).reshape(gram.shape))


def light_of_symbols(light: Footprints) -> NDArray[np.float32]:
    """Compute B^T, the light of each symbol on each pixel, (symbols, pixels)."""
    across, down = light
    leds = np.asarray(down[:, :, None] * across[:, None, :], np.float32)
    return np.asarray(leds_of(leds.reshape(len(across), -1)))


def gram_of(light: Footprints) -> NDArray[np.float32]:
    """Compute B^T B, (symbols, symbols) float32: <led_i, led_j> = <across_i, across_j> <down_i, down_j>."""
    # X X^T of NumPy takes six times as long; BLAS takes and returns the transpose, which is the same here
    single = (part.astype(np.float32).T for part in light)
    across, down = (blas.sgemm(1.0, part, part, trans_a=1).T for part in single)
    return transform_gram(across * down)
