"""Information blocks, one for each codeword: header, payload, CRC-32 (section 7); whitening of codewords (section 10).

A block of a message:

    byte 0      version (upper 4 bits), layer 0 high, 1 middle, 2 low (lower 4 bits)
    byte 1      identity of the array
    byte 2      stream: number of the message in its layer
    bytes 3-4   sequence: which segment of the message
    bytes 5-7   length of the whole message in bytes
    ...         payload, filled with zeros in the last segment
    last 4      CRC-32 (IEEE 802.3) of all bytes before

A block of a file has 4 added to its layer, and other fields (section 7.1):

    byte 2        code: 0 Cauchy, 1 RaptorQ
    bytes 3-5     number of its first symbol
    bytes 6-8     bytes of the file
    bytes 9-10    bytes of a symbol
    bytes 11-14   CRC-32 of the file
    ...           as many symbols as find room, then zeros

Numbers are big-endian; the most significant bit of a byte comes first.
"""

import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from heliograph.signal.m_sequence import m_sequence
from heliograph.signal.settings import LAYERS

VERSION = 1
"""Version of the air interface, in every block (section 7)."""

HEADER_BYTES = 8
"""Bytes before the payload (section 7)."""

CRC_BYTES = 4
"""Bytes of the CRC-32 (section 7)."""

MIN_BITS = 8 * (HEADER_BYTES + CRC_BYTES + 1)
"""Fewest information bits of a block: they hold one byte of payload."""

FILE_HEADER_BYTES = 15
"""Bytes before the symbols of a file (section 7.1)."""

FILE_LAYERS = 4
"""Added to the layer's number in a block of a file (section 7.1)."""

MAX_MESSAGE = (1 << 24) - 1
"""Longest message in bytes: the field for the length has three bytes."""

MAX_SEGMENTS = 1 << 16
"""Most segments of a message: the field for the sequence has two bytes."""

_MAX_BYTE = 255
"""Largest value of a field of one byte."""

WHITENER = 0b1100_0000_0000_0001
"""Polynomial of the whitening as bits: x^15 + x^14 + 1 (section 10), primitive, so the period is 32767 chips."""

WHITENER_START = (1 << 15) - 1
"""First 15 chips of the whitening: all ones (section 10)."""

LAYER_CHIPS = 8192
"""Chips between the starts of two layers' whitening (section 10): a quarter of the period, so that first
codewords of up to 8192 bits in the three layers have no chips in common. Twice the value
would start the low layer one chip after the high one."""

CODEWORD_CHIPS = 509
"""Chips between the starts of two codewords' whitening in a layer (section 10). Chosen, a prime: any shift but 0 gives
chips that agree with the unshifted ones in 16383 of 32767 places, so half or twice the value would do as well."""


@dataclass(frozen=True, slots=True)
class Block:
    """One segment of a message, as one codeword carries it.

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
        Bytes of the whole message, 0 to 2**24 - 1; 0 for an idle block.
    payload
        Bytes of the segment, without the zeros that fill the block; at most `payload_bytes`.
    """

    layer: str
    identity: int
    stream: int
    sequence: int
    length: int
    payload: bytes


@dataclass(frozen=True, slots=True)
class FileBlock:
    """Symbols of a file, as one codeword carries them (section 7.1).

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
        Bytes of the whole file with its name, 1 to 2**24 - 1.
    size
        Bytes of a symbol, 1 to 65535.
    check
        CRC-32 of the whole file with its name.
    payload
        The symbols one after the other: a multiple of `size` bytes, at least one.
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


AnyBlock = Block | FileBlock
"""What a codeword carries."""


def symbol_bytes(k: int) -> int:
    """Return the bytes that a block has for symbols of a file; below 1 where it is too small for any.

    Parameters
    ----------
    k
        Information bits of the block, a multiple of 8.
    """
    return k // 8 - FILE_HEADER_BYTES - CRC_BYTES


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
    room = payload_bytes(k) if isinstance(block, Block) else symbol_bytes(k)
    if len(block.payload) > room:
        raise ValueError(f"a block of {k} bits holds {room} bytes of payload, not {len(block.payload)}")
    _check_fields(block)
    body = _head(block) + block.payload.ljust(room, b"\0")
    return np.unpackbits(np.frombuffer(body + zlib.crc32(body).to_bytes(4), dtype=np.uint8))


def _head(block: AnyBlock) -> bytes:
    layer = LAYERS.index(block.layer)
    if isinstance(block, Block):
        head = bytes([VERSION << 4 | layer, block.identity, block.stream])
        return head + block.sequence.to_bytes(2) + block.length.to_bytes(3)
    head = bytes([VERSION << 4 | FILE_LAYERS + layer, block.identity, block.code]) + block.number.to_bytes(3)
    return head + block.length.to_bytes(3) + block.size.to_bytes(2) + block.check.to_bytes(4)


_MESSAGE_FIELDS = {"identity": _MAX_BYTE, "stream": _MAX_BYTE, "sequence": MAX_SEGMENTS - 1, "length": MAX_MESSAGE}
_FILE_FIELDS = {
    "identity": _MAX_BYTE, "code": _MAX_BYTE, "number": MAX_MESSAGE, "length": MAX_MESSAGE, "size": MAX_SEGMENTS - 1,
    "check": (1 << 32) - 1,
}  # fmt: skip
"""Largest value of each field."""


def _check_fields(block: AnyBlock) -> None:
    if block.layer not in LAYERS:
        raise ValueError(f"layers are {', '.join(LAYERS)}, not {block.layer}")
    for name, most in (_MESSAGE_FIELDS if isinstance(block, Block) else _FILE_FIELDS).items():
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


@lru_cache(maxsize=1)
def _period() -> NDArray[np.uint8]:
    chips = m_sequence(WHITENER, WHITENER_START)
    chips.setflags(write=False)
    return chips


def whitening(e: int, layer: str, codeword: int = 0) -> NDArray[np.uint8]:
    """Return the chips that whiten a codeword by addition modulo 2 (section 10).

    They are the M-sequence of x^15 + x^14 + 1 from the state of all ones. Without whitening, idle blocks and runs of
    equal bytes would give patterns unlike random ones.

    Parameters
    ----------
    e
        Coded bits of the codeword, at least 0.
    layer
        "high", "middle" or "low".
    codeword
        Number of the codeword in its layer and packet, from 0.

    Returns
    -------
    (e,) uint8 chips 0 and 1.
    """
    # g((8192 l + 509 i + j) mod 32767)
    start = LAYER_CHIPS * LAYERS.index(layer) + CODEWORD_CHIPS * codeword
    chips = _period()
    return chips[np.arange(start, start + e) % chips.size]
