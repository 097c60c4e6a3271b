"""Poses of a packet that was not read whole: where the differences of single pairs are what an array can give.

What passes before an array is beside it first, pulls the poses that sums show by up to a pitch for a few pairs, and
then hides a part of it. With nothing decoded, a difference still tells where the array is: its light is that of LEDs,
at the pose B, of random symbols c,

    d = g (B c + o) + n,   q = (d - g o)^T (s^2 + g^2 B B^T)^-1 (d - g o),

and a pose that is wrong by a third of a pixel leaves light that no symbols explain, so q is many times as large.
"""

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import Floats
from heliograph.receive.equalise.lmmse import products
from heliograph.receive.observe.cutout import Cutout
from heliograph.receive.observe.noise import Noise
from heliograph.receive.observe.statistics import whiten

ODD_RATIO = 2.0
"""Least q of a pair whose pose is looked for, as a multiple of the packet's usual q, less for what is hidden.

Of the pairs before a post came, in a film at 47 m, q was 0.86 to 1.14 times their median. Pulled by 0.2 px and more it
was six times as large or more.
"""

USUAL_QUANTILE = 0.25
"""Quantile of the pairs' q that is usual: a quarter of the pairs may be taken to be right."""

ALIKE_RATIO = 3.0
"""Largest q of a pose that may be the right one, as a multiple of the least.

Where a side is hidden, an array moved by one LED gives nearly the same light: of such poses those are taken that are
nearest to the poses of the pairs before and after.
"""

REACH_PX, STEP_PX = 1.2, 0.2
"""Largest error looked for along x and y, and its step, in px: half of the width of the dip that q has."""

FINE_PX = (0.1, 0.05)
"""Steps by which a pose is made finer, in px. Poses of decoded packets are refined to less (`pose_refinement`)."""


def consistent(
    cutouts: Sequence[Cutout | None], noise: Noise, led_gains: Floats, gain: float
) -> tuple[list[Cutout | None], float]:
    """Move each pair whose difference no array gives at its pose to where one does.

    Parameters
    ----------
    cutouts
        One per pair; None where the array was not seen.
    noise
        Variances inside and beside the array in squared gray levels.
    led_gains
        (n, n) gains of the LEDs, at least 0, 1 for the median LED.
    gain
        Gray levels of the array with all LEDs on.

    Returns
    -------
    The cut-outs with their poses moved, and the largest move in px.
    """

    def left(cutout: Cutout) -> float:
        return _unexplained(cutout, noise, led_gains, gain)

    seen = {k: cutout for k, cutout in enumerate(cutouts) if cutout is not None}
    rest = {k: left(cutout) for k, cutout in seen.items()}
    shares = [q / _open_share(seen[k]) for k, q in rest.items()]
    usual = float(np.quantile(shares, USUAL_QUANTILE, method="lower")) if seen else 0.0
    errors = _smoothest(
        [
            _errors(cutout, left) if rest[k] > ODD_RATIO * usual * _open_share(cutout) else np.zeros((1, 2))
            for k, cutout in seen.items()
        ]
    )
    out = [*cutouts]
    for (k, cutout), error in zip(seen.items(), errors, strict=True):
        if error.any():
            out[k] = _at(cutout, error)
    return out, max((float(np.hypot(*error)) for error in errors), default=0.0)


def _errors(cutout: Cutout, left: Callable[[Cutout], float]) -> Floats:
    """Errors (m, 2) in px that a pair's pose may have: the lowest dips of q along x or along y."""
    steps = np.arange(-round(REACH_PX / STEP_PX), round(REACH_PX / STEP_PX) + 1) * STEP_PX
    lines = [np.outer(steps, axis) for axis in np.eye(2)]
    rests = [np.array([left(_at(cutout, error)) for error in line]) for line in lines]
    line, rest = min(zip(lines, rests, strict=True), key=lambda one: float(one[1].min()))
    around = np.concatenate([[np.inf], rest, [np.inf]])
    dips = (rest <= around[:-2]) & (rest <= around[2:])
    found = [_finer(cutout, error, q, left) for error, q in zip(line[dips], rest[dips], strict=True)]
    least = min(q for _, q in found)
    return np.array([error for error, q in found if q <= ALIKE_RATIO * least]) if least < np.inf else np.zeros((1, 2))


def _finer(cutout: Cutout, error: Floats, q: float, left: Callable[[Cutout], float]) -> tuple[Floats, float]:
    """The error (2,) near another one that leaves least, and what it leaves."""
    for step in FINE_PX:
        for move in step * np.array([(1, 0), (-1, 0), (0, 1), (0, -1)]):
            rest = left(_at(cutout, error + move))
            if rest < q:
                error, q = error + move, rest
    return error, q


def _smoothest(errors: Sequence[Floats]) -> list[Floats]:
    """Of each pair's errors (m, 2) one, such that the sum of their squared changes is least (Viterbi)."""
    cost, came = np.zeros(len(errors[0])) if errors else np.zeros(0), list[NDArray[np.intp]]()
    for before, after in pairwise(errors):
        change = ((after[:, None] - before[None]) ** 2).sum(-1) + cost
        came.append(change.argmin(1))
        cost = change.min(1)
    place = int(cost.argmin()) if errors else 0
    path = [place]
    for back in reversed(came):
        place = int(back[place])
        path.append(place)
    return [one[k] for one, k in zip(errors, reversed(path), strict=True)] if errors else []


def _open_share(cutout: Cutout) -> float:
    """Share of the LEDs that nothing hides."""
    return 1.0 if cutout.in_sight is None else max(float(cutout.in_sight.mean()), 1 / cutout.in_sight.size)


def _at(cutout: Cutout, error: Floats) -> Cutout:
    return cutout.moved(np.append(error, np.zeros(2)))


def _unexplained(cutout: Cutout, noise: Noise, led_gains: Floats, gain: float) -> float:
    """The quantity q of a cut-out at its pose; infinite where rounding leaves none."""
    whitened = whiten(cutout, noise, len(led_gains), led_gains)
    pair = whitened.statistics()
    light = (whitened.difference - gain * whitened.offset)[None]
    try:
        left = float(products(whitened, pair, light, np.arange(led_gains.size), gain**2 / noise.lit)[0, 0])
    except np.linalg.LinAlgError:
        return np.inf
    return left / noise.lit if 0 < left < np.inf else np.inf
