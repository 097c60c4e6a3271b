"""What a reception amounts to: counts by array and layer, messages, errors where the truth is known."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

from heliograph.link.truth import TruthFile
from heliograph.measure.errors import ErrorCounter
from heliograph.receive import Packet
from heliograph.receive.packets import Codeword
from heliograph.signal.block import payload_bytes
from heliograph.signal.message import Message, Reassembler
from heliograph.signal.settings import LAYERS


@dataclass(slots=True)
class LayerTally:
    """Codewords of a layer.

    Attributes
    ----------
    ok, failed
        Codewords read and not.
    bytes
        Payload of the read ones; repeats count.
    """

    ok: int = 0
    failed: int = 0
    bytes: int = 0


@dataclass(slots=True)
class ArrayTally:
    """Packets of an array.

    Attributes
    ----------
    first_frame, last_frame
        Of its packets.
    packets
        How many.
    layers
        Codewords by layer.
    """

    first_frame: int
    last_frame: int = 0
    packets: int = 0
    layers: dict[str, LayerTally] = field(default_factory=lambda: {name: LayerTally() for name in LAYERS})

    def add(self, packet: Packet) -> None:
        """Count a packet."""
        self.last_frame = packet.last_frame
        self.packets += 1
        for name, words in packet.layers.items():
            tally = self.layers[name]
            for word in words:
                tally.ok += word.status == "ok"
                tally.failed += word.status != "ok"
                tally.bytes += len(word.block.payload) if word.block else 0


def is_packet(packet: Packet) -> bool:
    """Whether what a receiver hands out is a packet: with neither header nor a right codeword it is none.

    What is none is neither counted nor logged; if it was sent, it is missed.
    """
    return packet.status not in ("no_header", "no_array")


class Reception:
    """Gathers packets to messages and counts.

    Parameters
    ----------
    truth
        Truth of the film, if known.
    """

    def __init__(self, truth: TruthFile | None = None):
        self.arrays: dict[int, ArrayTally] = {}
        self.frames = 0
        self.detections = 0
        """Times the receiver took something for an array."""
        self.errors = ErrorCounter(truth.settings, truth.messages) if truth else None
        self._rows = truth.rows() if truth else None
        self._reassembler = Reassembler()

    def saw(self, index: int) -> None:
        """A frame was taken; the truth moves on with it."""
        self.frames += 1
        if self._rows is None or self.errors is None:
            return
        for row in self._rows:
            arrays = row["arrays"]
            self.errors.saw(float(row["time_s"]), arrays["distance_m"].tolist(), arrays["visible"].tolist())
            if row["index"] >= index:
                break

    def add(self, packet: Packet) -> Iterator[Message]:
        """Count a packet, if it is one; yield the messages it completes."""
        if not is_packet(packet):
            return
        if self.errors is not None:
            self.errors.received(packet)
        self.arrays.setdefault(packet.identity, ArrayTally(packet.first_frame)).add(packet)
        for words in packet.layers.values():
            yield from _completed(self._reassembler, words)

    def unfinished(self) -> list[tuple[int, str, int, int, int]]:
        """Messages that lack segments: (identity, layer, stream, bytes had, bytes in all)."""
        return self._reassembler.unfinished()

    def report(self, seconds: float) -> dict[str, Any]:
        """All counts as plain values, for JSON."""
        out: dict[str, Any] = {
            "frames": self.frames,
            "seconds": round(seconds, 3),
            "frames_per_second": round(self.frames / max(seconds, 1e-9), 1),
            "detections": self.detections,
            "arrays": [_plain(identity, tally) for identity, tally in sorted(self.arrays.items())],
        }
        if self.errors is not None:
            out["errors"] = self.errors.report()
            out["false_packets"] = self.errors.false_packets
            out["false_codewords"] = self.errors.false_codewords
        return out


def _completed(reassembler: Reassembler, words: Iterable[Codeword]) -> Iterator[Message]:
    for word in words:
        message = reassembler.add(word.block, payload_bytes(word.bits.size)) if word.block else None
        if message is not None:
            yield message


def _plain(identity: int, tally: ArrayTally) -> dict[str, Any]:
    layers = {n: {"ok": t.ok, "failed": t.failed, "bytes": t.bytes} for n, t in tally.layers.items()}
    return {
        "id": identity,
        "first_frame": tally.first_frame,
        "last_frame": tally.last_frame,
        "packets": tally.packets,
        "layers": layers,
    }
