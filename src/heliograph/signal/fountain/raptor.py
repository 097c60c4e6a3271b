"""RaptorQ file symbols (RFC 6330) from the package `raptorq`, for files with several megabytes (section 8.1)."""

from collections.abc import Mapping
from typing import Any

from heliograph.base.errors import HeliographError


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
