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


@dataclass(slots=True)
class Reassembler:
    """Puts messages together from blocks in any order, with repeats and gaps; each message comes out once.

    Memory is bounded by 256 messages a layer and array. A transmitter that changes a message must change its stream
    number; a block of another length or content under the same number starts the message anew.
    """

    _open: dict[tuple[int, str, int], _Assembly] = field(default_factory=dict)
    _done: dict[tuple[int, str, int], tuple[int, dict[int, int]]] = field(default_factory=dict)

    def add(self, block: Block) -> Message | None:
        """Take a block; return the message it completes, if it does and the message is new."""
        key = (block.identity, block.layer, block.stream)
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
        self._done[key] = (len(data), {i: zlib.crc32(piece) for i, piece in assembly.pieces.items()})
        return Message(*key, data)

    def _had(self, key: tuple[int, str, int], block: Block) -> bool:
        """Whether the block is of the message last completed under its number."""
        length, pieces = self._done.get(key, (0, {}))
        if length != block.length:
            return False
        if pieces.get(block.sequence) == zlib.crc32(block.payload):
            return True
        # same length, other content: the number has come round to a new message
        del self._done[key]
        return False

    def unfinished(self) -> list[tuple[int, str, int, int, int]]:
        """Messages still lacking segments: (identity, layer, stream, bytes had, bytes in all)."""
        return [(*key, sum(map(len, a.pieces.values())), a.length) for key, a in self._open.items()]
