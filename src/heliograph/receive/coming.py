"""Packets that are decoded, at once or in a thread beside the frames that follow."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import Protocol

from heliograph.receive.events import Event, Observer
from heliograph.receive.packets import Packet, Status, Words
from heliograph.receive.reader_protocol import PacketReader

HEADER_SEEN = 0.5
"""Least header score of a packet whose header was seen: half of the array's light must alternate."""

ENOUGH_SEEN = 0.5
"""Least fraction of a packet's data that must have been seen.

Below it a packet that the film's end cuts off is not given out, and one without a right codeword is "no_array". Of
data half of which is erased no code of a rate above 1/2 can be read. Half of it loses none of 192 codewords; twice of
it, all of the data, loses 20, all of cameras out of step (docs/constants.md).
"""


@dataclass(frozen=True, slots=True)
class DecodedPacket:
    """What decoding made of a packet.

    Attributes
    ----------
    reader
        The reader that read it.
    layers
        Codewords by layer, decoded or not.
    reason
        Why nothing was read, or empty; see `Packet`.
    events
        What observers are told of decoding, in its order.
    """

    reader: PacketReader
    layers: Words
    reason: str
    events: tuple[Event, ...]


class Decoders(Protocol):
    """Decodes packets, one after the other."""

    def submit(self, work: Callable[[], DecodedPacket], /) -> Future[DecodedPacket]:
        """Decode a packet, now or later.

        Parameters
        ----------
        work
            Decodes it; called once, from any thread.
        """


class AtOnce:
    """Decodes a packet when it is handed in."""

    def submit(self, work: Callable[[], DecodedPacket], /) -> Future[DecodedPacket]:
        """Decode it; see `Decoders`."""
        done = Future[DecodedPacket]()
        done.set_result(work())
        return done


def decoders(beside: bool) -> Decoders:
    """What decodes packets.

    Parameters
    ----------
    beside
        Whether in a thread of its own.
    """
    # one thread: what a packet teaches the next ones is learnt in their order
    return ThreadPoolExecutor(1, "heliograph-decode") if beside else AtOnce()


class ComingPacket:
    """A packet that was seen, and is decoded or being decoded.

    Parameters
    ----------
    seen
        The packet without its codewords.
    decoded
        What decoding makes of it.
    observe
        Gets the events of decoding, in the thread that asks for the packet.
    """

    def __init__(self, seen: Packet, decoded: Future[DecodedPacket], observe: Observer):
        self._seen, self._decoded, self._observe = seen, decoded, observe
        self._packet: Packet | None = None

    @property
    def done(self) -> bool:
        """Whether it is decoded."""
        return self._decoded.done()

    @property
    def reader(self) -> PacketReader:
        """The reader that read it, with what it has learnt; waits until it is decoded."""
        return self._decoded.result().reader

    def packet(self) -> Packet:
        """The packet; waits until it is decoded."""
        if self._packet is None:
            decoded, seen = self._decoded.result(), self._seen
            status = _status(decoded.layers, seen.header_score, seen.pairs_seen)
            self._packet = replace(
                seen, status=status, layers=decoded.layers, format=decoded.reader.format, reason=decoded.reason
            )
            for event in (*decoded.events, decoded.reader.shown(self._packet)):
                self._observe(event)
        return self._packet


def _status(layers: Words, header: float, seen: float) -> Status:
    good = [word.status == "ok" for words in layers.values() for word in words]
    if any(good):
        return "ok" if all(good) else "partial"
    if seen < ENOUGH_SEEN:
        return "no_array"
    return "crc_fail" if header >= HEADER_SEEN else "no_header"
