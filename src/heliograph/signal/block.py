"""Information blocks with header, payload and CRC-32 (section 7).

Each codeword carries a block. Message block:

    byte 0      version (upper 4 bits), layer 0 high, 1 middle, 2 low (lower 4 bits)
    byte 1      array identity
    byte 2      stream: message number in the layer
    bytes 3-4   sequence: segment number in the message
    bytes 5-7   message length in bytes
    ...         payload, zero-padded in the last segment
    last 4      CRC-32 (IEEE 802.3) of all preceding bytes

A file block adds 4 to the layer number and has other fields (section 7.1):

    byte 2        code: 0 Cauchy, 1 RaptorQ
    bytes 3-5     number of the first symbol
    bytes 6-8     file length in bytes
    bytes 9-10    symbol size in bytes
    bytes 11-14   CRC-32 of the file
    ...           as many symbols as fit, then zeros

A small file block has a shorter header (section 7.2). The layer number plus 8 marks a symbol (left), plus 12 a file
description (right):

    byte 2        tag: first CRC byte                   bytes 2-4   file length in bytes
    bytes 3-4     symbol number                         bytes 5-8   CRC-32 of the file
    ...           symbol, then zeros                    ...         zeros

Numbers are big-endian; bytes start with the most significant bit.
"""

import zlib
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.signal.settings import LAYERS

VERSION = 1
"""Air interface version in every block (section 7)."""

HEADER_BYTES = 8
"""Header bytes before the payload (section 7)."""

CRC_BYTES = 4
"""CRC-32 bytes (section 7)."""

MIN_BITS = 8 * (HEADER_BYTES + CRC_BYTES + 1)
"""Minimum information bits per block: header, CRC and a single payload byte."""

FILE_HEADER_BYTES = 15
"""Header bytes before the symbols in a file block (section 7.1)."""

FILE_LAYERS = 4
"""Offset to the layer number in a file block (section 7.1)."""

SMALL_BLOCK_BYTES = 40
"""Maximum size of a small file block in bytes (section 7.2). Above this size the header of section 7.1 takes less than
half of the block, while small blocks spend an eighth on file descriptions."""

SMALL_HEADER_BYTES = 5
"""Header bytes before the symbol in a small block (section 7.2)."""

NOTICE_BYTES = 9
"""Header bytes in a file description (section 7.2)."""

SYMBOL_LAYERS, NOTICE_LAYERS = 8, 12
"""Offsets to the layer number in a small block with a symbol or a file description (section 7.2)."""

MAX_MESSAGE = (1 << 24) - 1
"""Maximum message length in bytes: the length field has three bytes."""

MAX_SEGMENTS = 1 << 16
"""Maximum number of segments per message: the sequence field has two bytes."""

_MAX_BYTE = 255
"""Maximum byte value."""


@dataclass(frozen=True, slots=True)
class Block:
    """Message segment in a codeword.

    Attributes
    ----------
    layer
        "high", "middle" or "low".
    identity
        Array number, 0 to 255 (a transmitter uses 0 to 29).
    stream
        Message number in the layer, 0 to 255.
    sequence
        Segment number in the message, 0 to 65535.
    length
        Message length in bytes, 0 to 2**24 - 1; 0 for an idle block.
    payload
        Segment bytes, excluding padding; at most `payload_bytes`.
    """

    layer: str
    identity: int
    stream: int
    sequence: int
    length: int
    payload: bytes


@dataclass(frozen=True, slots=True)
class FileBlock:
    """File symbols in a codeword (section 7.1).

    Attributes
    ----------
    layer
        "high", "middle" or "low".
    identity
        Array number, 0 to 255 (a transmitter uses 0 to 29).
    code
        Number of the symbol code: 0 Cauchy, 1 RaptorQ.
    number
        Number of the first symbol, 0 to 2**24 - 1.
    length
        Length of file and name in bytes, 1 to 2**24 - 1.
    size
        Symbol size in bytes, 1 to 65535.
    check
        CRC-32 of file and name.
    payload
        Consecutive symbols: a positive multiple of `size` bytes.
    """

    layer: str
    identity: int
    code: int
    number: int
    length: int
    size: int
    check: int
    payload: bytes

    def symbols(self) -> Iterator[tuple[int, bytes]]:
        """Yield number and bytes for each symbol."""
        for place in range(0, len(self.payload), self.size):
            yield self.number + place // self.size, self.payload[place : place + self.size]


@dataclass(frozen=True, slots=True)
class SymbolBlock:
    """File symbol in a small block (section 7.2).

    Attributes
    ----------
    layer
        "high", "middle" or "low".
    identity
        Array number, 0 to 255 (a transmitter uses 0 to 29).
    tag
        First CRC byte of the file, 0 to 255.
    number
        Symbol number, 0 to 65535.
    payload
        Symbol bytes: an even number, at least two.
    """

    layer: str
    identity: int
    tag: int
    number: int
    payload: bytes


@dataclass(frozen=True, slots=True)
class FileNotice:
    """File description, which accompanies symbols in small blocks (section 7.2).

    Attributes
    ----------
    layer
        "high", "middle" or "low".
    identity
        Array number, 0 to 255 (a transmitter uses 0 to 29).
    length
        Length of file and name in bytes, 1 to 2**24 - 1.
    check
        CRC-32 of file and name.
    """

    layer: str
    identity: int
    length: int
    check: int

    @property
    def tag(self) -> int:
        """First CRC byte, which identifies the file in symbol blocks."""
        return self.check >> 24

    @property
    def payload(self) -> bytes:
        """Empty, as a description carries no symbols."""
        return b""


AnyFileBlock = FileBlock | SymbolBlock | FileNotice
"""Block types for files."""

AnyBlock = Block | AnyFileBlock
"""Block types for messages and files."""


def symbol_bytes(k: int) -> int:
    """Return the bytes available for file symbols in a block with `k` bits; below 1 if the block is too small."""
    return k // 8 - FILE_HEADER_BYTES - CRC_BYTES


def small_symbol_bytes(k: int) -> int:
    """Return the symbol size in bytes for a small block with `k` bits; below 2 if the block is too small."""
    return (k // 8 - SMALL_HEADER_BYTES - CRC_BYTES) // 2 * 2


def payload_bytes(k: int) -> int:
    """Return the payload bytes per block; raise a ValueError if `k` is invalid."""
    if k < MIN_BITS or k % 8:
        raise ValueError(f"a block needs a multiple of 8 bits, at least {MIN_BITS}, not {k}")
    return k // 8 - HEADER_BYTES - CRC_BYTES


def pack(block: AnyBlock, k: int) -> NDArray[np.uint8]:
    """Pack a block into information bits, (k,) uint8 (section 7); raise a ValueError if the block is invalid."""
    payload_bytes(k)  # checks k
    head = _head(block)
    room = k // 8 - CRC_BYTES - len(head)
    if len(block.payload) > room:
        raise ValueError(f"a block of {k} bits holds {room} bytes of payload, not {len(block.payload)}")
    body = head + block.payload.ljust(room, b"\0")
    return np.unpackbits(np.frombuffer(body + zlib.crc32(body).to_bytes(4), dtype=np.uint8))


def _head(block: AnyBlock) -> bytes:
    _check_fields(block)
    layer = LAYERS.index(block.layer)
    if isinstance(block, Block):
        head = bytes([VERSION << 4 | layer, block.identity, block.stream])
        return head + block.sequence.to_bytes(2) + block.length.to_bytes(3)
    if isinstance(block, SymbolBlock):
        return bytes([VERSION << 4 | SYMBOL_LAYERS + layer, block.identity, block.tag]) + block.number.to_bytes(2)
    if isinstance(block, FileNotice):
        head = bytes([VERSION << 4 | NOTICE_LAYERS + layer, block.identity])
        return head + block.length.to_bytes(3) + block.check.to_bytes(4)
    head = bytes([VERSION << 4 | FILE_LAYERS + layer, block.identity, block.code]) + block.number.to_bytes(3)
    return head + block.length.to_bytes(3) + block.size.to_bytes(2) + block.check.to_bytes(4)


_MOST_CHECK = (1 << 32) - 1
_FIELDS: dict[type, dict[str, int]] = {
    Block: {"identity": _MAX_BYTE, "stream": _MAX_BYTE, "sequence": MAX_SEGMENTS - 1, "length": MAX_MESSAGE},
    FileBlock: {"identity": _MAX_BYTE, "code": _MAX_BYTE, "number": MAX_MESSAGE, "length": MAX_MESSAGE,
                "size": MAX_SEGMENTS - 1, "check": _MOST_CHECK},
    SymbolBlock: {"identity": _MAX_BYTE, "tag": _MAX_BYTE, "number": MAX_SEGMENTS - 1},
    FileNotice: {"identity": _MAX_BYTE, "length": MAX_MESSAGE, "check": _MOST_CHECK},
}  # fmt: skip
"""Maximum value for each field."""


def _check_fields(block: AnyBlock) -> None:
    if block.layer not in LAYERS:
        raise ValueError(f"layers are {', '.join(LAYERS)}, not {block.layer}")
    for name, most in _FIELDS[type(block)].items():
        if not 0 <= getattr(block, name) <= most:
            raise ValueError(f"a block's {name} is 0 to {most}, not {getattr(block, name)}")


def check(bits: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Return True for each block with a correct CRC-32; (..., k) uint8 bits give (...) bool."""
    data = np.packbits(bits, axis=-1)
    rows = data.reshape(-1, data.shape[-1])
    good = [zlib.crc32(row[:-CRC_BYTES].tobytes()) == int.from_bytes(row[-CRC_BYTES:].tobytes()) for row in rows]
    return np.array(good, dtype=bool).reshape(data.shape[:-1])


def unpack(bits: NDArray[np.uint8]) -> AnyBlock | None:
    """Unpack a block from (k,) information bits; return None if the CRC, version, layer or a file field is invalid."""
    data = np.packbits(bits).tobytes()
    version, layer = data[0] >> 4, data[0] & 15
    if not check(bits) or version != VERSION:
        return None
    if FILE_LAYERS <= layer < FILE_LAYERS + len(LAYERS):
        return _file_block(data)
    if SYMBOL_LAYERS <= layer < SYMBOL_LAYERS + len(LAYERS):
        size = small_symbol_bytes(len(bits))
        payload = data[SMALL_HEADER_BYTES : SMALL_HEADER_BYTES + size]
        return SymbolBlock(LAYERS[layer & 3], data[1], data[2], int.from_bytes(data[3:5]), payload) if size else None
    if NOTICE_LAYERS <= layer < NOTICE_LAYERS + len(LAYERS):
        length = int.from_bytes(data[2:5])
        return FileNotice(LAYERS[layer & 3], data[1], length, int.from_bytes(data[5:9])) if length else None
    if layer >= len(LAYERS):
        return None
    sequence, length = int.from_bytes(data[3:5]), int.from_bytes(data[5:8])
    payload = data[HEADER_BYTES:-CRC_BYTES][: max(0, length - sequence * payload_bytes(len(bits)))]
    return Block(LAYERS[layer], data[1], data[2], sequence, length, payload)


def _file_block(data: bytes) -> FileBlock | None:
    """Unpack a file block; return None if a field is invalid."""
    number, length, size = int.from_bytes(data[3:6]), int.from_bytes(data[6:9]), int.from_bytes(data[9:11])
    room = data[FILE_HEADER_BYTES:-CRC_BYTES]
    if not length or not 0 < size <= len(room):
        return None
    payload = room[: len(room) // size * size]
    return FileBlock(LAYERS[data[0] & 3], data[1], data[2], number, length, size, int.from_bytes(data[11:15]), payload)
