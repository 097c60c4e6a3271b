"""Counts of errors by layer, of a packet, a film or a whole sweep."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from typing import Any, Self

from heliograph.measure.statistics import Clustered, Count
from heliograph.signal.settings import LAYERS


@dataclass(frozen=True, slots=True)
class LayerCounts:
    """Counts of a layer; a codeword is wrong where it was not read rightly, missed ones included."""

    # bits, bit_errors: information bits after the turbo decoder, of received packets
    bits: int = 0
    bit_errors: int = 0
    # raw_bits, raw_errors: coded bits before it, by the first equalisation, of received packets
    raw_bits: int = 0
    raw_errors: int = 0
    # codewords, codeword_errors, missed: codewords sent; those that are wrong; those of packets of which nothing was
    # received, which are wrong too
    codewords: int = 0
    codeword_errors: int = 0
    missed: int = 0
    # Received packets whose bits are in `bits`; one read in another format than it was sent in is not
    packets: int = 0
    # bit_squares, raw_squares: sums over the packets of the squares of their `bit_errors` and `raw_errors`: they show
    # how much errors cluster
    bit_squares: int = 0
    raw_squares: int = 0
    # final_raw_bits, final_raw_errors, final_raw_squares: the same of coded bits by the last equalisation before the
    # decoder; see `Codeword.final_raw`
    final_raw_bits: int = 0
    final_raw_errors: int = 0
    final_raw_squares: int = 0

    @classmethod
    def of_packet(cls, bits: Count, raw: Count, words: Count, final_raw: Count | None = None) -> Self:
        """Counts of one received packet."""
        last = raw if final_raw is None else final_raw
        return cls(
            bits.trials,
            bits.errors,
            raw.trials,
            raw.errors,
            words.trials,
            words.errors,
            packets=int(bits.trials > 0),
            bit_squares=bits.errors**2,
            raw_squares=raw.errors**2,
            final_raw_bits=last.trials,
            final_raw_errors=last.errors,
            final_raw_squares=last.errors**2,
        )

    @classmethod
    def of_missed(cls, codewords: int) -> Self:
        """Counts of a packet of which nothing was received."""
        return cls(codewords=codewords, codeword_errors=codewords, missed=codewords)

    def __add__(self, other: "LayerCounts") -> "LayerCounts":
        return LayerCounts(*(getattr(self, one.name) + getattr(other, one.name) for one in fields(self)))

    def __sub__(self, other: "LayerCounts") -> "LayerCounts":
        return LayerCounts(*(getattr(self, one.name) - getattr(other, one.name) for one in fields(self)))

    @property
    def decoded(self) -> Clustered:
        """Information bits after the turbo decoder; where none is wrong, the bound is by packets."""
        return Clustered(self.bits, self.bit_errors, self.packets, self.bit_squares)

    @property
    def decoded_bits(self) -> Clustered:
        """The same; where none is wrong, the bound is by bits, as a film has too few packets for one by packets."""
        return Clustered(self.bits, self.bit_errors, self.packets, self.bit_squares, scattered=True)

    @property
    def raw(self) -> Clustered:
        """Coded bits by the first equalisation; where none is wrong, the bound is by bits."""
        return Clustered(self.raw_bits, self.raw_errors, self.packets, self.raw_squares, scattered=True)

    @property
    def final_raw(self) -> Clustered:
        """Coded bits by the last equalisation before the turbo decoder; where none is wrong, the bound is by bits."""
        return Clustered(
            self.final_raw_bits, self.final_raw_errors, self.packets, self.final_raw_squares, scattered=True
        )

    @property
    def words(self) -> Count:
        """Codewords sent, and those that are wrong."""
        return Count(self.codewords, self.codeword_errors)

    @property
    def received(self) -> "LayerCounts":
        """The same without the codewords that were missed."""
        return replace(
            self, codewords=self.codewords - self.missed, codeword_errors=self.codeword_errors - self.missed, missed=0
        )


Layers = Mapping[str, LayerCounts]
"""Counts by layer."""

MOST_NUMBER = 1e12
"""Bound of seconds and metres that are read from a file; anything so large was never counted."""


def no_errors() -> dict[str, LayerCounts]:
    """Nothing counted, for each layer."""
    return {name: LayerCounts() for name in LAYERS}


def pooled(parts: Iterable[Layers]) -> dict[str, LayerCounts]:
    """Sum of several counts, by layer."""
    total = no_errors()
    for layers in parts:
        for name, counts in layers.items():
            total[name] = total[name] + counts
    return total


@dataclass(frozen=True, slots=True)
class BlockCounts:
    """Counts of a block, or the sum of several."""

    # Counts of bits and codewords by layer
    layers: Layers = field(default_factory=no_errors)
    # The same by the lower edge in m of the distance bin
    bins: Mapping[float, Layers] = field(default_factory=dict)
    # Payload of the codewords read, in bits, by layer
    payload_bits: Mapping[str, int] = field(default_factory=lambda: dict.fromkeys(LAYERS, 0))
    # packets, detected: packets filmed whole, all arrays; those of them whose header was found, or of which anything
    # was read
    packets: int = 0
    detected: int = 0
    # Codewords accepted as right that were not sent
    false_codewords: int = 0
    # false_packets, duplicates: packets received that were not sent, and those received again
    false_packets: int = 0
    duplicates: int = 0
    # Length of the film in s, by its frames
    film_s: float = 0.0
    # Frames that the receiver took; dropped ones do not count
    frames: int = 0

    @property
    def codewords(self) -> int:
        """Codewords sent, all layers."""
        return sum(layer.codewords for layer in self.layers.values())

    def __add__(self, other: "BlockCounts") -> "BlockCounts":
        starts = dict.fromkeys([*self.bins, *other.bins])
        return BlockCounts(
            pooled([self.layers, other.layers]),
            {start: pooled(one.bins[start] for one in (self, other) if start in one.bins) for start in starts},
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
        """Plain values, for JSON."""
        return {**asdict(self), "bins": [[start, _plain(layers)] for start, layers in sorted(self.bins.items())]}

    @classmethod
    def from_plain(cls, plain: Mapping[str, Any]) -> Self:
        """Counts from plain values: the inverse of `to_plain`."""
        _check_names("a block", plain, {one.name for one in fields(cls)})
        if not isinstance(plain["bins"], Sequence):
            raise ValueError("bins are a list")
        bins = {}
        for one in plain["bins"]:
            if not isinstance(one, Sequence) or len(one) != 2:
                raise ValueError("a bin is its start and its layers")
            bins[_number("the start of a bin", one[0])] = _layers(one[1])
        _check_names("payload_bits", plain["payload_bits"], set(LAYERS))
        payload = {name: _whole(f"payload_bits of {name}", plain["payload_bits"][name]) for name in LAYERS}
        rest = {one.name: _whole(one.name, plain[one.name]) for one in fields(cls) if one.type in (int, "int")}
        if rest["detected"] > rest["packets"]:
            raise ValueError("more packets are detected than were sent")
        film_s = _number("film_s", plain["film_s"])
        return cls(layers=_layers(plain["layers"]), bins=bins, payload_bits=payload, film_s=film_s, **rest)


def _plain(layers: Layers) -> dict[str, Any]:
    return {name: asdict(counts) for name, counts in layers.items()}


def _layers(plain: Any) -> Layers:
    _check_names("layers", plain, set(LAYERS))
    return {name: _layer(name, plain[name]) for name in LAYERS}


def _layer(name: str, plain: Any) -> LayerCounts:
    """Counts of a layer from plain values; a ValueError where they cannot have been counted."""
    _check_names(f"layer {name}", plain, {one.name for one in fields(LayerCounts)})
    found = LayerCounts(**{key: _whole(f"{key} of {name}", value) for key, value in plain.items()})
    within = (
        ("bit_errors", found.bit_errors, found.bits),
        ("raw_errors", found.raw_errors, found.raw_bits),
        ("codeword_errors", found.codeword_errors, found.codewords),
        ("missed", found.missed, found.codeword_errors),
        ("packets", found.packets, found.bits),
        ("bit_squares", found.bit_squares, found.bit_errors**2),
        ("raw_squares", found.raw_squares, found.raw_errors**2),
        ("final_raw_errors", found.final_raw_errors, found.final_raw_bits),
        ("final_raw_squares", found.final_raw_squares, found.final_raw_errors**2),
    )
    for key, value, most in within:
        if value > most:
            raise ValueError(f"{key} of {name} is at most {most}, not {value}")
    return found


def _check_names(what: str, plain: Any, wanted: set[str]) -> None:
    if not isinstance(plain, Mapping):
        raise ValueError(f"{what} has names and values")
    odd = sorted(wanted.symmetric_difference(map(str, plain)))
    if odd:
        raise ValueError(f"{what} {'lacks' if odd[0] in wanted else 'does not have'} '{odd[0][:40]}'")


def _whole(what: str, value: Any) -> int:
    """A count as SQLite and NumPy hold it."""
    if isinstance(value, bool) or not isinstance(value, int) or not 0 <= value < 2**63:
        raise ValueError(f"{what} is a whole number from 0")
    return value


def _number(what: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0 <= value < MOST_NUMBER:
        raise ValueError(f"{what} is a number from 0")
    return float(value)
