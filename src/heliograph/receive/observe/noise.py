"""Noise of a packet's cut-outs: inside the array by the unevenness of sums, beside it by differences."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.receive.geometry import kernels
from heliograph.receive.geometry.fit import robust_std
from heliograph.receive.geometry.footprint import by_squares, footprints
from heliograph.receive.observe import kernels as noise_kernels
from heliograph.receive.observe.cutout import ALL_SHOWN, Cutout

INSIDE = 0.8
"""Fraction of the array's light from which on a pixel lies inside the array.

A blurred rim has it 0.84 standard deviations inside the array: most of the slope, and its errors, are left out.
"""

BESIDE = 1e-3
"""Fraction of it below which a pixel lies beside the array: its light is then a fraction of a gray level."""

LEAST_NOISE = 1 / 6
"""Variance in squared gray levels that rounding alone gives a difference of two frames, 2 / 12."""

MOVED_ERROR = 0.2
"""Fraction of what motion leaves of the data in a sum to which that is known.

LEDs shine in a part of an exposure only, so motion moves each by its own part. Less noise than this fraction is not
seen beside it, and the difference of pattern and inverse errs by as much.
"""

_PARAMETERS = 4
"""Degrees of freedom that a fit of the array's light and a plane takes."""

ENOUGH_PIXELS = 4000
"""Pixels inside the array that give its noise to about 3 %, as many differences of sums have that spread."""


@dataclass(frozen=True, slots=True)
class Noise:
    """Variance of a pixel of a difference of two frames, in squared gray levels."""

    # Inside the array: mostly photons
    lit: float
    # Beside it: the sensor's own noise, and whatever changes in the background
    dark: float


def measure_noise(cutouts: Sequence[Cutout], gain: float, side: int, led_gains: Floats | None = None) -> Noise:
    """Noise of a packet's cut-outs.

    Inside the array the sum of a pair is even but for noise, which is that of the difference, and for what motion
    between the two frames leaves of the data. LEDs that failed stay where they are from one sum to the next, so
    successive sums are compared. Beside the array the difference is noise and changes of the background.
    """
    if not cutouts:
        return Noise(LEAST_NOISE, LEAST_NOISE)
    chosen = _enough(cutouts, side)
    found = {k: _unevenness(cutouts[k], gain, side, led_gains) for k in sorted({k for two in chosen for k in two})}
    uneven = [*found.values()]
    if len(uneven) > 1:
        # successive sums have independent noise, so their difference has twice its variance
        parts = [_variance(_subtracted(found[i], found[j]) / np.sqrt(2)) for i, j in chosen]
    else:
        parts = [_variance(uneven[0].residual)]
    total, count = np.array(parts).sum(0)
    unevenness, moved = float(total) / max(float(count), 1.0), float(np.mean([one.moved for one in uneven]))
    lit = max(unevenness - moved, MOVED_ERROR * moved, LEAST_NOISE)
    return Noise(lit, noise_beside(cutouts, side))


def noise_beside(cutouts: Sequence[Cutout], side: int) -> float:
    """Variance of a background pixel in a difference of two frames, errors of the background model included."""
    squares, count = 0.0, 0
    for cutout in cutouts:
        light = footprints(cutout.poses[0], cutout.corner, cutout.shape, side)
        power, pixels = noise_kernels.power_beside(cutout.difference, (*light,), BESIDE)
        # a combined pair has another noise than a difference of two frames
        squares += power if cutout.combination is None else power / cutout.combination.noise
        count += pixels
    return max(squares / max(count, 1), LEAST_NOISE)


def _enough(cutouts: Sequence[Cutout], side: int) -> list[tuple[int, int]]:
    """Numbers of successive cut-outs from all over a packet, as many as are enough; of one it and itself."""
    inside = max((side * cutouts[0].middle.pitch - 2) ** 2, 1.0)
    pairs = [*pairwise(range(len(cutouts)))] or [(0, 0)]
    return pairs[:: max(1, int(len(pairs) * inside / ENOUGH_PIXELS))]


@dataclass(frozen=True, slots=True)
class _Unevenness:
    """Residual of a sum inside the array, (rows, columns), NaN elsewhere; `moved` is its variance by motion."""

    residual: Floats
    corner: tuple[int, int]
    moved: float


def _unevenness(cutout: Cutout, gain: float, side: int, led_gains: Floats | None) -> _Unevenness:
    """Residual of a sum about the array with all LEDs on and a plane, scaled by its degrees of freedom."""
    frames = [footprints(pose, cutout.corner, cutout.shape, side) for pose in cutout.poses]
    sight = np.ones((side, side)) if cutout.in_sight is None else cutout.in_sight
    gains, residual = sight if led_gains is None else cutout.shining(led_gains), np.empty(cutout.shape)
    lit_by, covered = (by_squares(gains), by_squares(sight)), cutout.covered or (ALL_SHOWN, ALL_SHOWN)
    first, last = (*frames[0],), (*frames[1],)
    count = noise_kernels.unevenness(cutout.total, first, last, *lit_by, *covered, INSIDE, residual)
    residual *= np.sqrt(count / max(count - _PARAMETERS, 1))
    # of the sum A_1 x + A_2 (1 - x) motion leaves (A_1 - A_2) (x - 1/2), and random data have the variance 1/16
    moved = gain**2 / 16 * kernels.squared_difference(*frames[0], *frames[1]) / (side * cutout.middle.pitch) ** 2
    if cutout.combination is None:
        return _Unevenness(residual, cutout.corner, float(moved))
    # in units of a sum of two frames; of combined ones only a header's sum is even, in which nothing moves
    return _Unevenness(residual / np.sqrt(cutout.combination.sum_noise), cutout.corner, 0.0)


def _subtracted(one: _Unevenness, other: _Unevenness) -> Floats:
    """Difference of two residuals on the pixels that both have."""
    left, top = (max(a, b) for a, b in zip(one.corner, other.corner, strict=True))
    a, b = (u.residual[top - u.corner[1] :, left - u.corner[0] :] for u in (one, other))
    rows, cols = (min(m, n) for m, n in zip(a.shape, b.shape, strict=True))
    return np.asarray(a[:rows, :cols] - b[:rows, :cols])


def _variance(residual: Floats) -> tuple[float, int]:
    """Variance times the number of pixels, by the median magnitude as failed LEDs are no noise; and that number."""
    known = residual[np.isfinite(residual)]
    return (robust_std(known) ** 2 * known.size, known.size) if known.size else (0.0, 0)
