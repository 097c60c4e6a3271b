"""Messages of any length to blocks, and blocks in any order of arrival back to messages."""

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field

from heliograph.signal.block import MAX_MESSAGE, MAX_SEGMENTS, Block


@dataclass(frozen=True, slots=True)
class Message:
    """A whole message.

    Attributes
    ----------
    identity
        Number of the array that sent it.
    layer
        "high", "middle" or "low".
    stream
        Number of the message in its layer.
    data
        Its bytes.
    """

    identity: int
    layer: str
    stream: int
    data: bytes


def segments(message: Message, room: int) -> list[Block]:
    """Cut a message into blocks of `room` bytes of payload; an empty one gives one idle block.

    Raises
    ------
    ValueError
        The message is longer than 2**24 - 1 bytes or than 65,536 blocks.
    """
    limit = min(MAX_MESSAGE, MAX_SEGMENTS * room)
    if len(message.data) > limit:
        raise ValueError(f"a message of {room}-byte blocks has at most {limit} bytes, not {len(message.data)}")
    who = (message.layer, message.identity, message.stream)
    starts = range(0, max(1, len(message.data)), room)
    return [Block(*who, i, len(message.data), message.data[s : s + room]) for i, s in enumerate(starts)]


class Carousel:
    """All segments of a layer's messages, again and again; idle blocks where there is no message.

    Parameters
    ----------
    identity, layer
        Who sends them, and where.
    messages
        At most 256; message i is sent as stream i.
    room
        Bytes of payload in a block.
    """

    def __init__(self, identity: int, layer: str, messages: Sequence[bytes], room: int):
        if len(messages) > 256:
            raise ValueError(f"a layer carries at most 256 messages, not {len(messages)}")
        parts = [segments(Message(identity, layer, i, data), room) for i, data in enumerate(messages or [b""])]
        self._blocks = [block for blocks in parts for block in blocks]

    def block(self, number: int) -> Block:
        """Block `number` counted from the start of the transmission."""
        return self._blocks[number % len(self._blocks)]


@dataclass(slots=True)
class _Assembly:
    length: int
    pieces: dict[int, bytes] = field(default_factory=dict)

    def takes(self, block: Block) -> bool:
        """Whether the block agrees with what is there."""
        return self.length == block.length and self.pieces.get(block.sequence, block.payload) == block.payload

    def whole(self) -> bytes | None:
        if sum(map(len, self.pieces.values())) < self.length:
            return None
        return b"".join(self.pieces[i] for i in sorted(self.pieces))


_Key = tuple[int, str, int, int]
"""Identity, layer, stream, and the room of its blocks."""


@dataclass(slots=True)
class _Done:
    """The message last completed under a number: its length and CRC; the CRCs of its segments by their room."""

    data: tuple[int, int]
    pieces: dict[int, dict[int, int]] = field(default_factory=dict)


@dataclass(slots=True)
class Reassembler:
    """Puts messages together from blocks in any order, with repeats and gaps; each message comes out once.

    Memory is bounded by 256 messages a layer and array. A transmitter that changes a message must change its stream
    number; a block of another length or content under the same number starts the message anew.
    """

    _open: dict[_Key, _Assembly] = field(default_factory=dict)
    _done: dict[tuple[int, str, int], _Done] = field(default_factory=dict)

    def add(self, block: Block, room: int = 0) -> Message | None:
        """Take a block; return the message it completes, if it does and the message is new.

        Parameters
        ----------
        block
            The block.
        room
            Bytes of payload its codeword has room for: where packets differ in their rates, a message is cut anew for
            each size, and segments of one cut do not fit those of another.
        """
        who = (block.identity, block.layer, block.stream)
        key = (*who, room)
        if not block.length or not block.payload or self._had(key, block):
            return None
        assembly = self._open.get(key)
        if assembly is None or not assembly.takes(block):
            assembly = self._open[key] = _Assembly(block.length)
        assembly.pieces[block.sequence] = block.payload
        data = assembly.whole()
        if data is None:
            return None
        del self._open[key]
        last = self._done.get(who)
        known = last is not None and last.data == (len(data), zlib.crc32(data))
        done = last if last is not None and known else _Done((len(data), zlib.crc32(data)))
        done.pieces[room] = {i: zlib.crc32(piece) for i, piece in assembly.pieces.items()}
        self._done[who] = done
        return None if known else Message(*who, data)

    def _had(self, key: _Key, block: Block) -> bool:
        """Whether the block is of the message last completed under its number."""
        done = self._done.get(key[:3])
        pieces = done.pieces.get(key[3]) if done else None
        if done is None or pieces is None or done.data[0] != block.length:
            return False
        if pieces.get(block.sequence) == zlib.crc32(block.payload):
            return True
        # same length, other content: the number has come round to a new message
        del self._done[key[:3]]
        return False

    def unfinished(self) -> list[tuple[int, str, int, int, int]]:
        """Messages still lacking segments: (identity, layer, stream, bytes had, bytes in all)."""
        return [(*key[:3], sum(map(len, a.pieces.values())), a.length) for key, a in self._open.items()]
