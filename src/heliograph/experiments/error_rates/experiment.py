"""Bit error rate by distance, static and driving, before and after the turbo code: Fig. 13."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Literal

import numpy as np

from heliograph.experiments.error_rates.comparison import compare
from heliograph.experiments.error_rates.films import Filmed, Sums, Task, bin_of, lost_packets, measure
from heliograph.experiments.error_rates.pictures import pictures
from heliograph.experiments.error_rates.tables import comparison_table, plain_values, rates_table
from heliograph.experiments.error_rates.verdicts import alike, error_free, keying
from heliograph.experiments.result import Chapter, Context
from heliograph.measure.errors import BIN_M

QUICK_M, FULL_M = (25, 35, 45, 50, 55, 60, 70, 80), tuple(range(25, 85, 5))
"""Static distances."""

QUICK_DRIVES, FULL_DRIVES = 1, 16
QUICK_FILMS, FULL_FILMS = 3, 16
"""Drives, and static films of one packet a distance."""


def run(context: Context) -> Chapter:
    """Fig. 13: static points, drives, on-off keying; is driving like static?"""
    places, films = (QUICK_M, QUICK_FILMS) if context.quick else (FULL_M, FULL_FILMS)
    drives = QUICK_DRIVES if context.quick else FULL_DRIVES
    return chapter(context, [float(z) for z in places], films, drives)


def chapter(context: Context, places: Sequence[float], films: int, drives: int) -> Chapter:
    """Fig. 13 with as many static places, films a place and drives as given."""
    driven = context.each("drives", measure, _drives(context, drives), (0.0, 0.4))
    still = _static(context, places, films, "haar", (0.4, 0.55))
    keyed = _static(context, places, films, "ook", (0.55, 0.7))
    packets = [record for one in driven for record in one.packets]
    drive = [k for k, one in enumerate(driven) for _ in one.packets]
    wanted = [record.distance_m for record in packets] + [z for one in driven for z in one.lost]
    twins = context.each("the same at rest", measure, _twins(context, wanted), (0.7, 1.0))
    # those of lost packets, the last ones, only tell whether they are lost at rest as well
    pairs = [(a, b.packets[0], k) for a, b, k in zip(packets, twins, drive, strict=False) if b.packets]
    false = sum(one.false_codewords for one in (*driven, *twins))
    found = compare(
        [a for a, _, _ in pairs],
        [b for _, b, _ in pairs],
        np.random.default_rng([context.seed, 9]),
        drives=[k for _, _, k in pairs],
    )
    lost = {"driving": lost_packets(driven), "static": lost_packets(twins)}
    moving = _binned(driven)
    return Chapter(
        key="fig13",
        title="Bit error rate by distance, static and driving (Fig. 13)",
        text=_text(films, drives, context),
        findings=[alike(found, lost["driving"], lost["static"]), *error_free(moving), keying(still, keyed)],
        pictures=pictures(still, moving, keyed, found),
        tables=[rates_table(still, moving, keyed), comparison_table(found)],
        data={
            **plain_values(still, moving, keyed, found),
            "lost": {name: asdict(count) for name, count in lost.items()},
            "false_codewords": false,
        },
    )


def _drives(context: Context, count: int) -> list[Task]:
    """Drives; with a recorded trace every second one shakes as it does."""
    return [Task(None, "haar", (context.seed, 1, k), context.imu if k % 2 else None) for k in range(count)]


def _twins(context: Context, distances: Sequence[float]) -> list[Task]:
    """For each packet of the drives one at rest at the same distance."""
    return [Task(z, "haar", (context.seed, 2, k)) for k, z in enumerate(distances)]


def _static(
    context: Context,
    places: Sequence[float],
    films: int,
    modulation: Literal["haar", "ook"],
    span: tuple[float, float],
) -> Sums:
    todo = [Task(z, modulation, (context.seed, 3, len(modulation), k, round(z))) for z in places for k in range(films)]
    title = "static" if modulation == "haar" else "on-off keying"
    sums = Sums()
    for task, one in zip(todo, context.each(title, measure, todo, span), strict=True):
        assert task.distance_m is not None  # static
        for record in one.packets:
            sums.add(task.distance_m, record)
        for layers in one.missed.values():
            for name, count in layers.items():
                sums.miss(task.distance_m, name, count)
    return sums


def _binned(driven: Sequence[Filmed]) -> Sums:
    sums = Sums()
    for one in driven:
        for record in one.packets:
            sums.add(bin_of(record.distance_m), record)
        for start, layers in one.missed.items():
            for name, count in layers.items():
                sums.miss(start + BIN_M / 2, name, count)
    return sums


def _text(films: int, drives: int, context: Context) -> str:
    shake = "a road of class B and a recorded trace in turn" if context.imu and drives > 1 else "a road of class B"
    return (
        f"Static: {films} films of one packet a distance, each with the array at its own place on the pixel grid. "
        f"Driving: {drives} whole drives from 80 m to 25 m at 30 km/h, shaken by {shake}, in bins of {BIN_M:g} m. "
        "Errors are counted before the turbo code (raw) and after it; lost packets count as wrong codewords. Rate 1/3 "
        "in all layers, 256 bits a pattern at rest and driving (the paper drove at an eighth of its static rate). To "
        "compare, each packet of the drives has a twin at rest at the distance of its middle; packets, not bits, are "
        "what is compared, since errors of one packet depend on its place on the pixel grid, most of all at "
        "58 m, where LEDs lie as close as pixels. Intervals of ratios are a bootstrap over packets or over drives, "
        "whichever is wider; tests of equality take the packets of a drive as independent, and so does that of the "
        "packets lost. A lost packet of a drive has its twin in the middle of its distance bin. Intervals of bit error "
        "rates allow for bits of a packet that fail together; with no error met after the code, packets are counted "
        "for the bound."
    )
