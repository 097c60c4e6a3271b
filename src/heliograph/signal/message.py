"""Split messages into blocks, and reassemble messages from blocks in any order (section 8)."""

import zlib
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from operator import itemgetter

from heliograph.signal.block import MAX_MESSAGE, MAX_SEGMENTS, AnyBlock, Block

MAX_MESSAGES = 256  # maximum number of messages per layer: the stream field is a byte (section 7)


@dataclass(frozen=True, slots=True)
class Message:
    """Complete message.

    Attributes
    ----------
    identity
        Number of the sending array, 0 to 29.
    layer
        "high", "middle" or "low".
    stream
        Message number in the layer, 0 to 255.
    data
        Message bytes, at most 2**24 - 1.
    """

    identity: int
    layer: str
    stream: int
    data: bytes


def segments(message: Message, room: int) -> list[Block]:
    """Split a message into blocks with `room` payload bytes each; an empty message gives an idle block."""
    limit = min(MAX_MESSAGE, MAX_SEGMENTS * room)
    if len(message.data) > limit:
        raise ValueError(f"a message of {room}-byte blocks has at most {limit} bytes, not {len(message.data)}")
    who = (message.layer, message.identity, message.stream)
    starts = range(0, max(1, len(message.data)), room)
    return [Block(*who, i, len(message.data), message.data[s : s + room]) for i, s in enumerate(starts)]


@dataclass(frozen=True, slots=True)
class Updates:
    """Message with changing content; each content has a stream number."""

    # (start time in s after the start of transmission, bytes) for each content; sorted by time, not empty. The
    # transmitter sends the first content from the start, regardless of the start time.
    contents: tuple[tuple[float, bytes], ...]

    def at(self, time_s: float) -> int:
        """Return the index of the content at a time in s after the start of transmission."""
        return max(0, bisect_right(self.contents, time_s, key=itemgetter(0)) - 1)


class Carousel:
    """Endless sequence of message segments for a layer; idle blocks if the layer has no message (section 8).

    Message i is sent as stream i; changing messages share the remaining stream numbers.
    """

    def __init__(self, identity: int, layer: str, messages: Sequence[bytes | Updates], room: int):
        if len(messages) > MAX_MESSAGES:
            raise ValueError(f"a layer carries at most {MAX_MESSAGES} messages, not {len(messages)}")
        self._who, self._room = (identity, layer), room
        fixed = [data for data in messages if not isinstance(data, Updates)]
        self._updates = [data for data in messages if isinstance(data, Updates)]
        self._streams = (MAX_MESSAGES - len(fixed)) // max(1, len(self._updates))
        self._first = len(fixed)
        idle = [] if messages else [b""]
        self._fixed = [block for i, data in enumerate(fixed or idle) for block in self._cut(i, data)]
        for update in self._updates:
            self._cut(0, max((data for _, data in update.contents), key=len))
        self._now: tuple[list[int], list[Block]] = ([], [])

    def block(self, number: int, time_s: float = 0.0) -> Block:
        """Return block `number` in the layer; `time_s`, the start time of the packet, selects changing content."""
        if not self._updates:
            return self._fixed[number % len(self._fixed)]
        which = [update.at(time_s) for update in self._updates]
        if which != self._now[0]:
            self._now = (which, [*self._fixed, *self._changing(which)])
        blocks = self._now[1]
        return blocks[number % len(blocks)]

    def _changing(self, which: Sequence[int]) -> Iterator[Block]:
        for place, (update, one) in enumerate(zip(self._updates, which, strict=True)):
            stream = self._first + place * self._streams + one % self._streams
            yield from self._cut(stream, update.contents[one][1])

    def _cut(self, stream: int, data: bytes) -> list[Block]:
        identity, layer = self._who
        return segments(Message(identity, layer, stream, data), self._room)


_Key = tuple[int, str, int, int]  # identity, layer, stream, and payload bytes per block


@dataclass(slots=True)
class _Done:
    """Last complete message with a stream number: length and CRC; segment CRCs by payload size and sequence."""

    data: tuple[int, int]
    pieces: dict[int, dict[int, int]] = field(default_factory=dict)


@dataclass(slots=True)
class Reassembler:
    """Reassemble messages from blocks in any order, with repeats and gaps; return each message once (section 8).

    A block with another length or content, and the same stream number, restarts the message.
    """

    # Message length in bytes, and segments by sequence, of incomplete messages
    _open: dict[_Key, tuple[int, dict[int, bytes]]] = field(default_factory=dict)
    _done: dict[tuple[int, str, int], _Done] = field(default_factory=dict)

    def add(self, block: AnyBlock, room: int = 0) -> Message | None:
        """Add a block with a correct CRC; return a newly completed message, or None. File blocks are ignored.

        Segments with different payload sizes per block, `room` in bytes, do not fit together.
        """
        if not isinstance(block, Block):
            return None
        who = (block.identity, block.layer, block.stream)
        key = (*who, room)
        if not block.length or not block.payload or self._had(key, block):
            return None
        length, pieces = self._open.get(key, (0, dict[int, bytes]()))
        if length != block.length or pieces.get(block.sequence, block.payload) != block.payload:
            pieces = {}
            self._open[key] = block.length, pieces
        pieces[block.sequence] = block.payload
        if sum(map(len, pieces.values())) < block.length:
            return None
        data = b"".join(pieces[i] for i in sorted(pieces))
        del self._open[key]
        last = self._done.get(who)
        known = last is not None and last.data == (len(data), zlib.crc32(data))
        done = last if last is not None and known else _Done((len(data), zlib.crc32(data)))
        done.pieces[room] = {i: zlib.crc32(piece) for i, piece in pieces.items()}
        self._done[who] = done
        return None if known else Message(*who, data)

    def _had(self, key: _Key, block: Block) -> bool:
        """Return True if the block belongs to the last complete message with this stream number."""
        done = self._done.get(key[:3])
        pieces = done.pieces.get(key[3]) if done else None
        if done is None or pieces is None or done.data[0] != block.length:
            return False
        if pieces.get(block.sequence) == zlib.crc32(block.payload):
            return True
        # same length, different content: the stream number has a new message
        del self._done[key[:3]]
        return False

    def unfinished(self) -> list[tuple[int, str, int, int, int]]:
        """Return incomplete messages: (identity, layer, stream, received bytes, message length in bytes)."""
        return [(*key[:3], sum(map(len, pieces.values())), length) for key, (length, pieces) in self._open.items()]
