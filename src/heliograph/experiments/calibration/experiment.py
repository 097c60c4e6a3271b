"""Calibration of the soft receiver: predicted error probabilities of its LLRs, and errors of its distances."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

import numpy as np
from matplotlib.figure import Figure

from heliograph.base.arrays import Floats
from heliograph.experiments import plots
from heliograph.experiments.calibration.recorder import (
    FIRST,
    LAST,
    CalibrationFilm,
    CalibrationRecord,
    ReliabilityBin,
    ReliabilityCounts,
    record,
)
from heliograph.experiments.report import Context, ExperimentResult, Finding, Table, Verdict
from heliograph.link.settings import load_settings


def reliability_diagram(bins: Mapping[str, Sequence[ReliabilityBin]]) -> Figure:
    """Observed over predicted error probability of the bins that are judged, with 95 % intervals."""
    figure = Figure(figsize=(8, 4))
    axes = figure.subplots()
    for (name, part), colour in zip(bins.items(), (plots.BLUE, plots.ORANGE), strict=True):
        here = judged(part)
        if here:
            ratio, low, high = np.array([one.ratio() for one in here]).T
            x = [one.predicted for one in here]
            axes.errorbar(x, ratio, (ratio - low, high - ratio), color=colour, marker="o", ms=4, capsize=2, label=name)
    for line in (1 - TOLERANCE, 1 + TOLERANCE):
        axes.axhline(line, color=plots.GRAY, lw=0.8, ls="--")
    axes.set(xscale="log", yscale="log", xlabel="predicted error probability", ylabel="observed / predicted")
    axes.legend(frameon=False)
    return figure


def distance_errors(distances: Mapping[str, Floats]) -> Figure:
    """Error of each packet's distance."""
    figure = Figure(figsize=(8, 4))
    axes = figure.subplots()
    for (case, rows), colour in zip(distances.items(), (plots.BLUE, plots.ORANGE, plots.GREEN), strict=False):
        for first, marker in ((True, "o"), (False, ".")):
            here = rows[(rows[:, 2] == 0) == first]
            if len(here):
                label = f"{case}, {'first packet' if first else 'later packets'}"
                fill: Literal["none", "full"] = "none" if first else "full"
                error = here[:, 1] - here[:, 0]
                axes.plot(here[:, 0], error, marker, color=colour, label=label, fillstyle=fill, ms=4, alpha=0.6)
    for line in (-GOOD_M, GOOD_M):
        axes.axhline(line, color=plots.GRAY, lw=0.8, ls="--")
    axes.set(xlabel="distance (m)", ylabel="error (m)")
    axes.legend(frameon=False)
    return figure


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


STATIC, DRIVING, WHOLE = "at rest", "driving", "whole drives"

QUICK_M = (40.0, 80.0, 125.0)
FULL_M = (25.0, 40.0, 60.0, 70.0, 80.0, 90.0, 100.0, 125.0, 150.0, 180.0, 210.0)

TEXT = (
    "Packets of the reference link at rest (one packet a film, the array at its own place on the pixel grid) and on "
    "the road at 30 km/h (three packets a film, road of class B), and whole drives from 80 m to 25 m, received blind "
    "by the soft receiver. LLRs: each LLR that the equaliser hands to the decoder predicts that its sign is wrong "
    "with the probability 1 / (1 + exp |LLR|); the observed rate stands beside it. First iteration: nothing is known "
    "yet. Last iteration: codewords that were not decoded at once, as they were last given to the decoder, with other "
    "layers cancelled or estimated. Distance: that of the packet, from the pitch in the image, against the true one in "
    "the packet's middle. The first packet has one header only; intervals of an rms take errors as independent and "
    "normal."
)


@dataclass(frozen=True, slots=True)
class Calibration:
    """Predictions and distances of all packets."""

    # Bits by `FIRST` and `LAST`
    reliability: dict[str, ReliabilityCounts]
    # Rows of `CalibrationRecord.distances` by case
    distances: dict[str, Floats]

    @classmethod
    def of(cls, records: Iterable[CalibrationRecord]) -> "Calibration":
        """All records together."""
        reliability = {name: ReliabilityCounts() for name in (FIRST, LAST)}
        rows: dict[str, list[Floats]] = {}
        for one in records:
            rows.setdefault(one.case, []).append(one.distances)
            for name, counts in reliability.items():
                counts.include(one.reliability[name])
        return cls(reliability, {case: np.concatenate(parts) for case, parts in rows.items()})

    def plain(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return {
            "reliability": {name: counts.table.sum(0).tolist() for name, counts in self.reliability.items()},
            "distances": {case: rows.tolist() for case, rows in self.distances.items()},
        }


def run(context: Context) -> ExperimentResult:
    """Receive packets by distance; compare predictions and distances with the truth."""
    measured = Calibration.of(context.each("the soft receiver", record, films(context)))
    bins = {name: counts.bins() for name, counts in measured.reliability.items()}
    errors = by_distance(measured.distances)
    diagram = "Observed over predicted error probability; between the dashed lines it is as asked."
    return ExperimentResult(
        key="soft",
        title="The soft receiver: calibration of LLRs, and distances",
        text=TEXT,
        findings=[*(calibrated(name, part) for name, part in bins.items()), accurate(errors)],
        pictures=[
            (reliability_diagram(bins), diagram),
            (distance_errors(measured.distances), "Error of a packet's distance."),
        ],
        tables=[*(_reliability_table(name, part) for name, part in bins.items()), _distance_table(errors)],
        data=measured.plain(),
    )


def films(context: Context) -> list[CalibrationFilm]:
    """Films to be received; far ones, which take longest, first."""
    out = []
    for z in sorted(QUICK_M if context.quick else FULL_M, reverse=True):
        for case, preset, packets, count in ((STATIC, "static", 1, 24), (DRIVING, "paper", 3, 8)):
            channel = {"distance_m": z, "stop_m": 5.0}
            # the LLRs of the equaliser are counted, near packets included
            receive = {"receiver": "soft", "soft": {"led_by_led": False}}
            settings = load_settings(preset, {"channel": channel, "receive": receive})
            seeds = [1000 * context.seed + k for k in range(3 if context.quick else count)]
            out += [CalibrationFilm(case=case, settings=settings, seed=seed, packets=packets) for seed in seeds]
    whole = load_settings("paper", None, ["receive.receiver=soft"])
    seeds = [1000 * context.seed + k for k in range(3)]
    drives = [CalibrationFilm(case=WHOLE, settings=whole, seed=seed, packets=None) for seed in seeds]
    return out if context.quick else drives + out


def _reliability_table(name: str, bins: Sequence[ReliabilityBin]) -> Table:
    rows = [
        [
            one.range_text(),
            str(one.count.trials),
            str(one.count.errors),
            f"{one.expected:.1f}",
            one.ratio_text(),
        ]
        for one in bins
    ]
    head = ["predicted", "bits", "wrong", "expected", "ratio"]
    return Table(f"Bits by predicted error probability, {name}", head, rows)


def _distance_table(errors: Sequence[DistanceErrors]) -> Table:
    rows = []
    for one in errors:
        rms, least, most = rms_m(one.errors_m)
        spread = f"{rms:.3f} ({least:.3f} to {most:.3f})"
        place = f"{one.from_m:g} to {one.to_m:g} m"
        rows.append([one.case, place, str(len(one.errors_m)), spread, f"{one.errors_m.mean():+.3f}"])
    return Table("Error of distance in m", ["case", "distance", "packets", "rms (95 %)", "bias"], rows)
