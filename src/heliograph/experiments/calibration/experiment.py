"""Calibration of the soft receiver: predicted error probabilities of LLRs, and errors of distances.

Packets of the reference link at rest (single packets, random pixel phases of the array) and on the road at 30 km/h
(films of three packets, road of class B), and full drives from 80 m to 25 m, received by the soft receiver with channel
estimation. LLRs: each LLR of the equaliser predicts a wrong sign with the probability 1 / (1 + exp |LLR|); tables
compare this with the observed rate. First iteration: no prior knowledge. Last iteration: the last decoder input of
codewords that later iterations decoded, with other layers cancelled or estimated. Distance: estimated from the pitch in
the image, and the true distance in the middle of the packet. The first packet has a single header. Intervals of an rms
assume independent normal errors.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.special import chdtri

from heliograph.base.arrays import Floats
from heliograph.experiments import plots
from heliograph.experiments.calibration.recorder import (
    FIRST,
    LAST,
    CalibrationFilm,
    ReliabilityBin,
    record,
    reliability_bins,
)
from heliograph.experiments.report import Context, ExperimentResult, Finding, Table, description, verdict_of
from heliograph.link.settings import load_settings

TOLERANCE = 0.1
"""Allowed relative deviation of observed from predicted error probability."""

GOOD_M = 0.25
"""Required rms error of the distance in m."""


@plots.styled
def reliability_diagram(bins: Mapping[str, Sequence[ReliabilityBin]]) -> Figure:
    """Observed over predicted error probability of the judged bins, with 95 % intervals."""
    figure = Figure(figsize=(8, 4))
    axes = figure.add_subplot(xlabel="predicted error probability", ylabel="observed / predicted")
    for name, part in bins.items():
        here = judged(part)
        if here:
            ratio, low, high = np.array([one.ratio() for one in here]).T
            axes.errorbar([one.predicted for one in here], ratio, (ratio - low, high - ratio), marker="o", label=name)
    for line in (1 - TOLERANCE, 1 + TOLERANCE):
        axes.axhline(line, color=plots.GRAY, lw=0.8, ls="--")
    axes.set(xscale="log", yscale="log")
    axes.legend()
    return figure


@plots.styled
def distance_plot(distances: Mapping[str, Floats]) -> Figure:
    """Distance error of each packet."""
    figure = Figure(figsize=(8, 4))
    axes = figure.add_subplot(xlabel="distance (m)", ylabel="error (m)")
    for k, (case, rows) in enumerate(distances.items()):
        for name, marker, here in (("first", "o", rows[rows[:, 2] == 0]), ("later", ".", rows[rows[:, 2] > 0])):
            if len(here):
                style: dict[str, Any] = {"color": f"C{k}", "mfc": "none" if name == "first" else None, "alpha": 0.6}
                axes.plot(here[:, 0], here[:, 1] - here[:, 0], marker, label=f"{case}, {name} packets", **style)
    for line in (-GOOD_M, GOOD_M):
        axes.axhline(line, color=plots.GRAY, lw=0.8, ls="--")
    axes.legend()
    return figure


@dataclass(frozen=True, slots=True)
class DistanceErrors:
    """Distance errors of packets in a distance bin."""

    # Case of the films, and first or later packets
    case: str
    from_m: float
    to_m: float
    # (packets,) errors in m
    errors_m: Floats


def judged(bins: Sequence[ReliabilityBin]) -> list[ReliabilityBin]:
    """Bins with at least 30 observed or expected errors."""
    return [one for one in bins if max(one.count.errors, one.expected) >= 30]


def calibrated(name: str, bins: Sequence[ReliabilityBin]) -> Finding:
    """Compare observed and predicted error probabilities."""
    here = judged(bins)
    off = [one for one in here if one.ratio()[1] > 1 + TOLERANCE or one.ratio()[2] < 1 - TOLERANCE]
    near = [one for one in here if abs(one.ratio()[0] - 1) <= TOLERANCE]
    bits, errors = sum(one.count.trials for one in bins), sum(one.count.errors for one in bins)
    expected = sum(one.expected for one in bins)
    return Finding(
        f"Question: predicted and observed error probability within 10 %, {name}.",
        f"{errors} of {bits} bits wrong, {expected:.0f} expected; of {len(here)} bins with 30 errors or more "
        f"{len(near)} are within {TOLERANCE:.0%}, {len(off)} apart for certain.",
        verdict_of(not off if here else None),
        "Apart: " + "; ".join(f"{one.range_text()}: {one.ratio_text()}" for one in off) + "." if off else "",
    )


def by_distance(distances: Mapping[str, Floats]) -> list[DistanceErrors]:
    """Errors by case and distance, with the first packets separate."""
    edges = (22.5, 32.5, 50.0, 65.0, 75.0, 82.5, 95.0, 110.0, 140.0, 165.0, 195.0, 225.0)
    out = []
    for case, rows in distances.items():
        for name, chosen in (("first packet", rows[:, 2] == 0), ("later packets", rows[:, 2] > 0)):
            for low, high in pairwise(edges):
                here = rows[chosen & (rows[:, 0] >= low) & (rows[:, 0] < high) & np.isfinite(rows[:, 1])]
                if len(here):
                    out.append(DistanceErrors(f"{case}, {name}", low, high, here[:, 1] - here[:, 0]))
    return out


def rms_m(errors_m: Floats) -> tuple[float, float, float]:
    """Rms of errors in m with 95 % interval."""
    total, n = float((errors_m**2).sum()), len(errors_m)
    # sum of squares / sigma^2 is chi-square of n
    return (total / n) ** 0.5, (total / chdtri(n, 0.025)) ** 0.5, (total / chdtri(n, 0.975)) ** 0.5


def accurate(errors: Sequence[DistanceErrors]) -> Finding:
    """Check the distance errors up to 80 m."""
    near = [one for one in errors if one.to_m <= 82.5]
    worst = max(near, key=lambda one: rms_m(one.errors_m)[0])
    rms, low, high = rms_m(worst.errors_m)
    pooled = np.concatenate([one.errors_m for one in near])
    return Finding(
        f"Question: distance from one camera below {GOOD_M:g} m rms up to 80 m.",
        f"{len(pooled)} packets to 80 m: {rms_m(pooled)[0]:.3f} m rms; worst are {len(worst.errors_m)} packets "
        f"{worst.case}, {worst.from_m:g} to {worst.to_m:g} m: {rms:.3f} m ({low:.3f} to {high:.3f}).",
        verdict_of(rms < GOOD_M),
        "Published: 0.5 m at 60 m from two cameras, 0.75 m within 100 m from an event camera.",
    )


def run(context: Context, distances_m: Sequence[float] = ()) -> ExperimentResult:
    """Receive packets and compare predictions and distances with the truth."""
    full_m = (25.0, 40.0, 60.0, 70.0, 80.0, 90.0, 100.0, 125.0, 150.0, 180.0, 210.0)
    todo = films(context, distances_m or ((40.0, 80.0, 125.0) if context.quick else full_m))
    records = context.each("the soft receiver", record, todo)
    counts = {name: [row for one in records for row in one.reliability[name]] for name in (FIRST, LAST)}
    bins = {name: reliability_bins(rows) for name, rows in counts.items()}
    rows: dict[str, list[tuple[float, float, int]]] = {}
    for one in records:
        rows.setdefault(one.case, []).extend(one.distances)
    distances = {case: np.reshape(part, (-1, 3)) for case, part in rows.items()}
    errors = by_distance(distances)
    return ExperimentResult(
        key="soft",
        title="The soft receiver: calibration of LLRs, and distances",
        text=description(__doc__),
        findings=[*(calibrated(name, part) for name, part in bins.items()), accurate(errors)],
        pictures=[
            (reliability_diagram(bins), "Observed over predicted error probability; dashed: tolerance."),
            (distance_plot(distances), "Distance error of a packet."),
        ],
        tables=[*(_reliability_table(name, part) for name, part in bins.items()), _distance_table(errors)],
        data={
            "reliability": {name: np.sum(part, 0).tolist() for name, part in counts.items()},
            "distances": {case: part.tolist() for case, part in distances.items()},
        },
    )


def films(context: Context, distances_m: Sequence[float]) -> list[CalibrationFilm]:
    """Films to receive; far films take longest and come first."""
    out = []
    for z in sorted(distances_m, reverse=True):
        for case, preset, packets, count in (("at rest", "static", 1, 24), ("driving", "paper", 3, 8)):
            channel = {"distance_m": z, "stop_m": 5.0}
            # near packets need the equaliser, too
            receive = {"receiver": "soft", "soft": {"led_by_led": False}}
            settings = load_settings(preset, {"channel": channel, "receive": receive})
            seeds = [1000 * context.seed + k for k in range(3 if context.quick else count)]
            out += [CalibrationFilm(case=case, settings=settings, seed=seed, packets=packets) for seed in seeds]
    if context.quick:
        return out
    full = load_settings("paper", None, ["receive.receiver=soft"])
    seeds = [1000 * context.seed + k for k in range(3)]
    return [CalibrationFilm(case="whole drives", settings=full, seed=seed, packets=None) for seed in seeds] + out


def _reliability_table(name: str, bins: Sequence[ReliabilityBin]) -> Table:
    rows = [
        [one.range_text(), str(one.count.trials), str(one.count.errors), f"{one.expected:.1f}", one.ratio_text()]
        for one in bins
    ]
    head = ["predicted", "bits", "wrong", "expected", "ratio"]
    return Table(f"Bits by predicted error probability, {name}", head, rows)


def _distance_table(errors: Sequence[DistanceErrors]) -> Table:
    rows = []
    for one in errors:
        rms, low, high = rms_m(one.errors_m)
        spread, place = f"{rms:.3f} ({low:.3f} to {high:.3f})", f"{one.from_m:g} to {one.to_m:g} m"
        rows.append([one.case, place, str(len(one.errors_m)), spread, f"{one.errors_m.mean():+.3f}"])
    return Table("Error of distance in m", ["case", "distance", "packets", "rms (95 %)", "bias"], rows)
