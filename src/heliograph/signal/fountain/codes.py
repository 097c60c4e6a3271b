"""Codes that make symbols of a file, by name and by the number that a block has (section 8.1)."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal, Protocol

from heliograph.signal.fountain import cauchy, raptor

CodeName = Literal["cauchy", "raptorq"]

MOST_SYMBOLS = 1 << 15
"""Most symbols of a file (section 8.1): half of the numbers that a code has at least, so that as many repair it."""


class Encoder(Protocol):
    """Symbols of one file."""

    @property
    def count(self) -> int:
        """Number of source symbols: about as many different symbols reconstruct the file."""

    def symbol(self, number: int) -> bytes:
        """Return a symbol's bytes.

        Parameters
        ----------
        number
            Number of the symbol, from 0.
        """


@dataclass(frozen=True, slots=True)
class FountainCode:
    """A code that makes symbols of a file.

    Attributes
    ----------
    number
        Number of the code in a block.
    alignment, least
        Bytes of a symbol: a multiple of the first, at least the second.
    most_bytes
        Most bytes of a file.
    numbers
        Symbols by number that there may be.
    encoder
        Makes the symbols of a file of its bytes and the bytes of a symbol.
    decode
        Takes symbols by number, bytes of the file and of a symbol; returns the file's bytes, maybe with zeros behind,
        or None where they are not enough.
    """

    number: int
    alignment: int
    least: int
    most_bytes: int
    numbers: int
    encoder: Callable[[bytes, int], Encoder]
    decode: Callable[[Mapping[int, bytes], int, int], bytes | None]

    def fits(self, length: int, size: int) -> bool:
        """Whether a file can have symbols of a size.

        Parameters
        ----------
        length
            Bytes of the file.
        size
            Bytes of a symbol.
        """
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
"""Codes by name. Every receiver reads "cauchy"; "raptorq" needs the package of that name."""

BY_NUMBER = {code.number: code for code in CODES.values()}
"""Codes by the number that a block has."""
