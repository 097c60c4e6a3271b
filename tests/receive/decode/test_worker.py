"""Packet decoding inline and in a worker process, in parallel with tracking."""

import itertools
import os
import pickle
import sys
import threading
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from recorder import Recorder
from scenes import SIDE, comparable, film, link, received, statuses
from waiting import HANG_S

from heliograph.base import registry
from heliograph.base.errors import HeliographError
from heliograph.base.frames import Frame
from heliograph.link.settings import LinkSettings
from heliograph.receive import array, build
from heliograph.receive.api import make_receiver
from heliograph.receive.decode import worker
from heliograph.receive.decode.combining import SoftBuffer
from heliograph.receive.decode.soft_packet import SoftPacket
from heliograph.receive.decode.worker import MAX_ARRAYS, MAX_BUFFERS, ArrayKey, Decoded, PacketDecoder, PendingPacket
from heliograph.receive.equalise.led_gains import LedGains, update_brightness
from heliograph.receive.events import ignore
from heliograph.receive.geometry.pose import ORIENTATIONS, UPRIGHT, Orientation
from heliograph.receive.packet import Packet
from heliograph.receive.registry import RECEIVERS
from heliograph.signal.packet import PacketFormat
from heliograph.signal.settings import SignalSettings

PACKET = 52  # frames per packet: two header pairs and 24 data pairs


def soft(*changes: str, **channel: Any) -> LinkSettings:
    return link("receive.receiver=soft", "signal.data_pairs=24", *changes, **{"distance_m": 40.0, **channel})


def two_arrays(receiver: str, in_background: bool) -> LinkSettings:
    arrays = [{"x_m": x_m, "y_m": 0.0} for x_m in (-0.45, 0.45)]
    background = f"receive.decode.in_background={str(in_background).lower()}"
    changes = f"receive.receiver={receiver}", background, "transmit.identities=[3, 7]"
    return soft(*changes, arrays=arrays, distance_m=60.0)


@cache
def film_of_two() -> list[Frame]:
    return film(two_arrays("plain", False), 2 * PACKET + 32)


@cache
def film_of_one() -> list[Frame]:
    return film(soft(), 3 * PACKET + 10, roi_margin_px=20)


@pytest.mark.parametrize("receiver", ["plain", "soft"])
@pytest.mark.slow
def test_decoding_in_the_background_gives_the_same_packets_and_events(receiver: str) -> None:
    read, events = [], []
    for in_background in (False, True):
        recorder = Recorder()
        read.append(comparable(received(film_of_two(), two_arrays(receiver, in_background), recorder)))
        events.append(Counter(type(event).__name__ for event in recorder.events))
    assert (read[0], events[0]) == (read[1], events[1])
    identities = [packet.identity for packet in read[0]]
    assert identities.count(3) == identities.count(7) == 3


@pytest.mark.slow
def test_decoder_receives_pixels_and_little_else(monkeypatch: pytest.MonkeyPatch) -> None:
    """LED statistics, a megabyte for 256 LEDs, stay in the process that learnt the gains."""
    submitted = list[tuple[SoftPacket, int]]()

    def submit(call: Callable[..., Any], /, *args: Any) -> Future[Any]:
        pickled = pickle.dumps((call, args))
        if call.__name__ == "decode":
            submitted.append((args[0], len(pickled)))
        call, args = pickle.loads(pickled)
        return worker.call_inline(call, *args)

    monkeypatch.setattr(build, "decode_executor", lambda _: submit)
    packets = received(film_of_two()[: 2 * PACKET + 4], two_arrays("soft", True))
    assert set(statuses(packets)) == {"ok"}
    assert submitted
    for observations, size in submitted:
        pixels = sum(cutout.total.nbytes + cutout.difference.nbytes for cutout in observations._cutouts.values())
        assert size < 1.3 * pixels + 50_000


def decode_in_a_thread(monkeypatch: pytest.MonkeyPatch, before: Callable[[int], None]) -> None:
    """Decode packets in a thread; call a function with the packet number before each."""
    decode, calls = SoftPacket.decode, itertools.count(1)

    def late(self: SoftPacket, *arguments: Any) -> Any:
        before(next(calls))
        return decode(self, *arguments)

    monkeypatch.setattr(SoftPacket, "decode", late)
    monkeypatch.setattr(build, "decode_executor", lambda _: ThreadPoolExecutor(1).submit)


def receive_in_parts(
    frames: Sequence[Frame], settings: LinkSettings, first: int, between: Callable[[], object] = lambda: None
) -> tuple[list[Packet], list[Packet]]:
    receiver = make_receiver(settings.signal, settings.receive)
    early = [packet for frame in frames[:first] for packet in receiver.push(frame)]
    between()
    late = [packet for frame in frames[first:] for packet in receiver.push(frame)]
    return early, [*late, *receiver.finish()]


def test_receiver_takes_frames_while_a_packet_is_decoded(monkeypatch: pytest.MonkeyPatch) -> None:
    free = threading.Event()

    def hold(number: int) -> None:
        assert number > 1 or free.wait(HANG_S)

    decode_in_a_thread(monkeypatch, hold)
    early, late = receive_in_parts(film_of_one(), soft(), PACKET + 40, free.set)
    assert not early, "the first packet is still being decoded, and the receiver took the next packet's frames"
    assert [packet.first_frame for packet in late] == [0, PACKET, 2 * PACKET]


class LazyFuture(Future[Any]):
    """A future that computes pending work up to this item when its result is requested."""

    def __init__(self, pending: list["LazyFuture"], work: Callable[[], Any]) -> None:
        super().__init__()
        self._pending, self._work = pending, work

    def result(self, timeout: float | None = None) -> Any:
        while not self.done():
            first = self._pending.pop(0)
            first.set_result(first._work())
        return super().result(timeout)


@pytest.fixture
def decoded_lazily(monkeypatch: pytest.MonkeyPatch) -> list[LazyFuture]:
    """Decode packets only when the receiver waits for them; return the pending calls."""
    pending = list[LazyFuture]()

    def submit(call: Callable[..., Any], /, *args: Any) -> LazyFuture:
        pending.append(LazyFuture(pending, partial(call, *args)))
        return pending[-1]

    monkeypatch.setattr(build, "decode_executor", lambda _: submit)
    return pending


def test_receiver_waits_for_the_decoder_at_the_end_of_a_film(decoded_lazily: list[LazyFuture]) -> None:
    """Python prints an error for results sent during interpreter exit."""
    assert statuses(received(film_of_one()[: PACKET + 20], soft())) == ["ok"]
    assert decoded_lazily == []


@pytest.mark.parametrize(("change", "orientation", "waits"), [
    ("transmit.identities=[7]", UPRIGHT, False),
    # the rotated header has another identity: LED sampling, if enabled, resolves the ambiguity
    ("transmit.identities=[3]", UPRIGHT, False),
    ("transmit.identities=[3]; receive.soft.led_by_led=false", UPRIGHT, True),
    ("transmit.identities=[7]; receive.soft.led_by_led=false", ORIENTATIONS[1], True),
    # dark areas may be hidden LEDs or no LEDs
    ("channel.arrays.0.hidden=[0,0,0.5,0.5]", UPRIGHT, True),
])  # fmt: skip
@pytest.mark.usefixtures("decoded_lazily")
@pytest.mark.slow
def test_tracking_waits_if_the_first_header_is_ambiguous(change: str, orientation: Orientation, waits: bool) -> None:
    settings = soft(*change.split("; "), camera={"width": 80, "height": 80})
    frames = [replace(frame, pixels=orientation.turned(frame.pixels)) for frame in film(settings, 2 * PACKET + 2)]
    early, late = receive_in_parts(frames, settings, PACKET + 40)
    assert [packet.first_frame for packet in early] == ([0] if waits else [])
    assert statuses([*early, *late]) == ["ok"] * 2


@pytest.mark.usefixtures("decoded_lazily")
@pytest.mark.slow
def test_tracking_half_a_pattern_late_waits_only_for_the_first_packet() -> None:
    """No header pair alternates half a pattern out of step, but the light clock measures the header."""
    settings = soft(arrays=[{"x_m": 0.0, "y_m": 0.0, "start_s": 0.0025}])
    early, late = receive_in_parts(film(settings, 3 * PACKET + 2, roi_margin_px=20), settings, 2 * PACKET + 40)
    assert [packet.header_score for packet in early] == [0.0]
    assert statuses([*early, *late])[:3] == ["ok"] * 3


@pytest.mark.usefixtures("decoded_lazily")
def test_decoder_uses_learnt_led_gains_for_the_next_packet(monkeypatch: pytest.MonkeyPatch) -> None:
    decode, packets = SoftPacket.decode, list[int]()

    def noted(self: SoftPacket, led_gains: LedGains | None, *arguments: Any) -> Any:
        packets.append(0 if led_gains is None else led_gains.packets)
        return decode(self, led_gains, *arguments)

    monkeypatch.setattr(SoftPacket, "decode", noted)
    received(film_of_one()[: 2 * PACKET + 10], soft())
    assert packets[:2] == [0, 1]


KEY: ArrayKey = (3, UPRIGHT, 0)


@dataclass
class Scripted:
    """Observations with a scripted decoding result; they record the decoder's state."""

    decoded: Decoded
    form: PacketFormat = field(default_factory=lambda: PacketFormat(SignalSettings()))
    mode: int = 0
    state: tuple[LedGains | None, SoftBuffer] | None = None

    def decode(self, led_gains: LedGains | None, buffer: SoftBuffer | None, _observe: Any, /) -> Decoded:
        assert buffer is not None
        self.state = led_gains, buffer
        return self.decoded


def decode(decoder: PacketDecoder, key: ArrayKey = KEY, **decoded: Any) -> tuple[LedGains | None, SoftBuffer]:
    packet = Scripted(Decoded({}, **decoded))
    decoder.decode(cast(Any, packet), key)
    assert packet.state is not None
    return packet.state


def test_learning_without_a_solution_keeps_the_state() -> None:
    def fails() -> Any:
        raise np.linalg.LinAlgError

    decoder, after = PacketDecoder(), LedGains.sound(SIDE)
    decode(decoder, learn=lambda: after)
    learnt = decoder.learn(KEY)
    assert learnt is not None
    assert np.array_equal(learnt.values, after.values)
    assert decoder.learn(KEY) is None
    assert decode(decoder, learn=fails)[0] is after
    assert decoder.learn(KEY) is None
    assert decode(decoder)[0] is after


def test_pickled_decoder_keeps_a_separate_state() -> None:
    here, led_gains, buffer = PacketDecoder(), LedGains.sound(SIDE), SoftBuffer()
    there = pickle.loads(pickle.dumps(here))
    decode(there, buffer=buffer, learn=lambda: led_gains)
    there.learn(KEY)
    assert pickle.loads(pickle.dumps(here)) is there
    for decoder, gains, is_shared in ((there, led_gains, True), (here, None, False)):
        used = decode(decoder)
        assert used[0] is gains
        assert (used[1] is buffer) == is_shared


def test_decoder_keeps_the_states_of_the_latest_arrays_and_identities() -> None:
    decoder, led_gains = PacketDecoder(), LedGains.sound(SIDE)
    keys = [(k % 30, ORIENTATIONS[k // 30], k) for k in range(MAX_ARRAYS + 2)]
    for number, key in enumerate(keys):
        decode(decoder, key, buffer=SoftBuffer((), {("high", cast(Any, number)): ()}), learn=lambda: led_gains)
        decoder.learn(key)
    states = [decode(decoder, key) for key in keys]
    assert [gains is not None for gains, _ in states] == [False] * 2 + [True] * MAX_ARRAYS
    kept = [bool(buffer.codewords) for _, buffer in states]
    assert kept == [False] * (MAX_ARRAYS + 2 - MAX_BUFFERS) + [True] * MAX_BUFFERS
    # a redetected array keeps its buffer and starts with a new state
    gains, buffer = decode(decoder, (*keys[-1][:2], -1))
    assert buffer is states[-1][1]
    assert gains is None


def test_exception_in_the_decoder_ends_reception(monkeypatch: pytest.MonkeyPatch) -> None:
    # the second packet fails
    decode_in_a_thread(monkeypatch, lambda number: cast(None, 1 // (number - 2)))
    with pytest.raises(ZeroDivisionError):
        received(film_of_one()[: 2 * PACKET + 10], soft())


@pytest.mark.slow
def test_led_brightness_of_a_packet_reaches_the_tracker(monkeypatch: pytest.MonkeyPatch) -> None:
    updates = list[tuple[LedGains, LedGains]]()

    def noted(led_gains: LedGains | None, learnt: LedGains | None) -> LedGains | None:
        after = update_brightness(led_gains, learnt)
        if after is not None and learnt is not None:
            updates.append((learnt, after))
        return after

    monkeypatch.setattr(array, "update_brightness", noted)
    received(film_of_one()[: 2 * PACKET + 10], soft("receive.decode.in_background=true"))
    assert updates
    for learnt, after in updates:
        assert np.array_equal(learnt.brightness, after.brightness)


@pytest.mark.slow
def test_worker_process_that_died_is_reported_and_restarted() -> None:
    settings, frames = soft("receive.decode.in_background=true"), film_of_one()[: PACKET + 10]
    (packet,) = received(frames, settings)
    dying: Any = worker.call_in_process(partial(os._exit, 1))
    lost = PendingPacket(packet, cast(Any, None), dying, dying, ignore, None)
    with pytest.raises(HeliographError, match=r"^the process that decodes packets has ended.*in_background = false"):
        lost.packet()
    assert statuses(received(frames, settings)) == ["ok"]


@pytest.mark.slow
def test_worker_process_keeps_each_decoder_as_long_as_its_receiver(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def in_worker(expression: str) -> Any:
        return worker.call_in_process(eval, expression).result(HANG_S)

    def kept() -> Any:
        return in_worker("set(__import__('sys').modules['heliograph.receive.decode.worker']._local_decoders)")

    monkeypatch.setattr(registry, "_files", {})
    monkeypatch.setattr(sys, "path", sys.path.copy())
    monkeypatch.setattr(RECEIVERS, "_registered", RECEIVERS._registered.copy())
    monkeypatch.setattr(RECEIVERS, "origins", RECEIVERS.origins.copy())
    decoders = [PacketDecoder() for _ in range(40)]
    for decoder in decoders:
        assert worker.call_in_process(decoder.learn, KEY).result(HANG_S) is None
    process, names = in_worker("__import__('os').getpid()"), {decoder._name for decoder in decoders}
    assert names <= kept()
    # a part registered while they receive
    (tmp_path / "parts.py").write_text("import heliograph\nheliograph.register_receiver('none', lambda *_: None)\n")
    registry.load_parts(tmp_path / "parts.py")
    assert in_worker("__import__('heliograph.receive.registry', fromlist=['']).RECEIVERS.check('none')") == "none"
    assert in_worker("__import__('os').getpid()") == process
    assert names <= kept()
    del decoders, decoder
    assert not names & kept()
