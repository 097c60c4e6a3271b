"""Decoding of packets, inline or in a worker process, with the state learnt of each array."""

import contextlib
import logging
from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Any, Protocol, TypeVar
from uuid import uuid4
from weakref import finalize

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.base.errors import HeliographError
from heliograph.base.registry import register_again, registered
from heliograph.base.workers import worker_environment, worker_processes
from heliograph.receive.decode.codeword import unread
from heliograph.receive.decode.combining import SoftBuffer
from heliograph.receive.decode.header_reader import HeaderReader
from heliograph.receive.equalise.led_gains import LedGains
from heliograph.receive.equalise.single_mode import DecisionDirectedTracker
from heliograph.receive.events import DecodeEvent, Event, ExtractEvent, Observer
from heliograph.receive.geometry.pose import Orientation
from heliograph.receive.observe.cutout import Cutout
from heliograph.receive.packet import Packet, Words, ok_flags, packet_status
from heliograph.receive.sync.pairing import FramePair
from heliograph.receive.track.track import Track, TrackedPair
from heliograph.signal.formats import UnreadableModeError, check_mode
from heliograph.signal.packet import PacketFormat

LOG = logging.getLogger(__name__)

Key = TypeVar("Key")
Value = TypeVar("Value")
Result = TypeVar("Result")


@dataclass(frozen=True, slots=True)
class Decoded:
    """Result of decoding a packet.

    Attributes
    ----------
    words
        Codewords by layer, decoded or not.
    learn
        Computes the gains of the LEDs after this packet; None for no change.
    buffer
        Undecoded codewords of the array after this packet; None if unchanged.
    cutouts
        Decoded cut-outs of the pairs if they differ from the observed cut-outs; else None.
    luminances
        (pairs, n, n) decoded luminances; None if cut-outs were decoded.
    events
        Events of decoding, in order.
    failure
        Reason of a failure to decode the packet; else None.
    """

    words: Words
    learn: Callable[[], LedGains | None] | None = None
    buffer: SoftBuffer | None = None
    cutouts: tuple[Cutout | None, ...] | None = None
    luminances: Floats | None = None
    events: tuple[Event, ...] = ()
    failure: Exception | None = None


class PacketObservations(Protocol):
    """Observations of a packet, which another process can decode."""

    # Format of the packet, and the number of the format that the header signals
    form: PacketFormat
    mode: int

    @property
    def cutouts(self) -> Sequence[Cutout | None]:
        """Cut-outs of the pairs, None for missing pairs; empty if luminances are decoded."""

    def add_pair(self, place: int, pair: FramePair, tracked: TrackedPair) -> ExtractEvent:
        """Add a pair of data in which the array is visible.

        Parameters
        ----------
        place
            Number of the pair in the packet's data, from 0.
        pair
            Frames of a pattern and its inverse; in the single mode of two patterns.
        tracked
            The array in the frames.
        """

    def end(self, headers: HeaderReader, track: Track, decisions: DecisionDirectedTracker | None) -> None:
        """Take format, light and LED gains of the array at the end of the packet.

        Parameters
        ----------
        headers
            Reader of the packet's header.
        track
            The array at the end.
        decisions
            Tracker of the data, in the single mode without inverses; else None.
        """

    def has_codeword(self) -> bool:
        """Return True if a check, faster than `decode`, decodes a codeword."""

    def renumbered(self, place: int) -> "PacketObservations":
        """Return the packet with a lost pair: it and later pairs move to the next number.

        Parameters
        ----------
        place
            Number of the lost pair.
        """

    def decode(self, led_gains: LedGains | None, buffer: SoftBuffer | None, observe: Observer, /) -> Decoded:
        """Decode the packet.

        Parameters
        ----------
        led_gains
            Gains of the LEDs after the packets before; None if unknown.
        buffer
            Undecoded codewords of the array, for repetitions; None to combine none.
        observe
            Gets the events of decoding.
        """


# identity, orientation and number of an array; the number distinguishes arrays of equal identity, as after a loss
ArrayKey = tuple[int, Orientation, int]

MAX_ARRAYS = 64  # arrays in a decoder, more than are in view: 1 MB each with 16 x 16 LEDs
MAX_BUFFERS = 32  # soft buffers in a decoder, by identity and orientation: more than identities exist


class PacketDecoder:
    """Decodes the packets of a receiver's arrays and owns the states learnt of them.

    A pickled decoder becomes the decoder of the same name in the other process, where the state stays between packets.
    """

    def __init__(self, name: str | None = None):
        self._name, self._is_shared = name or uuid4().hex, False
        self._led_gains: dict[ArrayKey, LedGains] = {}
        # by identity, not by array: after a loss and a new detection the carousel goes on
        self._buffers: dict[tuple[int, Orientation], SoftBuffer] = {}
        self._learn: Callable[[], LedGains | None] | None = None

    def __reduce__(self) -> tuple[Any, ...]:
        if not self._is_shared:
            self._is_shared = True
            finalize(self, _ended.append, self._name)
        return _local_decoder, (self._name,)

    def decode(self, packet: PacketObservations, array: ArrayKey, lacks_pair: bool = False) -> Decoded:
        """Decode a packet of an array; `learn` updates the gains of the LEDs afterwards."""
        events, self._learn = list[Event](), None
        led_gains, buffer = self._led_gains.get(array), self._buffers.get(array[:2], SoftBuffer())
        try:
            check_mode(packet.mode, packet.form.settings.data_pairs)
            if lacks_pair:
                decoded = _decode_with_lost_pair(packet, led_gains, events.append)
            else:
                decoded = packet.decode(led_gains, buffer, events.append)
        except (np.linalg.LinAlgError, UnreadableModeError) as error:
            return Decoded(unread(packet.form, array[0]), events=tuple(events), failure=error)
        self._learn = decoded.learn
        if decoded.buffer is not None:
            _remember(self._buffers, array[:2], decoded.buffer, MAX_BUFFERS)
        return replace(decoded, learn=None, buffer=None, events=tuple(events))

    def learn(self, array: ArrayKey) -> LedGains | None:
        """Update the gains of an array's LEDs from the last packet; return them without the evidence."""
        learn, self._learn = self._learn, None
        try:
            led_gains = learn and learn()
        except np.linalg.LinAlgError:
            return None
        return led_gains and _remember(self._led_gains, array, led_gains, MAX_ARRAYS).without_evidence


_ended = deque[str]()  # names of pickled decoders that no longer exist here
_local_decoders: dict[str, PacketDecoder] = {}  # by name, of decoders that another process holds


def _local_decoder(name: str) -> PacketDecoder:
    """Decoder in this process for a pickled decoder."""
    return _local_decoders.setdefault(name, PacketDecoder(name))


def _forget(name: str) -> None:
    _local_decoders.pop(name, None)


def _remember(recent: dict[Key, Value], key: Key, value: Value, count: int) -> Value:
    """Add a value to a dictionary that keeps the values added last."""
    recent.pop(key, None)
    recent[key] = value
    while len(recent) > count:
        del recent[next(iter(recent))]
    return value


def _decode_with_lost_pair(packet: PacketObservations, led_gains: LedGains | None, observe: Observer) -> Decoded:
    """Decode a packet that lacks a pair of unknown number: try the middles of six parts of the packet.

    The sums after a lost pair stay even; only the next header, a pair early, shows the loss. Of 48 pairs at most four
    then have a wrong number, which the code corrects. Such a packet is not combined with repetitions.
    """
    best, most, pairs = Decoded({}), -1, packet.form.settings.data_pairs
    for place in sorted({(2 * k + 1) * pairs // 12 for k in range(6)}):
        renumbered = packet.renumbered(place)
        decoded = renumbered.decode(led_gains, None, observe)
        is_ok = ok_flags(decoded.words)
        if sum(is_ok) > most:
            most, best = sum(is_ok), replace(decoded, cutouts=decoded.cutouts or tuple(renumbered.cutouts))
        if all(is_ok):
            break
    return best


def call_inline(call: Callable[..., Result], /, *args: Any) -> Future[Result]:
    """Run a call at once."""
    done = Future[Result]()
    done.set_result(call(*args))
    return done


def call_in_process(call: Callable[..., Result], /, *args: Any) -> Future[Result]:
    """Run calls in order in a second process, shared by all receivers of this process, restarted if it has ended.

    A thread would gain little: tracking and decoding are half Python, which runs in a single thread at a time.
    """
    with worker_environment():
        try:
            return _submit(call, *args)
        except BrokenProcessPool:
            _process.cache_clear()
            return _submit(call, *args)


def _submit(call: Callable[..., Result], /, *args: Any) -> Future[Result]:
    process = _process()
    _register(process, registered())
    with contextlib.suppress(IndexError):
        while True:
            process.submit(_forget, _ended.popleft())
    return process.submit(call, *args)


@lru_cache(maxsize=1)
def _process() -> ProcessPoolExecutor:
    """Worker process of all receivers."""
    return worker_processes(1)


@lru_cache(maxsize=1)
def _register(process: ProcessPoolExecutor, parts: tuple[str, ...]) -> None:
    """Register parts in the worker process, once after each change."""
    process.submit(register_again, parts)


@dataclass(eq=False)
class PendingPacket:
    """Observed packet during and after decoding."""

    # The packet without codewords, and its observations
    undecoded: Packet
    observations: PacketObservations
    # Results of the decoder
    decoded: Future[Decoded]
    learnt: Future[LedGains | None]
    # Gets the events of decoding
    observe: Observer
    # Bounds of the camera's exposure in T_b by the headers so far
    exposure_range: tuple[float, float] | None
    _packet: Packet | None = field(default=None, init=False)

    @property
    def done(self) -> bool:
        """True if the packet is decoded."""
        return self.decoded.done()

    @property
    def led_gains(self) -> LedGains | None:
        """Gains of the LEDs after the packet, None if unchanged; waits for the decoder."""
        return wait_for(self.learnt)

    def settle(self) -> None:
        """Wait until the decoder has finished with the packet or failed."""
        with contextlib.suppress(Exception):
            self.learnt.result()

    def packet(self) -> Packet:
        """Packet with codewords; waits for the decoder."""
        if self._packet is None:
            decoded, packet = wait_for(self.decoded), self.undecoded
            if (failure := decoded.failure) is not None:
                # an occluded header may show any mode
                level = logging.INFO if isinstance(failure, UnreadableModeError) else logging.WARNING
                cause = packet.identity, packet.first_frame, failure
                LOG.log(level, "array %d, packet at frame %d is not read: %s", *cause)
            status = packet_status(decoded.words, packet.header_score, packet.pairs_seen)
            form, reason = self.observations.form.format, str(failure or "")
            self._packet = packet = replace(packet, status=status, layers=decoded.words, format=form, reason=reason)
            for event in decoded.events:
                self.observe(event)
            cutouts = tuple(self.observations.cutouts) if decoded.cutouts is None else decoded.cutouts
            exposure_range = self.exposure_range
            self.observe(DecodeEvent(packet.identity, packet, decoded.luminances, cutouts, exposure_range))
        return self._packet


def wait_for(future: Future[Result]) -> Result:
    """Wait for the result of a decoder's call; report the end of the worker process."""
    try:
        return future.result()
    except BrokenProcessPool:
        raise HeliographError(
            "the process that decodes packets has ended: was there too little memory? "
            "receive.decode.in_background = false decodes them in this process"
        ) from None
