"""Kernel of the expected correlations of a region's frames."""

import math

import numpy as np

from heliograph.base.compiled import compiled


@compiled(inline="always")
def _slot_weights(weights, start, length, first, slots):
    """Write the parts of an exposure in each slot from the first slot on; all times in slots."""
    for u in range(slots):
        low, high = max(start, first + u), min(start + length, first + u + 1)
        weights[u] = max(high - low, 0.0) / length


@compiled(inline="always")
def _covariance(one, other, covariance, pairs):
    """Covariance of the light of two exposures by slot weights."""
    total = 0.0
    for m in range(pairs):
        for i in range(8 * m, 8 * m + 8):
            if one[i] != 0.0:
                for j in range(8):
                    total += one[i] * covariance[i - 8 * m, j] * other[8 * m + j]
    return total


@compiled()
def expected_correlations(durations, phases, exposures, numbers, lags, covariance, min_variance, out):
    """Write the mean correlation of frames for each duration, phase, exposure, frame number and lag."""
    slots = 8 * int((4 * (np.max(lags) + 1) / np.min(durations)) / 8 + 4)
    one, other = np.empty(slots), np.empty(slots)
    for r in range(durations.shape[0]):
        for p in range(phases.shape[0]):
            for x in range(exposures.shape[0]):
                length = 4 * exposures[x] / durations[r]
                for t in range(numbers.shape[0]):
                    begin = 4 * (numbers[t] / durations[r] + phases[p])
                    first = 8 * math.floor(begin / 8)
                    for k in range(lags.shape[0]):
                        later = begin + 4 * lags[k] / durations[r]
                        pairs = math.ceil((later + length - first) / 8)
                        _slot_weights(one, begin, length, first, 8 * pairs)
                        _slot_weights(other, later, length, first, 8 * pairs)
                        power = _covariance(one, one, covariance, pairs) + min_variance
                        power *= _covariance(other, other, covariance, pairs) + min_variance
                        out[r, p, x, t, k] = _covariance(one, other, covariance, pairs) / math.sqrt(power)
