"""What a receiver claims of packets that were sent: likelihoods of bits and distances, beside the truth."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.link.settings import LinkSettings
from heliograph.link.simulate import Messages, simulate, transmitters
from heliograph.measure.bench import block_settings, dithered, random_messages, window_margin_px
from heliograph.measure.statistics import Clustered
from heliograph.receive import Packet, make_receiver
from heliograph.receive.packets import FrameReceiver
from heliograph.signal.block import pack

Floats = NDArray[np.float64]

EDGES = (0.0, 1e-4, 1e-3, 3e-3, 0.01, 0.03, 0.1, 0.2, 0.3, 0.4, 0.5)
"""Bins of the claimed error probability."""

FIRST, LAST = "first round", "last round"
"""LLRs of the equaliser before anything is known; those a codeword that came later was last decoded from."""


@dataclass(slots=True)
class Claims:
    """Bits by bin of the claimed error probability, a row a packet, since a packet's errors may come together.

    Attributes
    ----------
    table
        (packets, 3, bins): bits, those wrong, and the sum of what was claimed: errors to be expected.
    """

    table: Floats = field(default_factory=partial(np.zeros, (0, 3, len(EDGES) - 1)))

    def add(self, llr: Floats, sent: NDArray[np.uint8]) -> None:
        """Count the bits of a packet that were received at all, LLR = ln P(b=0)/P(b=1)."""
        known = llr != 0
        # P(wrong) = 1 / (1 + exp |LLR|)
        claimed = 1 / (1 + np.exp(np.abs(llr[known])))
        wrong = (llr[known] < 0) != sent[known]
        row = [
            np.histogram(claimed, EDGES, weights=w)[0] for w in (np.ones(len(claimed)), wrong.astype(float), claimed)
        ]
        self.table = np.concatenate([self.table, [row]])

    def include(self, other: "Claims") -> None:
        """Count another's as well."""
        self.table = np.concatenate([self.table, other.table])

    def bins(self) -> list["Bin"]:
        """What was claimed and observed, by bin."""
        out = []
        for k in range(len(EDGES) - 1):
            count = Clustered(scattered=True)
            for bits, wrong, _ in self.table[:, :, k]:
                count.add(int(bits), int(wrong))
            claimed = float(self.table[:, 2, k].sum() / max(count.trials, 1))
            out.append(Bin((EDGES[k], EDGES[k + 1]), claimed, count))
        return out


@dataclass(frozen=True, slots=True)
class Bin:
    """Bits of about one claimed error probability.

    Attributes
    ----------
    edges
        Of the bin.
    claimed
        Mean of the claimed error probability.
    count
        Bits and errors, by packet.
    """

    edges: tuple[float, float]
    claimed: float
    count: Clustered

    def ratio(self) -> tuple[float, float, float]:
        """Observed over claimed error probability, and its interval."""
        low, high = self.count.interval()
        return self.count.rate / self.claimed, low / self.claimed, high / self.claimed


@dataclass(frozen=True, kw_only=True)
class Block:
    """A film to be received.

    Attributes
    ----------
    case
        What it is counted under.
    settings
        The link.
    seed
        Of messages, road, noise and place.
    packets
        Its length; None: the whole drive.
    """

    case: str
    settings: LinkSettings
    seed: int
    packets: int | None = 1


@dataclass(slots=True)
class Told:
    """What the receiver told of a block.

    Attributes
    ----------
    case
        The block's.
    claims
        Bits by `FIRST` and `LAST`.
    distances
        (packets, 3): true distance in m in the middle of the packet, that told (NaN where nothing of the packet was
        read), number of the packet in its block.
    """

    case: str
    claims: dict[str, Claims] = field(default_factory=lambda: {FIRST: Claims(), LAST: Claims()})
    distances: Floats = field(default_factory=partial(np.zeros, (0, 3)))


def listen(block: Block) -> Told:
    """Simulate a film and receive it; the truth is compared afterwards."""
    settings = dithered(block_settings(block.settings, block.packets), block.seed)
    messages = random_messages(settings, block.seed)
    (sender,) = transmitters(settings, messages)
    ear, out, distance = _Ear(), Told(block.case), dict[int, float]()
    receiver = make_receiver(settings.signal, settings.receive, ear)
    for packet in _received(receiver, settings, messages, block.seed, distance):
        number = round(packet.start_time_s / settings.signal.packet_s)
        blocks = sender.blocks(number)
        layers = sender.format_of(number).layers
        sent = {n: layers[n].code.encode([pack(b, layers[n].code.k) for b in blocks[n]]) for n in layers}
        ear.tell(sent, out.claims)
        true = distance[(packet.first_frame + packet.last_frame) // 2]
        out.distances = np.vstack([out.distances, [true, _distance(packet), number]])
    return out


def _received(
    receiver: FrameReceiver, settings: LinkSettings, messages: Sequence[Messages], seed: int, distance: dict[int, float]
) -> Iterator[Packet]:
    """Packets of a film, the last one that its end completes included; the true distance of each frame is noted."""
    for frame, truth in simulate(settings, messages, seed, None, window_margin_px(settings)):
        distance[frame.index] = truth.arrays[0].distance_m
        yield from receiver.push(frame)
    yield from receiver.finish()


def _distance(packet: Packet) -> float:
    return packet.distance_m if packet.status in ("ok", "partial") else float("nan")


class _Ear:
    """Keeps the LLRs of a packet's rounds."""

    def __init__(self) -> None:
        self._rounds: list[dict[str, Floats]] = []

    def __call__(self, stage: str, data: Mapping[str, Any], /) -> None:
        """Take what the equaliser makes."""
        if stage == "equalise":
            self._rounds.append({name: llr.copy() for name, llr in data["llr"].items()})

    def tell(self, sent: Mapping[str, NDArray[np.uint8]], claims: Mapping[str, Claims]) -> None:
        """Count what was claimed of a packet, and forget it."""
        rounds, self._rounds = self._rounds, []
        if not rounds:
            return
        first = np.concatenate([rounds[0][name].ravel() for name in sent])
        bits = np.concatenate([sent[name].ravel() for name in sent])
        if len(first) != len(bits):  # taken for a packet of another format
            return
        claims[FIRST].add(first, bits)
        last = np.zeros_like(first)
        for one in rounds[1:]:
            # a decoded codeword is not estimated any more
            llr = np.concatenate([one[name].ravel() for name in sent])
            last = np.where(llr != 0, llr, last)
        claims[LAST].add(last, bits)
