"""Noise of a packet's glances: inside the array by what is not even in sums, beside it by differences."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from heliograph.receive.fit import spread_of
from heliograph.receive.soft import kernels
from heliograph.receive.soft.glance import Glance, all_on, dimmed, image_of, placed

Floats = NDArray[np.float64]

INSIDE = 0.8
"""Share of the array's light from which on a pixel lies inside the array."""

BESIDE = 1e-3
"""Share of it below which a pixel lies beside the array."""

LEAST_NOISE = 1 / 6
"""Variance in squared gray levels that rounding alone gives a difference of two frames."""

ENOUGH = 4000
"""Pixels inside the array by which its noise is known well enough, to 3 %."""


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
    if not glances:
        return Noise(LEAST_NOISE, LEAST_NOISE)
    chosen = _enough(glances, side)
    found = {k: _unevenness(glances[k], gain, side, shares) for k in sorted({k for two in chosen for k in two})}
    uneven = [*found.values()]
    if len(uneven) > 1:
        parts = [_variance(_apart(found[i], found[j]) / np.sqrt(2)) for i, j in chosen]
    else:
        parts = [_variance(uneven[0].residual)]
    total, count = np.array(parts).sum(0)
    lit = float(total) / max(float(count), 1.0) - float(np.mean([one.moved for one in uneven]))
    beside = np.concatenate([_beside(glance, side) for glance in glances])
    dark = float((beside**2).mean()) if beside.size else 0.0
    return Noise(max(lit, LEAST_NOISE), max(dark, LEAST_NOISE))


def noise_beside(glances: Sequence[Glance], side: int) -> float:
    """Variance of a pixel of single frames' glances beside the array, what is not known of the background included."""
    ones = np.ones((side, side))
    squares, count = 0.0, 0
    for glance in glances:
        lit = image_of(ones, glance.middle, glance.corner, glance.change.shape)
        beside = glance.change[lit < BESIDE]
        squares, count = squares + float((beside**2).sum()), count + beside.size
    return max(squares / max(count, 1), LEAST_NOISE)


def _enough(glances: Sequence[Glance], side: int) -> list[tuple[int, int]]:
    """Numbers of successive glances from all over a packet, as many as are enough; of one glance it and itself."""
    inside = max((side * glances[0].middle.pitch - 2) ** 2, 1.0)
    pairs = [*pairwise(range(len(glances)))] or [(0, 0)]
    return pairs[:: max(1, int(len(pairs) * inside / ENOUGH))]


@dataclass(frozen=True, slots=True)
class _Uneven:
    """What of a sum inside the array is not even, (rows, columns), NaN elsewhere.

    `moved` is the variance that motion between the two frames leaves of the data.
    """

    residual: Floats
    corner: tuple[int, int]
    moved: float


def _unevenness(glance: Glance, gain: float, side: int, shares: Floats | None) -> _Uneven:
    """Residuals of a sum inside the array, scaled by their degrees of freedom."""
    frames = [placed(pose, glance.corner, glance.change.shape, side) for pose in glance.poses]
    whole = all_on(frames[0], glance.change.shape)
    first, second = (all_on(dimmed(share, shares), glance.change.shape) for share in frames)
    lit = 0.5 * (first + second)
    inside = whole > INSIDE * whole.max()
    y, x = np.nonzero(inside)
    columns = np.stack([lit[inside], np.ones(len(x)), x - x.mean(), y - y.mean()], axis=1)
    fitted = columns @ np.linalg.lstsq(columns, glance.total[inside], rcond=1e-6)[0]
    residual = np.full(glance.total.shape, np.nan)
    residual[inside] = (glance.total[inside] - fitted) * np.sqrt(len(x) / max(len(x) - columns.shape[1], 1))
    # of the sum A_1 x + A_2 (1 - x) motion leaves (A_1 - A_2) (x - 1/2), and random data have the variance 1/16
    moved = gain**2 / 16 * kernels.difference(*frames[0], *frames[1]) / (side * glance.middle.pitch) ** 2
    if glance.mix is None:
        return _Uneven(residual, glance.corner, float(moved))
    # as if of two frames; of combined ones only a header's sum is even, in which nothing moves
    return _Uneven(residual / np.sqrt(glance.mix.total_noise), glance.corner, 0.0)


def _beside(glance: Glance, side: int) -> Floats:
    """The difference beside the array, as if of two frames."""
    lit = all_on(placed(glance.poses[0], glance.corner, glance.change.shape, side), glance.change.shape)
    beside = glance.change[lit < BESIDE]
    return beside if glance.mix is None else beside / np.sqrt(glance.mix.noise)


def _apart(one: _Uneven, other: _Uneven) -> Floats:
    """Difference of two residuals where both are known."""
    left, top = (max(a, b) for a, b in zip(one.corner, other.corner, strict=True))
    a, b = (u.residual[top - u.corner[1] :, left - u.corner[0] :] for u in (one, other))
    rows, cols = (min(m, n) for m, n in zip(a.shape, b.shape, strict=True))
    return np.asarray(a[:rows, :cols] - b[:rows, :cols])


def _variance(residual: Floats) -> tuple[float, int]:
    """Variance by the median magnitude, for LEDs that failed are no noise, times the number of pixels; and that."""
    known = residual[np.isfinite(residual)]
    return (spread_of(known) ** 2 * known.size, known.size) if known.size else (0.0, 0)
