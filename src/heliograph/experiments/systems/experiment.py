"""Other systems in the channel: on-off keying with and without the inverse, repetition, the hierarchical code."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from heliograph.experiments.result import Context, ExperimentResult, Table
from heliograph.experiments.systems.curves import CURVES, Points, SystemCurve, error_free_m, range_m
from heliograph.experiments.systems.pictures import CAPTION, error_rates
from heliograph.experiments.systems.schemes import SCHEMES, BitCounts, ReadMethod, count_bits
from heliograph.experiments.systems.verdicts import findings
from heliograph.measure.statistics import Count

QUICK_BITS, FULL_BITS = 20_000, 100_000
"""Bits of on-off keying a distance."""

RELATIVE_BITS = {"ook": 1.0, "haar": 0.5, "repeat2": 0.25, "repeat4": 0.25}
"""Bits of each scheme by those of on-off keying: the others send fewer a film."""

METHODS: Mapping[str, tuple[ReadMethod, ...]] = {
    "ook": ("plain", "inverse", "known"),
    "haar": ("plain", "inverse"),
    "repeat2": ("plain",),
    "repeat4": ("plain",),
}

QUICK_M: Mapping[str, Sequence[float]] = {
    "ook": (30, 40, 45, 50, 55, 60, 65, 70),
    "haar": (40, 45, 50, 60, 70, 80, 100),
    "repeat2": (60, 70, 80, 100, 120),
    "repeat4": (120, 140, 160),
}
FULL_M: Mapping[str, Sequence[float]] = {
    "ook": (25, 30, 35, 40, 42.5, 45, 50, 55, 57.5, 60, 62.5, 65, 70, 80),
    "haar": (25, 30, 35, 40, 45, 50, 55, 60, 65, 70, 75, 80, 90, 100, 120),
    "repeat2": (40, 50, 60, 65, 70, 75, 80, 90, 100, 120),
    "repeat4": (80, 100, 120, 130, 140, 150, 160),
}


TEXT = (
    "Static camera, reference link, no error-correcting code: random bits in pattern and inverse, detected and "
    "tracked by the plain receiver. Each film is one packet with the array at its own place on the pixel grid. "
    "The inverse undoes the blur of all LEDs by least squares with the pose and blur the receiver has "
    "estimated, or, as in the field trial, with the channel known beforehand. Repetition "
    "of low frequencies is on-off keying on squares of 2 x 2 or 4 x 4 LEDs, nothing more: all LEDs of a square "
    "show the same bit, and their luminances are added; a pattern then carries 64 or 16 bits in place of 256, "
    "and nothing is sent at the fine scale. Intervals allow for errors of one film that come together."
)


@dataclass(frozen=True, slots=True)
class SystemTask:
    """One scheme at one distance."""

    # Key of the scheme in `SCHEMES`
    scheme: str
    # Distance of the array in m, above 0
    distance_m: float
    # Bits of each part to be counted; fewer do where `ENOUGH` errors come first
    target: int
    # Of bits, places and noise
    seed: int


def measure(task: SystemTask) -> BitCounts:
    """Count the bits of a scheme at a distance."""
    return count_bits(SCHEMES[task.scheme], METHODS[task.scheme], task.distance_m, task.target, task.seed)


def tasks(context: Context) -> list[SystemTask]:
    """All schemes and distances, the longest first."""
    bits = QUICK_BITS if context.quick else FULL_BITS
    places = QUICK_M if context.quick else FULL_M
    return [
        SystemTask(key, float(z), round(RELATIVE_BITS[key] * bits), context.seed)
        for key in ("haar", "ook", "repeat4", "repeat2")
        for z in places[key]
    ]


def run(context: Context) -> ExperimentResult:
    """Error rates before any code of all systems, by distance; their ranges."""
    todo = tasks(context)
    counted = context.each("other systems", measure, todo)
    points = {curve.name: _points(curve, todo, counted) for curve in CURVES}
    return ExperimentResult(
        key="systems",
        title="Other systems in the same channel",
        text=TEXT,
        findings=findings(points),
        pictures=[(error_rates(points), CAPTION)],
        tables=[_table(points)],
        data={"systems": [_plain(curve, points[curve.name]) for curve in CURVES], "films": _films(todo, counted)},
    )


def _points(curve: SystemCurve, todo: Sequence[SystemTask], counted: Sequence[BitCounts]) -> Points:
    counts = [
        (task.distance_m, one.counts.get((curve.method, curve.part), Count()))
        for task, one in zip(todo, counted, strict=True)
        if task.scheme == curve.scheme
    ]
    return sorted(counts, key=lambda pair: pair[0])


def _table(points: Mapping[str, Points]) -> Table:
    head = ("system", "bits per pattern", "error-free to", "bits read to there, bound", "BER 1e-3 at", "BER 1e-2 at")
    return Table("Ranges before any code", head, [_row(curve, points[curve.name]) for curve in CURVES])


def _row(curve: SystemCurve, points: Points) -> tuple[str, ...]:
    free = error_free_m(points)
    first = points[0][0]
    reach = (f"{free[0]:g} m", f"{free[1].trials}, {free[1].text()}") if free else (f"nearer than {first:g} m", "")
    ranges = (range_m(points, rate) for rate in (1e-3, 1e-2))
    return (curve.name, str(curve.bits), *reach, *("-" if z is None else f"{z:.0f} m" for z in ranges))


def _plain(curve: SystemCurve, points: Points) -> dict[str, Any]:
    free = error_free_m(points)
    return {
        "system": curve.name,
        "bits_per_pattern": curve.bits,
        "error_free_m": free[0] if free else None,
        "range_1e-3_m": range_m(points, 1e-3),
        "range_1e-2_m": range_m(points, 1e-2),
        "points": [{"distance_m": z, "bits": c.trials, "errors": c.errors} for z, c in points],
    }


def _films(todo: Sequence[SystemTask], counted: Sequence[BitCounts]) -> list[dict[str, Any]]:
    return [
        {"scheme": t.scheme, "distance_m": t.distance_m, "films": c.films, "found": c.found}
        for t, c in zip(todo, counted, strict=True)
    ]
