"""Other systems in the same channel: on-off keying with and without inverses, repetition, the hierarchical code.

Static camera, reference link, no error-correcting code: random bits in pattern and inverse, detected and tracked by the
plain receiver. Each film is a packet with a random pixel phase of the array. The inverse removes the blur of all LEDs
by least squares, with the pose and blur estimated by the receiver or, as in the field trial, with a known channel.
Repetition of low frequencies is on-off keying on squares of 2 x 2 or 4 x 4 LEDs: all LEDs of a square show the same
bit, and the luminances are added. A pattern then carries 64 or 16 bits instead of 256. Intervals account for the
correlation of errors within a film.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from heliograph.experiments import plots
from heliograph.experiments.plots import DARK_GRAY, LAYER_COLOURS
from heliograph.experiments.report import Context, ExperimentResult, Finding, Table, description, verdict_of
from heliograph.experiments.systems.schemes import SCHEMES, BitCounts, ReadMethod, count_bits
from heliograph.measure.statistics import Count
from heliograph.sweeps.plot import legend_entries


@dataclass(frozen=True, slots=True)
class SystemCurve:
    """Error rate curve of a system."""

    name: str
    scheme: str
    method: ReadMethod
    # Part of the pattern that is counted
    part: str
    colour: str
    dashes: str = "-"

    @property
    def bits(self) -> int:
        """Bits of a pattern."""
        part = SCHEMES[self.scheme].parts[self.part]
        return part.stop - part.start


CURVES = (
    SystemCurve("on-off keying", "ook", "plain", "all", DARK_GRAY),
    SystemCurve("on-off keying, inverse", "ook", "inverse", "all", DARK_GRAY, "--"),
    SystemCurve("on-off keying, inverse, pose known", "ook", "known", "all", "darkgray", ":"),
    *(SystemCurve(f"hierarchical, {n}", "haar", "plain", n, colour) for n, colour in LAYER_COLOURS.items()),
    *(SystemCurve(f"hierarchical, {n}, inverse", "haar", "inverse", n, c, "--") for n, c in LAYER_COLOURS.items()),
    SystemCurve("on-off keying, 2 x 2 LEDs a bit", "repeat2", "plain", "all", "#8e44ad"),
    SystemCurve("on-off keying, 4 x 4 LEDs a bit", "repeat4", "plain", "all", plots.RED),
)

Points = Sequence[tuple[float, Count]]
"""Bits and errors by distance in m, near first."""


def error_free_m(points: Points) -> tuple[float, Count] | None:
    """Largest distance in m with no error up to there, and the counted bits; None if the first distance has errors."""
    total, last = Count(), None
    for z, count in points:
        if not count.trials or count.errors:
            break
        total.add(count.trials, 0)
        last = z
    return None if last is None else (last, total)


def range_m(points: Points, rate: float) -> float | None:
    """Distance in m at which the error rate exceeds a rate, by log-linear interpolation; None if out of range."""
    before: tuple[float, float] | None = None
    for z, count in points:
        if not count.trials:
            return None
        # half an error stands for none
        log = float(np.log10(max(count.errors, 0.5) / count.trials))
        if log > np.log10(rate):
            if before is None:
                return None
            fraction = (np.log10(rate) - before[1]) / (log - before[1])
            return float(before[0] + fraction * (z - before[0]))
        before = z, log
    return None


KASASHIMA_M = {"plain": 40.0, "inverse": 60.0}
"""Error-free distances of the field trial of Kasashima et al. 2013."""


@plots.styled
def error_rates(points: Mapping[str, Points]) -> Figure:
    """On-off keying and repetition left, the hierarchical code right."""
    figure = Figure(figsize=(12, 5))
    left, right = figure.subplots(1, 2, sharey=True)
    for curve in CURVES:
        panels = [right] if curve.scheme == "haar" else [left, right] if curve is CURVES[0] else [left]
        for axes in panels:
            style = {"color": curve.colour, "ls": curve.dashes, "ms": 3, "lw": 1.2}
            plots.draw_rates(axes, points[curve.name], curve.name, capsize=0, **style)
    for axes, title in ((left, "on-off keying, inverse and repetition"), (right, "the hierarchical code")):
        axes.set(title=title, xlabel="distance (m)", yscale="log", ylim=(1e-6, 1))
        axes.legend(*legend_entries(axes), fontsize=8, loc="lower right")
    for z in KASASHIMA_M.values():
        left.axvline(z, color="lightgray", lw=1, zorder=0)
    left.set_ylabel("bit error rate")
    return figure


def findings(points: Mapping[str, Points]) -> list[Finding]:
    """Judge all claims."""
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
            "Question: the same to 60 m with the estimated pose and blur.",
            KASASHIMA_M["inverse"],
            inverse,
            "with the pose known see above: the rest is estimation error, mostly of the pitch; the inverse amplifies "
            "this error at some pixel phases if LEDs are closer than pixels",
        ),
        _hierarchical(points),
    ]


def field_trial(claim: str, claimed_m: float, points: Points, why: str = "") -> Finding:
    """Compare with a field trial: the claim holds with no error up to `claimed_m` and some within 10 m more."""
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
    return Finding(claim, ours, verdict_of(holds), "" if holds else why)


def _hierarchical(points: Mapping[str, Points]) -> Finding:
    """Compare the ranges of the hierarchical code and of plain keying."""
    keyed, repeat = (range_m(points[name], 1e-2) for name in ("on-off keying", "on-off keying, 2 x 2 LEDs a bit"))
    layers = {name: range_m(points[f"hierarchical, {name}"], 1e-2) for name in LAYER_COLOURS}
    text = ", ".join(f"{name} {_metres(z)}" for name, z in layers.items())
    high = layers["high"]
    holds = high is not None and keyed is not None and high > keyed
    return Finding(
        "The hierarchical code sends its high layer further than plain keying, in the same pattern as the rest.",
        f"BER 1e-2 before any code: on-off keying {_metres(keyed)}; hierarchical {text}; 2 x 2 LEDs a bit, with the "
        f"bits of the high layer only, {_metres(repeat)}.",
        verdict_of(holds),
        "Repetition reaches further than the high layer, because all light carries these bits." if holds else "",
    )


def _metres(z: float | None) -> str:
    return "beyond the measured distances" if z is None else f"{z:.0f} m"


METHODS: Mapping[str, tuple[ReadMethod, ...]] = {
    "haar": ("plain", "inverse"),
    "ook": ("plain", "inverse", "known"),
    "repeat4": ("plain",),
    "repeat2": ("plain",),
}
"""Read methods of each scheme; schemes with long computations come first."""


@dataclass(frozen=True, slots=True)
class SystemEffort:
    """Distances and bits of each scheme."""

    # Bits of on-off keying at each distance
    bits: int
    distances_m: Mapping[str, Sequence[float]]


QUICK = SystemEffort(
    20_000,
    {
        "ook": (30, 40, 45, 50, 55, 60, 65, 70),
        "haar": (40, 45, 50, 60, 70, 80, 100),
        "repeat2": (60, 70, 80, 100, 120),
        "repeat4": (120, 140, 160),
    },
)
FULL = SystemEffort(
    100_000,
    {
        "ook": (25, 30, 35, 40, 42.5, 45, 50, 55, 57.5, 60, 62.5, 65, 70, 80),
        "haar": (25, 30, 35, 40, 45, 50, 55, 60, 65, 70, 75, 80, 90, 100, 120),
        "repeat2": (40, 50, 60, 65, 70, 75, 80, 90, 100, 120),
        "repeat4": (80, 100, 120, 130, 140, 150, 160),
    },
)


def _count_scheme(bits: int, seed: int, work: tuple[str, float]) -> BitCounts:
    """Count the bits of a scheme at a distance."""
    key, distance_m = work
    # other schemes than on-off keying send fewer bits per film
    target = round({"ook": 1.0, "haar": 0.5}.get(key, 0.25) * bits)
    return count_bits(SCHEMES[key], METHODS[key], distance_m, target, seed)


def run(context: Context, effort: SystemEffort | None = None) -> ExperimentResult:
    """Error rates before any code by distance, and ranges of all systems."""
    effort = effort or (QUICK if context.quick else FULL)
    todo = [(key, float(z)) for key in METHODS for z in effort.distances_m[key]]
    counted = context.each("other systems", partial(_count_scheme, effort.bits, context.seed), todo)
    points = {curve.name: _points(curve, todo, counted) for curve in CURVES}
    head = ("system", "bits per pattern", "error-free to", "bits read to there, bound", "BER 1e-3 at", "BER 1e-2 at")
    caption = (
        "Bit error rate before any code; 95 % intervals; an arrow is an upper bound (3/n) with no error. Vertical "
        "lines: 40 m and 60 m, the error-free distances of Kasashima et al. without and with the inverse."
    )
    return ExperimentResult(
        key="systems",
        title="Other systems in the same channel",
        text=description(__doc__),
        findings=findings(points),
        pictures=[(error_rates(points), caption)],
        tables=[Table("Ranges before any code", head, [_row(curve, points[curve.name]) for curve in CURVES])],
        data={
            "systems": [_plain(curve, points[curve.name]) for curve in CURVES],
            "films": [
                {"scheme": key, "distance_m": z, "films": bits.films, "found": bits.found}
                for (key, z), bits in zip(todo, counted, strict=True)
            ],
        },
    )


def _points(curve: SystemCurve, todo: Sequence[tuple[str, float]], counted: Sequence[BitCounts]) -> Points:
    counts = [
        (z, bits.counts.get((curve.method, curve.part), Count()))
        for (key, z), bits in zip(todo, counted, strict=True)
        if key == curve.scheme
    ]
    return sorted(counts, key=lambda pair: pair[0])


def _row(curve: SystemCurve, points: Points) -> tuple[str, ...]:
    free, nearest = error_free_m(points), points[0][0]
    reach = (f"{free[0]:g} m", f"{free[1].trials}, {free[1].text()}") if free else (f"nearer than {nearest:g} m", "")
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
