"""Fig. 13: bit error rate by distance, static and driving, before and after the turbo code."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from heliograph.experiments import plots
from heliograph.experiments.error_rates.comparison import MARGIN, RISK, Comparison, compare
from heliograph.experiments.error_rates.films import (
    CountsByDistance,
    FilmCounts,
    FilmTask,
    all_layers,
    bin_of,
    count_film,
    lost_packets,
)
from heliograph.experiments.plots import LAYER_COLOURS
from heliograph.experiments.report import Context, ExperimentResult, Finding, Table, Verdict
from heliograph.measure.counts import Layers
from heliograph.measure.errors import BIN_M
from heliograph.measure.statistics import Clustered, Count
from heliograph.signal.settings import LAYERS
from heliograph.sweeps.plot import legend_entries


def rates_table(static: CountsByDistance, driving: CountsByDistance, keyed: CountsByDistance) -> Table:
    """Error rates at rest, driving and of on-off keying, a row per distance."""
    head = ["distance"]
    head += [f"{n}: {what}" for n in LAYERS for what in ("raw", "decoded", "codewords wrong")] + ["on-off keying: raw"]
    rows = [_rates_row(f"static {z:g} m", layers, keyed.places.get(z)) for z, layers in sorted(static.places.items())]
    rows += [
        _rates_row(f"driving {z - BIN_M / 2:g}-{z + BIN_M / 2:g} m", layers, None)
        for z, layers in sorted(driving.places.items())
    ]
    return Table(
        "Bit error rates; no error among n raw bits, or after the code n packets, is written < 3/n", head, rows
    )


def _rates_row(name: str, layers: Layers, keyed: Layers | None) -> list[str]:
    cells = [name]
    for one in layers.values():
        cells += [one.raw.text(), one.decoded.text(), f"{one.codeword_errors} of {one.codewords}"]
    return [*cells, all_layers(keyed).text() if keyed else ""]


def comparison_table(found: Sequence[Comparison]) -> Table:
    """Driving against static, a row a comparison."""
    head = ("layer", "distance", "packets", "driving", "static", "ratio", "95 % interval", "p (Holm)", "verdict")
    rows = [
        (
            c.layer,
            "all" if c.bin_m is None else f"{c.bin_m - BIN_M / 2:g}-{c.bin_m + BIN_M / 2:g} m",
            str(c.pairs),
            f"{c.driving:.1e}",
            f"{c.static:.1e}",
            f"{c.ratio:.2f}",
            f"{c.low:.2f}-{c.high:.2f}",
            f"{c.p:.3f}",
            c.verdict,
        )
        for c in found
    ]
    return Table(f"Driving against static, raw; alike: within a factor {MARGIN:g}", head, rows)


def plain_values(
    static: CountsByDistance, driving: CountsByDistance, keyed: CountsByDistance, found: Sequence[Comparison]
) -> dict[str, Any]:
    """All counts and comparisons as plain values, for JSON."""

    def plain(sums: CountsByDistance) -> list[dict[str, Any]]:
        return [{"distance_m": z, **{n: asdict(c) for n, c in by.items()}} for z, by in sorted(sums.places.items())]

    return {
        "static": plain(static),
        "driving": plain(driving),
        "ook": plain(keyed),
        "comparison": [asdict(c) for c in found],
    }


def pictures(
    static: CountsByDistance, driving: CountsByDistance, keyed: CountsByDistance, found: Sequence[Comparison]
) -> list[tuple[Figure, str]]:
    """Rates by distance, and driving over static; each with its caption."""
    rates = (
        "Bit error rate before and after the turbo code, by layer: static (lines), driving (open squares), on-off "
        "keying before any code (gray). Both are drawn half a metre aside. 95 % intervals; an arrow is a bound (3/n), "
        "no error met in n bits before the code, in n packets after it."
    )
    ratio = (
        "Raw errors driving over static at the same distances, 95 % over packets or drives; "
        f"gray: alike, a factor {MARGIN:g}."
    )
    return [(_rates_picture(static, driving, keyed), rates), (_ratio_picture(found), ratio)]


def _rates_picture(static: CountsByDistance, driving: CountsByDistance, keyed: CountsByDistance) -> Figure:
    """A column for each layer, a row before and one after the code."""
    figure = Figure(figsize=(12, 7.4))
    places = figure.subplots(2, len(LAYERS), sharex=True, sharey="row")
    for row, (kind, title) in zip(places, (("raw", "before"), ("decoded", "after")), strict=True):
        for axes, name in zip(row, LAYERS, strict=True):
            count = partial(_of, name, kind)
            _draw(axes, static, count, LAYER_COLOURS[name], "static", "-", -0.5)
            _draw(axes, driving, count, plots.BLACK, "driving", "none", 0.5)
            if kind == "raw":
                _draw(axes, keyed, all_layers, plots.GRAY, "on-off keying, static", "--")
            axes.set_yscale("log")
            axes.set_title(f"{name}, {title} the turbo code", fontsize=11)
            plots.tidy(axes)
        row[0].set_ylabel("bit error rate")
        # Least bit error rate that is drawn; intervals may reach lower. Chosen
        row[0].set_ylim(max(row[0].get_ylim()[0], 1e-6), 1.5)
    for axes in places[1]:
        axes.set_xlabel("distance (m)")
    entries = [legend_entries(axes) for axes in places.flat]
    # the first place has all systems, and any place may have bounds
    named = {label: handle for handles, labels in entries for label, handle in zip(labels, handles, strict=True)}
    handles, labels = list(named.values()), list(named)
    figure.tight_layout(rect=(0, 0.05, 1, 1))
    if handles:
        figure.legend(handles, labels, ncols=len(labels), frameon=False, loc="lower center")
    return figure


def _draw(
    axes: Axes,
    sums: CountsByDistance,
    count: Callable[[Layers], Count],
    colour: str,
    label: str,
    dashes: str,
    aside_m: float = 0.0,
) -> None:
    counts = [(z + aside_m, count(layers)) for z, layers in sorted(sums.places.items())]
    style: dict[str, Any] = {"color": colour, "ls": dashes, "lw": 1.2, "capsize": 2}
    style |= {"marker": "s", "mfc": "none", "ms": 6} if dashes == "none" else {"marker": "o", "ms": 4, "lw": 1.8}
    plots.draw_rates(axes, counts, label, **style)


def _ratio_picture(found: Sequence[Comparison]) -> Figure:
    figure = Figure(figsize=(9, 3.6))
    axes = figure.subplots()
    axes.axhspan(1 / MARGIN, MARGIN, color=plots.PALE_GRAY, zorder=0)
    axes.axhline(1, color=plots.LIGHT_GRAY, lw=1, zorder=1)
    for k, name in enumerate(LAYERS):
        rows = [(c.bin_m + k - 1, c.ratio, c.low, c.high) for c in found if c.layer == name and c.bin_m is not None]
        if rows:
            z, ratio, low, high = np.array(rows).T
            high = np.minimum(high, 1e3)
            bars = (ratio - np.minimum(low, ratio), np.maximum(high, ratio) - ratio)
            axes.errorbar(z, ratio, bars, color=LAYER_COLOURS[name], marker="o", ms=4, ls="none", capsize=2, label=name)
    axes.set_yscale("log")
    axes.set_ylim(0.2, 5)
    axes.set_yticks((0.2, 0.5, 1, 2, 5), ("0.2", "0.5", "1", "2", "5"))
    axes.minorticks_off()
    axes.set_xlabel("distance (m)")
    axes.set_ylabel("driving / static")
    if axes.get_legend_handles_labels()[0]:
        axes.legend(frameon=False, ncols=3)
    plots.tidy(axes)
    figure.tight_layout()
    return figure


def _of(layer: str, kind: str, layers: Layers) -> Clustered:
    return layers[layer].raw if kind == "raw" else layers[layer].decoded


RARE = 1e-2
"""Bound of the rate of wrong codewords below which a layer without a wrong one counts as free of error."""


def alike(found: Sequence[Comparison], driving: Count, static: Count) -> Finding:
    """Whether error rates and losses while driving are like those at rest."""
    single, pooled = ([c for c in found if (c.bin_m is None) == whole] for whole in (False, True))
    count = {name: sum(c.verdict == name for c in single) for name in ("alike", "apart", "open")}
    apart = "; ".join(f"{c.layer} at {c.bin_m:g} m: {c.ratio:.2f}" for c in single if c.verdict == "apart")
    ratios = ", ".join(f"{c.layer} {c.ratio:.2f} ({c.low:.2f} to {c.high:.2f})" for c in pooled)
    ours = (
        f"Raw errors driving over static, by packets at the same distances: {ratios or 'too few errors'}. "
        f"Of {len(single)} bins by layer {count['alike']} are alike within a factor {MARGIN:g}, "
        f"{count['apart']} apart, {count['open']} open{': ' + apart if apart else ''}. "
        f"Packets lost: {driving.errors} of {driving.trials} driving, {static.errors} of {static.trials} at rest."
    )
    claim = "The driving field trial shows tendencies similar to the static case."
    return Finding(claim, ours, *_judged(single, pooled, _loss(driving, static)))


def _loss(driving: Count, static: Count) -> Literal["alike", "apart", "open"]:
    """Whether more packets are lost driving, by Fisher's exact test; alike: surely not more by the margin."""
    from scipy.stats import fisher_exact

    if not driving.trials or not static.trials:
        return "open"
    table = [[one.errors, one.trials - one.errors] for one in (driving, static)]
    _, chance = fisher_exact(table, alternative="greater")
    if chance < RISK:
        return "apart"
    # bound of the difference: Newcombe 1998
    up, down = driving.interval()[1] - driving.rate, static.rate - static.interval()[0]
    # difference of the fractions of packets lost up to which driving and static count as alike
    return "alike" if driving.rate - static.rate + float(np.hypot(up, down)) < 0.05 else "open"


def _judged(single: Sequence[Comparison], pooled: Sequence[Comparison], loss: str) -> tuple[Verdict, str]:
    """Apart anywhere: it differs. Alike in each layer as a whole and in loss: it holds. Else it is not decided."""
    reasons = []
    if any(c.verdict == "apart" for c in (*single, *pooled)):
        reasons.append(f"They differ significantly (Holm, {RISK:g}) and by more than the margin.")
    if loss == "apart":
        reasons.append(f"Significantly more packets are lost driving (Fisher, one-sided, {RISK:g}).")
    if reasons:
        return "differs", " ".join(reasons)
    if pooled and all(c.verdict == "alike" for c in pooled) and loss == "alike":
        return "holds", ""
    return "shown", "Too few packets to decide."


def error_free(driving: CountsByDistance) -> Iterator[Finding]:
    """Whether the drive from 80 m to 25 m with a code of rate one-third is free of error, for each layer."""
    for name in LAYERS:
        words, missed = Count(), 0
        first: tuple[float, Count] | None = None
        for place, layers in sorted(driving.places.items()):
            here = layers[name]
            words.add(here.codewords, here.codeword_errors)
            missed += here.missed
            if first is None and here.codeword_errors:
                first = place - BIN_M / 2, here.raw
        ours = f"{words.errors} of {words.trials} codewords wrong while driving ({words.text()})"
        ours += "." if first is None else f", none of them nearer than {first[0]:g} m."
        claim = f"With a turbo code of rate one-third 25 m to 80 m are free of error while driving: {name} layer."
        if first is not None:
            yield Finding(claim, ours, "differs", _reasons(words.errors, missed, first[1]))
        elif words.interval()[1] < RARE:
            yield Finding(claim, ours, "holds")
        else:
            yield Finding(claim, ours, "shown", f"Too few codewords to bound the rate of wrong ones below {RARE:g}.")


def _reasons(wrong: int, missed: int, raw: Count) -> str:
    """Why codewords are wrong: their packets were missed; too many raw errors where the first of them are."""
    reasons = [f"{missed} of the {wrong} wrong codewords are of packets not received."] if missed else []
    # raw error rate from which on the code may be the reason of wrong codewords; rate 1/3 corrects about 0.15
    if missed < wrong and raw.rate > 0.13:
        reasons.append(f"The raw error rate is {raw.text()} where the first are wrong, too much for rate 1/3.")
    return " ".join(reasons)


def keying(static: CountsByDistance, keyed: CountsByDistance) -> Finding:
    """Raw error rate of plain on-off keying beside those of the layers."""
    shared = [z for z in sorted(keyed.places) if z in static.places and z >= 50]
    parts, between = [], []
    for z in shared:
        one = all_layers(keyed.places[z])
        rates = {name: static.places[z][name].raw for name in LAYERS}
        if one.errors:
            parts.append(f"{z:g} m: {one.text()} beside {' / '.join(rates[name].text() for name in LAYERS)}")
            between.append(rates["high"].rate < one.rate)
    return Finding(
        "The hierarchical code protects its high layer: fewer errors than plain on-off keying at the same place.",
        f"Raw rates of on-off keying beside high / middle / low: {'; '.join(parts) or 'no errors from 50 m on'}.",
        "shown" if not between else "holds" if all(between) else "differs",
    )


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
