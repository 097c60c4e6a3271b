"""Fountain codes by name and by block field number (section 8.1)."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal, Protocol

from heliograph.signal.fountain import cauchy, raptor

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


def _decode_cauchy(symbols: Mapping[int, bytes], length: int, size: int) -> bytes:
    return cauchy.decode(symbols, -(-length // size))


CODES: Mapping[CodeName, FountainCode] = {
    "cauchy": FountainCode(0, 2, 2, (1 << 24) - 1, cauchy.NUMBERS, cauchy.CauchyEncoder, _decode_cauchy),
    # the package aligns symbols to 8 bytes, and splits symbols below 64 bytes and files from 10 MiB on
    "raptorq": FountainCode(1, 8, 64, 1 << 23, 1 << 24, raptor.RaptorEncoder, raptor.decode),
}
"""Codes by name. Every receiver supports "cauchy"; "raptorq" requires the package raptorq."""

BY_NUMBER = {code.number: code for code in CODES.values()}
"""Codes by block field number."""
