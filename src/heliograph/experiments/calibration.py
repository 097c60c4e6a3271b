"""Calibration of the soft receiver: predicted error probabilities of LLRs, and errors of distances.

Packets of the reference link at rest (single packets, random pixel phases of the array) and on the road at 30 km/h
(films of three packets, road of class B), and full drives from 80 m to 25 m, received by the soft receiver with channel
estimation. LLRs: each LLR of the equaliser predicts a wrong sign with the probability 1 / (1 + exp |LLR|); tables
compare this with the observed rate. First iteration: no prior knowledge. Last iteration: the last decoder input of
codewords that later iterations decoded, with other layers cancelled or estimated. Distance: estimated from the pitch in
the image, and the true distance in the middle of the packet. The first packet has a single header. Intervals of an rms
assume independent normal errors.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.special import chdtri

from heliograph.base.arrays import Floats
from heliograph.channel.truth import ArrayTruth
from heliograph.experiments.links import receive_packets
from heliograph.experiments.report import Context, ExperimentResult, Finding, Table, verdict_of
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import transmitters
from heliograph.measure.bench import block_settings, dithered, random_messages
from heliograph.measure.statistics import Clustered
from heliograph.receive.api import make_receiver
from heliograph.receive.events import EqualiseEvent, Event
from heliograph.signal.block import pack

TOLERANCE = 0.1  # allowed relative deviation of observed from predicted error probability
GOOD_M = 0.25  # required rms error of the distance in m
EDGES = (0.0, 1e-4, 1e-3, 3e-3, 0.01, 0.03, 0.1, 0.2, 0.3, 0.4, 0.5)  # bin edges of the predicted error probability

FIRST, LAST = "first iteration", "last iteration"
"""LLRs of the equaliser with no prior knowledge, and LLRs of the last decoding of a later codeword."""


@dataclass(frozen=True, kw_only=True)
class CalibrationFilm:
    """Film to receive."""

    # Name in tables
    case: str
    # Link with a single array
    settings: LinkSettings
    seed: int
    # Length in packets; None: all of the drive
    packets: int | None = 1


@dataclass(slots=True)
class CalibrationRecord:
    """Predictions and distances of the packets of a film."""

    case: str
    # Result of `count_bits` for each packet, by `FIRST` and `LAST`
    reliability: dict[str, list[Floats]] = field(default_factory=lambda: {FIRST: [], LAST: []})
    # For each packet: true distance in m, estimated distance (NaN if no codeword was read), number in the film
    distances: list[tuple[float, float, int]] = field(default_factory=list)


def record(film: CalibrationFilm) -> CalibrationRecord:
    """Simulate and receive a film, and compare each packet with the truth."""
    settings = dithered(block_settings(film.settings, film.packets), film.seed)
    messages = random_messages(settings, film.seed)
    (sender,) = transmitters(settings, messages)
    iterations: list[dict[str, Floats]] = []
    truths: dict[int, ArrayTruth] = {}

    def observe(event: Event) -> None:
        if isinstance(event, EqualiseEvent):
            iterations.append({name: llr.copy() for name, llr in event.llr.items()})

    receiver = make_receiver(settings.signal, settings.receive, observe)
    out = CalibrationRecord(film.case)
    for packet in receive_packets(settings, messages, film.seed, receiver, truths):
        number = round(packet.start_time_s / settings.signal.packet_s)
        blocks, layers = sender.blocks(number), sender.format_of(number).layers
        sent = [layers[n].code.encode([pack(b, layers[n].code.k) for b in blocks[n]]).ravel() for n in layers]
        llrs = [np.concatenate([llr[n].ravel() for n in layers]) for llr in iterations]
        iterations.clear()
        # other lengths: the receiver assumed another packet format
        if llrs and len(llrs[0]) == sum(map(len, sent)):
            last = np.zeros_like(llrs[0])
            for llr in llrs[1:]:
                # the equaliser skips decoded codewords
                last = np.where(llr != 0, llr, last)
            out.reliability[FIRST].append(count_bits(llrs[0], np.concatenate(sent)))
            out.reliability[LAST].append(count_bits(last, np.concatenate(sent)))
        true = truths[(packet.first_frame + packet.last_frame) // 2].distance_m
        found = packet.distance_m if packet.status in ("ok", "partial") else float("nan")
        out.distances.append((true, found, number))
    return out


def count_bits(llr: Floats, sent: NDArray[np.uint8]) -> Floats:
    """Bits, wrong bits and the sum of predicted error probabilities of a packet, (3, bins)."""
    known = llr != 0
    # P(wrong) = 1 / (1 + exp |LLR|)
    predicted = 1 / (1 + np.exp(np.abs(llr[known])))
    weights = (np.ones(len(predicted)), ((llr[known] < 0) != sent[known]).astype(float), predicted)
    return np.array([np.histogram(predicted, EDGES, weights=w)[0] for w in weights])


@dataclass(frozen=True, slots=True)
class ReliabilityBin:
    """Bits of similar predicted error probability."""

    # Smallest and largest predicted error probability
    edges: tuple[float, float]
    # Mean predicted error probability
    predicted: float
    # Bits and errors, clustered by packet
    count: Clustered

    @property
    def expected(self) -> float:
        """Expected number of wrong bits."""
        return self.predicted * self.count.trials

    def ratio(self) -> tuple[float, float, float]:
        """Observed over predicted error probability with 95 % interval."""
        low, high = self.count.interval()
        return self.count.rate / self.predicted, low / self.predicted, high / self.predicted

    def range_text(self) -> str:
        """Edges as text."""
        return f"{self.edges[0]:g} to {self.edges[1]:g}"

    def ratio_text(self) -> str:
        """Ratio and interval as text; "-" for no bits."""
        if not (self.count.trials and self.predicted):
            return "-"
        ratio, low, high = self.ratio()
        return f"{ratio:.2f} ({low:.2f} to {high:.2f})"


def reliability_bins(counts: Sequence[Floats]) -> list[ReliabilityBin]:
    """Predicted and observed error probabilities of packets, by bin."""
    table, out = np.reshape(counts, (-1, 3, len(EDGES) - 1)), []
    for k, edges in enumerate(pairwise(EDGES)):
        count = Clustered(scattered=True)
        for bits, wrong, _ in table[:, :, k]:
            count.add(int(bits), int(wrong))
        out.append(ReliabilityBin(edges, float(table[:, 2, k].sum() / max(count.trials, 1)), count))
    return out


def judged(bins: Sequence[ReliabilityBin]) -> list[ReliabilityBin]:
    """Bins with at least 30 observed or expected errors."""
    return [part for part in bins if max(part.count.errors, part.expected) >= 30]


def calibrated(name: str, bins: Sequence[ReliabilityBin]) -> Finding:
    """Compare observed and predicted error probabilities."""
    here = judged(bins)
    off = [part for part in here if part.ratio()[1] > 1 + TOLERANCE or part.ratio()[2] < 1 - TOLERANCE]
    near = [part for part in here if abs(part.ratio()[0] - 1) <= TOLERANCE]
    bits, errors = sum(part.count.trials for part in bins), sum(part.count.errors for part in bins)
    return Finding(
        f"Question: predicted and observed error probability within 10 %, {name}.",
        f"{errors} of {bits} bits wrong, {sum(part.expected for part in bins):.0f} expected; of {len(here)} bins with "
        f"30 errors or more {len(near)} are within {TOLERANCE:.0%}, {len(off)} apart for certain.",
        verdict_of(not off if here else None),
        "Apart: " + "; ".join(f"{part.range_text()}: {part.ratio_text()}" for part in off) + "." if off else "",
    )


DistanceErrors = Mapping[tuple[str, float, float], Floats]
"""Distance errors of packets in m, (packets,), by case of the films and edges of the distance bin in m."""


def by_distance(distances: Mapping[str, Floats]) -> DistanceErrors:
    """Errors by case and distance, with the first packets separate."""
    edges = (22.5, 32.5, 50.0, 65.0, 75.0, 82.5, 95.0, 110.0, 140.0, 165.0, 195.0, 225.0)
    out: dict[tuple[str, float, float], Floats] = {}
    for case, rows in distances.items():
        for name, chosen in (("first packet", rows[:, 2] == 0), ("later packets", rows[:, 2] > 0)):
            for low, high in pairwise(edges):
                here = rows[chosen & (rows[:, 0] >= low) & (rows[:, 0] < high) & np.isfinite(rows[:, 1])]
                if len(here):
                    out[f"{case}, {name}", low, high] = here[:, 1] - here[:, 0]
    return out


def rms_m(errors_m: Floats) -> tuple[float, float, float]:
    """Rms of errors in m with 95 % interval."""
    total, n = float((errors_m**2).sum()), len(errors_m)
    # sum of squares / sigma^2 is chi-square of n
    return (total / n) ** 0.5, (total / chdtri(n, 0.025)) ** 0.5, (total / chdtri(n, 0.975)) ** 0.5


def accurate(errors: DistanceErrors) -> Finding:
    """Check the distance errors up to 80 m."""
    near = [(place, errors_m) for place, errors_m in errors.items() if place[2] <= 82.5]
    (case, from_m, to_m), worst = max(near, key=lambda part: rms_m(part[1])[0])
    rms, low, high = rms_m(worst)
    pooled = np.concatenate([errors_m for _, errors_m in near])
    return Finding(
        f"Question: distance from one camera below {GOOD_M:g} m rms up to 80 m.",
        f"{len(pooled)} packets to 80 m: {rms_m(pooled)[0]:.3f} m rms; worst are {len(worst)} packets "
        f"{case}, {from_m:g} to {to_m:g} m: {rms:.3f} m ({low:.3f} to {high:.3f}).",
        verdict_of(rms < GOOD_M),
        "Published: 0.5 m at 60 m from two cameras, 0.75 m within 100 m from an event camera.",
    )


def _reliability_diagram(bins: Mapping[str, Sequence[ReliabilityBin]]) -> Figure:
    """Observed over predicted error probability of the judged bins, with 95 % intervals."""
    figure = Figure(figsize=(8, 4))
    axes = figure.add_subplot(xlabel="predicted error probability", ylabel="observed / predicted")
    for name, part in bins.items():
        if here := judged(part):
            ratio, low, high = np.array([one.ratio() for one in here]).T
            axes.errorbar([one.predicted for one in here], ratio, (ratio - low, high - ratio), marker="o", label=name)
    axes.axhspan(1 - TOLERANCE, 1 + TOLERANCE, color="lightgray", zorder=0, label=f"within {100 * TOLERANCE:g} %")
    axes.set(xscale="log", yscale="log")
    axes.legend(loc="upper left", bbox_to_anchor=(1, 1))
    return figure


def _distance_plot(distances: Mapping[str, Floats]) -> Figure:
    """Distance error of each packet."""
    figure = Figure(figsize=(8, 4))
    axes = figure.add_subplot(xlabel="distance (m)", ylabel="error (m)")
    for k, (case, rows) in enumerate(distances.items()):
        for name, marker, here in (("first", "o", rows[rows[:, 2] == 0]), ("later", ".", rows[rows[:, 2] > 0])):
            if len(here):
                style: dict[str, Any] = {"color": f"C{k}", "mfc": "none" if name == "first" else None, "alpha": 0.6}
                axes.plot(here[:, 0], here[:, 1] - here[:, 0], marker, label=f"{case}, {name} packets", **style)
    axes.axhspan(-GOOD_M, GOOD_M, color="lightgray", alpha=0.4, zorder=0, label=f"within {GOOD_M:g} m")
    axes.legend(loc="upper left", bbox_to_anchor=(1, 1))
    return figure


def run(context: Context, films: Sequence[CalibrationFilm] = ()) -> ExperimentResult:
    """Receive packets and compare predictions and distances with the truth."""
    records = context.each("the soft receiver", record, films or all_films(context))
    counts = {name: [row for one in records for row in one.reliability[name]] for name in (FIRST, LAST)}
    bins = {name: reliability_bins(rows) for name, rows in counts.items()}
    cases = dict.fromkeys(one.case for one in records)
    distances = {
        case: np.reshape([row for one in records if one.case == case for row in one.distances], (-1, 3))
        for case in cases
    }
    errors = by_distance(distances)
    reliability_columns: dict[str, Callable[[ReliabilityBin], str]] = {
        "predicted": ReliabilityBin.range_text,
        "bits": lambda part: str(part.count.trials),
        "wrong": lambda part: str(part.count.errors),
        "expected": lambda part: f"{part.expected:.1f}",
        "ratio": ReliabilityBin.ratio_text,
    }
    distance_rows = [
        [case, f"{low:g} to {high:g} m", str(len(part)), "{:.3f} ({:.3f} to {:.3f})".format(*rms_m(part)),
         f"{part.mean():+.3f}"]
        for (case, low, high), part in errors.items()
    ]  # fmt: skip
    title = "Bits by predicted error probability"
    return ExperimentResult(
        findings=[*(calibrated(name, part) for name, part in bins.items()), accurate(errors)],
        pictures=[
            (_reliability_diagram(bins), "Observed over predicted error probability, with 95 % intervals."),
            (_distance_plot(distances), "Distance error of a packet."),
        ],
        tables=[
            *(Table.of(f"{title}, {name}", part, reliability_columns) for name, part in bins.items()),
            Table("Error of distance in m", ["case", "distance", "packets", "rms (95 %)", "bias"], distance_rows),
        ],
        data={
            "reliability": {name: np.sum(part, 0).tolist() for name, part in counts.items()},
            "distances": {case: part.tolist() for case, part in distances.items()},
        },
    )


def all_films(context: Context) -> list[CalibrationFilm]:
    """Films to receive; far films take longest and come first."""
    out, quick_m = [], (125.0, 80.0, 40.0)
    full_m = (210.0, 180.0, 150.0, 125.0, 100.0, 90.0, 80.0, 70.0, 60.0, 40.0, 25.0)
    for z in quick_m if context.quick else full_m:
        for case, preset, packets, count in (("at rest", "static", 1, 24), ("driving", "paper", 3, 8)):
            channel = {"distance_m": z, "stop_m": 5.0}
            # near packets need the equaliser, too
            receive = {"receiver": "soft", "soft": {"led_by_led": False}}
            settings = load_settings(preset, {"channel": channel, "receive": receive})
            seeds = [1000 * context.seed + k for k in range(3 if context.quick else count)]
            out += [CalibrationFilm(case=case, settings=settings, seed=seed, packets=packets) for seed in seeds]
    if context.quick:
        return out
    full = load_settings("paper", None, ["receive.receiver=soft"])
    seeds = [1000 * context.seed + k for k in range(3)]
    return [CalibrationFilm(case="whole drives", settings=full, seed=seed, packets=None) for seed in seeds] + out
