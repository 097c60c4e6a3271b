"""Other systems in the channel: on-off keying with and without the inverse, repetition, the hierarchical code."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from heliograph.experiments.plots import COLOURS
from heliograph.experiments.result import Chapter, Context, Finding, Table
from heliograph.experiments.systems.schemes import SCHEMES, Heard, Reading, listen
from heliograph.measure.statistics import Count

QUICK_BITS, FULL_BITS = 20_000, 100_000
"""Bits of on-off keying a distance."""

SHARE = {"ook": 1.0, "haar": 0.5, "repeat2": 0.25, "repeat4": 0.25}
"""Bits of the other schemes, as a share of that: theirs are fewer a film."""

READINGS: Mapping[str, tuple[Reading, ...]] = {
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

KASASHIMA_M = {"plain": 40.0, "inverse": 60.0}
"""Distances to which the field trial of Kasashima et al. 2013 was free of error."""


CAPTION = (
    "Bit error rate before any code; 95 % intervals; an arrow is a bound (3/n), no error met. Upright lines: 40 m and "
    "60 m, to which Kasashima et al. found no error without and with the inverse."
)


@dataclass(frozen=True, slots=True)
class Line:
    """A system as it is shown: what it sends and how it is read."""

    name: str
    scheme: str
    reading: Reading
    part: str
    colour: str
    dashes: str

    @property
    def bits(self) -> int:
        """Bits of a pattern."""
        part = SCHEMES[self.scheme].parts[self.part]
        return part.stop - part.start


LINES = (
    Line("on-off keying", "ook", "plain", "all", "#4a5056", "-"),
    Line("on-off keying, inverse", "ook", "inverse", "all", "#4a5056", "--"),
    Line("on-off keying, inverse, pose known", "ook", "known", "all", "#9aa1a8", ":"),
    *(Line(f"hierarchical, {n}", "haar", "plain", n, COLOURS[n], "-") for n in COLOURS),
    *(Line(f"hierarchical, {n}, inverse", "haar", "inverse", n, COLOURS[n], "--") for n in COLOURS),
    Line("on-off keying, 2 x 2 LEDs a bit", "repeat2", "plain", "all", "#8e44ad", "-"),
    Line("on-off keying, 4 x 4 LEDs a bit", "repeat4", "plain", "all", "#c0392b", "-"),
)

Points = Sequence[tuple[float, Count]]


@dataclass(frozen=True, slots=True)
class Task:
    """One scheme at one distance."""

    scheme: str
    distance_m: float
    target: int
    seed: int


def measure(task: Task) -> Heard:
    """Listen to a scheme at a distance."""
    return listen(SCHEMES[task.scheme], READINGS[task.scheme], task.distance_m, task.target, task.seed)


def tasks(context: Context) -> list[Task]:
    """All that is to be measured, the longest first."""
    bits = QUICK_BITS if context.quick else FULL_BITS
    places = QUICK_M if context.quick else FULL_M
    return [
        Task(key, float(z), round(SHARE[key] * bits), context.seed)
        for key in ("haar", "ook", "repeat4", "repeat2")
        for z in places[key]
    ]


def run(context: Context) -> Chapter:
    """Error rates before any code of all systems, by distance; their ranges."""
    todo = tasks(context)
    heard = context.each("other systems", measure, todo)
    points = {line.name: _points(line, todo, heard) for line in LINES}
    return Chapter(
        key="systems",
        title="Other systems in the same channel",
        text=(
            "Static camera, reference link, no error-correcting code: random bits in pattern and inverse, detected and "
            "tracked by the plain receiver. Each film is one packet with the array at its own place on the pixel grid. "
            "The inverse undoes the blur of all LEDs by least squares with the pose and blur the receiver has "
            "estimated, or, as in the field trial, with the channel known beforehand. Repetition "
            "of low frequencies is on-off keying on squares of 2 x 2 or 4 x 4 LEDs, nothing more: all LEDs of a square "
            "show the same bit, and their luminances are added; a pattern then carries 64 or 16 bits in place of 256, "
            "and nothing is sent at the fine scale. Intervals allow for errors of one film that come together."
        ),
        findings=_findings(points),
        pictures=[(_picture(points), CAPTION)],
        tables=[_table(points)],
        data={"systems": [_plain(line, points[line.name]) for line in LINES], "films": _films(todo, heard)},
    )


def _points(line: Line, todo: Sequence[Task], heard: Sequence[Heard]) -> Points:
    counts = [
        (task.distance_m, one.counts.get((line.reading, line.part), Count()))
        for task, one in zip(todo, heard, strict=True)
        if task.scheme == line.scheme
    ]
    return sorted(counts, key=lambda pair: pair[0])


def error_free_m(points: Points) -> tuple[float, Count] | None:
    """Largest distance up to which no error was met at any, and the bits of all of them; None: not even the first."""
    total, last = Count(), None
    for z, count in points:
        if not count.trials or count.errors:
            break
        total.add(count.trials, 0)
        last = z
    return None if last is None else (last, total)


def range_m(points: Points, rate: float) -> float | None:
    """Distance at which the error rate passes `rate`, log rate over distance taken as straight; None: not in sight."""
    before: tuple[float, float] | None = None
    for z, count in points:
        if not count.trials:
            return None
        # no error met: half an error
        log = float(np.log10(max(count.errors, 0.5) / count.trials))
        if log > np.log10(rate):
            if before is None:
                return None
            share = (np.log10(rate) - before[1]) / (log - before[1])
            return float(before[0] + share * (z - before[0]))
        before = z, log
    return None


def _findings(points: Mapping[str, Points]) -> list[Finding]:
    plain, inverse, known = (points[line.name] for line in LINES[:3])
    return [
        _trial(
            "Kasashima et al. 2013: on-off keying is free of error to 40 m without the inverse.",
            KASASHIMA_M["plain"],
            plain,
        ),
        _trial(
            "Kasashima et al. 2013: with the inverse, the channel known, it is free of error to 60 m.",
            KASASHIMA_M["inverse"],
            known,
        ),
        _trial(
            "Asked: the same to 60 m with pose and blur as the receiver finds them by itself.",
            KASASHIMA_M["inverse"],
            inverse,
            "with the pose known see above: what is left is the estimate's error, most of it of the pitch, which the "
            "inverse does not forgive where LEDs lie closer than pixels, in some places on the pixel grid",
        ),
        _against(points),
    ]


def _trial(claim: str, claimed_m: float, points: Points, why: str = "") -> Finding:
    """The field trial's distance beside ours: free of error to there, and not at 10 m more."""
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
    layers = {name: range_m(points[f"hierarchical, {name}"], limit) for name in COLOURS}
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


def _table(points: Mapping[str, Points]) -> Table:
    head = ("system", "bits per pattern", "error-free to", "bits read to there, bound", "BER 1e-3 at", "BER 1e-2 at")
    return Table("Ranges before any code", head, [_row(line, points[line.name]) for line in LINES])


def _row(line: Line, points: Points) -> tuple[str, ...]:
    free = error_free_m(points)
    first = points[0][0]
    reach = (f"{free[0]:g} m", f"{free[1].trials}, {free[1].text()}") if free else (f"nearer than {first:g} m", "")
    ranges = (range_m(points, rate) for rate in (1e-3, 1e-2))
    return (line.name, str(line.bits), *reach, *("-" if z is None else f"{z:.0f} m" for z in ranges))


def _plain(line: Line, points: Points) -> dict[str, Any]:
    free = error_free_m(points)
    return {
        "system": line.name,
        "bits_per_pattern": line.bits,
        "error_free_m": free[0] if free else None,
        "range_1e-3_m": range_m(points, 1e-3),
        "range_1e-2_m": range_m(points, 1e-2),
        "points": [{"distance_m": z, "bits": c.trials, "errors": c.errors} for z, c in points],
    }


def _films(todo: Sequence[Task], heard: Sequence[Heard]) -> list[dict[str, Any]]:
    return [
        {"scheme": t.scheme, "distance_m": t.distance_m, "films": h.films, "found": h.found}
        for t, h in zip(todo, heard, strict=True)
    ]


def _picture(points: Mapping[str, Points]) -> Figure:
    figure = Figure(figsize=(12, 5))
    left, right = figure.subplots(1, 2, sharey=True)
    for line in LINES:
        for axes, shown in (
            (left, line.scheme != "haar"),
            (right, line.scheme == "haar" or line.name == LINES[0].name),
        ):
            if shown:
                _draw(axes, line, points[line.name])
    for axes, title in ((left, "on-off keying, inverse and repetition"), (right, "the hierarchical code")):
        axes.set_title(title, fontsize=10)
        axes.set_xlabel("distance (m)")
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(alpha=0.25, lw=0.6)
        axes.legend(frameon=False, fontsize=8, loc="lower right")
    for z in KASASHIMA_M.values():
        left.axvline(z, color="#c9ced6", lw=1, zorder=0)
    left.set_yscale("log")
    left.set_ylim(1e-6, 1)
    left.set_ylabel("bit error rate")
    figure.tight_layout()
    return figure


def _draw(axes: Any, line: Line, points: Points) -> None:
    met = [(z, c.rate, *c.interval()) for z, c in points if c.errors]
    if met:
        z, rate, low, high = np.array(met).T
        bars = (rate - low, high - rate)
        axes.errorbar(z, rate, bars, color=line.colour, ls=line.dashes, marker="o", ms=3, lw=1.2, label=line.name)
    free = [(z, c.bound) for z, c in points if c.trials and not c.errors]
    if free:
        z, bound = np.array(free).T
        label = None if met else line.name
        axes.plot(z, bound, color=line.colour, marker=r"$\downarrow$", ms=7, ls="none", alpha=0.7, label=label)
