"""Bit error rate by distance, static and driving, before and after the turbo code: Fig. 13."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Literal

import numpy as np

from heliograph.experiments.error_rates.comparison import Comparison, compare
from heliograph.experiments.error_rates.films import (
    CountsByDistance,
    FilmCounts,
    FilmTask,
    bin_of,
    count_film,
    lost_packets,
)
from heliograph.experiments.error_rates.pictures import pictures
from heliograph.experiments.error_rates.tables import comparison_table, plain_values, rates_table
from heliograph.experiments.error_rates.verdicts import alike, error_free, keying
from heliograph.experiments.result import Context, ExperimentResult, Finding
from heliograph.measure.errors import BIN_M
from heliograph.measure.statistics import Count


@dataclass(frozen=True, slots=True)
class ErrorRateEffort:
    """How much is filmed."""

    # Distances at rest in m
    places_m: Sequence[float]
    # Films of one packet at each distance
    films: int
    # Whole drives from 80 m to 25 m
    drives: int


QUICK = ErrorRateEffort((25.0, 35.0, 45.0, 50.0, 55.0, 60.0, 70.0, 80.0), films=3, drives=1)
FULL = ErrorRateEffort(tuple(float(z) for z in range(25, 85, 5)), films=16, drives=16)


@dataclass(frozen=True, slots=True)
class ErrorRates:
    """Counts of all films, and driving beside static."""

    # static, driving, keyed: counts at rest, driving, and of on-off keying at rest
    static: CountsByDistance
    driving: CountsByDistance
    keyed: CountsByDistance
    # Raw error rates of driving against static, at the same distances
    found: Sequence[Comparison]
    # Packets filmed whole and those of which nothing was received, "driving" and "static"
    lost: Mapping[str, Count]
    # Codewords accepted as right that were not sent
    false_codewords: int


def run(context: Context, effort: ErrorRateEffort | None = None) -> ExperimentResult:
    """Fig. 13: static points, drives, on-off keying; is driving like static?"""
    effort = effort or (QUICK if context.quick else FULL)
    rates = measure(context, effort)
    counts = (rates.static, rates.driving, rates.keyed)
    return ExperimentResult(
        key="fig13",
        title="Bit error rate by distance, static and driving (Fig. 13)",
        text=_text(effort, context),
        findings=judge(rates),
        pictures=pictures(*counts, rates.found),
        tables=[rates_table(*counts), comparison_table(rates.found)],
        data={
            **plain_values(*counts, rates.found),
            "lost": {name: asdict(count) for name, count in rates.lost.items()},
            "false_codewords": rates.false_codewords,
        },
    )


def measure(context: Context, effort: ErrorRateEffort) -> ErrorRates:
    """Film, receive and count all; compare each packet of the drives with a packet at rest at the same distance."""
    driven = context.each("drives", count_film, _drives(context, effort.drives), (0.0, 0.4))
    static = _static(context, effort, "haar", (0.4, 0.55))
    keyed = _static(context, effort, "ook", (0.55, 0.7))
    packets = [record for one in driven for record in one.packets]
    drive = [k for k, one in enumerate(driven) for _ in one.packets]
    wanted = [record.distance_m for record in packets] + [z for one in driven for z in one.lost]
    twins = context.each("the same at rest", count_film, _twins(context, wanted), (0.7, 1.0))
    # the twins of lost packets, the last ones, only show whether they are lost at rest as well
    pairs = [(a, b.packets[0], k) for a, b, k in zip(packets, twins, drive, strict=False) if b.packets]
    found = compare(
        [a for a, _, _ in pairs],
        [b for _, b, _ in pairs],
        np.random.default_rng([context.seed, 9]),
        drives=[k for _, _, k in pairs],
    )
    lost = {"driving": lost_packets(driven), "static": lost_packets(twins)}
    return ErrorRates(
        static, _binned(driven), keyed, found, lost, sum(one.false_codewords for one in (*driven, *twins))
    )


def judge(rates: ErrorRates) -> list[Finding]:
    """All claims on error rates."""
    return [
        alike(rates.found, rates.lost["driving"], rates.lost["static"]),
        *error_free(rates.driving),
        keying(rates.static, rates.keyed),
    ]


def _drives(context: Context, count: int) -> list[FilmTask]:
    """Drives; with a recorded trace every second one shakes as it does."""
    return [FilmTask(None, "haar", (context.seed, 1, k), context.imu if k % 2 else None) for k in range(count)]


def _twins(context: Context, distances: Sequence[float]) -> list[FilmTask]:
    """For each packet of the drives one at rest at the same distance."""
    return [FilmTask(z, "haar", (context.seed, 2, k)) for k, z in enumerate(distances)]


def _static(
    context: Context, effort: ErrorRateEffort, modulation: Literal["haar", "ook"], span: tuple[float, float]
) -> CountsByDistance:
    todo = [
        FilmTask(z, modulation, (context.seed, 3, len(modulation), k, round(z)))
        for z in effort.places_m
        for k in range(effort.films)
    ]
    title = "static" if modulation == "haar" else "on-off keying"
    sums = CountsByDistance()
    for task, one in zip(todo, context.each(title, count_film, todo, span), strict=True):
        assert task.distance_m is not None  # static
        for record in one.packets:
            sums.add(task.distance_m, record)
        for layers in one.missed.values():
            for name, count in layers.items():
                sums.miss(task.distance_m, name, count)
    return sums


def _binned(driven: Sequence[FilmCounts]) -> CountsByDistance:
    sums = CountsByDistance()
    for one in driven:
        for record in one.packets:
            sums.add(bin_of(record.distance_m), record)
        for start, layers in one.missed.items():
            for name, count in layers.items():
                sums.miss(start + BIN_M / 2, name, count)
    return sums


def _text(effort: ErrorRateEffort, context: Context) -> str:
    shake = (
        "a road of class B and a recorded trace in turn" if context.imu and effort.drives > 1 else "a road of class B"
    )
    return (
        f"Static: {effort.films} films of one packet a distance, each with the array at its own place on the pixel "
        f"grid. Driving: {effort.drives} whole drives from 80 m to 25 m at 30 km/h, shaken by {shake}, in bins of "
        f"{BIN_M:g} m. Errors are counted before the turbo code (raw) and after it; lost packets count as wrong "
        "codewords. Rate 1/3 in all layers, 256 bits a pattern at rest and driving (the paper drove at an eighth of "
        "its static rate). To compare, each packet of the drives has a twin at rest at the distance of its middle. "
        "Packets are compared, not bits, since errors of one packet depend on its place on the pixel grid, most of all "
        "at 58 m, where LEDs lie as close as pixels. Intervals of ratios are a bootstrap over packets or over drives, "
        "whichever is wider; tests of equality take the packets of a drive as independent, and so does that of the "
        "packets lost. A lost packet of a drive has its twin in the middle of its distance bin. Intervals of bit error "
        "rates allow for bits of a packet that fail together; with no error met after the code, packets are counted "
        "for the bound."
    )
