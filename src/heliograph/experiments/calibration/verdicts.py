"""Whether LLRs are calibrated, and whether distances are as accurate as asked."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.experiments.calibration.recorder import ReliabilityBin
from heliograph.experiments.result import Finding, Verdict

TOLERANCE = 0.1
"""Relative departure of observed from predicted error probability that is allowed."""

ENOUGH = 30
"""Errors expected or observed from which on a bin is judged."""

GOOD_M, GOOD_TO_M = 0.25, 80.0
"""Rms error of distance in m that is asked for, and the distance in m up to which it is."""

DISTANCE_BINS = (22.5, 32.5, 50.0, 65.0, 75.0, 82.5, 95.0, 110.0, 140.0, 165.0, 195.0, 225.0)
"""Edges in m of the bins of distance."""


@dataclass(frozen=True, slots=True)
class DistanceErrors:
    """Errors of distance of packets in a bin of distance."""

    # The films' case, and whether it is the first packet of a film or a later one
    case: str
    # from_m, to_m: edges of the bin in m
    from_m: float
    to_m: float
    # (packets,) errors in m
    errors_m: Floats


def judged(bins: Sequence[ReliabilityBin]) -> list[ReliabilityBin]:
    """The bins with enough errors to be judged."""
    return [one for one in bins if max(one.count.errors, one.expected) >= ENOUGH]


def calibrated(name: str, bins: Sequence[ReliabilityBin]) -> Finding:
    """Whether observed and predicted error probabilities agree."""
    here = judged(bins)
    off = [one for one in here if one.ratio()[1] > 1 + TOLERANCE or one.ratio()[2] < 1 - TOLERANCE]
    near = [one for one in here if abs(one.ratio()[0] - 1) <= TOLERANCE]
    bits, errors = sum(one.count.trials for one in bins), sum(one.count.errors for one in bins)
    expected = sum(one.expected for one in bins)
    ours = (
        f"{errors} of {bits} bits wrong, {expected:.0f} expected; of {len(here)} bins with {ENOUGH} errors or more "
        f"{len(near)} are within {TOLERANCE:.0%}, {len(off)} apart for certain."
    )
    why = "Apart: " + "; ".join(f"{one.range_text()}: {one.ratio_text()}" for one in off) + "." if off else ""
    verdict: Verdict = "differs" if off else "holds" if here else "shown"
    return Finding(f"Asked: predicted and observed error probability within 10 %, {name}.", ours, verdict, why)


def by_distance(distances: Mapping[str, Floats]) -> list[DistanceErrors]:
    """Errors by case and distance, first packets apart."""
    out = []
    for case, rows in distances.items():
        for name, chosen in (("first packet", rows[:, 2] == 0), ("later packets", rows[:, 2] > 0)):
            for low, high in pairwise(DISTANCE_BINS):
                here = rows[chosen & (rows[:, 0] >= low) & (rows[:, 0] < high) & np.isfinite(rows[:, 1])]
                if len(here):
                    out.append(DistanceErrors(f"{case}, {name}", low, high, here[:, 1] - here[:, 0]))
    return out


def rms_m(errors_m: Floats) -> tuple[float, float, float]:
    """Rms of errors in m, and the ends of its 95 % interval."""
    from scipy.special import chdtri

    total, n = float((errors_m**2).sum()), len(errors_m)
    # sum of squares / sigma^2 is chi-square of n
    return (total / n) ** 0.5, (total / chdtri(n, 0.025)) ** 0.5, (total / chdtri(n, 0.975)) ** 0.5


def accurate(errors: Sequence[DistanceErrors]) -> Finding:
    """Whether distances are as accurate as asked."""
    near = [one for one in errors if one.to_m <= GOOD_TO_M + 2.5]
    worst = max(near, key=lambda one: rms_m(one.errors_m)[0])
    rms, low, high = rms_m(worst.errors_m)
    count = sum(len(one.errors_m) for one in near)
    pooled = rms_m(np.concatenate([one.errors_m for one in near]))[0]
    return Finding(
        f"Asked: distance from one camera below {GOOD_M:g} m rms up to {GOOD_TO_M:g} m.",
        f"{count} packets to {GOOD_TO_M:g} m: {pooled:.3f} m rms; worst are {len(worst.errors_m)} packets "
        f"{worst.case}, {worst.from_m:g} to {worst.to_m:g} m: {rms:.3f} m ({low:.3f} to {high:.3f}).",
        "holds" if rms < GOOD_M else "differs",
        "Published: 0.5 m at 60 m from two cameras, 0.75 m within 100 m from an event camera.",
    )
