"""Predicted error probabilities and distances of received packets, with the truth."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import Floats
from heliograph.experiments.links import receive_link
from heliograph.link.settings import LinkSettings
from heliograph.link.simulate import transmitters
from heliograph.measure.bench import block_settings, dithered, random_messages
from heliograph.measure.statistics import Clustered
from heliograph.receive import Packet, make_receiver
from heliograph.receive.events import EqualiseEvent, Event
from heliograph.signal.block import pack

EDGES = (0.0, 1e-4, 1e-3, 3e-3, 0.01, 0.03, 0.1, 0.2, 0.3, 0.4, 0.5)
"""Bin edges of the predicted error probability."""

FIRST, LAST = "first iteration", "last iteration"
"""LLRs of the equaliser with no prior knowledge, and LLRs of the last decoding of a later codeword."""


def count_bits(llr: Floats, sent: NDArray[np.uint8]) -> Floats:
    """Bits, wrong bits and the sum of predicted error probabilities of a packet, (3, bins)."""
    known = llr != 0
    # P(wrong) = 1 / (1 + exp |LLR|)
    predicted = 1 / (1 + np.exp(np.abs(llr[known])))
    wrong = (llr[known] < 0) != sent[known]
    weights = (np.ones(len(predicted)), wrong.astype(float), predicted)
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
    distance_m: dict[int, float] = {}

    def observe(event: Event) -> None:
        if isinstance(event, EqualiseEvent):
            iterations.append({name: llr.copy() for name, llr in event.llr.items()})

    receiver = make_receiver(settings.signal, settings.receive, observe)

    def packets() -> Iterator[Packet]:
        for truth, received in receive_link(settings, messages, film.seed, receiver):
            distance_m[truth.index] = truth.arrays[0].distance_m
            yield from received
        yield from receiver.finish()

    out = CalibrationRecord(film.case)
    for packet in packets():
        number = round(packet.start_time_s / settings.signal.packet_s)
        blocks, layers = sender.blocks(number), sender.format_of(number).layers
        sent = {n: layers[n].code.encode([pack(b, layers[n].code.k) for b in blocks[n]]) for n in layers}
        _count_iterations(iterations, sent, out.reliability)
        iterations.clear()
        true = distance_m[(packet.first_frame + packet.last_frame) // 2]
        found = packet.distance_m if packet.status in ("ok", "partial") else float("nan")
        out.distances.append((true, found, number))
    return out


def _count_iterations(
    iterations: Sequence[Mapping[str, Floats]],
    sent: Mapping[str, NDArray[np.uint8]],
    reliability: Mapping[str, list[Floats]],
) -> None:
    """Count the bits of a packet."""
    if not iterations:
        return
    bits = np.concatenate([sent[name].ravel() for name in sent])
    llrs = [np.concatenate([llr[name].ravel() for name in sent]) for llr in iterations]
    if len(llrs[0]) != len(bits):  # the receiver assumed another packet format
        return
    reliability[FIRST].append(count_bits(llrs[0], bits))
    last = np.zeros_like(llrs[0])
    for llr in llrs[1:]:
        # the equaliser skips decoded codewords
        last = np.where(llr != 0, llr, last)
    reliability[LAST].append(count_bits(last, bits))
