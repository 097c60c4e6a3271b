"""Information blocks, one for each codeword: header, payload, CRC-32 (section 7).

A block of a message:

    byte 0      version (upper 4 bits), layer 0 high, 1 middle, 2 low (lower 4 bits)
    byte 1      identity of the array
    byte 2      stream: number of the message in its layer
    bytes 3-4   sequence: which segment of the message
    bytes 5-7   length of the message in bytes
    ...         payload, filled with zeros in the last segment
    last 4      CRC-32 (IEEE 802.3) of all bytes before

A block of a file has 4 added to its layer, and other fields (section 7.1):

    byte 2        code: 0 Cauchy, 1 RaptorQ
    bytes 3-5     number of its first symbol
    bytes 6-8     bytes of the file
    bytes 9-10    bytes of a symbol
    bytes 11-14   CRC-32 of the file
    ...           as many symbols as find room, then zeros

Small blocks of a file have a shorter header (section 7.2): the layer plus 8 for a symbol, plus 12 for the description
of the file:

    byte 2        tag: the first byte of the check      bytes 2-4   bytes of the file
    bytes 3-4     number of the symbol                  bytes 5-8   CRC-32 of the file
    ...           the symbol, then zeros                ...         zeros

Numbers are big-endian; the most significant bit of a byte comes first.
"""

import zlib
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.signal.settings import LAYERS

VERSION = 1
"""Version of the air interface, in every block (section 7)."""

HEADER_BYTES = 8
"""Bytes before the payload (section 7)."""

CRC_BYTES = 4
"""Bytes of the CRC-32 (section 7)."""

MIN_BITS = 8 * (HEADER_BYTES + CRC_BYTES + 1)
"""Minimum information bits of a block: a single byte of payload."""

FILE_HEADER_BYTES = 15
"""Bytes before the symbols of a file (section 7.1)."""

FILE_LAYERS = 4
"""Added to the layer's number in a block of a file (section 7.1)."""

SMALL_BLOCK_BYTES = 40
"""Bytes of a block up to which files are sent by small blocks (section 7.2). Chosen: of larger ones the head of 7.1
takes less than half, and small blocks spend an eighth on telling what the file is."""

SMALL_HEADER_BYTES = 5
"""Bytes before the symbol of a small block (section 7.2)."""

NOTICE_BYTES = 9
"""Bytes that tell what a file is (section 7.2)."""

SYMBOL_LAYERS, NOTICE_LAYERS = 8, 12
"""Added to the layer's number in a small block with a symbol and with the description of a file (section 7.2)."""

MAX_MESSAGE = (1 << 24) - 1
"""Longest message in bytes: the field for the length has three bytes."""

MAX_SEGMENTS = 1 << 16
"""Most segments of a message: the field for the sequence has two bytes."""

_MAX_BYTE = 255
"""Largest value of a byte."""


@dataclass(frozen=True, slots=True)
class Block:
    """Segment of a message in a codeword.

    Attributes
    ----------
    layer
        "high", "middle" or "low".
    identity
        Number of the array, 0 to 255 (a transmitter uses 0 to 29).
    stream
        Number of the message in its layer, 0 to 255.
    sequence
        Number of the segment in the message, 0 to 65535.
    length
        Bytes of the message, 0 to 2**24 - 1; 0 for an idle block.
    payload
        Bytes of the segment, padding excluded; at most `payload_bytes`.
    """

    layer: str
    identity: int
    stream: int
    sequence: int
    length: int
    payload: bytes


@dataclass(frozen=True, slots=True)
class FileBlock:
    """Symbols of a file in a codeword (section 7.1).

    Attributes
    ----------
    layer
        "high", "middle" or "low".
    identity
        Number of the array, 0 to 255 (a transmitter uses 0 to 29).
    code
        Number of the code that makes symbols of the file: 0 Cauchy, 1 RaptorQ.
    number
        Number of the first symbol, 0 to 2**24 - 1.
    length
        Bytes of the file and its name, 1 to 2**24 - 1.
    size
        Bytes of a symbol, 1 to 65535.
    check
        CRC-32 of the file and its name.
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
        """Yield each symbol's number and bytes."""
        for place in range(0, len(self.payload), self.size):
            yield self.number + place // self.size, self.payload[place : place + self.size]


@dataclass(frozen=True, slots=True)
class SymbolBlock:
    """A symbol of a file in a small block (section 7.2).

    Attributes
    ----------
    layer
        "high", "middle" or "low".
    identity
        Number of the array, 0 to 255 (a transmitter uses 0 to 29).
    tag
        First byte of the file's check, 0 to 255.
    number
        Number of the symbol, 0 to 65535.
    payload
        The symbol: an even number of bytes, at least two.
    """

    layer: str
    identity: int
    tag: int
    number: int
    payload: bytes


@dataclass(frozen=True, slots=True)
class FileNotice:
    """What a file is of which small blocks carry symbols (section 7.2).

    Attributes
    ----------
    layer
        "high", "middle" or "low".
    identity
        Number of the array, 0 to 255 (a transmitter uses 0 to 29).
    length
        Bytes of the file and its name, 1 to 2**24 - 1.
    check
        CRC-32 of the file and its name.
    """

    layer: str
    identity: int
    length: int
    check: int

    @property
    def tag(self) -> int:
        """First byte of the check, by which symbols name the file."""
        return self.check >> 24

    @property
    def payload(self) -> bytes:
        """No symbols."""
        return b""


AnyFileBlock = FileBlock | SymbolBlock | FileNotice
"""What a codeword carries of a file."""

AnyBlock = Block | AnyFileBlock
"""What a codeword carries."""


def symbol_bytes(k: int) -> int:
    """Return the bytes that a block has for symbols of a file; below 1 where it is too small for any.

    Parameters
    ----------
    k
        Information bits of the block, a multiple of 8.
    """
    return k // 8 - FILE_HEADER_BYTES - CRC_BYTES


def small_symbol_bytes(k: int) -> int:
    """Return the bytes of a symbol in a small block (section 7.2); below 2 where there is no room for one.

    Parameters
    ----------
    k
        Information bits of the block, a multiple of 8.
    """
    return (k // 8 - SMALL_HEADER_BYTES - CRC_BYTES) // 2 * 2


def payload_bytes(k: int) -> int:
    """Return the bytes of payload in a block.

    Parameters
    ----------
    k
        Information bits of the block: a multiple of 8, at least `MIN_BITS`.

    Raises
    ------
    ValueError
        `k` is no multiple of 8 or below `MIN_BITS`.
    """
    if k < MIN_BITS or k % 8:
        raise ValueError(f"a block needs a multiple of 8 bits, at least {MIN_BITS}, not {k}")
    return k // 8 - HEADER_BYTES - CRC_BYTES


def pack(block: AnyBlock, k: int) -> NDArray[np.uint8]:
    """Return the information bits of a block (section 7).

    Parameters
    ----------
    block
        Block whose fields and payload the bits carry.
    k
        Information bits of the codeword: a multiple of 8, at least `MIN_BITS`.

    Returns
    -------
    (k,) uint8 bits 0 and 1; zeros fill up a short payload.

    Raises
    ------
    ValueError
        `k` is no block's size, the payload does not fit, or a field is out of its range.
    """
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
"""Largest value of each field."""


def _check_fields(block: AnyBlock) -> None:
    if block.layer not in LAYERS:
        raise ValueError(f"layers are {', '.join(LAYERS)}, not {block.layer}")
    for name, most in _FIELDS[type(block)].items():
        if not 0 <= getattr(block, name) <= most:
            raise ValueError(f"a block's {name} is 0 to {most}, not {getattr(block, name)}")


def check(bits: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Return whether the CRC-32 of each block is right, (...) bool.

    Parameters
    ----------
    bits
        (..., k) uint8 information bits 0 and 1; k is a multiple of 8.
    """
    data = np.packbits(bits, axis=-1)
    rows = data.reshape(-1, data.shape[-1])
    good = [zlib.crc32(row[:-CRC_BYTES].tobytes()) == int.from_bytes(row[-CRC_BYTES:].tobytes()) for row in rows]
    return np.array(good, dtype=bool).reshape(data.shape[:-1])


def unpack(bits: NDArray[np.uint8]) -> AnyBlock | None:
    """Read a block from its information bits; None where the CRC, the version, the layer or a file's field is wrong.

    Parameters
    ----------
    bits
        (k,) uint8 bits 0 and 1; k is a multiple of 8, at least `MIN_BITS`.
    """
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
    """A file's symbols; None where the fields cannot be."""
    number, length, size = int.from_bytes(data[3:6]), int.from_bytes(data[6:9]), int.from_bytes(data[9:11])
    room = data[FILE_HEADER_BYTES:-CRC_BYTES]
    if not length or not 0 < size <= len(room):
        return None
    payload = room[: len(room) // size * size]
    return FileBlock(LAYERS[data[0] & 3], data[1], data[2], number, length, size, int.from_bytes(data[11:15]), payload)
