"""Information blocks: what one codeword carries. Header, payload, CRC-32; and the whitening of codewords.

    byte 0      version (upper 4 bits), layer 0 high, 1 middle, 2 low (lower 4 bits)
    byte 1      identity of the array
    byte 2      stream: number of the message in its layer
    bytes 3-4   sequence: which segment of the message
    bytes 5-7   length of the whole message in bytes
    ...         payload, filled with zeros in the last segment
    last 4      CRC-32 (IEEE 802.3) of all before

Numbers are big-endian, bits go most significant first.
"""

import zlib
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from heliograph.signal.m_sequence import m_sequence
from heliograph.signal.settings import LAYERS

VERSION = 1
HEADER_BYTES = 8
CRC_BYTES = 4
MIN_BITS = 8 * (HEADER_BYTES + CRC_BYTES + 1)
"""Fewest information bits that hold a byte of payload."""

MAX_MESSAGE = (1 << 24) - 1
"""Longest message in bytes."""

MAX_SEGMENTS = 1 << 16

WHITENER = 0b1100_0000_0000_0001
"""x^15 + x^14 + 1."""


@dataclass(frozen=True, slots=True)
class Block:
    """One segment of a message, as a codeword carries it.

    Attributes
    ----------
    layer
        "high", "middle" or "low".
    identity
        Number of the array.
    stream
        Number of the message in its layer, 0 to 255.
    sequence
        Number of the segment in the message, from 0.
    length
        Bytes of the whole message; 0 for an idle block.
    payload
        As many bytes as fit.
    """

    layer: str
    identity: int
    stream: int
    sequence: int
    length: int
    payload: bytes


def payload_bytes(k: int) -> int:
    """Bytes of payload in a block of k bits."""
    if k < MIN_BITS or k % 8:
        raise ValueError(f"a block needs a multiple of 8 bits, at least {MIN_BITS}, not {k}")
    return k // 8 - HEADER_BYTES - CRC_BYTES


def pack(block: Block, k: int) -> NDArray[np.uint8]:
    """Information bits of a block, (k,) uint8.

    Raises
    ------
    ValueError
        The payload does not fit, or a field is out of its range.
    """
    room = payload_bytes(k)
    if len(block.payload) > room:
        raise ValueError(f"a block of {k} bits holds {room} bytes of payload, not {len(block.payload)}")
    _check_fields(block)
    head = bytes([VERSION << 4 | LAYERS.index(block.layer), block.identity, block.stream])
    head += block.sequence.to_bytes(2) + block.length.to_bytes(3)
    body = head + block.payload.ljust(room, b"\0")
    return np.unpackbits(np.frombuffer(body + zlib.crc32(body).to_bytes(4), dtype=np.uint8))


def _check_fields(block: Block) -> None:
    if block.layer not in LAYERS:
        raise ValueError(f"layers are {', '.join(LAYERS)}, not {block.layer}")
    largest = {"identity": 255, "stream": 255, "sequence": MAX_SEGMENTS - 1, "length": MAX_MESSAGE}
    for name, most in largest.items():
        if not 0 <= getattr(block, name) <= most:
            raise ValueError(f"a block's {name} is 0 to {most}, not {getattr(block, name)}")


def check(bits: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Whether the CRC-32 of blocks is right: (..., k) information bits -> (...) bool."""
    data = np.packbits(bits, axis=-1)
    rows = data.reshape(-1, data.shape[-1])
    good = [zlib.crc32(row[:-CRC_BYTES].tobytes()) == int.from_bytes(row[-CRC_BYTES:].tobytes()) for row in rows]
    return np.array(good, dtype=bool).reshape(data.shape[:-1])


def unpack(bits: NDArray[np.uint8]) -> Block | None:
    """Read a block back; None where the CRC, the version or a field is wrong."""
    data = np.packbits(bits).tobytes()
    version, layer = data[0] >> 4, data[0] & 15
    if not check(bits) or version != VERSION or layer >= len(LAYERS):
        return None
    sequence, length = int.from_bytes(data[3:5]), int.from_bytes(data[5:8])
    payload = data[HEADER_BYTES:-CRC_BYTES][: max(0, length - sequence * payload_bytes(len(bits)))]
    return Block(LAYERS[layer], data[1], data[2], sequence, length, payload)


@lru_cache(maxsize=1)
def _period() -> NDArray[np.uint8]:
    chips = m_sequence(WHITENER, (1 << 15) - 1)
    chips.setflags(write=False)
    return chips


def whitening(e: int, layer: str, codeword: int = 0) -> NDArray[np.uint8]:
    """Chips to be added modulo 2 to the e coded bits of a layer's codeword of a packet, (e,) uint8.

    The M-sequence of x^15 + x^14 + 1 from the state of all ones, advanced by 8192 chips a layer and 509 a codeword.
    """
    start = 8192 * LAYERS.index(layer) + 509 * codeword
    chips = _period()
    return chips[np.arange(start, start + e) % chips.size]
