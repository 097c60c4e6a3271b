"""A file's symbols by RaptorQ (RFC 6330), of the package `raptorq`: for files of megabytes (section 8.1)."""

from collections.abc import Mapping
from typing import Any

from heliograph.base.errors import HeliographError

NUMBERS = 1 << 24
"""Numbers of symbols: the encoding symbol ID of RFC 6330 has three bytes."""

ALIGNMENT = 8
"""Symbols have a multiple of so many bytes: the package's own choice."""

LEAST_BYTES = 64
"""Least bytes of a symbol: below, the package cuts symbols up."""

MOST_BYTES = 1 << 23
"""Most bytes of a file. From 10 MiB on the package cuts a file into several source blocks."""

REPAIR = 4
"""Repair symbols are sent for so many times the file's own before all come again. Chosen."""


def is_there() -> bool:
    """Whether the package is installed."""
    try:
        _package()
    except HeliographError:
        return False
    return True


class RaptorEncoder:
    """Symbols of a file.

    Parameters
    ----------
    data
        The file's bytes, 1 to `MOST_BYTES`.
    size
        Bytes of a symbol, a multiple of 8, at least 64.

    Raises
    ------
    HeliographError
        The package `raptorq` is not installed.
    """

    def __init__(self, data: bytes, size: int):
        self.count = -(-len(data) // size)
        packets = _package().Encoder.with_defaults(data, size).get_encoded_packets(REPAIR * self.count)
        # the package puts the number of the source block, here 0, and that of the symbol before each
        self._symbols = [packet[4:] for packet in packets]

    def symbol(self, number: int) -> bytes:
        """Return a symbol's bytes.

        Parameters
        ----------
        number
            Number of the symbol, 0 to (1 + `REPAIR`) `count` - 1.
        """
        return self._symbols[number]

    @property
    def numbers(self) -> int:
        """Symbols that are sent before they come again."""
        return len(self._symbols)


def decode(symbols: Mapping[int, bytes], length: int, size: int) -> bytes | None:
    """Return the file's bytes; None where the symbols are not yet enough.

    Parameters
    ----------
    symbols
        Symbols by number, each of `size` bytes.
    length
        Bytes of the file.
    size
        Bytes of a symbol.

    Raises
    ------
    HeliographError
        The package `raptorq` is not installed.
    """
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
        raise HeliographError(
            "files sent by RaptorQ need the package raptorq: pip install 'heliograph[raptorq]'"
        ) from None
    return raptorq
