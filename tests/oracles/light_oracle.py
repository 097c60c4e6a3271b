"""Expected correlation of two frames of an array, as `heliograph.probe.kernels` computes it."""

from collections.abc import Sequence

import numpy as np

from heliograph.probe.light import MIN_VARIANCE, pair_covariance


def expected_correlation(
    rate: float, phase: float, exposure: float, number: int, lag: int, slot_order: Sequence[int]
) -> float:
    covariance = pair_covariance(slot_order)
    starts = [4 * ((number + later) / rate + phase) for later in (0, lag)]
    length = 4 * exposure / rate
    slots = np.arange(8 * np.floor(starts[0] / 8), 8 * np.ceil((starts[1] + length) / 8))
    one, other = (
        np.clip(np.minimum(start + length, slots + 1) - np.maximum(start, slots), 0, None).reshape(-1, 8) / length
        for start in starts
    )
    own, its, both = (np.einsum("pi,ij,pj", a, covariance, b) for a, b in ((one, one), (other, other), (one, other)))
    return float(both / np.sqrt((own + MIN_VARIANCE) * (its + MIN_VARIANCE)))
