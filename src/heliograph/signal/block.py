"""Information blocks with header, payload and CRC-32, one in each codeword (docs/air-interface.md, section 7)."""

import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.signal.settings import LAYERS

VERSION = 1  # air interface version in every block (section 7)
CRC_BYTES = 4  # CRC-32 bytes (section 7)
MIN_BITS = 8 * (8 + CRC_BYTES + 1)  # minimum information bits per block: header, CRC and a single payload byte
MAX_MESSAGE = (1 << 24) - 1  # maximum message length in bytes: the length field has three bytes
MAX_SEGMENTS = 1 << 16  # maximum number of segments per message: the sequence field has two bytes


@dataclass(frozen=True, slots=True)
class Block:
    """Message segment in a codeword."""

    # "high", "middle" or "low", as in all blocks
    layer: str
    # Array number, 0 to 255 (a transmitter uses 0 to 29), as in all blocks
    identity: int
    # Message number in the layer, 0 to 255
    stream: int
    # Segment number in the message, 0 to 65535
    sequence: int
    # Message length in bytes, 0 to 2**24 - 1; 0 for an idle block
    length: int
    # Segment bytes, excluding padding; at most `payload_bytes`
    payload: bytes


@dataclass(frozen=True, slots=True)
class FileBlock:
    """File symbols in a codeword (section 7.1)."""

    layer: str
    identity: int
    # Number of the symbol code: 0 Cauchy, 1 RaptorQ
    code: int
    # Number of the first symbol, 0 to 2**24 - 1
    number: int
    # Length of file and name in bytes, 1 to 2**24 - 1
    length: int
    # Symbol size in bytes, 1 to 65535
    size: int
    # CRC-32 of file and name
    check: int
    # Consecutive symbols: a positive multiple of `size` bytes
    payload: bytes

    def symbols(self) -> Iterator[tuple[int, bytes]]:
        """Yield number and bytes for each symbol."""
        for place in range(0, len(self.payload), self.size):
            yield self.number + place // self.size, self.payload[place : place + self.size]


@dataclass(frozen=True, slots=True)
class SymbolBlock:
    """File symbol in a small block (section 7.2)."""

    layer: str
    identity: int
    # First CRC byte of the file, 0 to 255
    tag: int
    # Symbol number, 0 to 65535
    number: int
    # Symbol bytes: an even number, at least two
    payload: bytes


@dataclass(frozen=True, slots=True)
class FileNotice:
    """File description, which accompanies symbols in small blocks (section 7.2)."""

    layer: str
    identity: int
    # Length of file and name in bytes, 1 to 2**24 - 1
    length: int
    # CRC-32 of file and name
    check: int

    @property
    def tag(self) -> int:
        """First CRC byte, which identifies the file in symbol blocks."""
        return self.check >> 24

    @property
    def payload(self) -> bytes:
        """Empty, as a description carries no symbols."""
        return b""


AnyFileBlock = FileBlock | SymbolBlock | FileNotice  # block types for files

AnyBlock = Block | AnyFileBlock  # block types for messages and files

_LAYOUTS: dict[int, tuple[type[AnyBlock], dict[str, int]]] = {
    0: (Block, {"stream": 1, "sequence": 2, "length": 3}),
    4: (FileBlock, {"code": 1, "number": 3, "length": 3, "size": 2, "check": 4}),
    8: (SymbolBlock, {"tag": 1, "number": 2}),
    12: (FileNotice, {"length": 3, "check": 4}),
}
"""Block type by offset to the layer number, with the bytes of each header field after the identity (section 7)."""


def symbol_bytes(k: int) -> int:
    """Return the bytes available for file symbols in a block with `k` bits; below 1 if the block is too small."""
    return k // 8 - 15 - CRC_BYTES  # 15 header bytes


def small_symbol_bytes(k: int) -> int:
    """Return the symbol size in bytes for a small block with `k` bits; below 2 if the block is too small."""
    return (k // 8 - 5 - CRC_BYTES) // 2 * 2  # 5 header bytes


def payload_bytes(k: int) -> int:
    """Return the payload bytes per block; raise a ValueError if `k` is invalid."""
    if k < MIN_BITS or k % 8:
        raise ValueError(f"a block needs a multiple of 8 bits, at least {MIN_BITS}, not {k}")
    return k // 8 - 8 - CRC_BYTES  # 8 header bytes


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
    if block.layer not in LAYERS:
        raise ValueError(f"layers are {', '.join(LAYERS)}, not {block.layer}")
    offset, sizes = next((n, sizes) for n, (kind, sizes) in _LAYOUTS.items() if isinstance(block, kind))
    head = bytes([VERSION << 4 | offset + LAYERS.index(block.layer)])
    for name, size in {"identity": 1, **sizes}.items():
        value = getattr(block, name)
        if not 0 <= value < 256**size:
            raise ValueError(f"a block's {name} is 0 to {256**size - 1}, not {value}")
        head += value.to_bytes(size)
    return head


def check(bits: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Return True for each block with a correct CRC-32; (..., k) uint8 bits give (...) bool."""
    data = np.packbits(bits, axis=-1)
    rows = data.reshape(-1, data.shape[-1])
    good = [zlib.crc32(row[:-CRC_BYTES].tobytes()) == int.from_bytes(row[-CRC_BYTES:].tobytes()) for row in rows]
    return np.array(good, dtype=bool).reshape(data.shape[:-1])


def unpack(bits: NDArray[np.uint8]) -> AnyBlock | None:
    """Unpack a block from (k,) information bits; return None if the CRC, version, layer or a file field is invalid."""
    data = np.packbits(bits).tobytes()
    version, layer = data[0] >> 4, data[0] & 3
    if not check(bits) or version != VERSION or layer >= len(LAYERS):
        return None
    kind, sizes = _LAYOUTS[data[0] & 12]
    fields: dict[str, Any] = {"layer": LAYERS[layer], "identity": data[1]}
    end = 2
    for name, size in sizes.items():
        fields[name] = int.from_bytes(data[end : end + size])
        end += size
    room = data[end:-CRC_BYTES]
    if kind is Block:
        fields["payload"] = room[: max(0, fields["length"] - fields["sequence"] * len(room))]
    elif kind is not FileNotice:  # complete symbols
        size = fields.get("size", len(room) // 2 * 2)
        if not 0 < size <= len(room):
            return None
        fields["payload"] = room[: len(room) // size * size]
    if kind is not Block and not fields.get("length", 1):
        return None
    return kind(**fields)
