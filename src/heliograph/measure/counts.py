"""Error counts by layer of a packet, a film or a sweep."""

import operator
from collections.abc import Iterable, Mapping
from dataclasses import asdict, astuple, dataclass, field, fields
from typing import Annotated, Any, Self

from pydantic import Field, TypeAdapter, ValidationError

from heliograph.measure.statistics import Clustered, Count
from heliograph.signal.settings import LAYERS

MAX_NUMBER = 1e12  # upper bound of seconds and metres in a file
TICK_S = 1e-4  # resolution of counted times in s
BUDGET_S = 0.1  # longest time in s between the end of a packet and the output of a timely packet

Number = Annotated[int, Field(strict=True, ge=0, lt=2**63)]
Amount = Annotated[float, Field(strict=True, ge=0, lt=MAX_NUMBER)]
# Number of times by value; the values in `TICK_S` are texts, the keys of JSON
Histogram = Mapping[Annotated[str, Field(pattern=r"^\d{1,15}$")], Number]


@dataclass(frozen=True, slots=True)
class LayerCounts:
    """Counts of a layer; codeword errors include missed codewords."""

    # Information bits of received packets after the turbo decoder
    bits: Number = 0
    bit_errors: Number = 0
    # Coded bits of received packets by the first equalisation
    raw_bits: Number = 0
    raw_errors: Number = 0
    # Sent codewords, wrong codewords, and codewords of missed packets
    codewords: Number = 0
    codeword_errors: Number = 0
    missed: Number = 0
    # Received packets with counted bits; packets decoded in a wrong format are excluded
    packets: Number = 0
    # Sums of squared errors per packet, for the clustering of errors
    bit_squares: Number = 0
    raw_squares: Number = 0
    # Coded bits by the last equalisation, see `Codeword.final_raw`
    final_raw_bits: Number = 0
    final_raw_errors: Number = 0
    final_raw_squares: Number = 0
    # Sent packets, and the sum of squared wrong codewords per packet
    sent_packets: Number = 0
    word_squares: Number = 0

    @classmethod
    def of_packet(cls, bits: Count, raw: Count, words: Count, final_raw: Count | None = None) -> Self:
        """Return the counts of a received packet."""
        last = final_raw or raw
        trials = (bits.trials, bits.errors, raw.trials, raw.errors, words.trials, words.errors, 0)
        squares = (bits.errors**2, raw.errors**2)
        return cls(
            *trials, int(bits.trials > 0), *squares, last.trials, last.errors, last.errors**2, 1, words.errors**2
        )

    @classmethod
    def of_missed(cls, codewords: int, packets: int = 1) -> Self:
        """Return the counts of missed packets of equal size."""
        counts = {"codewords": codewords, "codeword_errors": codewords, "missed": codewords}
        return cls(**counts, sent_packets=packets, word_squares=codewords**2 // packets)

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
    def words(self) -> Clustered:
        """Sent and wrong codewords; the codewords of a packet fail together."""
        return Clustered(self.codewords, self.codeword_errors, self.sent_packets, self.word_squares)


Layers = Mapping[str, LayerCounts]  # counts by layer


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
    bins: Mapping[Amount, Layers] = field(default_factory=dict)
    # Payload of decoded codewords in bits by layer
    payload_bits: Mapping[str, Number] = field(default_factory=lambda: dict.fromkeys(LAYERS, 0))
    # Complete packets in the film, and packets with a detected header or decoded data
    packets: Number = 0
    detected: Number = 0
    # Accepted codewords that were not sent
    false_codewords: Number = 0
    # Received packets that were not sent, and packets received again
    false_packets: Number = 0
    duplicates: Number = 0
    # Length of the film in s
    film_s: Amount = 0.0
    # Received frames, dropped frames excluded
    frames: Number = 0
    # Received packets with a distance, and the sum of their squared relative errors
    distances: Number = 0
    distance_squares: Amount = 0.0
    # Decoded packets with poses in space, and those whose 95 % regions hold the true position and the true pose
    posed: Number = 0
    covered_positions: Number = 0
    covered_poses: Number = 0
    # Processor time of the receiver in s
    receiver_s: Amount = field(default=0.0, compare=False)
    # Received packets without a codeword of identities that no array has, and detections of no array
    uncertain_packets: Number = 0
    false_detections: Number = 0
    # Payload of correct codewords in bits, in packets received within `BUDGET_S`
    timely_bits: Number = 0
    # Received packets within half an array of the true position, with the sum of their errors in px, and beyond
    located: Number = 0
    misplaced: Number = 0
    position_px: Amount = 0.0
    # Arrays with a complete packet, and times from the first view to the first packet with a correct codeword
    arrays: Number = 0
    acquisition: Histogram = field(default_factory=dict)
    # Times from the start of a packet to the output of the packet, with a correct codeword
    latency: Histogram = field(default_factory=dict)
    # Processor times from the frame to the output of a packet with a codeword
    processing: Histogram = field(default_factory=dict, compare=False)

    @property
    def codewords(self) -> int:
        """Sent codewords of all layers."""
        return sum(layer.codewords for layer in self.layers.values())

    def __add__(self, other: "BlockCounts") -> "BlockCounts":
        starts = dict.fromkeys([*self.bins, *other.bins])
        names = [part.name for part in fields(self)[2:]]
        return BlockCounts(
            pooled([self.layers, other.layers]),
            {start: pooled(part.bins[start] for part in (self, other) if start in part.bins) for start in starts},
            **{name: _sum(getattr(self, name), getattr(other, name)) for name in names},
        )

    def to_plain(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        plain = asdict(self)
        return {**plain, "bins": [[start, layers] for start, layers in sorted(plain["bins"].items())]}

    @staticmethod
    def from_plain(plain: Mapping[str, Any]) -> "BlockCounts":
        """Return counts from the result of `to_plain`; raise ValueError for invalid counts."""
        try:
            block = _BLOCK.validate_python({**plain, "bins": dict(plain["bins"])})
            parts = [block.layers, *block.bins.values()]
            # a missing or unknown name changes the plain values
            names_match = block.to_plain() == plain
            names_match &= all(set(names) == set(LAYERS) for names in (block.payload_bits, *parts))
        except ValidationError as error:
            raise ValueError(f"{error.errors()[0]['loc'][-1]}: {error.errors()[0]['msg']}") from None
        except (TypeError, LookupError):
            names_match = False
        if not names_match:
            raise ValueError("the counts have missing or unknown names")
        if block.detected > block.packets:
            raise ValueError("more packets are detected than were sent")
        for counts in (layer for part in parts for layer in part.values()):
            kinds = (counts.decoded, counts.raw, counts.final_raw, counts.words)
            errors_fit = all(kind.errors <= kind.trials and kind.squares <= kind.errors**2 for kind in kinds)
            words_fit = counts.missed <= counts.codeword_errors <= counts.codewords
            if not (errors_fit and words_fit and counts.packets <= counts.bits):
                raise ValueError("more errors than trials")
        return block


def ticks(time_s: float) -> str:
    """Return the key of a time in a histogram."""
    return str(round(max(time_s, 0.0) / TICK_S))


def _sum(one: Any, other: Any) -> Any:
    """Return the sum of two numbers or histograms."""
    if isinstance(one, Mapping):
        return {key: one.get(key, 0) + other.get(key, 0) for key in {**one, **other}}
    return one + other


_BLOCK = TypeAdapter(BlockCounts)
