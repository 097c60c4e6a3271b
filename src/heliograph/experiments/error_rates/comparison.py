"""Whether packets of a drive have the error rates of packets at rest at the same distances."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import Floats
from heliograph.experiments.error_rates.films import PacketRecord, bin_of
from heliograph.signal.settings import LAYERS

MARGIN = 1.5
"""Factor between driving and static within which they count as alike; a layer's error rate changes by so much within
about 3 m."""

RISK = 0.05
"""Level of significance of the tests; intervals cover 1 less this."""

RESAMPLES = 4000
"""Draws of a bootstrap, and turnings of signs of a test."""


@dataclass(frozen=True, slots=True)
class Comparison:
    """Driving against static in a bin."""

    # layer, bin_m: where; the bin by its middle, None: all bins together
    layer: str
    bin_m: float | None
    # Packets of the drives, each with one at rest at the same distance
    pairs: int
    # driving, static: means of the packets' raw error rates, of the drives and at rest, 0 to 1
    driving: float
    static: float
    # ratio, low, high: driving over static, with a 95 % interval over packets or drives, whichever is wider
    ratio: float
    low: float
    high: float
    # The p value of the test that both are equal, adjusted by Holm, 0 to 1
    p: float
    # "alike": the interval lies within the margin; "apart": they differ, and by more than it; "open": neither
    verdict: Literal["alike", "apart", "open"]


_Paired = tuple[str, float | None, tuple[float, ...]]
"""Layer, bin, and what `_paired` gives."""


def compare(
    driving: Sequence[PacketRecord],
    static: Sequence[PacketRecord],
    rng: np.random.Generator,
    margin: float = MARGIN,
    drives: Sequence[int] = (),
) -> list[Comparison]:
    """Whether packets of a drive have the raw error rates of packets at rest at the same distances.

    Equality is tested by turning the signs of the pairs' differences, with Holm's correction over all layers and bins,
    and over the layers where all bins are taken together. The interval of the ratio is a bootstrap over pairs, so that
    errors of a packet may depend on each other, or one over drives, so that packets of a drive may, if it is wider.
    """
    bins = np.array([bin_of(record.distance_m) for record in driving])
    films = np.array(drives or [0] * len(driving))
    found: list[_Paired] = []
    for layer in LAYERS:
        for place in (*np.unique(bins), None):
            here = np.flatnonzero(_read(driving, static, layer) & ((bins == place) | (place is None)))
            one, other = (_rates([side[int(i)] for i in here], layer) for side in (driving, static))
            # raw errors of both together below which a bin is not compared
            if len(here) >= 3 and one[1] + other[1] >= 30:
                found.append(
                    (layer, None if place is None else float(place), _paired(one[0], other[0], films[here], rng))
                )
    return [_comparison(*one, p, margin) for one, p in zip(found, _adjusted(found), strict=True)]


def _adjusted(found: Sequence[_Paired]) -> list[float]:
    """Their p values by Holm, single bins and whole layers each by themselves."""
    adjusted: dict[int, float] = {}
    for single in (True, False):
        family = [k for k, (_, place, _) in enumerate(found) if (place is not None) == single]
        adjusted |= zip(family, holm([found[k][2][-1] for k in family]), strict=True)
    return [adjusted[k] for k in range(len(found))]


def _read(driving: Sequence[PacketRecord], static: Sequence[PacketRecord], layer: str) -> NDArray[np.bool_]:
    """In which pairs bits of the layer were read, of both."""
    both = zip(driving, static, strict=True)
    return np.array([min(a.layers[layer].raw_bits, b.layers[layer].raw_bits) > 0 for a, b in both], dtype=bool)


def _rates(records: Sequence[PacketRecord], layer: str) -> tuple[Floats, int]:
    """Raw error rate of each packet, and their errors in all."""
    counts = [record.layers[layer] for record in records]
    rates = np.array([c.raw_errors / max(c.raw_bits, 1) for c in counts])
    return rates, sum(c.raw_errors for c in counts)


def _paired(a: Floats, b: Floats, drives: NDArray[np.int_], rng: np.random.Generator) -> tuple[float, ...]:
    """(pairs, mean a, mean b, ratio, low, high, p) of paired rates, and of which drive each pair is."""
    tiny = 1e-9
    names, film = np.unique(drives, return_inverse=True)
    spans = []
    for one, other in ((a, b), (np.bincount(film, a), np.bincount(film, b))):
        draws = rng.integers(0, len(one), (RESAMPLES, len(one)))
        ratios = (one[draws].sum(1) + tiny) / (other[draws].sum(1) + tiny)
        spans.append(np.quantile(ratios, (RISK / 2, 1 - RISK / 2)))
    # a single drive says nothing of how drives differ
    low, high = (min(spans[0][0], spans[1][0]), max(spans[0][1], spans[1][1])) if len(names) > 1 else spans[0]
    signs = rng.choice((-1.0, 1.0), (RESAMPLES, len(a)))
    difference = a - b
    more = np.abs(signs @ difference) >= abs(difference.sum()) * (1 - 1e-12)
    # the data themselves are one of the turnings
    p = (1 + np.count_nonzero(more)) / (1 + RESAMPLES)
    return float(len(a)), a.mean(), b.mean(), (a.sum() + tiny) / (b.sum() + tiny), float(low), float(high), float(p)


def holm(p: Sequence[float]) -> list[float]:
    """Adjusted p values of Holm 1979: the k-th smallest of m times m - k, never falling, at most 1."""
    order, out, worst = np.argsort(p), [0.0] * len(p), 0.0
    for k, i in enumerate(order):
        worst = max(worst, min(1.0, (len(p) - k) * p[int(i)]))
        out[int(i)] = worst
    return out


def _comparison(layer: str, place: float | None, v: Sequence[float], p: float, margin: float) -> Comparison:
    pairs, driving, static, ratio, low, high, _ = (float(x) for x in v)
    verdict: Literal["alike", "apart", "open"] = "open"
    if 1 / margin <= low and high <= margin:
        verdict = "alike"
    elif p < RISK and not low <= 1 <= high and not 1 / margin <= ratio <= margin:
        verdict = "apart"
    return Comparison(layer, place, int(pairs), driving, static, ratio, low, high, p, verdict)
