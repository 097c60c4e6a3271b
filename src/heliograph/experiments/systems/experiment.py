"""Other systems in the same channel: on-off keying with and without inverses, repetition, the hierarchical code."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from heliograph.experiments import plots
from heliograph.experiments.plots import LAYER_COLOURS
from heliograph.experiments.report import Context, ExperimentResult, Finding, Table
from heliograph.experiments.systems.schemes import SCHEMES, BitCounts, ReadMethod, count_bits
from heliograph.measure.statistics import Count
from heliograph.sweeps.plot import legend_entries


@dataclass(frozen=True, slots=True)
class SystemCurve:
    """A system, and how its error rate is drawn."""

    # Its name in tables
    name: str
    # scheme, method, part: how bits are sent and read, and the part of the pattern that is counted
    scheme: str
    method: ReadMethod
    part: str
    # colour, dashes: style of its line
    colour: str
    dashes: str

    @property
    def bits(self) -> int:
        """Bits of a pattern."""
        part = SCHEMES[self.scheme].parts[self.part]
        return part.stop - part.start


CURVES = (
    SystemCurve("on-off keying", "ook", "plain", "all", plots.DARK_GRAY, "-"),
    SystemCurve("on-off keying, inverse", "ook", "inverse", "all", plots.DARK_GRAY, "--"),
    SystemCurve("on-off keying, inverse, pose known", "ook", "known", "all", plots.MIDDLE_GRAY, ":"),
    *(SystemCurve(f"hierarchical, {n}", "haar", "plain", n, LAYER_COLOURS[n], "-") for n in LAYER_COLOURS),
    *(SystemCurve(f"hierarchical, {n}, inverse", "haar", "inverse", n, LAYER_COLOURS[n], "--") for n in LAYER_COLOURS),
    SystemCurve("on-off keying, 2 x 2 LEDs a bit", "repeat2", "plain", "all", plots.VIOLET, "-"),
    SystemCurve("on-off keying, 4 x 4 LEDs a bit", "repeat4", "plain", "all", plots.RED, "-"),
)

Points = Sequence[tuple[float, Count]]
"""Bits and errors by distance in m, near first."""


def error_free_m(points: Points) -> tuple[float, Count] | None:
    """Largest distance in m with no error there and nearer, and the bits counted; None: not even the first."""
    total, last = Count(), None
    for z, count in points:
        if not count.trials or count.errors:
            break
        total.add(count.trials, 0)
        last = z
    return None if last is None else (last, total)


def range_m(points: Points, rate: float) -> float | None:
    """Distance in m at which the error rate passes a rate; None: it does not within the distances measured.

    The logarithm of the rate is taken as linear in distance between two points.
    """
    before: tuple[float, float] | None = None
    for z, count in points:
        if not count.trials:
            return None
        # no error met: half an error
        log = float(np.log10(max(count.errors, 0.5) / count.trials))
        if log > np.log10(rate):
            if before is None:
                return None
            fraction = (np.log10(rate) - before[1]) / (log - before[1])
            return float(before[0] + fraction * (z - before[0]))
        before = z, log
    return None


CAPTION = (
    "Bit error rate before any code; 95 % intervals; an arrow is a bound (3/n), no error met. Upright lines: 40 m and "
    "60 m, to which Kasashima et al. found no error without and with the inverse."
)


def error_rates(points: Mapping[str, Points]) -> Figure:
    """On-off keying and repetition left, the hierarchical code right."""
    figure = Figure(figsize=(12, 5))
    left, right = figure.subplots(1, 2, sharey=True)
    for curve in CURVES:
        for axes, shown in (
            (left, curve.scheme != "haar"),
            (right, curve.scheme == "haar" or curve.name == CURVES[0].name),
        ):
            if shown:
                style = {"color": curve.colour, "ls": curve.dashes, "ms": 3, "lw": 1.2}
                plots.draw_rates(axes, points[curve.name], curve.name, **style)
    for axes, title in ((left, "on-off keying, inverse and repetition"), (right, "the hierarchical code")):
        axes.set_title(title, fontsize=10)
        axes.set_xlabel("distance (m)")
        plots.tidy(axes)
        axes.legend(*legend_entries(axes), frameon=False, fontsize=8, loc="lower right")
    for z in KASASHIMA_M.values():
        left.axvline(z, color=plots.LIGHT_GRAY, lw=1, zorder=0)
    left.set_yscale("log")
    left.set_ylim(1e-6, 1)
    left.set_ylabel("bit error rate")
    figure.tight_layout()
    return figure


KASASHIMA_M = {"plain": 40.0, "inverse": 60.0}
"""Distances to which the field trial of Kasashima et al. 2013 was free of error."""


def findings(points: Mapping[str, Points]) -> list[Finding]:
    """All claims."""
    plain, inverse, known = (points[curve.name] for curve in CURVES[:3])
    return [
        field_trial(
            "Kasashima et al. 2013: on-off keying is free of error to 40 m without the inverse.",
            KASASHIMA_M["plain"],
            plain,
        ),
        field_trial(
            "Kasashima et al. 2013: with the inverse, the channel known, it is free of error to 60 m.",
            KASASHIMA_M["inverse"],
            known,
        ),
        field_trial(
            "Asked: the same to 60 m with pose and blur as the receiver finds them by itself.",
            KASASHIMA_M["inverse"],
            inverse,
            "with the pose known see above: what is left is the estimate's error, most of it of the pitch, which the "
            "inverse does not forgive where LEDs lie closer than pixels, in some places on the pixel grid",
        ),
        _against(points),
    ]


def field_trial(claim: str, claimed_m: float, points: Points, why: str = "") -> Finding:
    """The field trial's distance beside ours: it holds if there is no error to there, and some within 10 m more."""
    here = [count for z, count in points if z <= claimed_m]
    beyond = [(z, count) for z, count in points if claimed_m < z <= claimed_m + 10]
    wrong, bits = sum(c.errors for c in here), sum(c.trials for c in here)
    free = error_free_m(points)
    further = "; ".join(f"{z:g} m: {c.text()}" for z, c in beyond)
    at = next((c.text() for z, c in points if z == claimed_m), "not measured")
    ours = (
        f"{wrong} errors of {bits} bits to {claimed_m:g} m ({at} there); no error to "
        f"{f'{free[0]:g} m' if free else 'any distance'}. Beyond: {further}."
    )
    holds = bool(bits) and not wrong and any(c.errors for _, c in beyond)
    return Finding(claim, ours, "holds" if holds else "differs", "" if holds else why)


def _against(points: Mapping[str, Points]) -> Finding:
    """The hierarchical code beside plain keying: what is left of it further out."""
    limit = 1e-2
    keyed = range_m(points["on-off keying"], limit)
    layers = {name: range_m(points[f"hierarchical, {name}"], limit) for name in LAYER_COLOURS}
    text = ", ".join(f"{name} {_metres(z)}" for name, z in layers.items())
    repeat = range_m(points["on-off keying, 2 x 2 LEDs a bit"], limit)
    high = layers["high"]
    holds = high is not None and keyed is not None and high > keyed
    return Finding(
        "The hierarchical code sends its high layer further than plain keying, in the same pattern as the rest.",
        f"BER 1e-2 before any code: on-off keying {_metres(keyed)}; hierarchical {text}; 2 x 2 LEDs a bit, with the "
        f"bits of the high layer alone, {_metres(repeat)}.",
        "holds" if holds else "differs",
        "Repetition reaches further than the high layer, for it puts all of its light there." if holds else "",
    )


def _metres(z: float | None) -> str:
    return "beyond what was measured" if z is None else f"{z:.0f} m"


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
