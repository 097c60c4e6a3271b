"""The hot loop of the light's rate; `light.expected_correlation` is the same written for reading."""

import math

import numpy as np

from heliograph.base.compiled import compiled


@compiled(inline="always")
def _shown(weights, start, length, first, slots):
    """Parts of an exposure (slots,) that fall on each slot from the first one on; all in slots, overwritten."""
    for u in range(slots):
        low, high = max(start, first + u), min(start + length, first + u + 1)
        weights[u] = max(high - low, 0.0) / length


@compiled(inline="always")
def _product(one, other, covariance, pairs):
    """Covariance of the light of two exposures, by their parts on the slots of pairs."""
    total = 0.0
    for m in range(pairs):
        for i in range(8 * m, 8 * m + 8):
            if one[i] != 0.0:
                for j in range(8):
                    total += one[i] * covariance[i - 8 * m, j] * other[8 * m + j]
    return total


@compiled()
def expected_correlations(rates, phases, exposures, numbers, lags, covariance, least, out):
    """How alike frames are on average, by how long a pattern lasts in frames."""
    most = 8 * int((4 * (np.max(lags) + 1) / np.min(rates)) / 8 + 4)
    one, other = np.empty(most), np.empty(most)
    for r in range(rates.shape[0]):
        for p in range(phases.shape[0]):
            for x in range(exposures.shape[0]):
                length = 4 * exposures[x] / rates[r]
                for t in range(numbers.shape[0]):
                    begin = 4 * (numbers[t] / rates[r] + phases[p])
                    first = 8 * math.floor(begin / 8)
                    for k in range(lags.shape[0]):
                        later = begin + 4 * lags[k] / rates[r]
                        pairs = math.ceil((later + length - first) / 8)
                        _shown(one, begin, length, first, 8 * pairs)
                        _shown(other, later, length, first, 8 * pairs)
                        own = _product(one, one, covariance, pairs) + least
                        its = _product(other, other, covariance, pairs) + least
                        out[r, p, x, t, k] = _product(one, other, covariance, pairs) / math.sqrt(own * its)
