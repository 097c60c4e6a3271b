"""Cut messages into blocks, and put messages together from blocks in any order of arrival (section 8)."""

import zlib
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from operator import itemgetter

from heliograph.signal.block import MAX_MESSAGE, MAX_SEGMENTS, AnyBlock, Block

MAX_MESSAGES = 256
"""Messages of a layer: the stream field is a byte (section 7)."""


@dataclass(frozen=True, slots=True)
class Message:
    """A complete message.

    Attributes
    ----------
    identity
        Number of the array that sent it, 0 to 29.
    layer
        "high", "middle" or "low".
    stream
        Number of the message in its layer, 0 to 255.
    data
        Its bytes, at most 2**24 - 1.
    """

    identity: int
    layer: str
    stream: int
    data: bytes


def segments(message: Message, room: int) -> list[Block]:
    """Cut a message into blocks; an empty message gives an idle block.

    Parameters
    ----------
    message
        Message to cut; its identity, layer and stream go into each block.
    room
        Bytes of payload in a block, at least 1.

    Returns
    -------
    list of Block
        In the order of their sequence; all but the last are full.

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


@dataclass(frozen=True, slots=True)
class Updates:
    """A message whose content changes during the transmission; each content has a stream number.

    Attributes
    ----------
    contents
        Start time of each content in s from the start of the transmission, and its bytes; sorted by time, not empty.
        The first content is sent from the start, whatever its time.
    """

    contents: tuple[tuple[float, bytes], ...]

    def at(self, time_s: float) -> int:
        """Return the number of the content that is sent at a time.

        Parameters
        ----------
        time_s
            Time from the start of the transmission in s.
        """
        return max(0, bisect_right(self.contents, time_s, key=itemgetter(0)) - 1)


class Carousel:
    """Send all segments of a layer's messages, again and again; idle blocks where there is no message (section 8).

    Parameters
    ----------
    identity
        Number of the array, 0 to 29.
    layer
        "high", "middle" or "low".
    messages
        At most 256; message i is sent as stream i. Those that change share the numbers that are left.
    room
        Bytes of payload in a block, at least 1.

    Raises
    ------
    ValueError
        There are more than 256 messages, or a message is too long for `segments`.
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
        """Return a block of the transmission.

        Parameters
        ----------
        number
            Number of the block in its layer, from 0 at the start of the transmission.
        time_s
            Time at which its packet begins, from there in s; it matters for messages that change.
        """
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


@dataclass(slots=True)
class _Assembly:
    """A message that lacks segments: its length in bytes, and its segments by sequence."""

    length: int
    pieces: dict[int, bytes] = field(default_factory=dict)

    def takes(self, block: Block) -> bool:
        """Whether the block is of the same length, and of the same bytes as a segment received before."""
        return self.length == block.length and self.pieces.get(block.sequence, block.payload) == block.payload

    def whole(self) -> bytes | None:
        """All bytes of the message; None where some are missing."""
        if sum(map(len, self.pieces.values())) < self.length:
            return None
        return b"".join(self.pieces[i] for i in sorted(self.pieces))


_Key = tuple[int, str, int, int]
"""Identity, layer, stream, and bytes of payload in a block."""


@dataclass(slots=True)
class _Done:
    """The message last completed under a number: length and CRC; CRCs of its segments by payload size and sequence."""

    data: tuple[int, int]
    pieces: dict[int, dict[int, int]] = field(default_factory=dict)


@dataclass(slots=True)
class Reassembler:
    """Put messages together from blocks in any order, with repeats and gaps; each message is returned once (section 8).

    Memory is bounded by an incomplete message per array, layer, block size and stream (0 to 255). A transmitter that
    changes a message must change its stream number; a block of another length or content under the same number starts
    the message again.
    """

    _open: dict[_Key, _Assembly] = field(default_factory=dict)
    _done: dict[tuple[int, str, int], _Done] = field(default_factory=dict)

    def add(self, block: AnyBlock, room: int = 0) -> Message | None:
        """Add a block; return the message that it completes, or None if no new message is complete.

        Parameters
        ----------
        block
            A block whose CRC is right; blocks of files are ignored.
        room
            Bytes of payload in a block of its codeword. If packets differ in their rates, the transmitter cuts a
            message for each size, and segments of different sizes do not fit together.
        """
        if not isinstance(block, Block):
            return None
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
        """Whether the block belongs to the message last completed under its number."""
        done = self._done.get(key[:3])
        pieces = done.pieces.get(key[3]) if done else None
        if done is None or pieces is None or done.data[0] != block.length:
            return False
        if pieces.get(block.sequence) == zlib.crc32(block.payload):
            return True
        # same length, other content: the transmitter reuses the number for a new message
        del self._done[key[:3]]
        return False

    def unfinished(self) -> list[tuple[int, str, int, int, int]]:
        """Return the messages that lack segments: (identity, layer, stream, bytes received, bytes of the message)."""
        return [(*key[:3], sum(map(len, a.pieces.values())), a.length) for key, a in self._open.items()]
