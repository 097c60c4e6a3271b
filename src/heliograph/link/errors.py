"""Error counting: packets received against packets sent, by layer and distance."""

from collections.abc import Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from heliograph.link.settings import LinkSettings
from heliograph.link.simulate import Messages, transmitters
from heliograph.link.statistics import Count
from heliograph.receive import Codeword, Packet
from heliograph.receive.decode import ERASED
from heliograph.signal.block import pack
from heliograph.signal.settings import LAYERS
from heliograph.transmit import Transmitter

BIN_M = 5.0
"""Width of a distance bin in m."""


@dataclass(slots=True)
class LayerErrors:
    """Errors of a layer.

    Attributes
    ----------
    bits
        Information bits after the turbo decoder, of received packets.
    raw
        Coded bits before it, of received packets.
    codewords
        Codewords sent; an error is one not read rightly, missed ones included.
    missed
        Codewords of packets that were not received at all.
    """

    bits: Count = field(default_factory=Count)
    raw: Count = field(default_factory=Count)
    codewords: Count = field(default_factory=Count)
    missed: int = 0


_Bins = dict[int, dict[str, LayerErrors]]


@dataclass(slots=True)
class _Sent:
    """A packet an array sent while it was filmed."""

    frames: int = 0
    hidden: int = 0
    distance_m: float = 0.0
    """At the frame nearest to its middle, which is `off_middle` of the packet away."""
    off_middle: float = 1.0
    received: bool = False
    early: _Bins = field(default_factory=dict)
    """Errors of a packet handed out before its last frame was filmed."""


class ErrorCounter:
    """Compares packets with the truth.

    Parameters
    ----------
    settings
        The link as simulated.
    messages
        What each array sent.
    """

    def __init__(self, settings: LinkSettings, messages: Sequence[Messages]):
        self._settings = settings
        self._senders = transmitters(settings, messages)
        self._sent: list[dict[int, _Sent]] = [{} for _ in self._senders]
        self._bins: _Bins = {}
        self.false_codewords = 0
        """Codewords passed as right that were not sent so: there must be none."""

    def saw(self, time_s: float, distances_m: Sequence[float], visible: Sequence[bool]) -> None:
        """Take the truth of a frame: the time of its exposure and where the arrays were."""
        for array, (distance, in_view) in enumerate(zip(distances_m, visible, strict=True)):
            number, place = self._packet_at(array, time_s)
            if number < 0:
                continue
            sent = self._sent[array].setdefault(number, _Sent())
            sent.frames += 1
            sent.hidden += not in_view
            if abs(place - 0.5) < sent.off_middle:
                sent.distance_m, sent.off_middle = distance, abs(place - 0.5)

    def received(self, packet: Packet) -> None:
        """Take a packet; the truth up to its last frame must have been seen."""
        if packet.identity not in self._settings.transmit.identities:
            self._count_false(packet)
            return
        array = self._settings.transmit.identities.index(packet.identity)
        number, _ = self._packet_at(array, self._true_time(packet.start_time_s) + 0.5 * self._packet_s(array))
        sent = self._sent[array].get(number)
        if sent is None or sent.received:
            self._count_false(packet)
            return
        sent.received = True
        if not self._whole(array, sent):
            sent.early = self._bins_of(array, number, sent, packet)
            return
        _merge(self._bins, self._bins_of(array, number, sent, packet))

    def bins(self) -> dict[float, dict[str, LayerErrors]]:
        """Errors by the lower edge of the distance bin and by layer, near first; missed packets counted.

        A packet filmed whole and not received so far counts as missed, for now: it may still come. One cut off by the
        end of the film is left out, whatever was read of it.
        """
        bins = deepcopy(self._bins)
        for array, packets in enumerate(self._sent):
            for sent in packets.values():
                if sent.early and self._whole(array, sent):
                    _merge(bins, sent.early)
                if not sent.received and not sent.hidden and self._whole(array, sent):
                    self._count_missed(bins, array, sent)
        return {key * BIN_M: bins[key] for key in sorted(bins)}

    def report(self) -> list[dict[str, Any]]:
        """The bins as plain values, for JSON."""
        rows = []
        for start, layers in self.bins().items():
            rows.append({"from_m": start, "to_m": start + BIN_M, **{n: _plain(e) for n, e in layers.items()}})
        return rows

    def total(self) -> dict[str, LayerErrors]:
        """All bins together, by layer."""
        return pooled(self.bins().values())

    def _compare(
        self, sender: Transmitter, number: int, errors: LayerErrors, layer: str, words: Sequence[Codeword]
    ) -> None:
        code = sender.format.layers[layer].code
        for word, block in zip(words, sender.blocks(number)[layer], strict=True):
            sent = pack(block, code.k)
            wrong = int(np.count_nonzero(word.bits != sent))
            known = word.raw != ERASED
            errors.raw.add(int(known.sum()), int(np.count_nonzero((word.raw != code.encode(sent)) & known)))
            errors.bits.add(code.k, wrong)
            errors.codewords.add(1, wrong > 0 or word.status != "ok")
            self.false_codewords += word.status == "ok" and wrong > 0

    def _count_missed(self, bins: _Bins, array: int, sent: _Sent) -> None:
        for name, layer in self._senders[array].format.layers.items():
            errors = _errors(bins, sent, name)
            errors.codewords.add(layer.codewords, layer.codewords)
            errors.missed += layer.codewords

    def _count_false(self, packet: Packet) -> None:
        self.false_codewords += sum(word.status == "ok" for words in packet.layers.values() for word in words)

    def _bins_of(self, array: int, number: int, sent: _Sent, packet: Packet) -> _Bins:
        """Errors of one packet."""
        bins: _Bins = {}
        for name, words in packet.layers.items():
            self._compare(self._senders[array], number, _errors(bins, sent, name), name, words)
        return bins

    def _whole(self, array: int, sent: _Sent) -> bool:
        """Whether the packet was filmed from its first pattern to its last."""
        return sent.frames >= self._packet_s(array) * self._settings.channel.camera.fps - 1

    def _packet_s(self, array: int) -> float:
        return self._settings.signal.packet_s * (1 + self._settings.channel.arrays[array].clock_ppm * 1e-6)

    def _true_time(self, time_s: float) -> float:
        """True time of what the camera's clock calls `time_s`."""
        camera = self._settings.channel.camera
        return camera.start_s + (time_s - camera.start_s) * (1 + camera.clock_ppm * 1e-6)

    def _packet_at(self, array: int, time_s: float) -> tuple[int, float]:
        """Number of the packet shown at a time, and how much of it is over."""
        place = self._settings.channel.arrays[array]
        # a frame that starts with a pattern must not fall before it by rounding
        number, share = divmod((time_s + 1e-7 - place.start_s) / self._packet_s(array), 1.0)
        return int(number), share


def _merge(bins: _Bins, more: _Bins) -> None:
    """Add errors to bins."""
    for key, layers in more.items():
        bins[key] = pooled([bins.get(key, {}), layers])


def _errors(bins: _Bins, sent: _Sent, layer: str) -> LayerErrors:
    """Where the errors of a packet's layer are counted."""
    return bins.setdefault(int(sent.distance_m // BIN_M), {name: LayerErrors() for name in LAYERS})[layer]


def pooled(bins: Any) -> dict[str, LayerErrors]:
    """Sum of several bins, by layer."""
    out = {name: LayerErrors() for name in LAYERS}
    for layers in bins:
        for name, errors in layers.items():
            for kind in ("bits", "raw", "codewords"):
                count = getattr(errors, kind)
                getattr(out[name], kind).add(count.trials, count.errors)
            out[name].missed += errors.missed
    return out


def _plain(errors: LayerErrors) -> Mapping[str, Any]:
    return {
        "bits": errors.bits.trials,
        "errors": errors.bits.errors,
        "raw_bits": errors.raw.trials,
        "raw_errors": errors.raw.errors,
        "codewords": errors.codewords.trials,
        "codeword_errors": errors.codewords.errors,
        "missed": errors.missed,
    }
