"""Fountain codes by name and by block field number (section 8.1): Cauchy, and RaptorQ of the package `raptorq`."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, Protocol

from heliograph.base.errors import HeliographError
from heliograph.signal.fountain import cauchy

CodeName = Literal["cauchy", "raptorq"]


class Encoder(Protocol):
    """Symbol encoder for a file."""

    # Number of source symbols; about as many different symbols reconstruct the file
    count: int
    # Number of different symbols before repetition
    numbers: int

    def symbol(self, number: int) -> bytes:
        """Return the bytes of a symbol; numbers start at 0."""


@dataclass(frozen=True, slots=True)
class FountainCode:
    """Fountain code for file symbols."""

    # Code number in a block
    number: int
    # Symbol sizes are multiples of this number of bytes, at least `min_bytes`
    alignment: int
    min_bytes: int
    # Maximum file length in bytes
    max_bytes: int
    # Number of different symbols
    numbers: int
    # Factory for a symbol encoder from file bytes and symbol size
    encoder: Callable[[bytes, int], Encoder]
    # Function from symbols by number, file length and symbol size to the file bytes, possibly zero-padded; None if the
    # symbols are insufficient
    decode: Callable[[Mapping[int, bytes], int, int], bytes | None]

    def fits(self, length: int, size: int) -> bool:
        """Return True if the code supports a file length and a symbol size in bytes."""
        aligned = size >= self.min_bytes and size % self.alignment == 0
        # at most 2^15 source symbols (section 8.1): half of the smallest number range; the other half is for repair
        return aligned and 0 < length <= min(self.max_bytes, size << 15)


class RaptorEncoder:
    """Symbol encoder for a file; raise a HeliographError if the package `raptorq` is not installed."""

    def __init__(self, data: bytes, size: int):
        self.count = -(-len(data) // size)
        packets = _package().Encoder.with_defaults(data, size).get_encoded_packets(4 * self.count)
        # each packet starts with 4 header bytes: source block number, here 0, and symbol number
        self._symbols = [packet[4:] for packet in packets]
        self.numbers = len(self._symbols)

    def symbol(self, number: int) -> bytes:
        """Return a source symbol, or one of 4 repair symbols per source symbol."""
        return self._symbols[number]


def _decode_raptor(symbols: Mapping[int, bytes], length: int, size: int) -> bytes | None:
    """Decode a file from symbols with `size` bytes each; return None if the symbols are insufficient."""
    decoder = _package().Decoder.with_defaults(length, size)
    for number, data in symbols.items():
        found: bytes | None = decoder.decode(number.to_bytes(4) + data)
        if found is not None:
            return found
    return None


def _package() -> Any:
    try:
        import raptorq
    except ImportError:
        raise HeliographError("RaptorQ needs the package raptorq: pip install 'heliograph[raptorq]'") from None
    return raptorq


CODES: Mapping[CodeName, FountainCode] = {
    "cauchy": FountainCode(
        0,
        2,
        2,
        (1 << 24) - 1,
        cauchy.NUMBERS,
        cauchy.CauchyEncoder,
        lambda symbols, length, size: cauchy.decode(symbols, -(-length // size)),
    ),
    # the package aligns symbols to 8 bytes, and splits symbols below 64 bytes and files from 10 MiB on
    "raptorq": FountainCode(1, 8, 64, 1 << 23, 1 << 24, RaptorEncoder, _decode_raptor),
}
"""Codes by name. Every receiver supports "cauchy"; "raptorq" requires the package raptorq."""

BY_NUMBER = {code.number: code for code in CODES.values()}  # codes by block field number
