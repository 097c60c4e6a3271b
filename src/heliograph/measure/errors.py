"""Error counting: packets received against packets sent, by layer and distance."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.link.settings import LinkSettings
from heliograph.link.simulate import Messages, transmitters
from heliograph.measure.counts import LayerCounts, Layers, no_errors, pooled
from heliograph.measure.statistics import Count
from heliograph.receive import Packet
from heliograph.receive.decode.codeword import ERASED
from heliograph.signal.block import pack
from heliograph.transmit import Transmitter

BIN_M = 5.0
"""Width of a distance bin in m."""


@dataclass(slots=True)
class _Sent:
    """A packet an array sent while it was filmed."""

    frames: int = 0
    hidden: int = 0
    distance_m: float = 0.0
    """At the frame nearest to its middle, which is `off_middle` of the packet away."""
    off_middle: float = 1.0
    counts: Layers = field(default_factory=dict)
    """Of the best reception of it; empty if nothing was received."""
    right: int = 0
    """Codewords read rightly in it."""
    found: bool = False
    """Whether the receiver found its header."""


class ErrorCounter:
    """Compares packets with the truth."""

    def __init__(self, settings: LinkSettings, messages: Sequence[Messages]):
        self._settings = settings
        self._senders = transmitters(settings, messages)
        self._sent: list[dict[int, _Sent]] = [{} for _ in self._senders]
        self.false_packets = 0
        self.uncertain_packets = 0
        self.false_codewords = 0
        self.duplicates = 0
        self._last_s: float | None = None
        self._seen_s: list[float] = []

    def saw(self, time_s: float, distances_m: Sequence[float], visible: Sequence[bool]) -> None:
        """Take the truth of a frame; frames come in the order of time."""
        lost, self._last_s = self._lost_before(time_s), time_s
        self._seen_s.append(time_s)
        for array, (distance, in_view) in enumerate(zip(distances_m, visible, strict=True)):
            number, place = self._packet_at(array, time_s)
            if number < 0:
                continue
            sent = self._sent[array].setdefault(number, _Sent())
            sent.frames += 1
            for missing_s in lost:
                # sent and filmed all the same
                before = self._sent[array].get(self._packet_at(array, missing_s)[0])
                if before is not None:
                    before.frames += 1
            sent.hidden += not in_view
            if abs(place - 0.5) < sent.off_middle:
                sent.distance_m, sent.off_middle = distance, abs(place - 0.5)

    def found(self, identity: int, start_time_s: float) -> None:
        """Take a header that the receiver found; one that was not sent is not looked at."""
        sent = self._sent_at(identity, start_time_s)
        if sent is not None:
            sent[2].found = True

    def received(self, packet: Packet) -> None:
        """Count a packet against the truth."""
        place = self._sent_at(packet.identity, packet.start_time_s)
        if place is None:
            self._count_false(packet)
            return
        array, number, sent = place
        counts, right = self._compare(self._senders[array], number, packet)
        self.duplicates += bool(sent.counts)
        if not sent.counts or right > sent.right:
            sent.counts, sent.right = counts, right

    def bins(self) -> dict[float, Layers]:
        """Errors by the lower edge of the distance bin and by layer, near first; missed packets counted.

        A packet filmed whole counts as missed until it is received. One cut off by the end of the film is left out,
        whatever was read of it.
        """
        bins: dict[int, list[Layers]] = {}
        for array, number, sent in self._counted():
            layers = sent.counts or self._missed(array, number)
            bins.setdefault(int(sent.distance_m // BIN_M), []).append(layers)
        return {key * BIN_M: pooled(bins[key]) for key in sorted(bins)}

    def detected(self) -> tuple[int, int]:
        """Number of packets that `bins` count, and of those whose header was found or of which anything was read."""
        found = [bool(sent.counts) or sent.found for _, _, sent in self._counted()]
        return len(found), sum(found)

    def report(self) -> list[dict[str, Any]]:
        """The bins as plain values, for JSON."""
        rows = []
        for start, layers in self.bins().items():
            rows.append({"from_m": start, "to_m": start + BIN_M, **{n: _plain(c) for n, c in layers.items()}})
        return rows

    def total(self) -> Layers:
        """All bins together, by layer."""
        return pooled(self.bins().values())

    def _counted(self) -> Iterator[tuple[int, int, _Sent]]:
        """Packets that are counted: array, number of the packet, and what was received of it."""
        for array, packets in enumerate(self._sent):
            for number, sent in packets.items():
                if self._whole(array, sent) and (sent.counts or not sent.hidden):
                    yield array, number, sent

    def _sent_at(self, identity: int, start_time_s: float) -> tuple[int, int, _Sent] | None:
        """Array, number and record of the packet that begins at a time of the camera's clock; None if none does."""
        if identity not in self._settings.transmit.identities:
            return None
        array = self._settings.transmit.identities.index(identity)
        number, _ = self._packet_at(array, self._true_time(start_time_s) + 0.5 * self._packet_s(array))
        sent = self._sent[array].get(number)
        return None if sent is None else (array, number, sent)

    def _compare(self, sender: Transmitter, number: int, packet: Packet) -> tuple[Layers, int]:
        """Counts of a packet, and how many of its codewords are right; false ones are counted."""
        layers, right = no_errors(), 0
        for name, words in packet.layers.items():
            code, blocks = sender.format_of(number).layers[name].code, sender.blocks(number)[name]
            if len(words) != len(blocks) or words[0].bits.size != code.k or words[0].raw.size != code.length:
                # taken for a packet of another format: nothing of it was read
                self.false_codewords += sum(word.status == "ok" for word in words)
                layers[name] = LayerCounts.of_packet(Count(), Count(), Count(len(blocks), len(blocks)))
                continue
            bits, raw, final_raw, sent_words = Count(), Count(), Count(), Count()
            for word, block in zip(words, blocks, strict=True):
                sent = pack(block, code.k)
                wrong = int(np.count_nonzero(word.bits != sent))
                coded = code.encode(sent)
                _compare_raw(raw, word.raw, coded)
                _compare_raw(final_raw, word.raw if word.final_raw is None else word.final_raw, coded)
                bits.add(code.k, wrong)
                sent_words.add(1, wrong > 0 or word.status != "ok")
                right += word.status == "ok" and wrong == 0
                self.false_codewords += word.status == "ok" and wrong > 0
            layers[name] = LayerCounts.of_packet(bits, raw, sent_words, final_raw)
        return layers, right

    def _missed(self, array: int, number: int) -> Layers:
        """Counts of a packet of which nothing was received."""
        layers = self._senders[array].format_of(number).layers
        return {name: LayerCounts.of_missed(layer.codewords) for name, layer in layers.items()}

    def _count_false(self, packet: Packet) -> None:
        if not packet.has_codeword and packet.identity not in self._settings.transmit.identities:
            self.uncertain_packets += 1
            return
        self.false_packets += 1
        self.false_codewords += sum(word.status == "ok" for words in packet.layers.values() for word in words)

    def _whole(self, array: int, sent: _Sent) -> bool:
        """Whether the packet was filmed from its first pattern to its last."""
        return sent.frames >= self._packet_s(array) * self._settings.channel.camera.fps - 1

    def _lost_before(self, time_s: float) -> list[float]:
        """Times of the frames dropped between the last one and this."""
        period = self._settings.channel.camera.frame_period_s
        steps = 1 if self._last_s is None else round((time_s - self._last_s) / period)
        return [time_s - k * period for k in range(1, steps)]

    def _packet_s(self, array: int) -> float:
        return self._settings.signal.packet_s * (1 + self._settings.channel.arrays[array].clock_ppm * 1e-6)

    def _true_time(self, time_s: float) -> float:
        """True time of what the camera's clock calls `time_s`."""
        camera = self._settings.channel.camera
        if not camera.gaps:
            # the clock ticks with each frame delivered
            tick = round((time_s - camera.start_s) * camera.fps)
            place = min(max(tick, 0), len(self._seen_s) - 1)
            return self._seen_s[place] + (tick - place) * camera.frame_period_s
        return camera.start_s + (time_s - camera.start_s) * (1 + camera.clock_ppm * 1e-6)

    def _packet_at(self, array: int, time_s: float) -> tuple[int, float]:
        """Number of the packet shown at a time, and the fraction of it that is over."""
        place = self._settings.channel.arrays[array]
        # a frame that starts with a pattern must not fall before it by rounding
        number, over = divmod((time_s + 1e-7 - place.start_s) / self._packet_s(array), 1.0)
        return int(number), over


def _compare_raw(count: Count, decided: NDArray[np.uint8], coded: NDArray[np.uint8]) -> None:
    """Count coded bits that were received, and the wrong ones of them."""
    known = decided != ERASED
    count.add(int(known.sum()), int(np.count_nonzero((decided != coded) & known)))


def _plain(counts: LayerCounts) -> Mapping[str, Any]:
    return {
        "bits": counts.bits,
        "errors": counts.bit_errors,
        "raw_bits": counts.raw_bits,
        "raw_errors": counts.raw_errors,
        "codewords": counts.codewords,
        "codeword_errors": counts.codeword_errors,
        "missed": counts.missed,
    }
