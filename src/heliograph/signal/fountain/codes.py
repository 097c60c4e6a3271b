"""Fountain codes by name and by block field number (section 8.1)."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal, Protocol

from heliograph.signal.fountain import cauchy, raptor

CodeName = Literal["cauchy", "raptorq"]

MOST_SYMBOLS = 1 << 15
"""Maximum source symbols per file (section 8.1): half of the smallest number range; the other half is for repair."""


class Encoder(Protocol):
    """Symbol encoder for a file."""

    @property
    def count(self) -> int:
        """Number of source symbols; about as many different symbols reconstruct the file."""

    def symbol(self, number: int) -> bytes:
        """Return the bytes of a symbol; numbers start at 0."""


@dataclass(frozen=True, slots=True)
class FountainCode:
    """Fountain code for file symbols.

    Attributes
    ----------
    number
        Code number in a block.
    alignment, least
        Symbol size in bytes: a multiple of `alignment`, at least `least`.
    most_bytes
        Maximum file length in bytes.
    numbers
        Number of different symbols.
    encoder
        Factory for a symbol encoder from file bytes and symbol size.
    decode
        Function from symbols by number, file length and symbol size to the file bytes, possibly zero-padded; returns
        None if the symbols are insufficient.
    """

    number: int
    alignment: int
    least: int
    most_bytes: int
    numbers: int
    encoder: Callable[[bytes, int], Encoder]
    decode: Callable[[Mapping[int, bytes], int, int], bytes | None]

    def fits(self, length: int, size: int) -> bool:
        """Return True if the code supports a file length and a symbol size in bytes."""
        aligned = size >= self.least and size % self.alignment == 0
        return aligned and 0 < length <= min(self.most_bytes, MOST_SYMBOLS * size)


def _cauchy(symbols: Mapping[int, bytes], length: int, size: int) -> bytes:
    return cauchy.decode(symbols, -(-length // size))


CODES: Mapping[CodeName, FountainCode] = {
    "cauchy": FountainCode(0, cauchy.WORD_BYTES, cauchy.WORD_BYTES, (1 << 24) - 1, cauchy.NUMBERS, cauchy.CauchyEncoder,
                           _cauchy),
    "raptorq": FountainCode(1, raptor.ALIGNMENT, raptor.LEAST_BYTES, raptor.MOST_BYTES, raptor.NUMBERS,
                            raptor.RaptorEncoder, raptor.decode),
}  # fmt: skip
"""Codes by name. Every receiver supports "cauchy"; "raptorq" requires the package raptorq."""

BY_NUMBER = {code.number: code for code in CODES.values()}
"""Codes by block field number."""
