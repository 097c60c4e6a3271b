"""Packets that are decoded, at once or in a process beside the frames that follow."""

import contextlib
import logging
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib import import_module
from typing import NamedTuple, Protocol, TypeVar

import numpy as np

from heliograph.base.errors import HeliographError
from heliograph.base.registry import registered
from heliograph.base.shared import Shared
from heliograph.base.workers import worker_environment, worker_processes
from heliograph.receive.decode.codeword import unread
from heliograph.receive.events import Event, Observer
from heliograph.receive.lost_pair import decode_renumbered
from heliograph.receive.packets import Packet, Status, Words
from heliograph.receive.reader_protocol import Decoded, Lesson, TakenPacket
from heliograph.signal.formats import UnreadableModeError
from heliograph.signal.packet import PacketFormat
from heliograph.signal.settings import SignalSettings

LOG = logging.getLogger(__name__)

Result = TypeVar("Result")

HEADER_SEEN = 0.5
"""Least header score of a packet whose header was seen: half of the array's light must alternate."""

ENOUGH_SEEN = 0.5
"""Least fraction of a packet's data that must have been seen.

Below it a packet that the film's end cuts off is not given out, and one without a right codeword is "no_array". Of
data half of which is erased no code of a rate above 1/2 can be read. Half of it loses none of 192 codewords; twice of
it, all of the data, loses 20, all of cameras out of step.
"""

LESSONS_KEPT = 32
"""Arrays whose lessons the process that decodes keeps, those asked for last: more than are in view.

An array of 16 x 16 LEDs takes 1 MB. One that is left out is learnt anew.
"""


class Teaching(NamedTuple):
    """What the packets of an array have taught.

    Attributes
    ----------
    lesson
        What the last one taught that was studied; None before.
    study
        Gives what the packet taught that was decoded last; None where it is studied, or teaches nothing.
    """

    lesson: Lesson | None = None
    study: Callable[[], Lesson | None] | None = None


class SharedLesson(Shared[Teaching]):
    """Hands what was learnt of an array on from packet to packet, where these are decoded.

    Parameters
    ----------
    name
        What tells it from others in another process; None for a new name.
    """

    kept = LESSONS_KEPT

    def __init__(self, name: str | None = None) -> None:
        super().__init__(Teaching(), name)


@dataclass(frozen=True, slots=True)
class DecodedPacket:
    """A packet once it is decoded.

    Attributes
    ----------
    decoded
        What decoding made of it.
    events
        What observers are told of decoding, in its order.
    failure
        Why nothing was read; None where it was decoded.
    renumbered
        The packet with its pairs renumbered, where that is how it was decoded; None else.
    """

    decoded: Decoded
    events: tuple[Event, ...] = ()
    failure: Exception | None = None
    renumbered: TakenPacket | None = None


@dataclass(frozen=True, slots=True)
class Work:
    """A packet to be decoded; another process may do it.

    Attributes
    ----------
    taken
        All that was taken of the packet.
    identity
        Number of the array, 0 to 29.
    signal
        Settings of the light's signal.
    lacks_pair
        Whether a pair of it is lost, nobody knows which.
    taught
        What the array's packets before have taught.
    """

    taken: TakenPacket
    identity: int
    signal: SignalSettings
    lacks_pair: bool
    taught: SharedLesson

    def __call__(self) -> DecodedPacket:
        """Decode it."""
        events, renumbered, lesson = list[Event](), None, self.taught.content.lesson
        taken = self.taken.taught(lesson)
        try:
            if self.lacks_pair:
                renumbered, decoded = decode_renumbered(taken, self.signal.data_pairs, events.append)
            else:
                decoded = taken.decode(events.append)
        except (np.linalg.LinAlgError, UnreadableModeError) as error:
            words = unread(PacketFormat(self.signal, self.taken.format), self.identity)
            return DecodedPacket(Decoded(words), tuple(events), error)
        self.taught.keep(Teaching(lesson, decoded.study))
        # what it teaches is worked out later, and here
        return DecodedPacket(replace(decoded, study=None), tuple(events), None, renumbered)


@dataclass(frozen=True, slots=True)
class Glance:
    """A look at a packet before it is decoded.

    Attributes
    ----------
    taken
        All that was taken of the packet.
    """

    taken: TakenPacket

    def __call__(self) -> bool:
        """Whether a codeword of it is right."""
        return self.taken.glance()


def glanced(decoders: "Decoders", taken: TakenPacket) -> bool:
    """Whether a look at a packet shows a right codeword; waits for it.

    Parameters
    ----------
    decoders
        Where packets are decoded.
    taken
        All that was taken of the packet.

    Raises
    ------
    HeliographError
        The process that decodes has ended.
    """
    return _result(decoders.submit(Glance(taken)))


@dataclass(frozen=True, slots=True)
class Study:
    """Works out what a packet teaches, after it was decoded and handed out.

    Attributes
    ----------
    taught
        What the array's packets have taught.
    """

    taught: SharedLesson

    def __call__(self) -> Lesson | None:
        """What readers are told of what the packet that was decoded last has taught; None for nothing."""
        before, study = self.taught.content
        if study is None:
            return None
        self.taught.keep(Teaching(before))
        try:
            lesson = study()
        except np.linalg.LinAlgError:
            return None
        self.taught.keep(Teaching(lesson))
        return None if lesson is None else lesson.told


class Decoders(Protocol):
    """Decodes packets, one after the other."""

    def submit(self, work: Callable[[], Result], /) -> Future[Result]:
        """Decode or study a packet, now or later, after all that was submitted before.

        Parameters
        ----------
        work
            Does it; called once, here or in another process.
        """


class AtOnce:
    """Decodes a packet when it is handed in."""

    def submit(self, work: Callable[[], Result], /) -> Future[Result]:
        """Do it; see `Decoders`."""
        done = Future[Result]()
        done.set_result(work())
        return done


class Beside:
    """Decodes packets in another process, the same one for all receivers of this process.

    A thread would do no good: following and decoding are half Python, of which one thread runs at a time.
    """

    def submit(self, work: Callable[[], Result], /) -> Future[Result]:
        """Hand it to the process; see `Decoders`."""
        return _submitted(work)


def decoders(beside: bool) -> Decoders:
    """What decodes packets.

    Parameters
    ----------
    beside
        Whether in a process of its own, which is begun now.
    """
    if not beside:
        return AtOnce()
    _submitted(_loaded)
    return Beside()


def _submitted(work: Callable[[], Result]) -> Future[Result]:
    """Hand work to the process, or to another one where that has ended."""
    with worker_environment():
        try:
            return _process(registered()).submit(work)
        except BrokenProcessPool:
            _process.cache_clear()
            return _process(registered()).submit(work)


@lru_cache(maxsize=1)
def _process(_parts: tuple[str, ...]) -> ProcessPoolExecutor:
    """The process that decodes, which knows some registered parts."""
    # one process: what packets show of an array and its codewords is kept there, in the packets' order
    return worker_processes(1)


def _loaded() -> None:
    """Have all that decoding needs before the first packet comes."""
    import_module("heliograph.receive.assemblies")


class ComingPacket:
    """A packet that was seen, and is decoded or being decoded.

    Parameters
    ----------
    seen
        The packet without its codewords.
    taken
        All that was taken of it.
    work
        What decoding makes of it.
    lesson
        What readers are told of what it teaches of the array.
    observe
        Gets the events of decoding, in the thread that asks for the packet.
    exposure_range
        Exposures in T_b between which headers so far put the camera's; None where nothing is known of it.
    """

    def __init__(
        self,
        seen: Packet,
        taken: TakenPacket,
        work: Future[DecodedPacket],
        lesson: Future[Lesson | None],
        observe: Observer,
        exposure_range: tuple[float, float] | None,
    ):
        self._seen, self._taken, self._work, self._lesson, self._observe = seen, taken, work, lesson, observe
        self._exposure_range = exposure_range
        self._packet: Packet | None = None

    @property
    def done(self) -> bool:
        """Whether it is decoded."""
        return self._work.done()

    @property
    def lesson(self) -> Lesson | None:
        """What readers are told of what it teaches, None for nothing; waits until that is known.

        Raises
        ------
        HeliographError
            The process that decodes has ended.
        """
        return _result(self._lesson)

    def settle(self) -> None:
        """Wait until nothing more comes of it: neither the packet nor, whatever comes of that, what it teaches."""
        with contextlib.suppress(Exception):
            self._lesson.result()

    def packet(self) -> Packet:
        """The packet; waits until it is decoded.

        Raises
        ------
        HeliographError
            The process that decodes has ended.
        """
        if self._packet is None:
            result, seen = _result(self._work), self._seen
            taken, words = result.renumbered or self._taken, result.decoded.words
            self._packet = replace(
                seen,
                status=_status(words, seen.header_score, seen.pairs_seen),
                layers=words,
                format=taken.format,
                reason=self._reason(result.failure),
            )
            for event in result.events:
                self._observe(event)
            self._observe(replace(taken.shown(self._packet, result.decoded), exposure_range=self._exposure_range))
        return self._packet

    def _reason(self, failure: Exception | None) -> str:
        if failure is None:
            return ""
        # of a header that something hides, any mode may be read
        level = logging.INFO if isinstance(failure, UnreadableModeError) else logging.WARNING
        place = self._seen.identity, self._seen.first_frame
        LOG.log(level, "array %d, packet at frame %d is not read: %s", *place, failure)
        return str(failure)


def _result(work: Future[Result]) -> Result:
    try:
        return work.result()
    except BrokenProcessPool:
        raise HeliographError(
            "the process that decodes packets has ended: was there too little memory? "
            "receive.decode.beside = false decodes them in this process"
        ) from None


def _status(layers: Words, header: float, seen: float) -> Status:
    good = [word.status == "ok" for words in layers.values() for word in words]
    if any(good):
        return "ok" if all(good) else "partial"
    if seen < ENOUGH_SEEN:
        return "no_array"
    return "crc_fail" if header >= HEADER_SEEN else "no_header"
