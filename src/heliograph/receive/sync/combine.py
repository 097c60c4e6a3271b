"""What an exposure of part of a pattern shows of the four symbols of a square of 2 x 2 LEDs.

PWM lights an LED of level k in the first k slots: slot j of a pattern shows on_j = 1 where k > j, else 0, and slot j of
the inverse shows 1 - on_(3 - j). Only the sum of all four on_j is the level, which is linear in the symbols. Any other
sum of lambda_j on_j is a function of the square's four symbols that holds products of symbols. The four symbols have 16
values in all, few enough to list the *response* to each.

Frames of any timing combined to a pattern and its inverse, and what the two then contain.

Let on_j be 1 where an LED is on in slot j of a pattern, else 0. The first four slots of a pair show on_0 to on_3. The
other four are those of the inverse: slot j of the inverse shows 1 - on_(3 - j). A frame f shows each slot by the
overlap omega of its exposure and the slot. Of an LED it shows

    l_f = sum_i sum_j omega_fij on_ij + const_f,

where j counts the slots and i the pairs: the one before, this one and the next. A difference d = sum_f alpha_f r_f of
the frames r_f with sum_f alpha_f = 0 holds nothing that is constant. Of all such differences `combine_pair` takes the
one whose slope over the pair's levels is largest against noise and light of the pairs before and after.

A packet's pairs combined of frames out of step: what is observed of them, and what that tells of their symbols.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import TINY, Floats
from heliograph.signal.formats import DIMMED
from heliograph.signal.pwm import SLOTS

SIGNS = np.array([[1, 1, 1, 1], [1, -1, 1, -1], [1, 1, -1, -1], [1, -1, -1, 1]], np.float64)
"""The Haar transform of a square: LEDs (0, 0), (0, 1), (1, 0), (1, 1) by symbols of D11, D12, D21, D22."""

VALUES = np.array([[1 - 2 * (k >> i & 1) for i in range(4)] for k in range(16)], np.float64)
"""(16, 4) all values of a square's symbols."""

# (2, 4, 16) which values of a square have +1, and which have -1, of each symbol
_SPLIT = np.stack([VALUES.T > 0, VALUES.T < 0]).astype(np.float64)

LEAST_LIKELIHOOD = 1e-300
"""Least likelihood that is told from none: the LLR of two such is beyond `LARGEST_LLR` by far."""

# level = 4 x = 2 + 1/2 H^T d H
_LEVELS = 2 + VALUES @ SIGNS / 2
_LIT = (_LEVELS[..., None] > np.arange(SLOTS)).astype(np.float64)

MEAN_LIT = _LIT.mean((0, 1))
"""(4,) E on_j of random data: 15, 11, 5 and 1 sixteenths."""

COVARIANCE = np.einsum("klr,kls->rs", _LIT - MEAN_LIT, _LIT - MEAN_LIT) / (16 * 4)
"""(4, 4) of the on_j of an LED."""

SLOPES = COVARIANCE.sum(0)
"""(4,) cov(on_j, level); as the level's variance is 1, also the slope of on_j over the level."""


def response(weights: Floats) -> Floats:
    """Observed symbols, by the 16 values of the true ones.

    They are the Haar transform of the light sum_j lambda_j on_j of each LED about its mean.
    """
    return np.asarray(((_LIT - MEAN_LIT) @ weights) @ SIGNS.T)


def response_of_levels(weights: Floats, lit: NDArray[np.bool_]) -> Floats:
    """Observed symbols of LEDs that are lit through the whole pattern or not at all. Returns (symbols,)."""
    light = (lit[..., None] - MEAN_LIT) @ weights
    side = len(lit)
    squares = light.reshape(side // 2, 2, side // 2, 2).transpose(0, 2, 1, 3).reshape(-1, 4)
    return np.asarray((squares @ SIGNS.T).T.reshape(-1))


def moments(table: Floats, mean: Floats) -> tuple[Floats, Floats]:
    """Mean and variance of the observed symbols. Returns (..., symbols) each."""
    first, second = _moments(table, _chances(mean))
    return first, np.maximum(second - first**2, 0)


def posterior_moments(table: Floats, observed: Floats, variance: Floats, mean: Floats) -> tuple[Floats, Floats]:
    """Mean of the observed symbols and of their squares without the errors of estimates, once these are known."""
    # of known symbols too: what is observed may be out of all proportion to what they give
    chance = _joint(_fit(table, observed, variance)) * _chances(uncertain(mean))
    return _moments(table, chance / chance.sum(-2, keepdims=True))


def symbol_llrs(table: Floats, observed: Floats, variance: Floats, mean: Floats) -> Floats:
    """Extrinsic LLRs ln P(c=+1)/P(c=-1) of the true symbols.

    An observed symbol depends on another one by the product of three. The equaliser's errors within a square are
    correlated, and so look like such products. What others say of a symbol therefore counts only as far as the other
    three symbols are known, or as the response is made of products rather than symbols.
    """
    prior, squares = uncertain(mean), _by_kind(mean)
    chance, fit = _chances(prior), _fit(table, observed, variance)
    # extrinsic: the symbol's own prior is left out
    own_prior = 2 * np.arctanh(_by_kind(prior))
    joint = _llrs((_joint(fit) * chance)[..., None, :, :]) - own_prior
    # in place: new memory costs more than what is computed in it
    fit -= fit.max(-2, keepdims=True)
    fit = np.exp(fit, out=fit)
    fit *= chance[..., None, :, :]
    own = _llrs(fit) - own_prior
    # part of the response's power that is products: 0 for the symbols themselves
    linear = np.einsum("...ki,ki->...", table, VALUES) / VALUES.size
    products = np.minimum((table**2).mean((-2, -1)) / linear**2 - 1, 1.0)[..., None, None]
    # of the three others of each
    known = np.moveaxis(squares**2, -2, 0)
    first, last = known[0] * known[1], known[2] * known[3]
    three = np.stack([known[1] * last, known[0] * last, first * known[3], first * known[2]], -2)
    trust = products + (1 - products) * three
    return np.asarray((own + trust * (joint - own)).reshape(mean.shape))


def uncertain(mean: Floats) -> Floats:
    """Means of which none is certain, so that no value of a square is impossible."""
    return np.clip(mean, TINY - 1, 1 - TINY)


def _by_kind(symbols: Floats) -> Floats:
    """Symbols (..., symbols) as (..., 4, squares)."""
    return symbols.reshape(*symbols.shape[:-1], 4, -1)


def _moments(table: Floats, chance: Floats) -> tuple[Floats, Floats]:
    """Mean of the observed symbols and of their squares, (..., symbols), by the chance of each value."""
    responses = np.swapaxes(table, -2, -1)
    first, second = responses @ chance, responses**2 @ chance
    flat = *first.shape[:-2], -1
    return first.reshape(flat), second.reshape(flat)


def _fit(table: Floats, observed: Floats, variance: Floats) -> Floats:
    """(..., 4, 16, squares) log likelihood of each value of a square by each of its observed symbols."""
    error = np.swapaxes(table, -2, -1)[..., None] - _by_kind(observed)[..., None, :]
    error *= error
    error *= _by_kind(-0.5 / variance)[..., None, :]
    return np.asarray(error)


def _joint(fit: Floats) -> Floats:
    """(..., 16, squares) likelihood of each value by all observed symbols, at most 1."""
    together = fit.sum(-3)
    return np.asarray(np.exp(together - together.max(-2, keepdims=True)))


def _llrs(likelihood: Floats) -> Floats:
    """LLRs (..., 4, squares) of each symbol by likelihoods (..., 4 or 1, 16, squares) of all values."""
    plus, minus = (np.maximum((part[:, None, :] @ likelihood)[..., 0, :], LEAST_LIKELIHOOD) for part in _SPLIT)
    return np.asarray(np.log(plus) - np.log(minus))


def _chances(mean: Floats) -> Floats:
    """(..., 16, squares) chance of each value of a square."""
    symbols = _by_kind(mean)
    chance = np.ones((*symbols.shape[:-2], 1, symbols.shape[-1]))
    for i in range(4):
        # the next bit of a value's number: 0 for +1
        one = symbols[..., i : i + 1, :]
        chance = np.concatenate([chance * (0.5 + 0.5 * one), chance * (0.5 - 0.5 * one)], -2)
    return chance


FRAME_NOISE = 0.05
"""Variance of a frame's noise in the choice of the difference, the light of an LED lit all through being 1.

A bit at the limit of decoding has about the variance 1/16. A larger value trusts frames less that straddle patterns.
"""

SUM_NOISE = 1e-3
"""The same in the choice of the sum. LEDs of a sum are not read one by one, so its unevenness counts for more."""

LEAST_WEIGHT = 0.05
"""Least weight of a frame as a fraction of the largest; frames of less are left out and cost no time."""

LEAST_SLOPE = 0.1
"""Least slope over the levels as a fraction of that in step; with less, a pair is lost (20 dB down)."""

LEAST_OVERLAP = 0.02
"""Least part of a frame's exposure within a pair for the frame to be used: that far two clocks agree."""

LEAST_HEADER = 0.1
"""Least root of the sum of squares of a header's amplitude over its frames, about their mean.

The four frames of two header pairs in step have 2: this is 26 dB down.
"""

EXACT = 0.035
"""Departure from a pattern less its inverse, as a fraction of T_b, that counts as none.

It costs a quarter of a dB: 0.1 T_b cost 0.7 dB.
"""

LEAK = 1e-3
"""Least weight of another pair's slot in the difference that is subtracted; the pair's own weigh 1/2 each."""

PAIR = 2 * SLOTS
_EDGES = np.arange(-PAIR, 2 * PAIR + 1) / SLOTS


@dataclass(frozen=True)
class Combination:
    """How frames combine to a pair."""

    # (k,) numbers of the frames, in the order given
    frames: NDArray[np.intp]
    # (k,) weights of the difference: positive ones make the pattern, negative ones its inverse; each sum to about 1
    difference: Floats
    # (k,) weights of the sum, in which the array is lit most evenly and as brightly as with all LEDs on
    total: Floats
    # (3, 4) light of each on_j in the difference: of the pair before, of this one, of the next
    slots: Floats
    # Mean light in the combined pattern and in its inverse for random data; 1/2 each in step
    levels: tuple[float, float]
    # Mean time of the sum's light, in T_b from the start of the pair
    sum_time: float
    # Mean times of the data's light in pattern and inverse, likewise
    data_times: tuple[float, float]
    # Of a header, what the difference shows of a cell that is dimmed to signal a format: contrast and light, 1/2 and 0
    # in step
    dimmed: tuple[float, float] = (DIMMED, 0.0)

    @property
    def noise(self) -> float:
        """Noise variance of the difference, 1 for a difference of two frames."""
        return float(0.5 * (self.difference**2).sum())

    @property
    def sum_noise(self) -> float:
        """Noise variance of the sum, 1 for a sum of two frames."""
        return float(0.5 * (self.total**2).sum())

    @cached_property
    def departure(self) -> float:
        """How far two frames depart from pattern and inverse, as a fraction of T_b; infinite for other frames."""
        ideal = np.zeros((3, SLOTS))
        ideal[1] = 0.5
        two = np.array_equal(self.total > 0.5, [True, True]) and len(self.difference) == 2
        return float(np.abs(self.slots - ideal).sum(1).max()) / 2 if two else float("inf")

    @cached_property
    def response(self) -> Floats:
        """(16, 4) observed symbols by the values of this pair's; see `partial_exposure.response`."""
        return response(self.slots[1])

    @cached_property
    def leaks(self) -> tuple[Floats | None, Floats | None]:
        """(16, 4) light in the difference of the symbols of the pairs before and after; None where there is none."""
        before, after = (response(slots) if np.abs(slots).max() > LEAK else None for slots in self.slots[[0, 2]])
        return before, after


@dataclass(frozen=True)
class SlotLight:
    """Light in each PWM slot of a pattern, in the order of time."""

    # Order in which the slots of a pattern are lit as the level rises
    order: tuple[int, ...]

    @cached_property
    def rank(self) -> NDArray[np.intp]:
        """(4,): slot s in time is the rank[s]-th to be lit."""
        return np.argsort(np.asarray(self.order))

    @cached_property
    def shows(self) -> Floats:
        """(24, 3, 4): factor of each on_j in each slot of three pairs, 1 in patterns and -1 in inverses."""
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
        """(24,) mean light of each slot for random data, 0 to 1."""
        constant = (self.shows.sum((1, 2)) < 0).astype(np.float64)
        return np.asarray(self.shows.sum(1) @ MEAN_LIT + constant)

    @cached_property
    def dimmed(self) -> tuple[Floats, Floats]:
        """Contrast and mean light of each slot of a header's dimmed cells, (4,) each; 1 and 1/2 of other cells."""
        high, low = (np.where(self.rank < SLOTS * (0.5 + sign * DIMMED / 2), 1.0, 0.0) for sign in (1, -1))
        return high - low, 0.5 * (high + low)


def combine_pair(starts: Floats, exposure: float, light: SlotLight) -> Combination | None:
    """Combine frames for a pair of data."""
    overlap, middle = _overlaps(starts, exposure)
    shown = np.einsum("fj,jqr->fqr", overlap, light.shows)
    slope = shown[:, 1] @ SLOPES
    near = np.flatnonzero(overlap[:, PAIR : 2 * PAIR].sum(1) > LEAST_OVERLAP)
    difference = _difference(shown[near], slope[near])
    # in step the slope is 1/2: 1/4 of the pattern and 1/4 of its inverse
    if difference @ slope[near] < LEAST_SLOPE / 2:
        return None
    total = _total(shown[near], (overlap @ light.mean)[near])
    used = np.abs(difference) + total > 0
    near, difference, total = near[used], difference[used], total[used]
    overlap, middle, shown = overlap[near], middle[near], shown[near]
    parts = np.maximum(difference, 0), np.maximum(-difference, 0)
    data = overlap[:, PAIR : 2 * PAIR] * np.abs(light.shows[PAIR : 2 * PAIR, 1] @ SLOPES)
    return Combination(
        frames=near,
        difference=difference,
        total=total,
        slots=np.einsum("f,fqr->qr", difference, shown),
        levels=(float((parts[0] @ overlap) @ light.mean), float((parts[1] @ overlap) @ light.mean)),
        sum_time=_centroid(total, overlap * light.mean, middle),
        data_times=(
            _centroid(parts[0], data, middle[:, PAIR : 2 * PAIR]),
            _centroid(parts[1], data, middle[:, PAIR : 2 * PAIR]),
        ),
    )


def combine_header(starts: Floats, exposure: float, shown: Floats, dimmed: tuple[Floats, Floats]) -> Combination | None:
    """Combine frames of a header alone: their sum is free of it, their difference shows it as in step."""
    about = shown - shown.mean() if len(shown) else shown
    energy = float(about @ about)
    if energy < LEAST_HEADER**2:
        return None
    # least squares: sum beta = 2 with sum beta s = 0; sum w = 0 with sum w s = 2
    total, difference = 2 / len(shown) - 2 * shown.mean() / energy * about, 2 / energy * about
    # a header's LEDs are lit evenly
    middle = float(total @ (starts + exposure / 2)) / 2
    cell = (0.5 * float(difference @ dimmed[0]), float(difference @ dimmed[1]))
    empty = np.zeros((3, SLOTS))
    return Combination(np.arange(len(shown)), difference, total, empty, (0.5, 0.5), middle, (middle, middle), cell)


def _overlaps(starts: Floats, exposure: float) -> tuple[Floats, Floats]:
    """Part of each exposure in each slot of three pairs, and the middles of those times, (frames, 24)."""
    begin = np.maximum(starts[:, None], _EDGES[:-1])
    end = np.minimum(starts[:, None] + exposure, _EDGES[1:])
    return np.maximum(end - begin, 0.0) / exposure, (begin + end) / 2


def _difference(shown: Floats, slope: Floats) -> Floats:
    """Weights alpha = Q^-1 (theta - mu 1), which maximise (alpha theta)^2 / (alpha Q alpha) with sum alpha = 0."""
    weights, used = np.zeros_like(slope), np.arange(len(slope))
    # what is not linear in the levels, and light of other pairs, counts as noise at first
    rest = COVARIANCE - np.outer(SLOPES, SLOPES)
    matrix = FRAME_NOISE * np.eye(len(slope)) + shown[:, 1] @ rest @ shown[:, 1].T
    for q in (0, 2):
        matrix += shown[:, q] @ COVARIANCE @ shown[:, q].T
    while len(used) >= 2:
        h, ones = slope[used], np.ones(len(used))
        # mu = (1 Q^-1 theta) / (1 Q^-1 1)
        a, b = np.linalg.solve(matrix[np.ix_(used, used)], np.stack([h, ones], axis=1)).T
        alpha = a - b * (a.sum() / b.sum())
        strong = np.abs(alpha) >= LEAST_WEIGHT * np.abs(alpha).max()
        if strong.all():
            weights[used] = alpha / max(alpha[alpha > 0].sum(), TINY)
            break
        used = used[strong]
    return weights


def _total(shown: Floats, light: Floats) -> Floats:
    """Weights of the sum: the least noise and unevenness, for the mean light of all LEDs on; none is negative."""
    matrix = SUM_NOISE * np.eye(len(light))
    for q in range(3):
        matrix += shown[:, q] @ COVARIANCE @ shown[:, q].T
    weights, used = np.zeros_like(light), np.arange(len(light))
    while True:
        beta = np.linalg.solve(matrix[np.ix_(used, used)], light[used])
        strong = beta >= LEAST_WEIGHT * beta.max()
        if strong.all():
            weights[used] = beta / (beta @ light[used])
            return weights
        used = used[strong]


def _centroid(weights: Floats, light: Floats, middle: Floats) -> float:
    """Mean time of the light (frames, slots) of weighted frames."""
    return float((weights @ (light * middle)).sum() / max((weights @ light).sum(), TINY))


@dataclass(frozen=True, slots=True)
class ObservedSymbols:
    """What is expected of a packet's observed symbols."""

    # mean, variance: (pairs, symbols) of the light of each pair's own symbols
    mean: Floats
    variance: Floats
    # leak, leak_variance: (pairs, symbols) of the light of the pairs before and after
    leak: Floats
    leak_variance: Floats


@dataclass(frozen=True, slots=True)
class UnsynchronisedPacket:
    """How a packet's pairs show their symbols, and those of the pairs before and after."""

    # (pairs, 16, 4) observed symbols by the values of a pair's own; see `partial_exposure.response`
    response: Floats
    # before, after: (pairs, 16, 4) the same of the pair before and the one after; 0 where it does not show
    before: Floats
    after: Floats
    # (pairs, symbols) light of the header before the first pair, and of the one after the last
    headers: Floats

    @classmethod
    def of(cls, combinations: Sequence[Combination | None], header: NDArray[np.bool_]) -> "UnsynchronisedPacket":
        """A packet's pairs."""
        none, last = np.zeros_like(VALUES), len(combinations) - 1
        response, leaks, headers = [], list[tuple[Floats, Floats]](), np.zeros((last + 1, header.size))
        for k, combination in enumerate(combinations):
            response.append(VALUES if combination is None else combination.response)
            sides = [none, none]
            for side, place in enumerate((k - 1, k + 1)):
                leak = None if combination is None else combination.leaks[side]
                if leak is None or combination is None:
                    continue
                if 0 <= place <= last:
                    sides[side] = leak
                else:
                    headers[k] += response_of_levels(combination.slots[2 * side], header)
            leaks.append((sides[0], sides[1]))
        before, after = (np.stack([pair[side] for pair in leaks]) for side in (0, 1))
        return cls(np.stack(response), before, after, headers)

    @property
    def in_step(self) -> bool:
        """Whether all that is observed are the pairs' own symbols."""
        return not self.before.any() and not self.after.any() and bool((self.response == VALUES).all())

    def expected(self, mean: Floats) -> ObservedSymbols:
        """What is expected of the observed symbols."""
        if self.in_step:
            return ObservedSymbols(mean, 1 - mean**2, self.headers.copy(), np.zeros_like(mean))
        own, spread = moments(self.response, mean)
        leak, leak_spread = self.headers.copy(), np.zeros_like(mean)
        later, earlier = slice(1, None), slice(-1)
        for there, others, response in ((later, earlier, self.before), (earlier, later, self.after)):
            if response.any():
                part, more = moments(response[there], mean[others])
                leak[there] += part
                leak_spread[there] += more
        return ObservedSymbols(own, spread, leak, leak_spread)

    def llrs(self, found: Floats, variance: Floats, expected: ObservedSymbols, mean: Floats) -> Floats:
        """Extrinsic LLRs of the symbols by estimates of the observed ones."""
        own, noise = found - expected.leak, variance + expected.leak_variance
        if self.in_step:
            # y = c + n: ln P(c=+1)/P(c=-1) = 2 y / s^2
            return 2 * own / noise
        return symbol_llrs(self.response, own, noise, mean)

    def posterior_moments(
        self, pairs: NDArray[np.intp], found: Floats, variance: Floats, mean: Floats
    ) -> tuple[Floats, Floats]:
        """Mean of observed symbols and of their squares, the light of other pairs left out; see `partial_exposure`."""
        if self.in_step:
            # <c> = tanh(y / s^2 + arctanh <c>_prior), c^2 = 1
            first = np.tanh(found / variance + np.arctanh(uncertain(mean)))
            return first, np.ones_like(first)
        return posterior_moments(self.response[pairs], found, variance, mean)
