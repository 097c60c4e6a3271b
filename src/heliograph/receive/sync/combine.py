"""Combination of frames of any timing to a pattern and an inverse, and the symbols in the combined pair.

Let on_j be 1 if an LED is on in slot j of a pattern, else 0. PWM lights an LED of level k in the first k slots: on_j is
1 for k > j. Slot j of the inverse shows 1 - on_(3 - j). A frame f overlaps each slot by omega and so shows the LED as

    l_f = sum_i sum_j omega_fij on_ij + const_f,

where i counts the pairs (previous, current, next). A difference d = sum_f alpha_f r_f of frames r_f with
sum_f alpha_f = 0 is free of constant light. Among these differences, `combine_pair` selects the largest slope over the
levels of the pair against noise and light of the neighbouring pairs.

The level is the sum of all four on_j and linear in the symbols. Any other sum of lambda_j on_j also holds products of
the four symbols of a square of 2 x 2 LEDs. These symbols have 16 values, so that a table lists the *response* to each.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import TINY, Floats
from heliograph.receive.geometry.footprint import to_quarters
from heliograph.signal.formats import DIMMED
from heliograph.signal.pwm import SLOTS

# the Haar transform of a square: LEDs (0, 0), (0, 1), (1, 0), (1, 1) by symbols of D11, D12, D21, D22
SIGNS = np.array([[1, 1, 1, 1], [1, -1, 1, -1], [1, 1, -1, -1], [1, -1, -1, 1]], np.float64)

# (16, 4) all values of a square's symbols
VALUES = np.array([[1 - 2 * (k >> i & 1) for i in range(4)] for k in range(16)], np.float64)

# (2, 4, 16) which values of a square have +1, and which have -1, of each symbol
_SPLIT = np.stack([VALUES.T > 0, VALUES.T < 0]).astype(np.float64)

# level = 4 x = 2 + 1/2 H^T d H
_LIT = (2 + (VALUES @ SIGNS / 2)[..., None] > np.arange(SLOTS)).astype(np.float64)

MEAN_LIT = _LIT.mean((0, 1))  # (4,) E on_j of random data: 15, 11, 5 and 1 sixteenths

# (4, 4) covariance of the on_j of an LED
COVARIANCE = np.einsum("klr,kls->rs", _LIT - MEAN_LIT, _LIT - MEAN_LIT) / (16 * 4)

SLOPES = COVARIANCE.sum(0)  # (4,) cov(on_j, level); as the level's variance is 1, also the slope of on_j over the level


def response(weights: Floats) -> Floats:
    """Return the observed symbols for the 16 values of a square: the Haar transform of sum_j lambda_j on_j."""
    return np.asarray(((_LIT - MEAN_LIT) @ weights) @ SIGNS.T)


def response_of_levels(weights: Floats, lit: NDArray[np.bool_]) -> Floats:
    """Return the observed symbols (symbols,) of LEDs that are constantly on or off in a pattern."""
    return np.asarray((SIGNS @ to_quarters((lit[..., None] - MEAN_LIT) @ weights).reshape(4, -1)).ravel())


def moments(table: Floats, mean: Floats) -> tuple[Floats, Floats]:
    """Return mean and variance of the observed symbols, (..., symbols) each."""
    first, second = _moments(table, _probabilities(mean))
    return first, np.maximum(second - first**2, 0)


def posterior_moments(table: Floats, observed: Floats, variance: Floats, mean: Floats) -> tuple[Floats, Floats]:
    """Return the posterior means of the observed symbols and of the squared symbols, given noisy estimates."""
    # certain symbols are relaxed as well: their response may contradict the estimates
    probability = _joint_likelihood(_log_likelihoods(table, observed, variance)) * _probabilities(uncertain(mean))
    return _moments(table, probability / probability.sum(-2, keepdims=True))


def symbol_llrs(table: Floats, observed: Floats, variance: Floats, mean: Floats) -> Floats:
    """Compute extrinsic LLRs ln P(c=+1)/P(c=-1) of the true symbols.

    Correlated errors of the equaliser within a square look like products of symbols. The other observed symbols
    therefore count only if the three other symbols are known or if the response consists of products.
    """
    prior, squares = uncertain(mean), _by_kind(mean)
    probability, fit = _probabilities(prior), _log_likelihoods(table, observed, variance)
    # extrinsic: without the prior of the symbol
    own_prior = 2 * np.arctanh(_by_kind(prior))
    joint = _to_llrs((_joint_likelihood(fit) * probability)[..., None, :, :]) - own_prior
    # in place: allocation costs more than the arithmetic
    fit -= fit.max(-2, keepdims=True)
    fit = np.exp(fit, out=fit)
    fit *= probability[..., None, :, :]
    own = _to_llrs(fit) - own_prior
    # power of the products in the response; 0 for a linear response
    linear = np.einsum("...ki,ki->...", table, VALUES) / VALUES.size
    products = np.minimum((table**2).mean((-2, -1)) / linear**2 - 1, 1.0)[..., None, None]
    # the three other symbols of each
    known = np.moveaxis(squares**2, -2, 0)
    first, last = known[0] * known[1], known[2] * known[3]
    three = np.stack([known[1] * last, known[0] * last, first * known[3], first * known[2]], -2)
    trust = products + (1 - products) * three
    return np.asarray((own + trust * (joint - own)).reshape(mean.shape))


def uncertain(mean: Floats) -> Floats:
    """Clip means so that no value of a square is impossible."""
    return np.clip(mean, TINY - 1, 1 - TINY)


def _by_kind(symbols: Floats) -> Floats:
    """Reshape symbols (..., symbols) to (..., 4, squares)."""
    return symbols.reshape(*symbols.shape[:-1], 4, -1)


def _moments(table: Floats, probability: Floats) -> tuple[Floats, Floats]:
    """Return means of observed and of squared symbols, (..., symbols), for the probability of each value."""
    responses = np.swapaxes(table, -2, -1)
    first, second = responses @ probability, responses**2 @ probability
    flat = *first.shape[:-2], -1
    return first.reshape(flat), second.reshape(flat)


def _log_likelihoods(table: Floats, observed: Floats, variance: Floats) -> Floats:
    """Return (..., 4, 16, squares) log likelihoods of the values of a square for each observed symbol."""
    error = np.swapaxes(table, -2, -1)[..., None] - _by_kind(observed)[..., None, :]
    error *= error
    error *= _by_kind(-0.5 / variance)[..., None, :]
    return np.asarray(error)


def _joint_likelihood(fit: Floats) -> Floats:
    """Return (..., 16, squares) likelihoods of each value for all observed symbols, at most 1."""
    together = fit.sum(-3)
    return np.asarray(np.exp(together - together.max(-2, keepdims=True)))


def _to_llrs(likelihood: Floats) -> Floats:
    """Convert likelihoods (..., 4 or 1, 16, squares) of all values to LLRs (..., 4, squares)."""
    # the floor lies far beyond the LLR limit of the decoder
    plus, minus = (np.maximum((part[:, None, :] @ likelihood)[..., 0, :], 1e-300) for part in _SPLIT)
    return np.asarray(np.log(plus) - np.log(minus))


def _probabilities(mean: Floats) -> Floats:
    """Return (..., 16, squares) probabilities of the values of a square."""
    symbols = _by_kind(mean)
    probability = np.ones((*symbols.shape[:-2], 1, symbols.shape[-1]))
    for i in range(4):
        # bit i of the value is 0 for +1
        symbol = symbols[..., i : i + 1, :]
        probability = np.concatenate([probability * (0.5 + 0.5 * symbol), probability * (0.5 - 0.5 * symbol)], -2)
    return probability


PAIR = 2 * SLOTS  # slots of a pair


@dataclass(frozen=True)
class Combination:
    """Weights that combine frames to a pair."""

    # (k,) numbers of the frames, in the given order
    frames: NDArray[np.intp]
    # (k,) weights of the difference: positive for the pattern, negative for the inverse; each sum to about 1
    difference: Floats
    # (k,) weights of the sum, in which the array is lit evenly and as brightly as with all LEDs on
    total: Floats
    # (3, 4) light of each on_j in the difference: previous, current and next pair
    slots: Floats
    # Mean light in the combined pattern and in the inverse for random data; 1/2 each for a synchronous camera
    levels: tuple[float, float]
    # Mean time of the light in the sum, in T_b from the start of the pair
    sum_time: float
    # Mean times of the data light in pattern and inverse, likewise
    data_times: tuple[float, float]
    # Contrast and light of a dimmed header cell in the difference, (1/2, 0) for a synchronous camera
    dimmed: tuple[float, float] = (DIMMED, 0.0)

    @property
    def noise(self) -> float:
        """Noise variance of the difference, 1 for a difference of two frames."""
        return float(0.5 * (self.difference**2).sum())

    @cached_property
    def departure(self) -> float:
        """Misplaced light of two frames, as a fraction of T_b; infinite for any other number of frames."""
        ideal = np.zeros((3, SLOTS))
        ideal[1] = 0.5
        is_two = np.array_equal(self.total > 0.5, [True, True]) and len(self.difference) == 2
        return float(np.abs(self.slots - ideal).sum(1).max()) / 2 if is_two else float("inf")

    @cached_property
    def response(self) -> Floats:
        """(16, 4) observed symbols for each value of the current pair."""
        return response(self.slots[1])

    @cached_property
    def leaks(self) -> tuple[Floats | None, ...]:
        """(16, 4) responses to the symbols of the previous and the next pair; None without such light."""
        # slots of the pair weigh 1/2
        return tuple(response(slots) if np.abs(slots).max() > 1e-3 else None for slots in self.slots[[0, 2]])


@lru_cache
def slot_light(order: tuple[int, ...]) -> tuple[Floats, Floats]:
    """Return the light in the PWM slots of three pairs, for the order in which slots are lit as the level rises.

    Factor of each on_j, (24, 3, 4): 1 in patterns, -1 in inverses; and mean light for random data, (24,), 0 to 1.
    """
    rank, shows = np.argsort(order), np.zeros((3 * PAIR, 3, SLOTS))
    for q in range(3):
        slots = PAIR * q + np.arange(SLOTS)
        shows[slots, q, rank] = 1.0
        shows[slots + SLOTS, q, SLOTS - 1 - rank] = -1.0
    factors = shows.sum(1)
    return shows, factors @ MEAN_LIT + (factors.sum(1) < 0)


def dimmed_light(order: tuple[int, ...]) -> tuple[Floats, Floats]:
    """Return contrast and mean light of dimmed header cells in each slot, (4,) each; 1 and 1/2 for other cells."""
    rank = np.argsort(order)
    high, low = (np.where(rank < SLOTS * (0.5 + sign * DIMMED / 2), 1.0, 0.0) for sign in (1, -1))
    return high - low, 0.5 * (high + low)


def combine_pair(starts: Floats, exposure: float, order: tuple[int, ...]) -> Combination | None:
    """Combine frames to a data pair; None if the frames do not show the pair."""
    overlap, middle = _overlaps(starts, exposure)
    shows, mean = slot_light(order)
    seen = np.einsum("fj,jqr->fqr", overlap, shows)
    slope = seen[:, 1] @ SLOPES
    near = np.flatnonzero(overlap[:, PAIR : 2 * PAIR].sum(1) > 0.02)
    difference = _difference(seen[near], slope[near])
    # a synchronous pair has the slope 1/2: 1/4 from the pattern, 1/4 from the inverse; 20 dB down at least
    if difference @ slope[near] < 0.05:
        return None
    total = _total(seen[near], (overlap @ mean)[near])
    used = np.abs(difference) + total > 0
    near, difference, total = near[used], difference[used], total[used]
    overlap, middle = overlap[near], middle[near]
    parts = np.maximum(difference, 0), np.maximum(-difference, 0)
    data = overlap * np.abs(shows[:, 1] @ SLOPES)
    first, second = (float((part @ overlap) @ mean) for part in parts)
    slots, sum_time = np.einsum("f,fqr->qr", difference, seen[near]), _centroid(total, overlap * mean, middle)
    data_times = _centroid(parts[0], data, middle), _centroid(parts[1], data, middle)
    return Combination(near, difference, total, slots, (first, second), sum_time, data_times)


def combine_header(
    starts: Floats, exposure: float, amplitudes: Floats, dimmed: tuple[Floats, Floats]
) -> Combination | None:
    """Combine frames of a header: the sum is free of the header, the difference shows it as in a synchronous pair."""
    about = amplitudes - amplitudes.mean() if len(amplitudes) else amplitudes
    energy = float(about @ about)
    # 20 dB below the energy 4 of two synchronous pairs
    if energy < 0.04:
        return None
    # least squares: sum beta = 2 with sum beta s = 0; sum w = 0 with sum w s = 2
    total, difference = 2 / len(amplitudes) - 2 * amplitudes.mean() / energy * about, 2 / energy * about
    # the LEDs of a header are lit evenly
    middle = float(total @ (starts + exposure / 2)) / 2
    cell = (0.5 * float(difference @ dimmed[0]), float(difference @ dimmed[1]))
    empty = np.zeros((3, SLOTS))
    return Combination(np.arange(len(amplitudes)), difference, total, empty, (0.5, 0.5), middle, (middle, middle), cell)


def _overlaps(starts: Floats, exposure: float) -> tuple[Floats, Floats]:
    """Return the part of each exposure in each slot of three pairs, and the mean time in the slot, (frames, 24)."""
    edges = np.arange(-PAIR, 2 * PAIR + 1) / SLOTS
    begin = np.maximum(starts[:, None], edges[:-1])
    end = np.minimum(starts[:, None] + exposure, edges[1:])
    return np.maximum(end - begin, 0.0) / exposure, (begin + end) / 2


def _difference(slot_light: Floats, slope: Floats) -> Floats:
    """Return alpha = Q^-1 (theta - mu 1), which maximises (alpha theta)^2 / (alpha Q alpha) for sum alpha = 0."""
    # noise of a frame near the limit of decoding, 1/16; nonlinear light and light of other pairs count as noise
    matrix = 0.05 * np.eye(len(slope)) - np.outer(slope, slope)
    matrix += np.einsum("fqr,rs,gqs->fg", slot_light, COVARIANCE, slot_light)

    def solve(used: NDArray[np.intp]) -> Floats:
        # mu = (1 Q^-1 theta) / (1 Q^-1 1)
        sides = np.stack([slope[used], np.ones(len(used))], axis=1)
        a, b = np.linalg.solve(matrix[np.ix_(used, used)], sides).T
        return a - b * (a.sum() / b.sum())

    alpha = _prune(solve, len(slope))
    return alpha / max(alpha[alpha > 0].sum(), TINY)


def _total(slot_light: Floats, light: Floats) -> Floats:
    """Return nonnegative weights of the sum with the least noise and unevenness for the light of all LEDs on."""
    # less noise than in a difference: unevenness counts for more in a sum
    matrix = 1e-3 * np.eye(len(light)) + np.einsum("fqr,rs,gqs->fg", slot_light, COVARIANCE, slot_light)
    beta = _prune(lambda used: np.linalg.solve(matrix[np.ix_(used, used)], light[used]), len(light), signed=True)
    return beta / (beta @ light)


def _prune(solve: Callable[[NDArray[np.intp]], Floats], count: int, signed: bool = False) -> Floats:
    """Solve the weights of frames, without frames of less than a twentieth of the largest weight."""
    weights, used = np.zeros(count), np.arange(count)
    while len(used):
        solved = solve(used)
        size = solved if signed else np.abs(solved)
        strong = size >= 0.05 * size.max()
        if strong.all():
            weights[used] = solved
            break
        used = used[strong]
    return weights


def _centroid(weights: Floats, light: Floats, middle: Floats) -> float:
    """Return the mean time of the light (frames, slots) of weighted frames."""
    return float((weights @ (light * middle)).sum() / max((weights @ light).sum(), TINY))


Moments = tuple[Floats, Floats]  # mean and variance of the observed symbols of a packet, (pairs, symbols) each


@dataclass(frozen=True, slots=True)
class UnsynchronisedPacket:
    """Responses of the combined pairs of a packet to the symbols."""

    # (pairs, 16, 4) observed symbols for each value of the pair
    response: Floats
    # before, after: (pairs, 16, 4) observed symbols for each value of the previous and the next pair
    before: Floats
    after: Floats
    # (pairs, symbols) light of the header before the first pair and of the header after the last pair
    headers: Floats

    @classmethod
    def of(cls, combinations: Sequence[Combination | None], header: NDArray[np.bool_]) -> "UnsynchronisedPacket":
        """Collect the responses of the pairs of a packet; None stands for a synchronous pair."""
        count = len(combinations)
        before, after = np.zeros((2, count, *VALUES.shape))
        response, headers = np.tile(VALUES, (count, 1, 1)), np.zeros((count, header.size))
        for k, combination in enumerate(combinations):
            if combination is None:
                continue
            response[k] = combination.response
            for side, (leak, leaks) in enumerate(zip(combination.leaks, (before, after), strict=True)):
                if leak is not None and 0 <= k + 2 * side - 1 < count:
                    leaks[k] = leak
                elif leak is not None:
                    headers[k] += response_of_levels(combination.slots[2 * side], header)
        return cls(response, before, after, headers)

    @property
    def is_synchronous(self) -> bool:
        """True if each pair shows exactly the symbols of the pair."""
        return not self.before.any() and not self.after.any() and bool((self.response == VALUES).all())

    def expected(self, mean: Floats) -> tuple[Moments, Moments]:
        """Predict the light of the pairs' own symbols and that of the neighbouring pairs from the symbols' means."""
        leak, leak_variance = self.headers.copy(), np.zeros_like(mean)
        later, earlier = slice(1, None), slice(-1)
        for pairs, sources, response in ((later, earlier, self.before), (earlier, later, self.after)):
            if response.any():
                leak_mean, variance = moments(response[pairs], mean[sources])
                leak[pairs] += leak_mean
                leak_variance[pairs] += variance
        own = (mean, 1 - mean**2) if self.is_synchronous else moments(self.response, mean)
        return own, (leak, leak_variance)

    def llrs(self, observed: Floats, variance: Floats, leak: Moments, mean: Floats) -> Floats:
        """Compute extrinsic LLRs of the symbols from estimates of the observed symbols."""
        own, noise = observed - leak[0], variance + leak[1]
        if self.is_synchronous:
            # y = c + n: ln P(c=+1)/P(c=-1) = 2 y / s^2
            return 2 * own / noise
        return symbol_llrs(self.response, own, noise, mean)

    def posterior_moments(
        self, pairs: NDArray[np.intp], observed: Floats, variance: Floats, mean: Floats
    ) -> tuple[Floats, Floats]:
        """Return the posterior means of observed and of squared symbols, for estimates without leaks."""
        if self.is_synchronous:
            # <c> = tanh(y / s^2 + arctanh <c>_prior), c^2 = 1
            first = np.tanh(observed / variance + np.arctanh(uncertain(mean)))
            return first, np.ones_like(first)
        return posterior_moments(self.response[pairs], observed, variance, mean)
