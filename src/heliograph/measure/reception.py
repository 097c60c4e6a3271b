"""Reception of a film: codewords by array and layer, messages, and errors if the truth is known."""

import contextlib
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Protocol

from heliograph.base.errors import SettingsError, shown
from heliograph.base.frames import Frame
from heliograph.channel.truth import KnownChannel
from heliograph.link.film import FrameProgress, FrameSource, is_packet, read_packets, silent
from heliograph.link.settings import LinkSettings, load_settings, preset
from heliograph.link.truth import FrameTruth, signal_of
from heliograph.measure.counts import ticks
from heliograph.measure.errors import ErrorCounter
from heliograph.media import FilmReader, open_film
from heliograph.receive.api import AnyObserver, choose_receiver, make_receiver
from heliograph.receive.detect.budget import SearchLoad
from heliograph.receive.detect.detection import Detection
from heliograph.receive.events import DetectEvent, DropEvent, MissedStartEvent
from heliograph.receive.packet import Packet, Receiver
from heliograph.signal.block import Block, payload_bytes
from heliograph.signal.fountain.files import FileGatherer, FileKey, FileProgress
from heliograph.signal.message import Message, Reassembler
from heliograph.signal.settings import LAYERS, SignalSettings
from heliograph.transmit import Messages


class TruthSource(Protocol):
    """Truth of a film: a truth file or a live simulation."""

    @property
    def settings(self) -> LinkSettings:
        """Settings of the simulated link."""

    @property
    def messages(self) -> Sequence[Messages]:
        """Messages of each array, in the order of the arrays."""

    def frames(self) -> Iterator[FrameTruth]:
        """Yield the truth of each frame in temporal order."""


@dataclass(slots=True)
class LayerTally:
    """Codewords of a layer."""

    ok: int = 0
    failed: int = 0
    # Payload of decoded codewords in bytes, repetitions included
    bytes: int = 0


@dataclass(slots=True)
class ArrayTally:
    """Packets of an array."""

    # First frame of the first packet; `last_frame`: last frame of the latest packet
    first_frame: int
    # Estimated distance at the first and the latest packet in m
    first_distance_m: float
    last_frame: int = 0
    last_distance_m: float = 0.0
    packets: int = 0
    layers: dict[str, LayerTally] = field(default_factory=lambda: {name: LayerTally() for name in LAYERS})
    # True if a packet has a decoded codeword; otherwise the identity is uncertain
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


class ReceptionCounter:
    """Collector of messages and counts; memory does not grow with the film."""

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
        # Processor time of the receiver in s, and times from a frame to a packet with a codeword
        self.receiver_s = 0.0
        self.processing = Counter[str]()

    def saw(self, index: int) -> None:
        """Count a frame and advance the truth."""
        self.frames += 1
        if self._truths is None or self.errors is None:
            return
        for truth in self._truths:
            self.errors.saw(truth.time_s, truth.distances_m, truth.visible, truth.places, truth.homographies)
            if truth.index >= index:
                break

    def found(self, detection: Detection) -> None:
        """Count a detection."""
        self.detections += 1
        if self.errors is not None:
            self.errors.found((one.identity, one.start_time_s) for one in detection.hypotheses)

    def add(self, packet: Packet) -> Iterator[Message]:
        """Count a packet and yield the completed messages."""
        self.progress = ()
        if not is_packet(packet):
            return
        if self.errors is not None:
            self.errors.received(packet)
        self.arrays.setdefault(packet.identity, ArrayTally(packet.first_frame, packet.distance_m)).add(packet)
        files: dict[FileKey, FileProgress] = {}
        for word in (word for words in packet.layers.values() for word in words):
            if isinstance(word.block, Block):
                message = self._reassembler.add(word.block, payload_bytes(word.bits.size))
                if message is not None:
                    yield message
            elif word.block is not None and (update := self.files.add(word.block)) is not None:
                files[update.key] = update
        self.progress = tuple(files.values())
        self.file_rows |= {key: file_counts(progress) for key, progress in files.items()}

    @property
    def confirmed(self) -> set[int]:
        """Identities of arrays with a decoded codeword."""
        return {identity for identity, tally in self.arrays.items() if tally.confirmed}

    def unfinished(self) -> list[tuple[int, str, int, int, int]]:
        """Return incomplete messages: (identity, layer, stream, received bytes, total bytes)."""
        return self._reassembler.unfinished()

    def report(self, seconds: float) -> dict[str, Any]:
        """Return all counts as plain values for JSON."""
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


def receive_and_count(
    film: FrameSource,
    signal: SignalSettings,
    settings: LinkSettings,
    reception: ReceptionCounter,
    observe: AnyObserver | None = None,
    progress: FrameProgress = silent,
    truth: KnownChannel | None = None,
) -> Iterator[tuple[Packet, list[Message]]]:
    """Receive a film; yield each packet with the completed messages, and count both. Only bounds get the truth."""

    def count_event(event: Any) -> None:
        if isinstance(event, DetectEvent):
            reception.found(event.detection)
        elif isinstance(event, MissedStartEvent):
            reception.missed_starts.append({"id": event.identity, "time_s": round(event.time_s, 6)})
        elif isinstance(event, DropEvent):
            reception.left_out += event.load
        if observe is not None:
            observe(event)

    class CountedFilm:
        path = film.path

        def __iter__(self) -> Iterator[Frame]:
            for frame in film:
                reception.saw(frame.index)
                yield frame
                progress(reception.frames)

    receiver = TimedReceiver(make_receiver(signal, settings.receive, count_event, truth), reception)
    for packet in read_packets(CountedFilm(), signal, receiver):
        yield packet, list(reception.add(packet))


class TimedReceiver:
    """Receiver that reports the processor time to the counter."""

    def __init__(self, receiver: Receiver, reception: ReceptionCounter):
        self._receiver, self._reception = receiver, reception

    def push(self, frame: Frame) -> Iterator[Packet]:
        """Take the next frame; see `Receiver`."""
        return self._timed(lambda: self._receiver.push(frame))

    def finish(self) -> Iterator[Packet]:
        """End the film; see `Receiver`."""
        return self._timed(self._receiver.finish)

    def _timed(self, call: Callable[[], Iterable[Packet]]) -> Iterator[Packet]:
        """Yield the packets of a call; stop the clock while the caller has a packet."""
        began, spent_s = time.process_time(), 0.0
        for packet in call():
            spent_s += time.process_time() - began
            if packet.has_codeword:
                self._reception.processing[ticks(spent_s)] += 1
            yield packet
            began = time.process_time()
        self._reception.receiver_s += spent_s + time.process_time() - began


@dataclass(frozen=True, slots=True)
class Reception:
    """Reception of a film.

    Attributes
    ----------
    receiver
        Name of the receiver.
    messages
        Complete messages, in the order of completion.
    packets
        All packets, also those with failed codewords.
    arrays
        Counts of each array with a decoded codeword, by identity.
    incomplete
        Incomplete messages: identity, layer, stream, received bytes and length in bytes.
    """

    receiver: str
    messages: list[Message]
    packets: list[Packet]
    arrays: dict[int, ArrayTally]
    incomplete: list[tuple[int, str, int, int, int]]


def receive_film(
    film: FilmReader | Path | str,
    settings: LinkSettings | str = "paper",
    receiver: str | None = None,
    observe: AnyObserver | None = None,
) -> Reception:
    """Receive a film.

    The note of a simulated film on its signal overrides `settings`. All packets stay in memory, about 0.1 MB each; for
    films of hours use `receive_frames`.

    Parameters
    ----------
    film
        Path of a film, or an open film.
    settings
        Settings of the link, or the name of a preset.
    receiver
        Name of the receiver; "auto" chooses by the frame rate of the film. If left out, that of the settings, and
        "auto" for a preset that names none.
    observe
        Observer of the events, see `heliograph.receive.events`.

    Raises
    ------
    HeliographError
        The film cannot be read, the settings are invalid, or the receiver refuses the film.

    Examples
    --------
    >>> reception = heliograph.receive_film("drive.mkv")
    >>> [message.data for message in reception.messages]
    [b'red for 12 s']
    """
    link = load_settings(settings) if isinstance(settings, str) else settings
    if not isinstance(link, LinkSettings):
        raise SettingsError(f"settings are LinkSettings or the name of a preset, not {shown(settings)}")
    with contextlib.ExitStack() as closing:
        source = film if isinstance(film, FilmReader) else closing.enter_context(open_film(film, expand_range=True))
        signal, _ = signal_of(source, link.signal)
        if receiver is None and isinstance(settings, str) and "receiver" not in preset(settings).get("receive", {}):
            receiver = "auto"
        if receiver == "auto":
            receiver, _ = choose_receiver(signal, source.rate_hz)
        if receiver is not None:
            link = replace(link, receive=replace(link.receive, receiver=receiver))
        counter, packets, messages = ReceptionCounter(), list[Packet](), list[Message]()
        for packet, complete in receive_and_count(source, signal, link, counter, observe):
            packets.append(packet)
            messages += complete
    arrays = {identity: tally for identity, tally in counter.arrays.items() if tally.confirmed}
    return Reception(link.receive.receiver, messages, packets, arrays, counter.unfinished())


def file_counts(progress: FileProgress) -> dict[str, Any]:
    """Return the progress of a file as plain values."""
    key = progress.key
    counts = {"bytes": key.length, "symbols": progress.had, "needed": key.count}
    return {"file": str(key), **counts, "whole": progress.whole is not None}


def _plain(identity: int, tally: ArrayTally) -> dict[str, Any]:
    distances = {name: round(getattr(tally, name), 3) for name in ("first_distance_m", "last_distance_m")}
    plain = {"id": identity, **asdict(tally), **distances}
    del plain["confirmed"]
    return plain
