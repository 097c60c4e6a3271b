"""Packets received beside the truth: predicted error probabilities of their bits, and their distances."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import Floats
from heliograph.link.settings import LinkSettings
from heliograph.link.simulate import Messages, simulate, transmitters
from heliograph.measure.bench import block_settings, dithered, random_messages, window_margin_px
from heliograph.measure.statistics import Clustered
from heliograph.receive import Packet, Receiver, make_receiver
from heliograph.receive.events import EqualiseEvent, Event
from heliograph.signal.block import pack

EDGES = (0.0, 1e-4, 1e-3, 3e-3, 0.01, 0.03, 0.1, 0.2, 0.3, 0.4, 0.5)
"""Edges of the bins of the predicted error probability."""

FIRST, LAST = "first iteration", "last iteration"
"""LLRs of the equaliser before anything is known; and those a codeword that came later was last decoded from."""


@dataclass(slots=True)
class ReliabilityCounts:
    """Bits by bin of the predicted error probability, a row per packet, since errors of a packet may come together."""

    # (packets, 3, bins): bits, wrong bits, and the sum of the predicted error probabilities, which is the expected
    # number of wrong bits
    table: Floats = field(default_factory=partial(np.zeros, (0, 3, len(EDGES) - 1)))

    def add(self, llr: Floats, sent: NDArray[np.uint8]) -> None:
        """Count the bits of a packet that were received."""
        known = llr != 0
        # P(wrong) = 1 / (1 + exp |LLR|)
        predicted = 1 / (1 + np.exp(np.abs(llr[known])))
        wrong = (llr[known] < 0) != sent[known]
        weights = (np.ones(len(predicted)), wrong.astype(float), predicted)
        row = [np.histogram(predicted, EDGES, weights=w)[0] for w in weights]
        self.table = np.concatenate([self.table, [row]])

    def include(self, other: "ReliabilityCounts") -> None:
        """Count another's packets as well."""
        self.table = np.concatenate([self.table, other.table])

    def bins(self) -> list["ReliabilityBin"]:
        """Predicted and observed error probabilities, by bin."""
        out = []
        for k in range(len(EDGES) - 1):
            count = Clustered(scattered=True)
            for bits, wrong, _ in self.table[:, :, k]:
                count.add(int(bits), int(wrong))
            predicted = float(self.table[:, 2, k].sum() / max(count.trials, 1))
            out.append(ReliabilityBin((EDGES[k], EDGES[k + 1]), predicted, count))
        return out


@dataclass(frozen=True, slots=True)
class ReliabilityBin:
    """Bits of similar predicted error probability."""

    # Least and largest predicted error probability of the bin
    edges: tuple[float, float]
    # Mean of the predicted error probability
    predicted: float
    # Bits and errors, by packet
    count: Clustered

    @property
    def expected(self) -> float:
        """Expected number of wrong bits."""
        return self.predicted * self.count.trials

    def ratio(self) -> tuple[float, float, float]:
        """Observed over predicted error probability, and its 95 % interval."""
        low, high = self.count.interval()
        return self.count.rate / self.predicted, low / self.predicted, high / self.predicted

    def range_text(self) -> str:
        """The edges as text."""
        return f"{self.edges[0]:g} to {self.edges[1]:g}"

    def ratio_text(self) -> str:
        """The ratio and its interval as text; "-" where there are no bits."""
        if not (self.count.trials and self.predicted):
            return "-"
        ratio, low, high = self.ratio()
        return f"{ratio:.2f} ({low:.2f} to {high:.2f})"


@dataclass(frozen=True, kw_only=True)
class CalibrationFilm:
    """A film to be received."""

    # Name under which it is counted
    case: str
    # The link, with one array
    settings: LinkSettings
    # Of messages, road, noise and place
    seed: int
    # Its length in packets; None: the whole drive
    packets: int | None = 1


@dataclass(slots=True)
class CalibrationRecord:
    """Predictions and distances of a film's packets."""

    # Name under which the film is counted
    case: str
    # Bits by `FIRST` and `LAST`
    reliability: dict[str, ReliabilityCounts] = field(
        default_factory=lambda: {FIRST: ReliabilityCounts(), LAST: ReliabilityCounts()}
    )
    # (packets, 3): true distance in m in the middle of the packet, the receiver's (NaN where no codeword of the packet
    # was read), number of the packet in its film
    distances: Floats = field(default_factory=partial(np.zeros, (0, 3)))


def record(film: CalibrationFilm) -> CalibrationRecord:
    """Simulate a film and receive it blind; each packet is then compared with the truth."""
    settings = dithered(block_settings(film.settings, film.packets), film.seed)
    messages = random_messages(settings, film.seed)
    (sender,) = transmitters(settings, messages)
    recorder, out, distance_m = LlrRecorder(), CalibrationRecord(film.case), dict[int, float]()
    receiver = make_receiver(settings.signal, settings.receive, recorder)
    for packet in _received(receiver, settings, messages, film.seed, distance_m):
        number = round(packet.start_time_s / settings.signal.packet_s)
        blocks = sender.blocks(number)
        layers = sender.format_of(number).layers
        sent = {n: layers[n].code.encode([pack(b, layers[n].code.k) for b in blocks[n]]) for n in layers}
        recorder.count(sent, out.reliability)
        true = distance_m[(packet.first_frame + packet.last_frame) // 2]
        out.distances = np.vstack([out.distances, [true, _distance_m(packet), number]])
    return out


def _received(
    receiver: Receiver,
    settings: LinkSettings,
    messages: Sequence[Messages],
    seed: int,
    distance_m: dict[int, float],
) -> Iterator[Packet]:
    """Packets of a film, with the last one that its end completes; the true distance of each frame is noted."""
    for frame, truth in simulate(settings, messages, seed, None, window_margin_px(settings)):
        distance_m[frame.index] = truth.arrays[0].distance_m
        yield from receiver.push(frame)
    yield from receiver.finish()


def _distance_m(packet: Packet) -> float:
    return packet.distance_m if packet.status in ("ok", "partial") else float("nan")


class LlrRecorder:
    """Observer of a receiver that keeps the LLRs of a packet's iterations."""

    def __init__(self) -> None:
        self._iterations: list[dict[str, Floats]] = []

    def __call__(self, event: Event) -> None:
        """Keep the LLRs that the equaliser hands out."""
        if isinstance(event, EqualiseEvent):
            self._iterations.append({name: llr.copy() for name, llr in event.llr.items()})

    def count(self, sent: Mapping[str, NDArray[np.uint8]], reliability: Mapping[str, ReliabilityCounts]) -> None:
        """Count the bits of the packet that was just received, and forget it."""
        iterations, self._iterations = self._iterations, []
        if not iterations:
            return
        first = np.concatenate([iterations[0][name].ravel() for name in sent])
        bits = np.concatenate([sent[name].ravel() for name in sent])
        if len(first) != len(bits):  # taken for a packet of another format
            return
        reliability[FIRST].add(first, bits)
        last = np.zeros_like(first)
        for one in iterations[1:]:
            # a decoded codeword is not estimated any more
            llr = np.concatenate([one[name].ravel() for name in sent])
            last = np.where(llr != 0, llr, last)
        reliability[LAST].add(last, bits)
