"""Packets of which a whole pair is lost without a gap: which one it was, is found by decoding.

All sums after a lost pair are even, so nothing shows it until the next header comes in the place of the last pair. The
pairs from the lost one on have then the number of the one before. A code stands some wrong numbers: the packet is
decoded as if the pair were lost at each of a few places.

Packets that are decoded, at once or in a process beside the frames that follow.
"""

import contextlib
import logging
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib import import_module
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.base.errors import HeliographError
from heliograph.base.registry import registered
from heliograph.base.shared import Shared
from heliograph.base.workers import worker_environment, worker_processes
from heliograph.receive.decode.codeword import unread
from heliograph.receive.events import DecodeEvent, Event, Observer
from heliograph.receive.observe.cutout import Cutout
from heliograph.receive.packet import Packet, Status, Words
from heliograph.receive.track.track import Track
from heliograph.signal.formats import Format, UnreadableModeError
from heliograph.signal.packet import PacketFormat
from heliograph.signal.settings import SignalSettings


@dataclass(frozen=True, slots=True)
class ReadHeader:
    """A header pair as it was read.

    Attributes
    ----------
    track
        The array, its pose refined by the header.
    score
        Amplitude of the header as a fraction of the array's light.
    """

    track: Track
    score: float


class Lesson(Protocol):
    """What a packet teaches of its array: all of it stays where packets are decoded."""

    @property
    def misled(self) -> bool:
        """Whether the array is not quite as it is followed."""

    @property
    def told(self) -> "Lesson":
        """The part of it that readers need, which another process may have to hand over."""


@dataclass(frozen=True, slots=True)
class Decoded:
    """What decoding made of what was taken of a packet.

    Attributes
    ----------
    words
        Codewords by layer, decoded or not.
    study
        Gives what they teach of the array, which nobody need wait for; None where that is nothing.
    cutouts
        Cut-outs of its pairs where others were decoded than those taken; None else.
    luminances
        (pairs, n, n) that were decoded; None of a reader that does not read LED by LED.
    """

    words: Words
    study: Callable[[], Lesson | None] | None = None
    cutouts: tuple[Cutout | None, ...] | None = None
    luminances: Floats | None = None


class UndecodedPacket(Protocol):
    """All that was taken of a packet: a value, which another process may decode."""

    @property
    def format(self) -> Format:
        """The packet's format, as far as its header has shown it."""

    def taught(self, lesson: Any) -> "UndecodedPacket":
        """Give the same packet with what is known of the array by the packets before.

        They are decoded by then, where the reader may have known only of those before the last.

        Parameters
        ----------
        lesson
            What `Decoded.study` of the last packet that taught anything has given; None before the first.
        """

    def glance(self) -> bool:
        """Whether a codeword is right by what can be read at once, in less time than an equaliser takes."""

    def renumbered(self, place: int) -> "UndecodedPacket":
        """Give the same packet as it is if a pair is lost that the numbers do not tell of.

        What it teaches is not kept for later packets.

        Parameters
        ----------
        place
            Number of the lost pair; what was taken from there on is that of the pairs after it.
        """

    def decode(self, observe: Observer, /) -> Decoded:
        """Decode it.

        Parameters
        ----------
        observe
            Gets the events of decoding.
        """

    def shown(self, packet: Packet, decoded: Decoded) -> DecodeEvent:
        """What an observer of the packet gets.

        Parameters
        ----------
        packet
            The packet as it will be handed out.
        decoded
            What decoding made of it.
        """


PLACES = 6
"""Places at which a pair is taken for lost.

Of 48 pairs of data, four at most have then a wrong number, and half of their bits are right all the same: 4 % are
wrong. A code of rate 1/3 corrects about 17 %.
"""


def decode_with_missing_pair(taken: UndecodedPacket, pairs: int, observe: Observer) -> tuple[UndecodedPacket, Decoded]:
    """Decode a packet that lacks a pair nobody knows of."""
    best: tuple[UndecodedPacket, Decoded] | None = None
    # each in the middle of a part of the packet
    for place in np.unique((np.arange(PLACES) + 0.5) * pairs / PLACES).astype(int).tolist():
        one = taken.renumbered(place)
        decoded = one.decode(observe)
        if best is None or _right(decoded.words) > _right(best[1].words):
            best = one, decoded
        if _right(decoded.words) == sum(map(len, decoded.words.values())):
            break
    assert best is not None  # PLACES is at least one
    return best


def _right(words: Words) -> int:
    return sum(word.status == "ok" for layer in words.values() for word in layer)


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
    """What the packets of an array have taught."""

    # What the last one taught that was studied; None before
    lesson: Lesson | None = None
    # Gives what the packet taught that was decoded last; None where it is studied, or teaches nothing
    study: Callable[[], Lesson | None] | None = None


class SharedLesson(Shared[Teaching]):
    """Hands what was learnt of an array on from packet to packet, where these are decoded."""

    kept = LESSONS_KEPT

    def __init__(self, name: str | None = None) -> None:
        super().__init__(Teaching(), name)


@dataclass(frozen=True, slots=True)
class DecodedPacket:
    """A packet once it is decoded."""

    # What decoding made of it
    decoded: Decoded
    # What observers are told of decoding, in its order
    events: tuple[Event, ...] = ()
    # Why nothing was read; None where it was decoded
    failure: Exception | None = None
    # The packet with its pairs renumbered, where that is how it was decoded; None else
    renumbered: UndecodedPacket | None = None


@dataclass(frozen=True, slots=True)
class Work:
    """A packet to be decoded; another process may do it."""

    # All that was taken of the packet
    taken: UndecodedPacket
    # Number of the array, 0 to 29
    identity: int
    # Settings of the light's signal
    signal: SignalSettings
    # Whether a pair of it is lost, nobody knows which
    lacks_pair: bool
    # What the array's packets before have taught
    taught: SharedLesson

    def __call__(self) -> DecodedPacket:
        """Decode it."""
        events, renumbered, lesson = list[Event](), None, self.taught.content.lesson
        taken = self.taken.taught(lesson)
        try:
            if self.lacks_pair:
                renumbered, decoded = decode_with_missing_pair(taken, self.signal.data_pairs, events.append)
            else:
                decoded = taken.decode(events.append)
        except (np.linalg.LinAlgError, UnreadableModeError) as error:
            words = unread(PacketFormat(self.signal, self.taken.format), self.identity)
            return DecodedPacket(Decoded(words), tuple(events), error)
        self.taught.keep(Teaching(lesson, decoded.study))
        # what it teaches is worked out later, and here
        return DecodedPacket(replace(decoded, study=None), tuple(events), None, renumbered)


@dataclass(frozen=True, slots=True)
class QuickCheck:
    """A look at a packet before it is decoded."""

    # All that was taken of the packet
    taken: UndecodedPacket

    def __call__(self) -> bool:
        """Whether a codeword of it is right."""
        return self.taken.glance()


def glanced(decoders: "Decoders", taken: UndecodedPacket) -> bool:
    """Whether a look at a packet shows a right codeword; waits for it."""
    return _result(decoders.submit(QuickCheck(taken)))


@dataclass(frozen=True, slots=True)
class Study:
    """Works out what a packet teaches, after it was decoded and handed out."""

    # What the array's packets have taught
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
        """Decode or study a packet, now or later, after all that was submitted before."""


class InlineExecutor:
    """Decodes a packet when it is handed in."""

    def submit(self, work: Callable[[], Result], /) -> Future[Result]:
        """Do it; see `Decoders`."""
        done = Future[Result]()
        done.set_result(work())
        return done


class ProcessExecutor:
    """Decodes packets in another process, the same one for all receivers of this process.

    A thread would do no good: following and decoding are half Python, of which one thread runs at a time.
    """

    def submit(self, work: Callable[[], Result], /) -> Future[Result]:
        """Hand it to the process; see `Decoders`."""
        return _submitted(work)


def decoders(beside: bool) -> Decoders:
    """What decodes packets."""
    if not beside:
        return InlineExecutor()
    _submitted(_loaded)
    return ProcessExecutor()


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
    import_module("heliograph.receive.build")


class PendingPacket:
    """A packet that was seen, and is decoded or being decoded."""

    def __init__(
        self,
        seen: Packet,
        taken: UndecodedPacket,
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
        """What readers are told of what it teaches, None for nothing; waits until that is known."""
        return _result(self._lesson)

    def settle(self) -> None:
        """Wait until nothing more comes of it: neither the packet nor, whatever comes of that, what it teaches."""
        with contextlib.suppress(Exception):
            self._lesson.result()

    def packet(self) -> Packet:
        """The packet; waits until it is decoded."""
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
            "receive.decode.in_background = false decodes them in this process"
        ) from None


def _status(layers: Words, header: float, seen: float) -> Status:
    good = [word.status == "ok" for words in layers.values() for word in words]
    if any(good):
        return "ok" if all(good) else "partial"
    if seen < ENOUGH_SEEN:
        return "no_array"
    return "crc_fail" if header >= HEADER_SEEN else "no_header"
