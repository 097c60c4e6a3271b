"""Decoding of packets, inline or in a worker process, with the state learnt of each array."""

import contextlib
import logging
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, NamedTuple, Protocol, TypeVar
from uuid import uuid4

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.base.errors import HeliographError
from heliograph.base.registry import registered
from heliograph.base.workers import worker_environment, worker_processes
from heliograph.receive.decode.codeword import unread
from heliograph.receive.decode.combining import SoftBuffer
from heliograph.receive.equalise.led_gains import LedGains
from heliograph.receive.events import DecodeEvent, Event, Observer
from heliograph.receive.geometry.pose import Orientation
from heliograph.receive.observe.cutout import Cutout
from heliograph.receive.packet import Packet, Words, packet_status
from heliograph.signal.formats import UnreadableModeError
from heliograph.signal.packet import PacketFormat

LOG = logging.getLogger(__name__)

Key = TypeVar("Key")
Value = TypeVar("Value")
Result = TypeVar("Result")


@dataclass(frozen=True, slots=True)
class ArrayState:
    """State of an array, learnt from decoded packets.

    Attributes
    ----------
    led_gains
        Gains of the LEDs; None before a packet showed any.
    confirmed
        True if the equaliser has decoded a codeword of the array: the pose is right.
    misled
        True if samples at the LEDs decode better than the equaliser: the pose is wrong.
    buffer
        Undecoded codewords of the array, for repetitions; None without combining.
    """

    led_gains: LedGains | None = None
    confirmed: bool = False
    misled: bool = False
    buffer: SoftBuffer | None = None

    @property
    def for_tracking(self) -> "ArrayState":
        """State for tracking, less evidence and buffer."""
        led_gains = None if self.led_gains is None else self.led_gains.without_evidence
        return replace(self, led_gains=led_gains, buffer=None)


@dataclass(frozen=True, slots=True)
class Decoded:
    """Result of decoding a packet.

    Attributes
    ----------
    words
        Codewords by layer, decoded or not.
    learn
        Computes the array's state after this packet; None for no change.
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
    learn: Callable[[], ArrayState] | None = None
    buffer: SoftBuffer | None = None
    cutouts: tuple[Cutout | None, ...] | None = None
    luminances: Floats | None = None
    events: tuple[Event, ...] = ()
    failure: Exception | None = None


class Observations(Protocol):
    """Observations of a packet as a value, which another process can decode."""

    @property
    def form(self) -> PacketFormat:
        """Format of the packet, as far as the header has shown."""

    @property
    def cutouts(self) -> Sequence[Cutout | None]:
        """Cut-outs of the pairs, None for missing pairs; empty if luminances are decoded."""

    def has_codeword(self) -> bool:
        """Return True if a check, faster than `decode`, decodes a codeword."""

    def renumbered(self, place: int) -> "Observations":
        """Return the packet with a lost pair: it and later pairs move to the next number.

        Parameters
        ----------
        place
            Number of the lost pair.
        """

    def decode(self, state: ArrayState, observe: Observer, /) -> Decoded:
        """Decode the packet.

        Parameters
        ----------
        state
            State of the array after the packets before.
        observe
            Gets the events of decoding.
        """


class ArrayKey(NamedTuple):
    """Name of an array for the decoder of a receiver."""

    identity: int
    orientation: Orientation
    number: int  # distinguishes arrays of equal identity, as after a loss and a new detection


MAX_ARRAYS = 64
"""Array states in a decoder, more than are in view: 1 MB each with 16 x 16 LEDs."""

MAX_BUFFERS = 32
"""Soft buffers in a decoder, by identity and orientation: more than identities exist."""

MAX_DECODERS = 4
"""Decoders in the worker process, a decoder for each receiver."""


class PacketDecoder:
    """Decodes the packets of a receiver's arrays and owns the array states.

    A pickled decoder becomes the decoder of the same name in the other process, where the state stays between packets.
    """

    def __init__(self, name: str | None = None):
        self._name = name or uuid4().hex
        self._states: dict[ArrayKey, ArrayState] = {}
        # by identity, not by array: after a loss and a new detection the carousel goes on
        self._buffers: dict[tuple[int, Orientation], SoftBuffer] = {}
        self._learn: Callable[[], ArrayState] | None = None

    def __reduce__(self) -> tuple[Any, ...]:
        return _local_decoder, (self._name,)

    def has_codeword(self, packet: Observations) -> bool:
        """Return True if a quick check decodes a codeword of a packet."""
        return packet.has_codeword()

    def decode(self, packet: Observations, array: ArrayKey, lacks_pair: bool) -> Decoded:
        """Decode a packet of an array; `learn` updates the state of the array afterwards."""
        events, self._learn = list[Event](), None
        state = self._states.get(array, ArrayState())
        try:
            if lacks_pair:
                decoded = decode_with_missing_pair(packet, state, events.append)
            else:
                buffer = self._buffers.get(array[:2], SoftBuffer())
                decoded = packet.decode(replace(state, buffer=buffer), events.append)
        except (np.linalg.LinAlgError, UnreadableModeError) as error:
            return Decoded(unread(packet.form, array.identity), events=tuple(events), failure=error)
        self._keep(array, decoded.buffer)
        self._learn = decoded.learn
        return replace(decoded, learn=None, buffer=None, events=tuple(events))

    def learn(self, array: ArrayKey) -> ArrayState | None:
        """Update the state of an array from the last packet; return None if unchanged."""
        learn, self._learn = self._learn, None
        if learn is None:
            return None
        try:
            state = learn()
        except np.linalg.LinAlgError:
            return None
        self._keep(array, state.buffer)
        _remember(self._states, array, replace(state, buffer=None), MAX_ARRAYS)
        return state.for_tracking

    def _keep(self, array: ArrayKey, buffer: SoftBuffer | None) -> None:
        if buffer is not None:
            _remember(self._buffers, array[:2], buffer, MAX_BUFFERS)


_DECODERS: dict[str, PacketDecoder] = {}
"""Decoders of other processes, by name."""


def _local_decoder(name: str) -> PacketDecoder:
    """Decoder in this process for a pickled decoder."""
    return _remember(_DECODERS, name, _DECODERS.get(name) or PacketDecoder(name), MAX_DECODERS)


def _remember(recent: dict[Key, Value], key: Key, value: Value, count: int) -> Value:
    """Add a value to a dictionary that keeps the values added last."""
    recent.pop(key, None)
    recent[key] = value
    while len(recent) > count:
        del recent[next(iter(recent))]
    return value


def decode_with_missing_pair(packet: Observations, state: ArrayState, observe: Observer, places: int = 6) -> Decoded:
    """Decode a packet that lacks a pair of unknown number: try a few numbers.

    The sums after a lost pair stay even; only the next header, a pair early, shows the loss. Of 48 pairs at most four
    then have a wrong number, which the code corrects. Such a packet is not combined with repetitions.
    """
    best: Decoded | None = None
    pairs = packet.form.settings.data_pairs
    # each in the middle of a part of the packet
    for place in np.unique((np.arange(places) + 0.5) * pairs / places).astype(int).tolist():
        renumbered = packet.renumbered(place)
        decoded = renumbered.decode(replace(state, buffer=None), observe)
        if best is None or _count_decoded(decoded.words) > _count_decoded(best.words):
            best = replace(decoded, cutouts=decoded.cutouts or tuple(renumbered.cutouts))
        if _count_decoded(decoded.words) == sum(map(len, decoded.words.values())):
            break
    assert best is not None  # places is positive
    return best


def _count_decoded(words: Words) -> int:
    return sum(word.status == "ok" for layer in words.values() for word in layer)


class InlineExecutor(Executor):
    """Runs each call at once."""

    def submit(self, call: Callable[..., Result], /, *args: Any, **kwargs: Any) -> Future[Result]:
        """Run a call; see `Executor`."""
        done = Future[Result]()
        done.set_result(call(*args, **kwargs))
        return done


class ProcessExecutor(Executor):
    """Runs calls in order in a second process, shared by all receivers of this process.

    A thread would gain little: tracking and decoding are half Python, which runs in a single thread at a time.
    """

    def submit(self, call: Callable[..., Result], /, *args: Any, **kwargs: Any) -> Future[Result]:
        """Hand a call to the process, restarted if it has ended; see `Executor`."""
        with worker_environment():
            try:
                return _process(registered()).submit(call, *args, **kwargs)
            except BrokenProcessPool:
                _process.cache_clear()
                return _process(registered()).submit(call, *args, **kwargs)


@lru_cache(maxsize=1)
def _process(_parts: tuple[str, ...]) -> ProcessPoolExecutor:
    """Worker process with the registered parts."""
    return worker_processes(1)


class PendingPacket:
    """Observed packet during and after decoding."""

    def __init__(
        self,
        packet: Packet,
        observations: Observations,
        decoded: Future[Decoded],
        state: Future[ArrayState | None],
        observe: Observer,
        exposure_range: tuple[float, float] | None,
    ):
        self._undecoded, self._observations, self._decoded, self._state = packet, observations, decoded, state
        self._observe, self._exposure_range = observe, exposure_range
        self._packet: Packet | None = None

    @property
    def done(self) -> bool:
        """True if the packet is decoded."""
        return self._decoded.done()

    @property
    def state(self) -> ArrayState | None:
        """State of the array after the packet, None if unchanged; waits for the decoder."""
        return wait_for(self._state)

    def settle(self) -> None:
        """Wait until the decoder has finished with the packet or failed."""
        with contextlib.suppress(Exception):
            self._state.result()

    def packet(self) -> Packet:
        """Packet with codewords; waits for the decoder."""
        if self._packet is None:
            decoded, packet = wait_for(self._decoded), self._undecoded
            self._packet = packet = replace(
                packet,
                status=packet_status(decoded.words, packet.header_score, packet.pairs_seen),
                layers=decoded.words,
                format=self._observations.form.format,
                reason=self._log_failure(decoded.failure),
            )
            for event in decoded.events:
                self._observe(event)
            cutouts = tuple(self._observations.cutouts) if decoded.cutouts is None else decoded.cutouts
            self._observe(
                DecodeEvent(packet.identity, packet, decoded.luminances, cutouts, exposure_range=self._exposure_range)
            )
        return self._packet

    def _log_failure(self, failure: Exception | None) -> str:
        if failure is None:
            return ""
        # an occluded header may show any mode
        level = logging.INFO if isinstance(failure, UnreadableModeError) else logging.WARNING
        packet = self._undecoded
        LOG.log(level, "array %d, packet at frame %d is not read: %s", packet.identity, packet.first_frame, failure)
        return str(failure)


def wait_for(future: Future[Result]) -> Result:
    """Wait for the result of a decoder's call; report the end of the worker process."""
    try:
        return future.result()
    except BrokenProcessPool:
        raise HeliographError(
            "the process that decodes packets has ended: was there too little memory? "
            "receive.decode.in_background = false decodes them in this process"
        ) from None
