"""Bit error rate by distance, static and driving, before and after the turbo code.

Static films have a single packet, with random pixel phases of the array. Drives go from 80 m to 25 m at 30 km/h. Errors
are counted before the turbo code (raw) and after it; lost packets count as wrong codewords. The code rate is 1/3 in all
layers, with 256 bits a pattern at rest and driving; the paper drove at an eighth of the static rate.

For the comparison, each packet of the drives has a twin at rest at the same distance. Units are packets, not bits,
since errors of a packet depend on the pixel phase, most of all at 58 m, where LEDs lie as close as pixels. Intervals of
ratios are a bootstrap over packets or over drives, whichever is wider. The tests of equality and of lost packets assume
independent packets in a drive. The twin of a lost packet is in the middle of the distance bin. Intervals of bit error
rates account for dependent bits in a packet; with no error after the code, the bound counts packets.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.stats import fisher_exact

from heliograph.base.arrays import Floats
from heliograph.experiments import plots
from heliograph.experiments.links import receive_link, static_link
from heliograph.experiments.report import Context, ExperimentResult, Finding, Table, Verdict, count_text
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import Recordings, load_imu
from heliograph.measure.bench import random_messages
from heliograph.measure.counts import LayerCounts, Layers, pooled
from heliograph.measure.errors import BIN_M, ErrorCounter
from heliograph.measure.statistics import Clustered, Count
from heliograph.receive.api import make_receiver
from heliograph.receive.packet import Packet
from heliograph.signal.packet import PacketFormat
from heliograph.signal.settings import LAYERS
from heliograph.sweeps.plot import LAYER_COLOURS


@dataclass(frozen=True, slots=True)
class PacketRecord:
    """Received packet."""

    # True distance in m in the middle of the packet
    distance_m: float
    layers: Layers


@dataclass(frozen=True, slots=True)
class FilmCounts:
    """Counts of a film, packet by packet."""

    packets: Sequence[PacketRecord]
    # Counts of missed packets, by the lower edge of the distance bin in m
    missed: Mapping[float, Layers]
    # Middle of the distance bin in m of each missed packet
    lost: Sequence[float] = ()
    # Accepted codewords that were not sent
    false_codewords: int = 0


PUBLISHED_M = (25.0, 80.0)  # distances in m between which Nagura et al. 2010 report no error after the code

Modulation = Literal["haar", "ook"]  # the hierarchical code; on-off keying of each LED


@dataclass(frozen=True, slots=True)
class FilmTask:
    """Film at rest, or drive."""

    # Distance at rest in m; None: a drive from 80 m to 25 m at 30 km/h
    distance_m: float | None
    modulation: Modulation
    seed: tuple[int, ...]
    # File of the recorded motion of the drive; None: a road
    imu: Path | None = None


def count_film(task: FilmTask) -> FilmCounts:
    """Simulate, receive and count a film."""
    rng = np.random.default_rng(task.seed)
    signal = {"modulation": task.modulation}
    if task.distance_m is not None:
        return film_packets(static_link(task.distance_m, rng, signal=signal), rng)
    if task.imu is None:
        return film_packets(load_settings("paper", {"signal": signal}), rng)
    trace = load_imu(task.imu)
    shake = {"shake": "imu", "imu_start_s": float(rng.uniform(0, trace.t_s[-1]))}
    return film_packets(load_settings("paper", {"signal": signal, "channel": shake}), rng, Recordings(imu=trace))


def film_packets(settings: LinkSettings, rng: np.random.Generator, recordings: Recordings | None = None) -> FilmCounts:
    """Count the packets of a film separately, as errors within a packet are dependent."""
    seed = int(rng.integers(2**31))
    messages = random_messages(settings, seed)
    counter, receiver = ErrorCounter(settings, messages), make_receiver(settings.signal, settings.receive)
    times: list[float] = []
    distances: list[float] = []
    records: list[PacketRecord] = []
    for truth, packets in receive_link(settings, messages, seed, receiver, recordings):
        array = truth.arrays[0]
        counter.saw(truth.time_s, [array.distance_m], [array.visible])
        times.append(truth.time_s)
        distances.append(array.distance_m)
        for packet in packets:
            if packet.status not in ("no_header", "no_array"):
                middle = packet.start_time_s + settings.signal.packet_s / 2
                record = _counted(counter, packet, float(np.interp(middle, times, distances)))
                records += [record] if record else []
    words = PacketFormat(settings.signal).layers["high"].codewords
    missed = {
        start: {name: LayerCounts.of_missed(counts.missed, number) for name, counts in layers.items()}
        for start, layers in counter.bins().items()
        if (number := layers["high"].missed // words)
    }
    lost = [start + BIN_M / 2 for start, layers in missed.items() for _ in range(layers["high"].sent_packets)]
    return FilmCounts(records, missed, lost, counter.false_codewords)


def _counted(counter: ErrorCounter, packet: Packet, distance_m: float) -> PacketRecord | None:
    """Counts of a packet; None if the packet was cut by the end of the film, or received before."""
    before = counter.total()
    counter.received(packet)
    after = counter.total()
    # a packet counts as missed before the reception
    changes = {name: after[name] - before[name] for name in LAYERS}
    counts = {name: change + LayerCounts.of_missed(-change.missed) for name, change in changes.items()}
    complete = all(layer.codewords > 0 and min(asdict(layer).values()) >= 0 for layer in counts.values())
    return PacketRecord(distance_m, counts) if complete and any(c.raw_bits for c in counts.values()) else None


CountsByDistance = dict[float, Layers]  # counts of several packets by layer, by distance in m


def add_counts(counts: CountsByDistance, distance_m: float, layers: Layers) -> None:
    """Add counts at a distance."""
    counts[distance_m] = pooled([counts.get(distance_m, {}), layers])


def bin_of(distance_m: float) -> float:
    """Middle in m of the distance bin."""
    return float(distance_m // BIN_M * BIN_M + BIN_M / 2)


def lost_packets(films: Sequence[FilmCounts]) -> Count:
    """Filmed and missed packets."""
    lost = sum(len(film.lost) for film in films)
    return Count(sum(len(film.packets) for film in films) + lost, lost)


def all_layers(layers: Layers) -> Clustered:
    """Raw errors of all layers, clustered by packet."""
    parts = [counts.raw for counts in layers.values()]
    # upper bound of the squares of sums over layers, by Minkowski
    squares = round(sum(np.sqrt(part.squares) for part in parts) ** 2)
    trials, errors = sum(part.trials for part in parts), sum(part.errors for part in parts)
    return Clustered(trials, errors, max(part.clusters for part in parts), squares, scattered=True)


MARGIN = 1.5  # factor between driving and static up to which they are alike; about the change of an error rate over 3 m
RISK = 0.05  # significance level of the tests

ComparisonVerdict = Literal["alike", "apart", "open"]
"""Interval within the margin; significantly different beyond the margin; neither."""


@dataclass(frozen=True, slots=True)
class Comparison:
    """Raw error rates driving and static in a distance bin."""

    layer: str
    # Middle of the bin; None: all bins together
    bin_m: float | None
    # Packets of the drives, each with a packet at rest at the same distance
    pairs: int
    # Mean raw error rates of the packets
    driving: float
    static: float
    # Driving over static with 95 % interval over packets or drives, whichever is wider
    ratio: float
    low: float
    high: float
    # p value of the test of equality, adjusted by Holm
    p: float
    verdict: ComparisonVerdict = "open"


def compare(
    driving: Sequence[PacketRecord],
    static: Sequence[PacketRecord],
    rng: np.random.Generator,
    drives: Sequence[int] = (),
) -> list[Comparison]:
    """Compare the raw error rates of packets of drives with packets at rest at the same distances.

    The test of equality flips the signs of the differences of pairs, with the correction of Holm over all layers and
    bins, and separately over the layers with all bins together. The interval of the ratio is the wider
    interval of a bootstrap over pairs (dependent errors in a packet) and over drives (dependent packets in a drive).
    """
    bins = np.array([bin_of(record.distance_m) for record in driving])
    films = np.array(drives or [0] * len(driving))
    found: list[Comparison] = []
    for layer in LAYERS:
        bits, errors = (
            np.array([[getattr(r.layers[layer], name) for r in side] for side in (driving, static)])
            for name in ("raw_bits", "raw_errors")
        )
        rates = errors / np.maximum(bits, 1)
        for bin_m in (*map(float, np.unique(bins)), None):
            here = bits.min(0) > 0
            if bin_m is not None:
                here &= bins == bin_m
            # fewer packets or errors allow no comparison
            if here.sum() >= 3 and errors[:, here].sum() >= 30:
                found.append(_compare_pairs(layer, bin_m, rates[:, here], films[here], rng))
    for is_overall in (False, True):
        family = [k for k, one in enumerate(found) if (one.bin_m is None) == is_overall]
        for k, p in zip(family, holm([found[k].p for k in family]), strict=True):
            found[k] = replace(found[k], p=p, verdict=_verdict(found[k], p))
    return found


def _compare_pairs(
    layer: str, bin_m: float | None, rates: Floats, drives: NDArray[np.int_], rng: np.random.Generator
) -> Comparison:
    """Compare (2, pairs) rates, driving and static; `drives` has the drive of each pair."""
    a, b = rates
    tiny, resamples = 1e-9, 4000
    names, film = np.unique(drives, return_inverse=True)
    spans = []
    for one, other in ((a, b), (np.bincount(film, a), np.bincount(film, b))):
        draws = rng.integers(0, len(one), (resamples, len(one)))
        ratios = (one[draws].sum(1) + tiny) / (other[draws].sum(1) + tiny)
        spans.append(np.quantile(ratios, (RISK / 2, 1 - RISK / 2)))
    # a single drive does not show the variation between drives
    low, high = (min(spans[0][0], spans[1][0]), max(spans[0][1], spans[1][1])) if len(names) > 1 else spans[0]
    signs = rng.choice((-1.0, 1.0), (resamples, len(a)))
    difference = a - b
    more = np.abs(signs @ difference) >= abs(difference.sum()) * (1 - 1e-12)
    # the data themselves count as a resample
    p = (1 + np.count_nonzero(more)) / (1 + resamples)
    values = (a.mean(), b.mean(), (a.sum() + tiny) / (b.sum() + tiny), low, high, p)
    driving, at_rest, ratio, lower, upper, chance = map(float, values)
    return Comparison(layer, bin_m, len(a), driving, at_rest, ratio, lower, upper, chance)


def holm(p: Sequence[float]) -> list[float]:
    """Adjusted p values of Holm 1979: m - k times the k-th smallest of m, nondecreasing, at most 1."""
    order = np.argsort(p)
    out = np.empty(len(p))
    out[order] = np.minimum(np.maximum.accumulate(np.arange(len(p), 0, -1) * np.array(p)[order]), 1)
    return [float(value) for value in out]


def _verdict(one: Comparison, p: float) -> ComparisonVerdict:
    if one.low >= 1 / MARGIN and one.high <= MARGIN:
        return "alike"
    apart = p < RISK and not one.low <= 1 <= one.high and not 1 / MARGIN <= one.ratio <= MARGIN
    return "apart" if apart else "open"


@dataclass(frozen=True, slots=True)
class ErrorRateEffort:
    """Number of films."""

    # Distances at rest in m
    places_m: Sequence[float]
    # Films at each distance
    films: int
    # Drives from 80 m to 25 m
    drives: int


Rates = Mapping[str, CountsByDistance]  # counts of films "static", "driving" and "ook", on-off keying at rest


def run(context: Context, effort: ErrorRateEffort | None = None) -> ExperimentResult:
    """Count static films, drives and on-off keying, and compare driving with static."""
    quick = ErrorRateEffort((25.0, 35.0, 45.0, 50.0, 55.0, 60.0, 70.0, 80.0), films=3, drives=1)
    full = ErrorRateEffort(tuple(float(z) for z in range(25, 85, 5)), films=16, drives=16)
    effort = effort or (quick if context.quick else full)
    rates, comparisons, lost, false_codewords = measure(context, effort)
    road = "a road of class B"
    shake = f"{road} and a recorded trace in turn" if context.imu and effort.drives > 1 else road
    films = f"{effort.films} static films a distance; {effort.drives} drives"
    return ExperimentResult(
        text=f"{films}, shaken by {shake}, in bins of {BIN_M:g} m.",
        findings=[
            alike(comparisons, lost["driving"], lost["static"]),
            *error_free(rates["driving"]),
            keying(rates["static"], rates["ook"]),
        ],
        pictures=[
            (
                _rates_plot(rates),
                "Bit error rate before and after the turbo code, by layer: static (lines), driving (open squares), "
                "on-off keying before any code (gray), with an offset of half a metre. 95 % intervals; an arrow is an "
                "upper bound (3/n) for no error in n bits before the code, in n packets after it. The titles count "
                "codewords. Red: Nagura et al. 2010 report no error after the code from 25 m to 80 m; their text has "
                "no other values of Fig. 13.",
            ),
            (
                _ratio_plot(comparisons),
                "Raw errors driving over static at the same distances, 95 % over packets or drives; "
                f"gray: alike, a factor {MARGIN:g}.",
            ),
        ],
        tables=[_rates_table(rates), _comparison_table(comparisons)],
        data={
            **{
                name: [{"distance_m": z, **{n: asdict(c) for n, c in by.items()}} for z, by in sorted(counts.items())]
                for name, counts in rates.items()
            },
            "comparison": [asdict(comparison) for comparison in comparisons],
            "lost": {name: asdict(count) for name, count in lost.items()},
            "false_codewords": false_codewords,
        },
    )


def measure(context: Context, effort: ErrorRateEffort) -> tuple[Rates, Sequence[Comparison], Mapping[str, Count], int]:
    """Count all films, and compare each packet of the drives with a packet at rest at the same distance.

    Returns counts, comparisons, filmed and missed packets driving and at rest, and false codewords.
    """
    seed = context.seed
    # every second drive has the recorded motion
    drives = [FilmTask(None, "haar", (seed, 1, k), context.imu if k % 2 else None) for k in range(effort.drives)]
    driven = context.each("drives", count_film, drives, (0.0, 0.4))
    driving: CountsByDistance = {}
    for film in driven:
        for record in film.packets:
            add_counts(driving, bin_of(record.distance_m), record.layers)
        for start, layers in film.missed.items():
            add_counts(driving, start + BIN_M / 2, layers)
    static = _count_static(context, effort, "haar", "static", (0.4, 0.55))
    keyed = _count_static(context, effort, "ook", "on-off keying", (0.55, 0.7))
    packets = [(record, k) for k, film in enumerate(driven) for record in film.packets]
    wanted = [record.distance_m for record, _ in packets] + [z for film in driven for z in film.lost]
    tasks = [FilmTask(z, "haar", (seed, 2, k)) for k, z in enumerate(wanted)]
    twins = context.each("the same at rest", count_film, tasks, (0.7, 1.0))
    # the last twins, of lost packets, only enter the loss at rest
    pairs = [(record, twin.packets[0], k) for (record, k), twin in zip(packets, twins, strict=False) if twin.packets]
    moving, at_rest, numbers = zip(*pairs, strict=True) if pairs else ((), (), ())
    comparisons = compare(moving, at_rest, np.random.default_rng([seed, 9]), drives=numbers)
    lost = {"driving": lost_packets(driven), "static": lost_packets(twins)}
    false = sum(film.false_codewords for film in (*driven, *twins))
    return {"static": static, "driving": driving, "ook": keyed}, comparisons, lost, false


def _count_static(
    context: Context, effort: ErrorRateEffort, modulation: Modulation, title: str, span: tuple[float, float]
) -> CountsByDistance:
    places = [(z, k) for z in effort.places_m for k in range(effort.films)]
    tasks = [FilmTask(z, modulation, (context.seed, 3, len(modulation), k, round(z))) for z, k in places]
    counts: CountsByDistance = {}
    for (z, _), film in zip(places, context.each(title, count_film, tasks, span), strict=True):
        for layers in (*(record.layers for record in film.packets), *film.missed.values()):
            add_counts(counts, z, layers)
    return counts


def alike(comparisons: Sequence[Comparison], driving: Count, static: Count) -> Finding:
    """Compare error rates and losses while driving and at rest."""
    single, overall = ([c for c in comparisons if (c.bin_m is None) == every] for every in (False, True))
    count = {name: sum(c.verdict == name for c in single) for name in ("alike", "apart", "open")}
    apart = "; ".join(f"{c.layer} at {c.bin_m:g} m: {c.ratio:.2f}" for c in single if c.verdict == "apart")
    ratios = ", ".join(f"{c.layer} {c.ratio:.2f} ({c.low:.2f} to {c.high:.2f})" for c in overall)
    ours = (
        f"Raw errors driving over static, by packets at the same distances: {ratios or 'too few errors'}. "
        f"Of {len(single)} bins by layer {count['alike']} are alike within a factor {MARGIN:g}, "
        f"{count['apart']} apart, {count['open']} open{': ' + apart if apart else ''}. "
        f"Packets lost: {count_text(driving)} driving, {count_text(static)} at rest."
    )
    loss, reasons = _compare_loss(driving, static), []
    if any(c.verdict == "apart" for c in comparisons):
        reasons.append(f"They differ significantly (Holm, {RISK:g}) and by more than the margin.")
    if loss == "apart":
        reasons.append(f"Significantly more packets are lost driving (Fisher, one-sided, {RISK:g}).")
    verdict: Verdict = "differs"
    if not reasons:
        holds = overall and all(c.verdict == "alike" for c in overall) and loss == "alike"
        verdict, reasons = ("holds", []) if holds else ("shown", ["Too few packets to decide."])
    claim = "The driving field trial shows tendencies similar to the static case."
    return Finding(claim, ours, verdict, " ".join(reasons))


def _compare_loss(driving: Count, static: Count) -> ComparisonVerdict:
    """Compare the losses by Fisher's exact test, and bound the difference of the fractions by 0.05."""
    if not driving.trials or not static.trials:
        return "open"
    table = [[one.errors, one.trials - one.errors] for one in (driving, static)]
    if fisher_exact(table, alternative="greater")[1] < RISK:
        return "apart"
    # bound of the difference: Newcombe 1998
    up, down = driving.interval()[1] - driving.rate, static.rate - static.interval()[0]
    return "alike" if driving.rate - static.rate + float(np.hypot(up, down)) < 0.05 else "open"


def error_free(driving: CountsByDistance) -> Iterator[Finding]:
    """Check that the drive from 80 m to 25 m with a code of rate one-third is free of error, for each layer."""
    for name in LAYERS:
        counts = [(z - BIN_M / 2, layers[name]) for z, layers in sorted(driving.items())]
        words = pooled(driving.values())[name].words
        ours = f"{words.errors} of {words.trials} codewords wrong while driving ({words.text()})"
        claim = f"With a turbo code of rate one-third 25 m to 80 m are free of error while driving: {name} layer."
        first = next(((start, c.raw) for start, c in counts if c.codeword_errors), None)
        if first is not None:
            why = _reasons(words.errors, sum(c.missed for _, c in counts), first[1])
            yield Finding(claim, f"{ours}, all from {first[0]:g} m on.", "differs", why)
        # upper bound of the rate of wrong codewords
        elif words.interval()[1] < 0.01:
            yield Finding(claim, f"{ours}.", "holds")
        else:
            yield Finding(claim, f"{ours}.", "shown", "Too few codewords to bound the rate of wrong ones below 0.01.")


def _reasons(wrong: int, missed: int, raw: Count) -> str:
    """Reasons of wrong codewords: missed packets, and raw errors in the first bin with wrong codewords."""
    reasons = [f"{missed} of the {wrong} wrong codewords are of packets not received."] if missed else []
    # rate 1/3 corrects a raw error rate of about 0.15
    if missed < wrong and raw.rate > 0.13:
        reasons.append(f"The raw error rate is {raw.text()} where the first are wrong, too much for rate 1/3.")
    return " ".join(reasons)


def keying(static: CountsByDistance, keyed: CountsByDistance) -> Finding:
    """Compare the raw error rates of on-off keying and of the layers."""
    parts, fewer = [], []
    for z, layers in sorted(keyed.items()):
        ook = all_layers(layers)
        if z in static and z >= 50 and ook.errors:
            rates = [static[z][name].raw for name in LAYERS]
            parts.append(f"{z:g} m: {ook.text()}, high / middle / low {' / '.join(rate.text() for rate in rates)}")
            fewer.append(rates[0].rate < ook.rate)
    return Finding(
        "The hierarchical code protects its high layer: fewer errors than plain on-off keying at the same place.",
        f"Raw rates of on-off keying, and of the layers: {'; '.join(parts) or 'no errors from 50 m on'}.",
        "shown" if not fewer else "holds" if all(fewer) else "differs",
    )


def _rates_plot(rates: Rates) -> Figure:
    """Plot with a column for each layer, and a row before and after the code."""
    figure = Figure(figsize=(10, 7.4))
    panels = figure.subplots(2, len(LAYERS), sharex=True, sharey="row")
    for row, (kind, title) in zip(panels, (("raw", "before"), ("decoded", "after")), strict=True):
        for axes, name in zip(row, LAYERS, strict=True):
            static, driving = (
                [(z + offset, getattr(layers[name], kind)) for z, layers in sorted(counts.items())]
                for counts, offset in ((rates["static"], -0.5), (rates["driving"], 0.5))
            )
            plots.draw_rates(axes, static, f"static, {name}", color=LAYER_COLOURS[name], lw=1.8)
            squares = {"marker": "s", "mfc": "none", "ms": 6, "ls": "none"}
            plots.draw_rates(axes, driving, "driving", color="black", lw=1.2, **squares)
            if kind == "raw":
                keyed = [(z, all_layers(layers)) for z, layers in sorted(rates["ook"].items())]
                plots.draw_rates(axes, keyed, "on-off keying, static", color=plots.GRAY, ls="--", lw=1.8)
            axes.set(yscale="log", title=f"{name}, {title} the turbo code")
            if kind == "decoded":
                fixed, moving = (pooled(rates[k].values())[name].words for k in ("static", "driving"))
                wrong = f"{fixed.errors}/{fixed.trials} static, {moving.errors}/{moving.trials} driving"
                axes.set_title(f"{axes.get_title()}\nwrong: {wrong}")
                published = {"color": plots.RED, "marker": "s", "lw": 3, "label": "Nagura et al. 2010: no error"}
                # the lower edge stands for zero
                axes.plot(PUBLISHED_M, (0, 0), transform=axes.get_xaxis_transform(), clip_on=False, **published)
        # intervals may reach below the smallest drawn rate
        row[0].set(ylabel="bit error rate", ylim=(np.clip(row[0].get_ylim()[0], 1e-6, 1e-2), 1.5))
    for axes in panels[1]:
        axes.set_xlabel("distance (m)")
    plots.legend_below(figure, columns=4)
    return figure


def _ratio_plot(comparisons: Sequence[Comparison]) -> Figure:
    figure = Figure(figsize=(9, 3.6))
    axes = figure.add_subplot(xlabel="distance (m)", ylabel="driving / static", yscale="log", ylim=(0.2, 5))
    axes.axhspan(1 / MARGIN, MARGIN, color=plots.GRAY, alpha=0.12, lw=0, zorder=0)
    axes.axhline(1, color="lightgray", lw=1, zorder=1)
    for k, name in enumerate(LAYERS):
        rows = [
            (c.bin_m + k - 1, c.ratio, c.low, c.high) for c in comparisons if c.layer == name and c.bin_m is not None
        ]
        if rows:
            z, ratio, low, high = np.array(rows).T
            bars = (ratio - np.minimum(low, ratio), np.maximum(np.minimum(high, 1e3), ratio) - ratio)
            axes.errorbar(z, ratio, bars, color=LAYER_COLOURS[name], marker="o", ls="none", label=name)
    axes.set_yticks((0.2, 0.5, 1, 2, 5), ("0.2", "0.5", "1", "2", "5"))
    axes.minorticks_off()
    if axes.get_legend_handles_labels()[0]:
        axes.legend(ncols=3)
    return figure


def _rates_table(rates: Rates) -> Table:
    """Error rates at rest, driving and of on-off keying, with a row per distance."""
    head = ["distance", *(f"{n}: {part}" for n in LAYERS for part in ("raw", "decoded", "codewords wrong"))]
    places = [(f"static {z:g} m", layers, rates["ook"].get(z)) for z, layers in sorted(rates["static"].items())]
    places += [(f"driving {_bin_text(z)}", layers, None) for z, layers in sorted(rates["driving"].items())]
    rows = []
    for name, layers, keyed in places:
        cells = [
            text
            for c in layers.values()
            for text in (c.raw.text(), c.decoded.text(), f"{c.codeword_errors} of {c.codewords}")
        ]
        rows.append([name, *cells, all_layers(keyed).text() if keyed else ""])
    title = "Bit error rates; no error among n raw bits, or after the code n packets, is written < 3/n"
    return Table(title, [*head, "on-off keying: raw"], rows)


def _bin_text(middle_m: float) -> str:
    return f"{middle_m - BIN_M / 2:g}-{middle_m + BIN_M / 2:g} m"


def _comparison_table(comparisons: Sequence[Comparison]) -> Table:
    """Driving and static, with a row per comparison."""
    columns: dict[str, Callable[[Comparison], str]] = {
        "layer": lambda c: c.layer,
        "distance": lambda c: "all" if c.bin_m is None else _bin_text(c.bin_m),
        "packets": lambda c: str(c.pairs),
        "driving": lambda c: f"{c.driving:.1e}",
        "static": lambda c: f"{c.static:.1e}",
        "ratio": lambda c: f"{c.ratio:.2f}",
        "95 % interval": lambda c: f"{c.low:.2f}-{c.high:.2f}",
        "p (Holm)": lambda c: f"{c.p:.3f}",
        "verdict": lambda c: c.verdict,
    }
    return Table.of(f"Driving against static, raw; alike: within a factor {MARGIN:g}", comparisons, columns)
