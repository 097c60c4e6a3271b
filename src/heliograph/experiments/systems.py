"""Other systems in the same channel: on-off keying with and without inverses, repetition, the hierarchical code.

Static camera, reference link, no error-correcting code: random bits in pattern and inverse, detected and tracked by the
plain receiver. Each film is a packet with a random pixel phase of the array. The inverse removes the blur of all LEDs
by least squares, with the pose and blur estimated by the receiver or, as in the field trial, with a known channel.
Repetition of low frequencies is on-off keying on squares of 2 x 2 or 4 x 4 LEDs: all LEDs of a square show the same
bit, and the luminances are added. A pattern then carries 64 or 16 bits instead of 256. Intervals account for the
correlation of errors within a film.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Literal

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from heliograph.base.arrays import Floats
from heliograph.channel.camera import film
from heliograph.channel.truth import ArrayTruth
from heliograph.experiments import plots
from heliograph.experiments.links import static_link, true_pose
from heliograph.experiments.plots import DARK_GRAY
from heliograph.experiments.report import Context, ExperimentResult, Finding, Table, verdict_of
from heliograph.link.settings import LinkSettings
from heliograph.measure import statistics
from heliograph.measure.bench import window_margin_px
from heliograph.measure.statistics import Clustered, Count
from heliograph.receive.api import make_receiver
from heliograph.receive.decode.per_led import pair_luminances
from heliograph.receive.events import Event, ExtractEvent
from heliograph.signal import haar, ook
from heliograph.signal.header import header_levels
from heliograph.signal.packet import PacketFormat, with_inverses
from heliograph.signal.settings import SignalSettings
from heliograph.sweeps.plot import LAYER_COLOURS

ReadMethod = Literal["plain", "inverse", "known"]
"""Luminance at each LED position; the blur inverted; the blur inverted with the true pose and blur."""


@dataclass(frozen=True, kw_only=True)
class Scheme:
    """Mapping of bits to patterns of 16 x 16 LEDs."""

    # Parts of the bits of a pattern that are counted separately
    parts: Mapping[str, slice]
    # Read methods
    methods: tuple[ReadMethod, ...] = ("plain",)
    # LEDs in a row with the same bit; 0: the hierarchical code
    square: int
    # Number of bits to count, relative to on-off keying: other schemes send fewer bits per film
    effort: float = 0.25
    # Distances of the quick and of the full run
    quick_m: Sequence[float]
    full_m: Sequence[float]

    @property
    def bits(self) -> int:
        """Bits of a pattern."""
        return max(part.stop for part in self.parts.values())

    def encode(self, bits: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Patterns (pairs, 16, 16) of levels 0 to 4 for (pairs, bits) bits."""
        d = 1 - 2 * bits.astype(np.int8)
        if not self.square:
            return haar.encode(PacketFormat(SignalSettings(side=16)).join(d))
        small = d.reshape(-1, 16 // self.square, 16 // self.square)
        return ook.encode(np.kron(small, np.ones((1, self.square, self.square), np.int8)))

    def decode(self, x: Floats) -> Floats:
        """Soft bits (bits,), positive for 0, of (16, 16) luminances x' = gain (level - 2)."""
        if not self.square:
            parts = PacketFormat(SignalSettings(side=16)).split(haar.decode(x)[None])
            return np.concatenate([part[0] for part in parts.values()])
        n = 16 // self.square
        return np.asarray(ook.decode(x).reshape(n, self.square, n, self.square).sum(axis=(1, 3)).ravel())


SCHEMES = {
    "haar": Scheme(
        parts={"high": slice(0, 64), "middle": slice(64, 192), "low": slice(192, 256)},
        methods=("plain", "inverse"),
        square=0,
        effort=0.5,
        quick_m=(40, 45, 50, 60, 70, 80, 100),
        full_m=(25, 30, 35, 40, 45, 50, 55, 60, 65, 70, 75, 80, 90, 100, 120),
    ),
    "ook": Scheme(
        parts={"all": slice(0, 256)},
        methods=("plain", "inverse", "known"),
        square=1,
        effort=1.0,
        quick_m=(30, 40, 45, 50, 55, 60, 65, 70),
        full_m=(25, 30, 35, 40, 42.5, 45, 50, 55, 57.5, 60, 62.5, 65, 70, 80),
    ),
    "repeat4": Scheme(
        parts={"all": slice(0, 16)}, square=4, quick_m=(120, 140, 160), full_m=(80, 100, 120, 130, 140, 150, 160)
    ),
    "repeat2": Scheme(
        parts={"all": slice(0, 64)},
        square=2,
        quick_m=(60, 70, 80, 100, 120),
        full_m=(40, 50, 60, 65, 70, 75, 80, 90, 100, 120),
    ),
}
"""Schemes by name; schemes with long computations come first."""


@dataclass(slots=True)
class BitCounts:
    """Bits of a scheme counted at a distance."""

    # Bits and errors by method and part, clustered by film
    counts: dict[tuple[ReadMethod, str], Clustered] = field(default_factory=dict)
    films: int = 0
    # Films with a detected array
    found: int = 0

    def is_settled(self, target: int) -> bool:
        """True from four films on, if every count has enough bits or errors, or no film shows the array."""
        # fewer films give no interval; 200 errors give the rate to about 15 %
        return self.films >= 4 and all(c.trials >= target or c.errors >= 200 for c in self.counts.values())


def count_bits(bits: int, seed: int, work: tuple[str, float]) -> BitCounts:
    """Read films of a scheme at a distance, each with another pixel phase of the array, up to enough bits or errors."""
    key, distance_m = work
    counted = BitCounts()
    while not counted.is_settled(round(SCHEMES[key].effort * bits)):
        rng = np.random.default_rng([seed, counted.films, round(1000 * distance_m), *key.encode()])
        _count_film(SCHEMES[key], static_link(distance_m, rng), rng, counted)
    return counted


def _count_film(scheme: Scheme, settings: LinkSettings, rng: np.random.Generator, counted: BitCounts) -> None:
    """Count a film of a packet; the receiver expects a longer packet, so that it decodes nothing."""
    signal, header = settings.signal, settings.signal.header_pairs
    bits = rng.integers(0, 2, (signal.data_pairs, scheme.bits), dtype=np.uint8)
    head = header_levels(settings.transmit.identities[0], 16)[None].repeat(header, 0)
    patterns = with_inverses(np.concatenate([head, scheme.encode(bits)]))
    truths: list[ArrayTruth] = []
    wrong: dict[ReadMethod, list[NDArray[np.bool_]]] = {method: [] for method in scheme.methods}

    def observe(event: Event) -> None:
        if isinstance(event, ExtractEvent) and 0 <= (pair := event.frames[0].index // 2 - header) < signal.data_pairs:
            for method, rows in wrong.items():
                rows.append((scheme.decode(_luminances(event, method, truths, settings)) < 0) != bits[pair])

    # the high layer is readable beyond the reach of the default search
    detect = replace(settings.receive.detect, min_side_px=5.0)
    longer = replace(signal, data_pairs=signal.data_pairs + 1)
    receiver = make_receiver(longer, replace(settings.receive, detect=detect), observe)
    period, margin = signal.pattern_period_s, window_margin_px(settings)
    for frame, truth in film(settings.channel, [patterns], rng, pattern_period_s=period, roi_margin_px=margin):
        truths.append(truth.arrays[0])
        for _ in receiver.push(frame):
            pass
    counted.films += 1
    if not wrong["plain"]:
        return
    counted.found += 1
    for method, rows in wrong.items():
        for name, part in scheme.parts.items():
            errors = np.array(rows)[:, part]
            count = counted.counts.setdefault((method, name), Clustered(scattered=True))
            count.add(errors.size, int(errors.sum()))


def _luminances(
    event: ExtractEvent, method: ReadMethod, truths: Sequence[ArrayTruth], settings: LinkSettings
) -> Floats:
    """Luminances of a pair, (16, 16), in units of the gain; signs do not depend on the gain."""
    pattern, inverted = event.frames
    gain = settings.channel.emitter.all_on * settings.channel.sensor.full_scale
    poses = event.poses[0], event.poses[1]
    if method == "known":
        poses = true_pose(truths[pattern.index], settings), true_pose(truths[inverted.index], settings)
    return pair_luminances(event.frames, poses, gain, 16, "none" if method == "plain" else "inverse")


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

Points = Sequence[tuple[float, Count]]  # bits and errors by distance in m, near first


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
    # half an error stands for none
    rates = [(z, max(count.errors, 0.5) / count.trials if count.trials else math.nan) for z, count in points]
    found = statistics.range_m(rates, rate)
    return found if 0 < found < math.inf else None


def _rates_plot(points: Mapping[str, Points]) -> Figure:
    """On-off keying and repetition left, the hierarchical code right."""
    figure = Figure(figsize=(10, 6))
    left, right = figure.subplots(1, 2, sharey=True)
    for curve in CURVES:
        panels = [right] if curve.scheme == "haar" else [left, right] if curve is CURVES[0] else [left]
        for axes in panels:
            style = {"color": curve.colour, "ls": curve.dashes, "ms": 3, "lw": 1.2}
            plots.draw_rates(axes, points[curve.name], curve.name, capsize=0, **style)
    for z, name in ((40.0, "without inverse"), (60.0, "with inverse")):
        label = f"error-free {name} (Kasashima 2013)"
        left.plot((z, z), (1e-6, 1), color="lightgray", ls="-" if z == 40 else "--", lw=2, zorder=0, label=label)
    for axes, title in ((left, "on-off keying, inverse and repetition"), (right, "the hierarchical code")):
        axes.set(title=title, xlabel="distance (m)", yscale="log", ylim=(1e-6, 1))
    left.set_ylabel("bit error rate")
    plots.legend_below(figure, columns=3)
    return figure


def findings(points: Mapping[str, Points]) -> list[Finding]:
    """Judge all claims."""
    plain, inverse, known = (points[curve.name] for curve in CURVES[:3])
    return [
        field_trial("Kasashima et al. 2013: on-off keying is free of error to 40 m without the inverse.", 40.0, plain),
        field_trial(
            "Kasashima et al. 2013: with the inverse, the channel known, it is free of error to 60 m.", 60.0, known
        ),
        field_trial(
            "Question: the same to 60 m with the estimated pose and blur.",
            60.0,
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


def run(
    context: Context, bits: int | None = None, distances_m: Mapping[str, Sequence[float]] | None = None
) -> ExperimentResult:
    """Error rates before any code by distance, and ranges of all systems; `bits` of on-off keying at each distance."""
    bits = bits or (20_000 if context.quick else 100_000)
    distances_m = distances_m or {key: s.quick_m if context.quick else s.full_m for key, s in SCHEMES.items()}
    todo = [(key, float(z)) for key in SCHEMES for z in sorted(distances_m[key])]
    counted = context.each("other systems", partial(count_bits, bits, context.seed), todo)
    results = list(zip(todo, counted, strict=True))
    points = {
        curve.name: [
            (z, bits.counts.get((curve.method, curve.part), Count()))
            for (key, z), bits in results
            if key == curve.scheme
        ]
        for curve in CURVES
    }
    head = ("system", "bits per pattern", "error-free to", "bits read to there, bound", "BER 1e-3 at", "BER 1e-2 at")
    caption = "Bit error rate before any code; 95 % intervals; an arrow is an upper bound (3/n) with no error."
    return ExperimentResult(
        findings=findings(points),
        pictures=[(_rates_plot(points), caption)],
        tables=[Table("Ranges before any code", head, [_row(curve, points[curve.name]) for curve in CURVES])],
        data={
            "systems": [_plain(curve, points[curve.name]) for curve in CURVES],
            "films": [
                {"scheme": key, "distance_m": z, "films": bits.films, "found": bits.found} for (key, z), bits in results
            ],
        },
    )


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
