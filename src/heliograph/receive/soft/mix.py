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
from heliograph.signal.formats import DIMMED
from heliograph.signal.pwm import SLOTS

Floats = NDArray[np.float64]

NOISE = 0.05
"""Variance of a frame's noise against which combinations are weighed, the light of an LED lit all through being 1: a
bit at the limit of reading has about a variance of 1/16."""

TOTAL_NOISE = 1e-3
"""The same for a sum, of which LEDs are not read one by one: its unevenness counts for more."""

LEAST_WEIGHT = 0.05
"""Frames of a smaller weight, as a share of the largest, are left out."""

LEAST_SLOPE = 0.1
"""Slope over the levels, as a share of that in step, below which a pair shows nothing."""

LEAST_SHARE = 0.02
"""Share of its exposure that a frame has in a pair, at least, to be used for it."""

LEAST_HEADER = 0.1
"""Root of the sum of squares with which frames show a header, about their mean, from which on it is read."""

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
    change
        (k,) weights of D: positive those of the virtual pattern, negative those of its inverse, each about 1 in sum.
    total
        (k,) weights of the sum, in which the array is lit most evenly and as brightly as with all LEDs on.
    slots
        (3, 4) light of each u_r in D: of the pair before, of this one, of the next.
    levels
        Mean light in the virtual pattern and in its inverse, for random data; 1/2 each in step.
    light
        When the mean light of the sum was, in T_b from the start of the pair.
    data
        (2,) when the light of the data was in the virtual pattern and in its inverse.
    dimmed
        Of a header, what D shows of a cell that is dimmed to name a format: contrast and light, 1/2 and 0 in step.
    """

    frames: NDArray[np.intp]
    change: Floats
    total: Floats
    slots: Floats
    levels: tuple[float, float]
    light: float
    data: tuple[float, float]
    dimmed: tuple[float, float] = (DIMMED, 0.0)

    @property
    def noise(self) -> float:
        """Variance of the noise of D against that of a difference of two frames."""
        return float(0.5 * (self.change**2).sum())

    @property
    def total_noise(self) -> float:
        """The same of the sum."""
        return float(0.5 * (self.total**2).sum())

    @property
    def departure(self) -> float:
        """By how much two frames depart from pattern and inverse, in shares of T_b; infinite for other frames."""
        ideal = np.zeros((3, SLOTS))
        ideal[1] = 0.5
        two = np.array_equal(self.total > 0.5, [True, True]) and len(self.change) == 2
        return float(np.abs(self.slots - ideal).sum(1).max()) / 2 if two else float("inf")

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

    @cached_property
    def dimmed(self) -> tuple[Floats, Floats]:
        """Contrast and mean light of each slot of a header's dimmed cells, (4,) each; 1 and 1/2 of others."""
        high, low = (np.where(self.rank < SLOTS * (0.5 + sign * DIMMED / 2), 1.0, 0.0) for sign in (1, -1))
        return high - low, 0.5 * (high + low)


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


def mix_pair(starts: Floats, exposure: float, light: SlotLight) -> Mix | None:
    """Combine frames for a pair of data.

    Parameters
    ----------
    starts
        (frames,) starts of the exposures in T_b from the start of the pair.
    exposure
        Their length in T_b.
    light
        The slots.

    Returns
    -------
    Mix, or None where the frames show nothing of the pair.
    """
    share, middle = _shares(starts, exposure)
    shown = np.einsum("fj,jqr->fqr", share, light.shows)
    slope = shown[:, 1] @ squares.SLOPES
    near = np.flatnonzero(share[:, PAIR : 2 * PAIR].sum(1) > LEAST_SHARE)
    change = _change(shown[near], slope[near])
    if change @ slope[near] < LEAST_SLOPE / 2:
        return None
    total = _total(shown[near], (share @ light.mean)[near])
    used = np.abs(change) + total > 0
    near, change, total = near[used], change[used], total[used]
    share, middle, shown = share[near], middle[near], shown[near]
    parts = np.maximum(change, 0), np.maximum(-change, 0)
    data = share[:, PAIR : 2 * PAIR] * np.abs(light.shows[PAIR : 2 * PAIR, 1] @ squares.SLOPES)
    return Mix(
        frames=near,
        change=change,
        total=total,
        slots=np.einsum("f,fqr->qr", change, shown),
        levels=(float((parts[0] @ share) @ light.mean), float((parts[1] @ share) @ light.mean)),
        light=_centroid(total, share * light.mean, middle),
        data=(
            _centroid(parts[0], data, middle[:, PAIR : 2 * PAIR]),
            _centroid(parts[1], data, middle[:, PAIR : 2 * PAIR]),
        ),
    )


def mix_header(starts: Floats, exposure: float, shown: Floats, dimmed: tuple[Floats, Floats]) -> Mix | None:
    """Combine frames of a header alone: their sum is free of it, their difference shows it as in step.

    Parameters
    ----------
    starts, exposure
        See `mix_pair`.
    shown
        (frames,) how much of the header less its inverse each frame shows, -1 to 1.
    dimmed
        (frames,) the same of cells that are dimmed to name a format, and their mean light.

    Returns
    -------
    Mix, or None where the frames do not show the header.
    """
    about = shown - shown.mean() if len(shown) else shown
    energy = float(about @ about)
    if energy < LEAST_HEADER**2:
        return None
    # least squares: sum beta = 2 with sum beta s = 0; sum w = 0 with sum w s = 2
    total, change = 2 / len(shown) - 2 * shown.mean() / energy * about, 2 / energy * about
    # a header's LEDs are lit evenly
    middle = float(total @ (starts + exposure / 2)) / 2
    slots, dim = np.zeros((3, SLOTS)), (0.5 * float(change @ dimmed[0]), float(change @ dimmed[1]))
    return Mix(np.arange(len(shown)), change, total, slots, (0.5, 0.5), middle, (middle, middle), dim)


def _shares(starts: Floats, exposure: float) -> tuple[Floats, Floats]:
    """Share of each exposure in each slot of three pairs, and the middles of those times, (frames, 24)."""
    begin = np.maximum(starts[:, None], _EDGES[:-1])
    end = np.minimum(starts[:, None] + exposure, _EDGES[1:])
    return np.maximum(end - begin, 0.0) / exposure, (begin + end) / 2


def _change(shown: Floats, slope: Floats) -> Floats:
    """Weights of D: alpha = M^-1 (h - mu 1), which maximises (alpha h)^2 / (alpha M alpha) with sum alpha = 0."""
    weights, used = np.zeros_like(slope), np.arange(len(slope))
    # what is not linear in the levels, and what is of other pairs, counts as noise at first
    rest = squares.COVARIANCE - np.outer(squares.SLOPES, squares.SLOPES)
    matrix = NOISE * np.eye(len(slope)) + shown[:, 1] @ rest @ shown[:, 1].T
    for q in (0, 2):
        matrix += shown[:, q] @ squares.COVARIANCE @ shown[:, q].T
    while len(used) >= 2:
        h, ones = slope[used], np.ones(len(used))
        a, b = np.linalg.solve(matrix[np.ix_(used, used)], np.stack([h, ones], axis=1)).T
        alpha = a - b * (a.sum() / b.sum())
        strong = np.abs(alpha) >= LEAST_WEIGHT * np.abs(alpha).max()
        if strong.all():
            weights[used] = alpha / max(alpha[alpha > 0].sum(), 1e-12)
            break
        used = used[strong]
    return weights


def _total(shown: Floats, light: Floats) -> Floats:
    """Weights of the sum: the least noise and unevenness, for the mean light of all LEDs on; none is negative."""
    matrix = TOTAL_NOISE * np.eye(len(light))
    for q in range(3):
        matrix += shown[:, q] @ squares.COVARIANCE @ shown[:, q].T
    weights, used = np.zeros_like(light), np.arange(len(light))
    while True:
        beta = np.linalg.solve(matrix[np.ix_(used, used)], light[used])
        strong = beta >= LEAST_WEIGHT * beta.max()
        if strong.all():
            weights[used] = beta / (beta @ light[used])
            return weights
        used = used[strong]


def _centroid(weights: Floats, light: Floats, middle: Floats) -> float:
    """When the light (frames, slots) of weighted frames was."""
    return float((weights @ (light * middle)).sum() / max((weights @ light).sum(), 1e-9))
