"""Bit error rate by distance, static and driving, before and after the turbo code: Fig. 13."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from heliograph.experiments.chapter import Chapter, Context, Finding, Table, Verdict
from heliograph.experiments.plots import COLOURS
from heliograph.experiments.systems import static_link
from heliograph.link.bench import LayerCounts, random_messages, window_margin_px
from heliograph.link.errors import BIN_M, ErrorCounter
from heliograph.link.recordings import load_imu
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import Recordings, simulate
from heliograph.link.statistics import Count
from heliograph.receive import Packet, make_receiver
from heliograph.signal.packet import PacketFormat
from heliograph.signal.settings import LAYERS

Floats = NDArray[np.float64]

QUICK_M, FULL_M = (25, 35, 45, 50, 55, 60, 70, 80), tuple(range(25, 85, 5))
"""Static distances."""

QUICK_DRIVES, FULL_DRIVES = 1, 16
QUICK_FILMS, FULL_FILMS = 3, 16
"""Drives, and static films of one packet a distance."""

MARGIN = 1.5
"""Factor between driving and static within which they are taken for alike; a layer's error rate changes by so much
within about 3 m."""

RISK = 0.05

FEWEST = 30
"""Raw errors of both together below which a bin is not compared."""

RESAMPLES = 4000

LOST_MARGIN = 0.05
"""Difference of the shares of packets lost up to which driving and static are taken for alike."""

RARE = 1e-2
"""Bound of the rate of wrong codewords below which none wrong is taken for free of error."""

TOO_MUCH = 0.13
"""Raw error rate from which on the code may be the reason of wrong codewords; rate 1/3 stands about 0.15."""


@dataclass(frozen=True, slots=True)
class Record:
    """A packet received: the true distance at its middle, and its counts by layer."""

    distance_m: float
    layers: Mapping[str, LayerCounts]


@dataclass(frozen=True, slots=True)
class Filmed:
    """What came of a film.

    Attributes
    ----------
    packets
        Those received.
    missed
        Codewords of the others by distance bin and layer.
    lost
        The packets filmed whole of which nothing was received, each by the middle of its distance bin.
    false_codewords
        Codewords taken for right that were not sent.
    """

    packets: Sequence[Record]
    missed: Mapping[float, Mapping[str, int]]
    lost: Sequence[float] = ()
    false_codewords: int = 0


@dataclass(frozen=True, slots=True)
class Task:
    """A film to be received: at rest at a distance, or a drive.

    Attributes
    ----------
    distance_m
        Distance at rest; None: a drive from 80 m to 25 m at 30 km/h.
    modulation
        See `SignalSettings`.
    seed
        Of messages, place, motion and noise.
    imu
        Recorded motion of the drive; None: a road.
    """

    distance_m: float | None
    modulation: Literal["haar", "ook"]
    seed: tuple[int, ...]
    imu: Path | None = None


def measure(task: Task) -> Filmed:
    """Film, receive, count."""
    rng = np.random.default_rng(task.seed)
    signal = {"modulation": task.modulation}
    if task.distance_m is not None:
        return film_packets(static_link(task.distance_m, rng, signal=signal), rng)
    if task.imu is None:
        return film_packets(load_settings("paper", {"signal": signal}), rng)
    trace = load_imu(task.imu)
    shake = {"shake": "imu", "imu_start_s": float(rng.uniform(0, trace.t_s[-1]))}
    return film_packets(load_settings("paper", {"signal": signal, "channel": shake}), rng, Recordings(imu=trace))


def film_packets(settings: LinkSettings, rng: np.random.Generator, recordings: Recordings | None = None) -> Filmed:
    """Counts of each packet of a film by itself: errors within a packet are not independent."""
    seed = int(rng.integers(2**31))
    messages = random_messages(settings, seed)
    counter, receiver = ErrorCounter(settings, messages), make_receiver(settings.signal, settings.receive)
    times: list[float] = []
    distances: list[float] = []
    records: list[Record] = []
    for frame, truth in simulate(settings, messages, seed, recordings, window_margin_px(settings)):
        array = truth.arrays[0]
        counter.saw(truth.time_s, [array.distance_m], [array.visible])
        times.append(truth.time_s)
        distances.append(array.distance_m)
        for packet in receiver.push(frame):
            if packet.status not in ("no_header", "no_array"):
                middle = packet.start_time_s + settings.signal.packet_s / 2
                record = _counted(counter, packet, float(np.interp(middle, times, distances)))
                records += [record] if record else []
    missed = {start: {n: e.missed for n, e in layers.items() if e.missed} for start, layers in counter.bins().items()}
    missed = {start: layers for start, layers in missed.items() if layers}
    words = PacketFormat(settings.signal).layers["high"].codewords
    lost = [start + BIN_M / 2 for start, layers in missed.items() for _ in range(layers["high"] // words)]
    return Filmed(records, missed, lost, counter.false_codewords)


def _counted(counter: ErrorCounter, packet: Packet, distance_m: float) -> Record | None:
    """What a packet adds to the counts; None if it is none of its own: cut by the film's end, or received before."""
    before = {name: LayerCounts.of(errors) for name, errors in counter.total().items()}
    counter.received(packet)
    after = {name: LayerCounts.of(errors) for name, errors in counter.total().items()}
    counts = {name: _more(after[name], before[name]) for name in LAYERS}
    own = all(one.codewords > 0 and min(asdict(one).values()) >= 0 for one in counts.values())
    return Record(distance_m, counts) if own and any(one.raw_bits for one in counts.values()) else None


def _more(after: LayerCounts, before: LayerCounts) -> LayerCounts:
    """What was counted since, without the packets that are missed so far."""
    return LayerCounts(
        after.bits - before.bits,
        after.bit_errors - before.bit_errors,
        after.raw_bits - before.raw_bits,
        after.raw_errors - before.raw_errors,
        (after.codewords - after.missed) - (before.codewords - before.missed),
        (after.codeword_errors - after.missed) - (before.codeword_errors - before.missed),
    )


@dataclass(slots=True)
class Sums:
    """Counts of several packets, by distance and layer."""

    places: dict[float, dict[str, LayerCounts]] = field(default_factory=dict)

    def add(self, place: float, record: Record) -> None:
        """Count a packet."""
        here = self.places.setdefault(place, {name: LayerCounts() for name in LAYERS})
        for name, counts in record.layers.items():
            here[name].add(counts)

    def miss(self, place: float, layer: str, codewords: int) -> None:
        """Count codewords that were not received."""
        here = self.places.setdefault(place, {name: LayerCounts() for name in LAYERS})
        here[layer].add(LayerCounts(codewords=codewords, codeword_errors=codewords, missed=codewords))


def bin_of(distance_m: float) -> float:
    """Middle of the distance bin."""
    return float(distance_m // BIN_M * BIN_M + BIN_M / 2)


@dataclass(frozen=True, slots=True)
class Comparison:
    """Driving against static in a bin.

    Attributes
    ----------
    layer, bin_m
        Where; the bin by its middle, None: all bins together.
    pairs
        Packets of the drives, each with one at rest at the same distance.
    driving, static
        Raw error rates.
    ratio, low, high
        Driving over static, with a 95 % interval over packets or drives, whichever is wider.
    p
        Of equality, adjusted by Holm.
    verdict
        "alike": the interval lies within the margin; "apart": they differ, and by more than it; "open": neither.
    """

    layer: str
    bin_m: float | None
    pairs: int
    driving: float
    static: float
    ratio: float
    low: float
    high: float
    p: float
    verdict: Literal["alike", "apart", "open"]


_Paired = tuple[str, float | None, tuple[float, ...]]
"""Layer, bin, and what `_paired` gives."""


def compare(
    driving: Sequence[Record],
    static: Sequence[Record],
    rng: np.random.Generator,
    margin: float = MARGIN,
    drives: Sequence[int] = (),
) -> list[Comparison]:
    """Whether packets of a drive have the raw error rates of packets at rest at the same distances.

    Equality is tested by turning the signs of the pairs' differences, with Holm's correction over all layers and bins,
    and over the layers where all bins are taken together. The interval of the ratio is a bootstrap over pairs, so that
    errors of a packet may depend on each other, or one over drives, so that packets of a drive may, if it is wider.

    Parameters
    ----------
    driving, static
        Packets in pairs of equal distance.
    rng
        Of the resampling.
    margin
        Factor up to which they are taken for alike.
    drives
        Which drive each packet is of; none given: all of one, and the bootstrap is over pairs only.

    Returns
    -------
    By layer and bin where there are errors enough to compare, and by layer with all bins together.
    """
    bins = np.array([bin_of(record.distance_m) for record in driving])
    films = np.array(drives or [0] * len(driving))
    found: list[_Paired] = []
    for layer in LAYERS:
        for place in (*np.unique(bins), None):
            here = np.flatnonzero(_read(driving, static, layer) & ((bins == place) | (place is None)))
            one, other = (_rates([side[int(i)] for i in here], layer) for side in (driving, static))
            if len(here) >= 3 and one[1] + other[1] >= FEWEST:
                found.append(
                    (layer, None if place is None else float(place), _paired(one[0], other[0], films[here], rng))
                )
    return [_comparison(*one, p, margin) for one, p in zip(found, _adjusted(found), strict=True)]


def _adjusted(found: Sequence[_Paired]) -> list[float]:
    """Their p values by Holm, single bins and whole layers each by themselves."""
    adjusted: dict[int, float] = {}
    for single in (True, False):
        family = [k for k, (_, place, _) in enumerate(found) if (place is not None) == single]
        adjusted |= zip(family, holm([found[k][2][-1] for k in family]), strict=True)
    return [adjusted[k] for k in range(len(found))]


def _read(driving: Sequence[Record], static: Sequence[Record], layer: str) -> NDArray[np.bool_]:
    """In which pairs bits of the layer were read, of both."""
    both = zip(driving, static, strict=True)
    return np.array([min(a.layers[layer].raw_bits, b.layers[layer].raw_bits) > 0 for a, b in both], dtype=bool)


def _rates(records: Sequence[Record], layer: str) -> tuple[Floats, int]:
    """Raw error rate of each packet, and their errors in all."""
    counts = [record.layers[layer] for record in records]
    rates = np.array([c.raw_errors / max(c.raw_bits, 1) for c in counts])
    return rates, sum(c.raw_errors for c in counts)


def _paired(a: Floats, b: Floats, drives: NDArray[np.int_], rng: np.random.Generator) -> tuple[float, ...]:
    """(pairs, mean a, mean b, ratio, low, high, p) of paired rates, and of which drive each pair is."""
    tiny = 1e-9
    names, film = np.unique(drives, return_inverse=True)
    spans = []
    for one, other in ((a, b), (np.bincount(film, a), np.bincount(film, b))):
        draws = rng.integers(0, len(one), (RESAMPLES, len(one)))
        ratios = (one[draws].sum(1) + tiny) / (other[draws].sum(1) + tiny)
        spans.append(np.quantile(ratios, (RISK / 2, 1 - RISK / 2)))
    # a single drive says nothing of how drives differ
    low, high = (min(spans[0][0], spans[1][0]), max(spans[0][1], spans[1][1])) if len(names) > 1 else spans[0]
    signs = rng.choice((-1.0, 1.0), (RESAMPLES, len(a)))
    difference = a - b
    more = np.abs(signs @ difference) >= abs(difference.sum()) * (1 - 1e-12)
    # the data themselves are one of the turnings
    p = (1 + np.count_nonzero(more)) / (1 + RESAMPLES)
    return float(len(a)), a.mean(), b.mean(), (a.sum() + tiny) / (b.sum() + tiny), float(low), float(high), float(p)


def holm(p: Sequence[float]) -> list[float]:
    """Adjusted p values of Holm 1979: the k-th smallest of m times m - k, never falling, at most 1."""
    order, out, worst = np.argsort(p), [0.0] * len(p), 0.0
    for k, i in enumerate(order):
        worst = max(worst, min(1.0, (len(p) - k) * p[int(i)]))
        out[int(i)] = worst
    return out


def _comparison(layer: str, place: float | None, v: Sequence[float], p: float, margin: float) -> Comparison:
    pairs, driving, static, ratio, low, high, _ = (float(x) for x in v)
    verdict: Literal["alike", "apart", "open"] = "open"
    if 1 / margin <= low and high <= margin:
        verdict = "alike"
    elif p < RISK and not low <= 1 <= high and not 1 / margin <= ratio <= margin:
        verdict = "apart"
    return Comparison(layer, place, int(pairs), driving, static, ratio, low, high, p, verdict)


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
    lost = {"driving": _lost(driven), "static": _lost(twins)}
    moving = _binned(driven)
    return Chapter(
        key="fig13",
        title="Bit error rate by distance, static and driving (Fig. 13)",
        text=_text(films, drives, context),
        findings=[_alike(found, lost["driving"], lost["static"]), *_error_free(moving), _keyed(still, keyed)],
        pictures=_pictures(still, moving, keyed, found),
        tables=[_rates_table(still, moving, keyed), _comparison_table(found)],
        data={
            **_data(still, moving, keyed, found),
            "lost": {name: asdict(count) for name, count in lost.items()},
            "false_codewords": false,
        },
    )


def _lost(films: Sequence[Filmed]) -> Count:
    """Packets filmed whole, and those of them of which nothing was received."""
    return Count(sum(len(one.packets) + len(one.lost) for one in films), sum(len(one.lost) for one in films))


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
        "packets lost. A lost packet of a drive has its twin in the middle of its distance bin. Intervals of single "
        "bit error rates take bits as independent and are too narrow; those of codewords are the ones to compare by."
    )


def _alike(found: Sequence[Comparison], driving: Count, static: Count) -> Finding:
    """Driving shows tendencies similar to the static ones."""
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
    if fisher_exact(table, alternative="greater").pvalue < RISK:
        return "apart"
    # bound of the difference: Newcombe 1998
    up, down = driving.interval()[1] - driving.rate, static.rate - static.interval()[0]
    return "alike" if driving.rate - static.rate + float(np.hypot(up, down)) < LOST_MARGIN else "open"


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


def _error_free(moving: Sums) -> Iterator[Finding]:
    """Error-free communication from 25 m to 80 m with a code of rate one-third, for each layer."""
    for name in LAYERS:
        words, missed = Count(), 0
        first: tuple[float, Count] | None = None
        for place, layers in sorted(moving.places.items()):
            here = layers[name]
            words.add(here.codewords, here.codeword_errors)
            missed += here.missed
            if first is None and here.codeword_errors:
                first = place - BIN_M / 2, _count(here, "raw")
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
    if missed < wrong and raw.rate > TOO_MUCH:
        reasons.append(f"The raw error rate is {raw.text()} where the first are wrong, too much for rate 1/3.")
    return " ".join(reasons)


def _keyed(still: Sums, keyed: Sums) -> Finding:
    """Where plain keying, all its bits alike, lies among the layers."""
    shared = [z for z in sorted(keyed.places) if z in still.places and z >= 50]
    parts, between = [], []
    for z in shared:
        one = _pooled(keyed.places[z])
        rates = {name: _count(still.places[z][name], "raw") for name in LAYERS}
        if one.errors:
            parts.append(f"{z:g} m: {one.text()} beside {' / '.join(rates[name].text() for name in LAYERS)}")
            between.append(rates["high"].rate < one.rate)
    return Finding(
        "The hierarchical code protects its high layer: fewer errors than plain on-off keying at the same place.",
        f"Raw rates of on-off keying beside high / middle / low: {'; '.join(parts) or 'no errors from 50 m on'}.",
        "shown" if not between else "holds" if all(between) else "differs",
    )


def _count(counts: LayerCounts, kind: str) -> Count:
    return Count(counts.raw_bits, counts.raw_errors) if kind == "raw" else Count(counts.bits, counts.bit_errors)


def _of(layer: str, kind: str, layers: Mapping[str, LayerCounts]) -> Count:
    return _count(layers[layer], kind)


def _pooled(layers: Mapping[str, LayerCounts]) -> Count:
    """Raw errors of all layers."""
    return Count(sum(c.raw_bits for c in layers.values()), sum(c.raw_errors for c in layers.values()))


def _rates_table(still: Sums, moving: Sums, keyed: Sums) -> Table:
    head = ["distance"]
    head += [f"{n}: {what}" for n in LAYERS for what in ("raw", "decoded", "codewords wrong")] + ["on-off keying: raw"]
    rows = [_rates_row(f"static {z:g} m", layers, keyed.places.get(z)) for z, layers in sorted(still.places.items())]
    rows += [
        _rates_row(f"driving {z - BIN_M / 2:g}-{z + BIN_M / 2:g} m", layers, None)
        for z, layers in sorted(moving.places.items())
    ]
    return Table("Bit error rates; no error among n is written < 3/n", head, rows)


def _rates_row(name: str, layers: Mapping[str, LayerCounts], keyed: Mapping[str, LayerCounts] | None) -> list[str]:
    cells = [name]
    for one in layers.values():
        cells += [_count(one, "raw").text(), _count(one, "bits").text(), f"{one.codeword_errors} of {one.codewords}"]
    return [*cells, _pooled(keyed).text() if keyed else ""]


def _comparison_table(found: Sequence[Comparison]) -> Table:
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


def _data(still: Sums, moving: Sums, keyed: Sums, found: Sequence[Comparison]) -> dict[str, Any]:
    def plain(sums: Sums) -> list[dict[str, Any]]:
        return [{"distance_m": z, **{n: asdict(c) for n, c in by.items()}} for z, by in sorted(sums.places.items())]

    return {
        "static": plain(still),
        "driving": plain(moving),
        "ook": plain(keyed),
        "comparison": [asdict(c) for c in found],
    }


def _pictures(still: Sums, moving: Sums, keyed: Sums, found: Sequence[Comparison]) -> list[tuple[Figure, str]]:
    rates = (
        "Bit error rate before and after the turbo code: static (lines), driving (open squares), on-off keying before "
        "any code (gray). Layers are drawn half a metre aside. 95 % intervals; an arrow is a bound (3/n), no error met."
    )
    ratio = (
        "Raw errors driving over static at the same distances, 95 % over packets or drives; "
        f"gray: alike, a factor {MARGIN:g}."
    )
    return [(_rates_picture(still, moving, keyed), rates), (_ratio_picture(found), ratio)]


def _rates_picture(still: Sums, moving: Sums, keyed: Sums) -> Figure:
    figure = Figure(figsize=(12, 4.8))
    for axes, kind, title in zip(figure.subplots(1, 2), ("raw", "bits"), ("before", "after"), strict=True):
        for k, name in enumerate(LAYERS):
            count = partial(_of, name, kind)
            _draw(axes, still, count, COLOURS[name], f"{name}, static", "-", 0.5 * (k - 1))
            _draw(axes, moving, count, COLOURS[name], f"{name}, driving", "none", 0.5 * (k - 1))
        if kind == "raw":
            _draw(axes, keyed, _pooled, "#4a5056", "on-off keying, static", "--")
        axes.set_title(f"{title} the turbo code", fontsize=10)
        axes.set_yscale("log")
        axes.set_ylim(1e-6, 1)
        axes.set_xlabel("distance (m)")
        axes.set_ylabel("bit error rate")
        axes.legend(frameon=False, fontsize=8, loc="upper left")
        _clean(axes)
    figure.tight_layout()
    return figure


def _draw(
    axes: Any,
    sums: Sums,
    count: Callable[[Mapping[str, LayerCounts]], Count],
    colour: str,
    label: str,
    dashes: str,
    aside_m: float = 0.0,
) -> None:
    counts = [(z + aside_m, count(layers)) for z, layers in sorted(sums.places.items())]
    met = [(z, c.rate, *c.interval()) for z, c in counts if c.errors]
    style = {"color": colour, "ls": dashes, "lw": 1.2, "capsize": 2}
    style |= {"marker": "s", "mfc": "none", "ms": 6} if dashes == "none" else {"marker": "o", "ms": 3}
    if met:
        z, rate, low, high = np.array(met).T
        axes.errorbar(z, rate, (rate - low, high - rate), label=label, **style)
    free = [(z, 3 / c.trials) for z, c in counts if c.trials and not c.errors]
    if free:
        z, bound = np.array(free).T
        label = "" if met else label
        axes.plot(z, bound, color=colour, marker=r"$\downarrow$", ms=8, ls="none", alpha=0.6, label=label or None)


def _ratio_picture(found: Sequence[Comparison]) -> Figure:
    figure = Figure(figsize=(9, 3.6))
    axes = figure.subplots()
    axes.axhspan(1 / MARGIN, MARGIN, color="#eef0f2", zorder=0)
    axes.axhline(1, color="#c9ced6", lw=1, zorder=1)
    for k, name in enumerate(LAYERS):
        rows = [(c.bin_m + k - 1, c.ratio, c.low, c.high) for c in found if c.layer == name and c.bin_m is not None]
        if rows:
            z, ratio, low, high = np.array(rows).T
            high = np.minimum(high, 1e3)
            bars = (ratio - np.minimum(low, ratio), np.maximum(high, ratio) - ratio)
            axes.errorbar(z, ratio, bars, color=COLOURS[name], marker="o", ms=4, ls="none", capsize=2, label=name)
    axes.set_yscale("log")
    axes.set_ylim(0.2, 5)
    axes.set_yticks((0.2, 0.5, 1, 2, 5), ("0.2", "0.5", "1", "2", "5"))
    axes.minorticks_off()
    axes.set_xlabel("distance (m)")
    axes.set_ylabel("driving / static")
    if axes.get_legend_handles_labels()[0]:
        axes.legend(frameon=False, ncols=3)
    _clean(axes)
    figure.tight_layout()
    return figure


def _clean(axes: Any) -> None:
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(alpha=0.25, lw=0.6)
