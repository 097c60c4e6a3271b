"""Hot loops of the equaliser; `reference.py` says the same with whole matrices, and a test holds the two together."""

import math

import numpy as np

from heliograph.base.arrays import TINY
from heliograph.base.compiled import compiled

UNMODELLED = 1e-20
"""Probability that a symbol's value comes from something that no model of the light holds: 9 standard deviations.

What passes before an array hides LEDs in part, and what shines beside it pulls its pose. Symbols of such LEDs lie far
from -1 and +1, some dozens of standard deviations, and a Gaussian alone is then sure of one by chance. Of two films of
bright posts 22 codewords were read without it, and 27 or 28 with 1e-15, 1e-20 and 1e-30.
"""

UNMODELLED_SPREAD = 0.3
"""How far such a value lies from its symbol on average, as a fraction of the symbol: Laplace's distribution.

Of three films with posts 52 codewords were read with 0.3, 48 with 0.5 and 49 with 1.
"""


FEW, MANY = 2, 6
"""Disturbing symbols that are drawn from -1 and +1: at first, and in a second evaluation.

With all disturbers taken as Gaussian up to five times as many errors are predicted below 1 % as there are, with two
drawn twice as many, with six a tenth more; eight gain nothing for three times the time (docs/measured.md).
"""

DOUBTFUL_LLR, DECIDED_LLR = 3.0, 10.0
"""LLRs in magnitude, 5 % and 5e-5 wrong, between which a symbol is evaluated again.

Beyond them that would change no decision.
"""

LEAST_REST = 0.02
"""Least part of the variance left to the Gaussian once symbols are drawn: rounding in float32 may leave less."""


@compiled()
def precision(gram, unknown, scale, inverse, floor, size):
    """Posterior precision scale G + V^-1 of the unknown symbols; only the upper triangle is filled."""
    count, first = unknown.shape[0], unknown[0]
    together = unknown[count - 1] - first == count - 1
    out = np.empty((size, size), np.float32)
    for i in range(count):
        row = gram[unknown[i]]
        if together:  # without looking numbers up it takes a third of the time
            for j in range(i, count):
                out[i, j] = scale * row[first + j] + floor
        else:
            for j in range(i, count):
                out[i, j] = scale * row[unknown[j]] + floor
        out[i, i] += inverse[i]
        out[i, count:] = 0.0
    for i in range(count, size):
        out[i, i:] = 0.0
        out[i, i] = 1.0
    return out


@compiled()
def mirror(upper, out):
    """Fill a symmetric matrix from its upper triangle."""
    for i in range(out.shape[0]):
        for j in range(i):
            out[i, j] = upper[j, i]
        for j in range(i, out.shape[0]):
            out[i, j] = upper[i, j]


@compiled()
def extrinsic(covariance, posterior, mean, variance, out):
    """Extrinsic LLR of each symbol of a linear MMSE estimate.

    The estimate m is linear in the symbols: m_i - c_0i = sum_j R_ij (c_j - c_0j) + noise with R = 1 - S V^-1. In the
    statistic

        chi_i = m_i - c_0i S_ii / v_i = kappa c_i - sum_j S_ij / v_j (c_j - c_0j) + noise,   kappa = 1 - S_ii / v_i,

    of variance kappa S_ii, the symbols that weigh most are drawn from +-1 and the rest is Gaussian. With all of them
    Gaussian the LLR would be 2 chi_i / S_ii, too small where few neighbours disturb and their sum has no tails. `FEW`
    are drawn at first; where the LLR is then between `DOUBTFUL_LLR` and `DECIDED_LLR`, `MANY`.
    """
    inverse = (1.0 / variance).astype(np.float32)
    states, which = np.empty((2, 1 << MANY)), np.empty(MANY, np.int64)
    for i in range(covariance.shape[0]):
        row = covariance[i]
        k = 1.0 - row[i] / variance[i]
        u = posterior[i] - mean[i] * row[i] / variance[i]
        for most in (FEW, MANY):
            count = _heaviest(row, inverse, i, which[:most])
            out[i] = _mixture(u, k, k * row[i], row, which[:count], mean, variance, states)
            if not DOUBTFUL_LLR < abs(out[i]) < DECIDED_LLR:
                break


@compiled()
def _heaviest(row, inverse, i, which):
    """Write the numbers of the symbols that disturb symbol i most, the strongest first; return how many there are."""
    most = np.zeros(which.shape[0], np.float32)
    last = which.shape[0] - 1
    for j in range(row.shape[0]):
        weight = row[j] * row[j] * inverse[j]
        if weight > most[last] and j != i:
            place = last
            while place > 0 and most[place - 1] < weight:
                most[place], which[place] = most[place - 1], which[place - 1]
                place -= 1
            most[place], which[place] = weight, j
    count = 0
    while count < most.shape[0] and most[count] > 0:
        count += 1
    return count


@compiled()
def _mixture(u, k, power, row, drawn, mean, variance, states):
    """Ln p(u|c=+1) / p(u|c=-1) of u = k c - sum S_ij / v_j (c_j - c_0j) + rest, whose variance is `power` beside k c.

    row is S_i, drawn the numbers of the symbols to be drawn; states (2, 2^drawn or more) is overwritten.
    """
    # for each state of the drawn symbols: the statistic without them, and the log of its probability
    rest, chance = states
    rest[0], chance[0], noise, number = u, 0.0, power, 1
    for j in drawn:
        weight = row[j] / variance[j]
        noise -= weight * weight * variance[j]
        likely, unlikely = math.log(max(1.0 + mean[j], TINY)), math.log(max(1.0 - mean[j], TINY))
        for w in range(number):
            rest[number + w], chance[number + w] = rest[w] + weight * (1.0 - mean[j]), chance[w] + likely
            rest[w], chance[w] = rest[w] - weight * (1.0 + mean[j]), chance[w] + unlikely
        number *= 2
    noise = max(noise, LEAST_REST * power, TINY)
    # ln sum P exp(-(x -+ k)^2 / 2 r), less k^2 that both weight, by their largest exponents
    top, below = -np.inf, -np.inf
    for w in range(number):
        x = rest[w]
        chance[w] -= 0.5 * x * x / noise
        rest[w] = k * x / noise
        top, below = max(top, chance[w] + rest[w]), max(below, chance[w] - rest[w])
    plus, minus = 0.0, 0.0
    for w in range(number):
        plus += math.exp(chance[w] + rest[w] - top)
        minus += math.exp(chance[w] - rest[w] - below)
    # what no model holds: Laplace's distribution about each; the sums above lack exp(-k^2 / 2 r) and 1/2 of each drawn
    bend, width = 0.5 * k * k / noise + len(drawn) * math.log(2.0), max(UNMODELLED_SPREAD * k, TINY)
    other = math.log(UNMODELLED * math.sqrt(2.0 * math.pi * noise) / (2.0 * width))
    likely = _log_sum(top + math.log(plus) - bend, other - abs(u - k) / width)
    return likely - _log_sum(below + math.log(minus) - bend, other - abs(u + k) / width)


@compiled(inline="always")
def _log_sum(a, b):
    """Ln(e^a + e^b)."""
    return max(a, b) + math.log1p(math.exp(-abs(a - b)))
