"""Comparison of the error rates of drives and films at rest at the same distances."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import Floats
from heliograph.experiments.error_rates.films import PacketRecord, bin_of
from heliograph.signal.settings import LAYERS

MARGIN = 1.5
"""Factor between driving and static up to which they are alike; about the change of an error rate over 3 m."""

RISK = 0.05
"""Significance level of the tests."""

ComparisonVerdict = Literal["alike", "apart", "open"]
"""Interval within the margin; significantly different beyond the margin; neither."""


@dataclass(frozen=True, slots=True)
class Comparison:
    """Raw error rates driving and static in a distance bin."""

    layer: str
    # Middle of the bin; None: all bins together
    bin_m: float | None
    # Packets of the drives, each with a packet at rest at the same distance
    pairs: int
    # Mean raw error rates of the packets
    driving: float
    static: float
    # Driving over static with 95 % interval over packets or drives, whichever is wider
    ratio: float
    low: float
    high: float
    # p value of the test of equality, adjusted by Holm
    p: float
    verdict: ComparisonVerdict = "open"


def compare(
    driving: Sequence[PacketRecord],
    static: Sequence[PacketRecord],
    rng: np.random.Generator,
    drives: Sequence[int] = (),
) -> list[Comparison]:
    """Compare the raw error rates of packets of drives with packets at rest at the same distances.

    The test of equality flips the signs of the differences of pairs, with the correction of Holm over all layers and
    bins, and separately over the layers with all bins together. The interval of the ratio is the wider
    interval of a bootstrap over pairs (dependent errors in a packet) and over drives (dependent packets in a drive).
    """
    bins = np.array([bin_of(record.distance_m) for record in driving])
    films = np.array(drives or [0] * len(driving))
    found: list[Comparison] = []
    for layer in LAYERS:
        bits, errors = (
            np.array([[getattr(r.layers[layer], name) for r in side] for side in (driving, static)])
            for name in ("raw_bits", "raw_errors")
        )
        rates = errors / np.maximum(bits, 1)
        for bin_m in (*map(float, np.unique(bins)), None):
            here = bits.min(0) > 0
            if bin_m is not None:
                here &= bins == bin_m
            # fewer packets or errors allow no comparison
            if here.sum() >= 3 and errors[:, here].sum() >= 30:
                found.append(_compare_pairs(layer, bin_m, rates[:, here], films[here], rng))
    for pooled in (False, True):
        family = [k for k, one in enumerate(found) if (one.bin_m is None) == pooled]
        for k, p in zip(family, holm([found[k].p for k in family]), strict=True):
            found[k] = replace(found[k], p=p, verdict=_verdict(found[k], p))
    return found


def _compare_pairs(
    layer: str, bin_m: float | None, rates: Floats, drives: NDArray[np.int_], rng: np.random.Generator
) -> Comparison:
    """Compare (2, pairs) rates, driving and static; `drives` has the drive of each pair."""
    a, b = rates
    tiny, resamples = 1e-9, 4000
    names, film = np.unique(drives, return_inverse=True)
    spans = []
    for one, other in ((a, b), (np.bincount(film, a), np.bincount(film, b))):
        draws = rng.integers(0, len(one), (resamples, len(one)))
        ratios = (one[draws].sum(1) + tiny) / (other[draws].sum(1) + tiny)
        spans.append(np.quantile(ratios, (RISK / 2, 1 - RISK / 2)))
    # a single drive does not show the variation between drives
    low, high = (min(spans[0][0], spans[1][0]), max(spans[0][1], spans[1][1])) if len(names) > 1 else spans[0]
    signs = rng.choice((-1.0, 1.0), (resamples, len(a)))
    difference = a - b
    more = np.abs(signs @ difference) >= abs(difference.sum()) * (1 - 1e-12)
    # the data themselves count as a resample
    p = (1 + np.count_nonzero(more)) / (1 + resamples)
    values = (a.mean(), b.mean(), (a.sum() + tiny) / (b.sum() + tiny), low, high, p)
    driving, at_rest, ratio, lower, upper, chance = map(float, values)
    return Comparison(layer, bin_m, len(a), driving, at_rest, ratio, lower, upper, chance)


def holm(p: Sequence[float]) -> list[float]:
    """Adjusted p values of Holm 1979: m - k times the k-th smallest of m, nondecreasing, at most 1."""
    order = np.argsort(p)
    out = np.empty(len(p))
    out[order] = np.minimum(np.maximum.accumulate(np.arange(len(p), 0, -1) * np.array(p)[order]), 1)
    return [float(value) for value in out]


def _verdict(one: Comparison, p: float) -> ComparisonVerdict:
    if one.low >= 1 / MARGIN and one.high <= MARGIN:
        return "alike"
    apart = p < RISK and not one.low <= 1 <= one.high and not 1 / MARGIN <= one.ratio <= MARGIN
    return "apart" if apart else "open"
