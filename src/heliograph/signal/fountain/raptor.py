"""RaptorQ file symbols (RFC 6330) from the package `raptorq`, for files with several megabytes (section 8.1)."""

from collections.abc import Mapping
from typing import Any

from heliograph.base.errors import HeliographError

NUMBERS = 1 << 24
"""Number of symbols: the encoding symbol ID in RFC 6330 has three bytes."""

ALIGNMENT = 8
"""Symbol alignment in bytes, fixed by the package."""

LEAST_BYTES = 64
"""Minimum symbol size in bytes; the package splits smaller symbols."""

MOST_BYTES = 1 << 23
"""Maximum file length in bytes. From 10 MiB on, the package splits a file into several source blocks."""

REPAIR = 4
"""Repair symbols per source symbol before all symbols repeat."""


def is_there() -> bool:
    """Return True if the package is installed."""
    try:
        _package()
    except HeliographError:
        return False
    return True


class RaptorEncoder:
    """Symbol encoder for a file.

    Parameters
    ----------
    data
        File bytes, 1 to `MOST_BYTES`.
    size
        Symbol size in bytes, a multiple of 8, at least 64.

    Raises
    ------
    HeliographError
        The package `raptorq` is not installed.
    """

    def __init__(self, data: bytes, size: int):
        self.count = -(-len(data) // size)
        packets = _package().Encoder.with_defaults(data, size).get_encoded_packets(REPAIR * self.count)
        # each packet starts with 4 header bytes: source block number, here 0, and symbol number
        self._symbols = [packet[4:] for packet in packets]

    def symbol(self, number: int) -> bytes:
        """Return the symbol with a number from 0 to (1 + `REPAIR`) `count` - 1."""
        return self._symbols[number]

    @property
    def numbers(self) -> int:
        """Number of different symbols before repetition."""
        return len(self._symbols)


def decode(symbols: Mapping[int, bytes], length: int, size: int) -> bytes | None:
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
        raise HeliographError(
            "files sent by RaptorQ need the package raptorq: pip install 'heliograph[raptorq]'"
        ) from None
    return raptorq
