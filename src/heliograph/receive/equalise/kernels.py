"""Compiled kernels of the equaliser; `tests/oracles/equalise_oracle.py` states the same with full matrices."""

import math

import numpy as np

from heliograph.base.arrays import TINY
from heliograph.base.compiled import compiled

OUTLIER_PROBABILITY = 1e-20
"""Probability of light that no model explains, such as posts and lamps: a Gaussian would be sure of it by chance."""

OUTLIER_SPREAD = 0.3
"""Mean distance of an outlier from the symbol, relative to the symbol: Laplace's distribution."""


@compiled()
def precision(gram, unknown, scale, inverse, floor, size):
    """Compute the upper triangle of the posterior precision scale G + V^-1 of the unknown symbols."""
    count, first = unknown.shape[0], unknown[0]
    adjacent = unknown[count - 1] - first == count - 1
    out = np.empty((size, size), np.float32)
    for i in range(count):
        row = gram[unknown[i]]
        if adjacent:  # without indirect indices it takes a third of the time
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
    """Compute the extrinsic LLR of each symbol of a linear MMSE estimate.

    The estimate m is linear in the symbols: m_i - c_0i = sum_j R_ij (c_j - c_0j) + noise with R = 1 - S V^-1. In the
    statistic

        chi_i = m_i - c_0i S_ii / v_i = kappa c_i - sum_j S_ij / v_j (c_j - c_0j) + noise,   kappa = 1 - S_ii / v_i,

    of variance kappa S_ii, the symbols with the largest weights are drawn from +-1 and the rest is Gaussian. If all
    were Gaussian, the LLR would be 2 chi_i / S_ii, too small for few disturbing neighbours, which have no tails.
    """
    inverse = (1.0 / variance).astype(np.float32)
    states, which = np.empty((2, 1 << 6)), np.empty(6, np.int64)
    for i in range(covariance.shape[0]):
        row = covariance[i]
        k = 1.0 - row[i] / variance[i]
        u = posterior[i] - mean[i] * row[i] / variance[i]
        # with more symbols drawn if the LLR is neither too small to decide nor sure
        for drawn in (2, 6):
            count = _heaviest(row, inverse, i, which[:drawn])
            out[i] = _mixture(u, k, k * row[i], row, which[:count], mean, variance, states)
            if not 3.0 < abs(out[i]) < 10.0:
                break


@compiled()
def _heaviest(row, inverse, i, which):
    """Write the numbers of the symbols that disturb symbol i most, the strongest first; return the count."""
    largest = np.zeros(which.shape[0], np.float32)
    last = which.shape[0] - 1
    for j in range(row.shape[0]):
        weight = row[j] * row[j] * inverse[j]
        if weight > largest[last] and j != i:
            place = last
            while place > 0 and largest[place - 1] < weight:
                largest[place], which[place] = largest[place - 1], which[place - 1]
                place -= 1
            largest[place], which[place] = weight, j
    count = 0
    while count < largest.shape[0] and largest[count] > 0:
        count += 1
    return count


@compiled()
def _mixture(u, k, power, row, drawn, mean, variance, states):
    """Compute ln p(u|c=+1) / p(u|c=-1) of u = k c - sum S_ij / v_j (c_j - c_0j) + rest.

    `power` is the variance of u - k c, row is S_i, drawn the numbers of the symbols to draw; states (2, 2^drawn or
    more) is overwritten.
    """
    # for each state of the drawn symbols: the rest of the statistic, and the log probability
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
    # against rounding of float32
    noise = max(noise, 0.02 * power, TINY)
    # ln sum P exp(-(x -+ k)^2 / 2 r) relative to the largest exponents, the common k^2 left out
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
    # outliers: Laplace's distribution about each; the sums above lack exp(-k^2 / 2 r) and 1/2 of each drawn
    exponent, width = 0.5 * k * k / noise + len(drawn) * math.log(2.0), max(OUTLIER_SPREAD * k, TINY)
    other = math.log(OUTLIER_PROBABILITY * math.sqrt(2.0 * math.pi * noise) / (2.0 * width))
    likely = _log_sum(top + math.log(plus) - exponent, other - abs(u - k) / width)
    return likely - _log_sum(below + math.log(minus) - exponent, other - abs(u + k) / width)


@compiled(inline="always")
def _log_sum(a, b):
    """Compute ln(e^a + e^b)."""
    return max(a, b) + math.log1p(math.exp(-abs(a - b)))
