"""Error counts by layer of a packet, a film or a sweep."""

import operator
from collections.abc import Iterable, Mapping
from dataclasses import asdict, astuple, dataclass, field
from typing import Any, Self

from heliograph.measure.statistics import Clustered, Count
from heliograph.signal.settings import LAYERS


@dataclass(frozen=True, slots=True)
class LayerCounts:
    """Counts of a layer; codeword errors include missed codewords."""

    # Information bits of received packets after the turbo decoder
    bits: int = 0
    bit_errors: int = 0
    # Coded bits of received packets by the first equalisation
    raw_bits: int = 0
    raw_errors: int = 0
    # Sent codewords, wrong codewords, and codewords of missed packets
    codewords: int = 0
    codeword_errors: int = 0
    missed: int = 0
    # Received packets with counted bits; packets decoded in a wrong format are excluded
    packets: int = 0
    # Sums of squared errors per packet, for the clustering of errors
    bit_squares: int = 0
    raw_squares: int = 0
    # Coded bits by the last equalisation, see `Codeword.final_raw`
    final_raw_bits: int = 0
    final_raw_errors: int = 0
    final_raw_squares: int = 0

    @classmethod
    def of_packet(cls, bits: Count, raw: Count, words: Count, final_raw: Count | None = None) -> Self:
        """Return the counts of a received packet."""
        last = raw if final_raw is None else final_raw
        trials = (bits.trials, bits.errors, raw.trials, raw.errors, words.trials, words.errors, 0)
        squares = (bits.errors**2, raw.errors**2)
        return cls(*trials, int(bits.trials > 0), *squares, last.trials, last.errors, last.errors**2)

    @classmethod
    def of_missed(cls, codewords: int) -> Self:
        """Return the counts of a missed packet."""
        return cls(codewords=codewords, codeword_errors=codewords, missed=codewords)

    def __add__(self, other: "LayerCounts") -> "LayerCounts":
        return LayerCounts(*map(operator.add, astuple(self), astuple(other)))

    def __sub__(self, other: "LayerCounts") -> "LayerCounts":
        return LayerCounts(*map(operator.sub, astuple(self), astuple(other)))

    @property
    def decoded(self) -> Clustered:
        """Information bits after the turbo decoder; a bound for zero errors counts packets."""
        return Clustered(self.bits, self.bit_errors, self.packets, self.bit_squares)

    @property
    def decoded_bits(self) -> Clustered:
        """Information bits after the turbo decoder; a bound for zero errors counts bits, for short films."""
        return Clustered(self.bits, self.bit_errors, self.packets, self.bit_squares, scattered=True)

    @property
    def raw(self) -> Clustered:
        """Coded bits by the first equalisation; a bound for zero errors counts bits."""
        return Clustered(self.raw_bits, self.raw_errors, self.packets, self.raw_squares, scattered=True)

    @property
    def final_raw(self) -> Clustered:
        """Coded bits by the last equalisation; a bound for zero errors counts bits."""
        counts = (self.final_raw_bits, self.final_raw_errors, self.packets, self.final_raw_squares)
        return Clustered(*counts, scattered=True)

    @property
    def words(self) -> Count:
        """Sent and wrong codewords."""
        return Count(self.codewords, self.codeword_errors)

    @property
    def received(self) -> "LayerCounts":
        """Counts of received packets only."""
        return self - LayerCounts.of_missed(self.missed)


Layers = Mapping[str, LayerCounts]
"""Counts by layer."""

MAX_NUMBER = 1e12
"""Upper bound of seconds and metres in a file."""


def no_errors() -> dict[str, LayerCounts]:
    """Return zero counts for each layer."""
    return {name: LayerCounts() for name in LAYERS}


def pooled(parts: Iterable[Layers]) -> dict[str, LayerCounts]:
    """Return the sum of counts by layer."""
    total = no_errors()
    for layers in parts:
        for name, counts in layers.items():
            total[name] = total[name] + counts
    return total


@dataclass(frozen=True, slots=True)
class BlockCounts:
    """Counts of a block, or of several blocks."""

    # Counts of bits and codewords by layer
    layers: Layers = field(default_factory=no_errors)
    # Counts by the lower edge of the distance bin in m
    bins: Mapping[float, Layers] = field(default_factory=dict)
    # Payload of decoded codewords in bits by layer
    payload_bits: Mapping[str, int] = field(default_factory=lambda: dict.fromkeys(LAYERS, 0))
    # Complete packets in the film, and packets with a detected header or decoded data
    packets: int = 0
    detected: int = 0
    # Accepted codewords that were not sent
    false_codewords: int = 0
    # Received packets that were not sent, and packets received again
    false_packets: int = 0
    duplicates: int = 0
    # Length of the film in s
    film_s: float = 0.0
    # Received frames, dropped frames excluded
    frames: int = 0

    @property
    def codewords(self) -> int:
        """Sent codewords of all layers."""
        return sum(layer.codewords for layer in self.layers.values())

    def __add__(self, other: "BlockCounts") -> "BlockCounts":
        starts = dict.fromkeys([*self.bins, *other.bins])
        return BlockCounts(
            pooled([self.layers, other.layers]),
            {start: pooled(part.bins[start] for part in (self, other) if start in part.bins) for start in starts},
            {name: bits + other.payload_bits[name] for name, bits in self.payload_bits.items()},
            self.packets + other.packets,
            self.detected + other.detected,
            self.false_codewords + other.false_codewords,
            self.false_packets + other.false_packets,
            self.duplicates + other.duplicates,
            self.film_s + other.film_s,
            self.frames + other.frames,
        )

    def to_plain(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        plain = asdict(self)
        return {**plain, "bins": [[start, layers] for start, layers in sorted(plain["bins"].items())]}

    @classmethod
    def from_plain(cls, plain: Mapping[str, Any]) -> Self:
        """Return counts from the result of `to_plain`; raise ValueError for invalid counts."""
        try:
            block = cls(
                **{
                    **plain,
                    "layers": {name: LayerCounts(**plain["layers"][name]) for name in LAYERS},
                    "bins": {
                        start: {name: LayerCounts(**layers[name]) for name in LAYERS} for start, layers in plain["bins"]
                    },
                    "payload_bits": {name: plain["payload_bits"][name] for name in LAYERS},
                }
            )
            names_match = block.to_plain() == plain
        except (TypeError, LookupError, AttributeError):
            names_match = False
        if not names_match:
            raise ValueError("the counts have missing or unknown names")
        block._check()
        return block

    def _check(self) -> None:
        """Raise ValueError for impossible counts."""
        layers = [layer for part in (self.layers, *self.bins.values()) for layer in part.values()]
        numbers = [self.packets, self.detected, self.false_codewords, self.false_packets, self.duplicates, self.frames]
        numbers += [*self.payload_bits.values(), *(number for layer in layers for number in astuple(layer))]
        if any(type(number) is not int or not 0 <= number < 2**63 for number in numbers):
            raise ValueError("a count is no whole number from 0")
        if any(type(x) not in (int, float) or not 0 <= x < MAX_NUMBER for x in (self.film_s, *self.bins)):
            raise ValueError("a time or distance is no number from 0")
        if self.detected > self.packets:
            raise ValueError("more packets are detected than were sent")
        for c in layers:
            kinds = (c.decoded, c.raw, c.final_raw)
            errors_fit = all(k.errors <= k.trials and k.squares <= k.errors**2 for k in kinds)
            if not errors_fit or not c.missed <= c.codeword_errors <= c.codewords or c.packets > c.bits:
                raise ValueError("more errors than trials")
