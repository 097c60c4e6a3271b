"""A film received and counted: codewords by array and layer, messages, errors where the truth is known."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Protocol

from heliograph.base.frames import Frame
from heliograph.link.film import FrameProgress, FrameSource, is_packet, read_packets, silent
from heliograph.link.settings import LinkSettings
from heliograph.link.simulate import Messages
from heliograph.link.truth import FrameTruth
from heliograph.measure.errors import ErrorCounter
from heliograph.receive import Codeword, Packet, make_receiver
from heliograph.receive.api import AnyObserver
from heliograph.receive.detect.budget import SearchLoad
from heliograph.receive.detect.detection import Detection
from heliograph.receive.events import DetectEvent, DropEvent, MissedStartEvent
from heliograph.signal.block import Block, payload_bytes
from heliograph.signal.fountain.files import FileGatherer, FileKey, FileProgress
from heliograph.signal.message import Message, Reassembler
from heliograph.signal.settings import LAYERS, SignalSettings


class TruthSource(Protocol):
    """The truth of a film: a truth file, or that of frames as they are rendered."""

    @property
    def settings(self) -> LinkSettings:
        """The link as simulated."""

    @property
    def messages(self) -> Sequence[Messages]:
        """What each array sent, in the order of the arrays."""

    def frames(self) -> Iterator[FrameTruth]:
        """Yield the truth of each frame, in the order of time."""


@dataclass(slots=True)
class LayerTally:
    """Codewords of a layer."""

    # ok, failed: numbers of codewords read and not read
    ok: int = 0
    failed: int = 0
    # Payload of the read ones in bytes; repeats count
    bytes: int = 0


@dataclass(slots=True)
class ArrayTally:
    """Packets of an array."""

    # first_frame, last_frame: numbers of the frame in which its first packet begins and of that in which its newest
    # ends
    first_frame: int
    # first_distance_m, last_distance_m: distance of the array at its first and at its newest packet in m, as the
    # receiver finds it
    first_distance_m: float
    last_frame: int = 0
    last_distance_m: float = 0.0
    # Number of packets counted so far
    packets: int = 0
    # Codewords read and not read, by layer
    layers: dict[str, LayerTally] = field(default_factory=lambda: {name: LayerTally() for name in LAYERS})
    # True if any packet so far has a decoded codeword; the array's identity is uncertain otherwise
    confirmed: bool = False

    def add(self, packet: Packet) -> None:
        """Count a packet."""
        self.last_frame, self.last_distance_m = packet.last_frame, packet.distance_m
        self.packets += 1
        self.confirmed |= packet.has_codeword
        for name, words in packet.layers.items():
            tally = self.layers[name]
            for word in words:
                tally.ok += word.status == "ok"
                tally.failed += word.status != "ok"
                tally.bytes += len(word.block.payload) if word.block else 0


class Reception:
    """Gathers packets to messages and counts."""

    def __init__(self, truth: TruthSource | None = None, files: FileGatherer | None = None):
        self.arrays: dict[int, ArrayTally] = {}
        self.frames = 0
        self.detections = 0
        self.left_out = SearchLoad()
        self.missed_starts: list[dict[str, Any]] = []
        self.errors = ErrorCounter(truth.settings, truth.messages) if truth else None
        self._truths = truth.frames() if truth else None
        self._reassembler = Reassembler()
        self.files = files or FileGatherer()
        self.progress: tuple[FileProgress, ...] = ()
        self.file_rows: dict[FileKey, dict[str, Any]] = {}

    def saw(self, index: int) -> None:
        """Take the number of a frame; the truth moves on with it."""
        self.frames += 1
        if self._truths is None or self.errors is None:
            return
        for truth in self._truths:
            self.errors.saw(truth.time_s, truth.distances_m, truth.visible)
            if truth.index >= index:
                break

    def found(self, detection: Detection) -> None:
        """Count a detection."""
        self.detections += 1
        if self.errors is not None:
            for one in detection.hypotheses:
                self.errors.found(one.identity, one.start_time_s)

    def add(self, packet: Packet) -> Iterator[Message]:
        """Count a packet and yield the messages it completes."""
        self.progress = ()
        if not is_packet(packet):
            return
        if self.errors is not None:
            self.errors.received(packet)
        new = ArrayTally(packet.first_frame, packet.distance_m)
        self.arrays.setdefault(packet.identity, new).add(packet)
        for words in packet.layers.values():
            yield from _completed(self._reassembler, words)
        self.progress = tuple(self._gathered(packet))

    def _gathered(self, packet: Packet) -> Iterator[FileProgress]:
        """What is there of each file of which a packet has new symbols."""
        blocks = (word.block for words in packet.layers.values() for word in words)
        found = [self.files.add(block) for block in blocks if block is not None and not isinstance(block, Block)]
        for one in {one.key: one for one in found if one is not None}.values():
            self.file_rows[one.key] = {
                "file": str(one.key), "bytes": one.key.length, "symbols": one.had, "needed": one.key.count,
                "whole": one.whole is not None,
            }  # fmt: skip
            yield one

    @property
    def confirmed(self) -> set[int]:
        """Identities of the arrays of which a codeword is decoded."""
        return {identity for identity, tally in self.arrays.items() if tally.confirmed}

    def unfinished(self) -> list[tuple[int, str, int, int, int]]:
        """Messages that lack segments: (identity, layer, stream, bytes received, bytes in all)."""
        return self._reassembler.unfinished()

    def report(self, seconds: float) -> dict[str, Any]:
        """All counts as plain values, for JSON."""
        tallies = sorted(self.arrays.items())
        out: dict[str, Any] = {
            "frames": self.frames,
            "seconds": round(seconds, 3),
            "frames_per_second": round(self.frames / max(seconds, 1e-9), 1),
            "detections": self.detections,
            "dropped_candidates": self.left_out.dropped,
            "dropped_blocks": self.left_out.blocks,
            "arrays": [_plain(identity, tally) for identity, tally in tallies if tally.confirmed],
            "uncertain": [_plain(identity, tally) for identity, tally in tallies if not tally.confirmed],
            "missed_starts": list(self.missed_starts),
            "unfinished": [
                dict(zip(("id", "layer", "stream", "had", "bytes"), row, strict=True)) for row in self.unfinished()
            ],
            "files": list(self.file_rows.values()),
        }
        if self.errors is not None:
            out["errors"] = self.errors.report()
            out["false_packets"] = self.errors.false_packets
            out["false_codewords"] = self.errors.false_codewords
        return out


def receive_film(
    film: FrameSource,
    signal: SignalSettings,
    settings: LinkSettings,
    reception: Reception,
    observe: AnyObserver | None = None,
    progress: FrameProgress = silent,
) -> Iterator[tuple[Packet, list[Message]]]:
    """Packets of a film, each with the messages it completes, as soon as they are read; all are counted."""

    def counted(event: Any) -> None:
        if isinstance(event, DetectEvent):
            reception.found(event.detection)
        elif isinstance(event, MissedStartEvent):
            reception.missed_starts.append({"id": event.identity, "time_s": round(event.time_s, 6)})
        elif isinstance(event, DropEvent):
            reception.left_out += event.load
        if observe is not None:
            observe(event)

    receiver = make_receiver(signal, settings.receive, counted)
    for packet in read_packets(_Counted(film, reception, progress), signal, receiver):
        yield packet, list(reception.add(packet))


@dataclass(frozen=True, slots=True)
class _Counted:
    """A film whose frames are counted as they are taken."""

    film: FrameSource
    reception: Reception
    progress: FrameProgress

    @property
    def path(self) -> Path | str:
        return self.film.path

    def __iter__(self) -> Iterator[Frame]:
        for frame in self.film:
            self.reception.saw(frame.index)
            yield frame
            self.progress(self.reception.frames)


def _completed(reassembler: Reassembler, words: Iterable[Codeword]) -> Iterator[Message]:
    for word in words:
        message = reassembler.add(word.block, payload_bytes(word.bits.size)) if word.block else None
        if message is not None:
            yield message


def _plain(identity: int, tally: ArrayTally) -> dict[str, Any]:
    distances = {name: round(getattr(tally, name), 3) for name in ("first_distance_m", "last_distance_m")}
    plain = {"id": identity, **asdict(tally), **distances}
    del plain["confirmed"]
    return plain
