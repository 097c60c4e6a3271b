"""Frames of any timing combined to a virtual pattern and its virtual inverse, and what these contain.

In units of T_b from the start of a pair, slot j of the pair shows slot j of its pattern, u_j, up to j = 3, then slot
j - 4 of its inverse, 1 - u_(7 - j). A frame exposed from a to a + tau shows each slot by its share of the exposure,

    l_f = sum_q sum_r V_fqr u_qr + k_f,

r the slots of pattern q: the pair before, this one and the next. Of all combinations D = sum_f alpha_f l_f in which
what does not change cancels, sum_f alpha_f = 0, that one is taken whose slope over the pair's levels is largest
against the noise and what it holds of the pairs before and after.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.receive.soft import squares
from heliograph.signal.pwm import SLOTS

Floats = NDArray[np.float64]

NOISE = 0.05
"""Variance of a frame's noise against which combinations are weighed, the light of an LED lit all through being 1: a
bit at the limit of reading has about a variance of 1/16."""

LEAST_WEIGHT = 0.05
"""Frames of a smaller weight, as a share of the largest, are left out."""

LEAST_SLOPE = 0.1
"""Slope over the levels, as a share of that in step, below which a pair shows nothing."""

EXACT = 0.035
"""Departure from a pattern less its inverse, in shares of T_b, that is taken for none."""

PAIR = 2 * SLOTS
_EDGES = np.arange(-PAIR, 2 * PAIR + 1) / SLOTS


@dataclass(frozen=True)
class Mix:
    """A combination of frames for a pair.

    Attributes
    ----------
    frames
        (k,) numbers of the frames, in the order given.
    weights
        (k,) positive: of the virtual pattern, negative: of its inverse, together the difference D.
    slots
        (3, 4) light of each u_r in D: of the pair before, of this one, of the next.
    levels
        Mean light in the virtual pattern and in its inverse, for random data; 1/2 each in step.
    header
        Light of the header in D, as a share of that in step.
    light
        (2,) when the mean light of both was, in T_b from the start of the pair.
    data
        (2,) when the light of the data was.
    """

    frames: NDArray[np.intp]
    weights: Floats
    slots: Floats
    levels: tuple[float, float]
    header: float
    light: tuple[float, float]
    data: tuple[float, float]

    @property
    def noise(self) -> float:
        """Variance of the noise of D against that of a difference of two frames."""
        return float(0.5 * (self.weights**2).sum())

    @property
    def in_step(self) -> bool:
        """Whether D is a frame less the next, and these pattern and inverse."""
        ideal = np.zeros((3, SLOTS))
        ideal[1] = 0.5
        return len(self.frames) == 2 and bool(np.abs(self.slots - ideal).sum(1).max() < 2 * EXACT)

    @cached_property
    def table(self) -> Floats:
        """Cells as seen by the values of the true ones, see `squares.seen`."""
        return squares.seen(self.slots[1])

    @cached_property
    def leaks(self) -> tuple[Floats, Floats]:
        """The same for the cells of the pair before and of the next."""
        return squares.seen(self.slots[0]), squares.seen(self.slots[2])

    @property
    def leaky(self) -> tuple[bool, bool]:
        """Whether anything is seen of the pair before, and of the next."""
        return bool(np.abs(self.slots[0]).max() > 1e-3), bool(np.abs(self.slots[2]).max() > 1e-3)


@dataclass(frozen=True)
class SlotLight:
    """What the slots of a pattern show, in the order of time."""

    order: tuple[int, ...]

    @cached_property
    def rank(self) -> NDArray[np.intp]:
        """Slot s in time is the rank[s]-th to be lit."""
        return np.argsort(np.asarray(self.order))

    @cached_property
    def shows(self) -> Floats:
        """(24, 3, 4): sign and number of the u_r that each slot of three pairs shows."""
        out = np.zeros((3 * PAIR, 3, SLOTS))
        for j in range(3 * PAIR):
            q, s = divmod(j, PAIR)
            if s < SLOTS:
                out[j, q, self.rank[s]] = 1.0
            else:
                out[j, q, SLOTS - 1 - self.rank[s - SLOTS]] = -1.0
        return out

    @cached_property
    def mean(self) -> Floats:
        """(24,) mean light of each slot for random data."""
        constant = (self.shows.sum((1, 2)) < 0).astype(np.float64)
        return np.asarray(self.shows.sum(1) @ squares.MEAN_LIT + constant)


@dataclass(frozen=True, slots=True)
class VirtualFrame(Frame):
    """Frames combined to a pattern or to an inverse; its pixels are float32.

    Attributes
    ----------
    mix
        How.
    """

    mix: Mix | None = None


def mix_of(frame: Frame) -> Mix | None:
    """How a frame was combined; None for a camera's own."""
    return frame.mix if isinstance(frame, VirtualFrame) else None


def mix_pair(starts: Floats, exposure: float, light: SlotLight, header: Floats | None = None) -> Mix | None:
    """Combine frames for a pair.

    Parameters
    ----------
    starts
        (frames,) starts of the exposures in T_b from the start of the pair.
    exposure
        Their length in T_b.
    light
        The slots.
    header
        (frames,) for a pair of a header how much of it less its inverse each frame shows, -1 to 1.

    Returns
    -------
    Mix, or None where the frames show nothing of the pair.
    """
    begin = np.maximum(starts[:, None], _EDGES[:-1])
    end = np.minimum(starts[:, None] + exposure, _EDGES[1:])
    share = np.maximum(end - begin, 0.0) / exposure
    shown = np.einsum("fj,jqr->fqr", share, light.shows)
    slope = shown[:, 1] @ squares.SLOPES
    used = np.flatnonzero(share[:, PAIR : 2 * PAIR].sum(1) > 0.02)
    weights, strong = np.zeros(0), np.zeros(1, dtype=bool)
    while not strong.all():
        best = _best(shown[used], slope[used])
        if best is None:
            return None
        weights = best
        strong = np.abs(weights) >= LEAST_WEIGHT * np.abs(weights).max()
        used = used[strong]
    weights /= weights[weights > 0].sum()
    share, middle, slope = share[used], (begin + end)[used] / 2, slope[used]
    if weights @ slope < LEAST_SLOPE / 2:
        return None
    parts = [np.where(weights > 0, weights, 0.0), np.where(weights < 0, -weights, 0.0)]
    mean = share * light.mean
    data = share[:, PAIR : 2 * PAIR] * (light.shows[PAIR : 2 * PAIR, 1] @ squares.SLOPES)
    levels = [float((part @ mean).sum()) for part in parts]
    # about a tenth of the array's LEDs is lit in some slots: the sum of both is kept at that of all LEDs
    scale = 1.0 if header is not None else 1.0 / sum(levels)
    slots = scale * np.einsum("f,fqr->qr", weights, shown[used])
    return Mix(
        frames=used,
        weights=scale * weights,
        slots=slots,
        levels=(scale * levels[0], scale * levels[1]),
        header=1.0 if header is None else float(weights @ header[used] / 2),
        light=_centroids(parts, mean, middle),
        data=_centroids(parts, np.abs(data), middle[:, PAIR : 2 * PAIR]),
    )


def _best(shown: Floats, slope: Floats) -> Floats | None:
    """alpha = M^-1 (h - mu 1), which maximises (alpha h)^2 / (alpha M alpha) with sum alpha = 0."""
    if len(slope) < 2 or slope.max() <= 0 or slope.min() >= 0:
        return None
    # what is not linear in the levels counts as noise at first
    rest = squares.COVARIANCE - np.outer(squares.SLOPES, squares.SLOPES)
    matrix = NOISE * np.eye(len(slope)) + shown[:, 1] @ rest @ shown[:, 1].T
    for q in (0, 2):
        matrix += shown[:, q] @ squares.COVARIANCE @ shown[:, q].T
    a, b = np.linalg.solve(matrix, np.stack([slope, np.ones_like(slope)], axis=1)).T
    weights: Floats = a - b * (a.sum() / b.sum())
    return weights if (weights > 0).any() and (weights < 0).any() else None


def _centroids(parts: list[Floats], light: Floats, middle: Floats) -> tuple[float, float]:
    """When the light (frames, slots) of both parts was."""
    first, second = (float((part @ (light * middle)).sum() / max((part @ light).sum(), 1e-9)) for part in parts)
    return first, second
