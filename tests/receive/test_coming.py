"""Background packet decoding in parallel with tracking."""

import itertools
import os
import pickle
import threading
import time
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, cast

import numpy as np
import pytest
from recorder import Recorder
from scenes import SIDE, film, link
from waiting import HANG_S

from heliograph.base.errors import HeliographError
from heliograph.base.frames import Frame
from heliograph.link.settings import LinkSettings
from heliograph.receive import Packet, array, make_receiver, receive_frames
from heliograph.receive import build as assemblies
from heliograph.receive.decode.combining import SoftBuffer
from heliograph.receive.decode.soft_packet import SoftPacket
from heliograph.receive.decode.worker import (
    MAX_ARRAYS,
    MAX_BUFFERS,
    ArrayKey,
    Decoded,
    PacketDecoder,
    PendingPacket,
    call_in_process,
    call_inline,
    wait_for,
)
from heliograph.receive.equalise.led_gains import LedGains, update_brightness
from heliograph.receive.events import ignore
from heliograph.receive.geometry.pose import ORIENTATIONS, UPRIGHT, Orientation
from heliograph.signal.packet import PacketFormat
from heliograph.signal.settings import SignalSettings

PACKET = 100
"""Frames per packet."""


def settings_of(receiver: str, beside: bool) -> LinkSettings:
    arrays: list[dict[str, Any]] = [{"x_m": -0.45, "y_m": 0.0}, {"x_m": 0.45, "y_m": 0.0}]
    changes = (
        f"receive.receiver={receiver}",
        f"receive.decode.in_background={str(beside).lower()}",
        "transmit.identities=[3, 7]",
    )
    return link(*changes, arrays=arrays, distance_m=60.0)


def known(packet: Packet) -> tuple[Any, ...]:
    """Return all packet content."""
    words = [(w.status, w.bits.tobytes(), w.raw.tobytes(), w.margin) for by in packet.layers.values() for w in by]
    return (
        packet.identity,
        packet.status,
        packet.first_frame,
        packet.last_frame,
        packet.pose,
        packet.start_time_s,
        words,
    )


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    return film(settings_of("plain", False), 5 * PACKET + 60)


@pytest.mark.parametrize("receiver", ["plain", "soft"])
def test_the_packets_are_those_decoded_at_once(receiver: str, frames: list[Frame]) -> None:
    read, told = [], []
    for beside in (False, True):
        settings, recorder = settings_of(receiver, beside), Recorder()
        packets = list(receive_frames(frames, settings.signal, settings.receive, recorder))
        read.append([known(packet) for packet in packets])
        told.append(Counter(type(event).__name__ for event in recorder.events))
    assert read[0] == read[1]
    assert [one[0] for one in read[0]].count(3) == [one[0] for one in read[0]].count(7) == 6
    assert told[0] == told[1]


def test_what_is_handed_over_is_pixels_and_little_else(frames: list[Frame], monkeypatch: pytest.MonkeyPatch) -> None:
    """LED statistics, a megabyte for 256 LEDs, stay in the process that learnt the gains."""
    handed = list[tuple[SoftPacket, int]]()

    def noted(call: Callable[..., Any], /, *args: Any) -> Future[Any]:
        pickled = pickle.dumps((call, args))
        if call.__name__ == "decode":
            handed.append((args[0], len(pickled)))
        call, args = pickle.loads(pickled)
        return call_inline(call, *args)

    monkeypatch.setattr(assemblies, "decode_executor", lambda _: noted)
    settings = settings_of("soft", True)
    packets = list(receive_frames(frames, settings.signal, settings.receive))
    assert {packet.status for packet in packets} == {"ok"}
    assert handed
    for observations, size in handed:
        pixels = sum(one.total.nbytes + one.difference.nbytes for one in observations._cutouts.values())
        assert size < 1.3 * pixels + 50_000


def test_nothing_is_left_to_do_when_a_film_is_over(frames: list[Frame], monkeypatch: pytest.MonkeyPatch) -> None:
    """Python prints an error for results sent during interpreter exit."""
    asked = list[Future[Any]]()

    class Slow(ThreadPoolExecutor):
        def submit(self, call: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
            def late() -> Any:
                time.sleep(0.02)
                return call(*args, **kwargs)

            asked.append(super().submit(late))
            return asked[-1]

    with Slow(1) as executor:
        monkeypatch.setattr(assemblies, "decode_executor", lambda _: executor.submit)
        settings = settings_of("soft", True)
        list(receive_frames(frames[: 2 * PACKET], settings.signal, settings.receive))
        assert asked
        assert all(one.done() for one in asked)


def in_a_thread(monkeypatch: pytest.MonkeyPatch, before: Callable[[int], None]) -> None:
    """Decode packets in a thread; call a function with the packet number before each."""
    decode, calls = SoftPacket.decode, itertools.count(1)

    def late(self: SoftPacket, *arguments: Any) -> Any:
        before(next(calls))
        return decode(self, *arguments)

    monkeypatch.setattr(SoftPacket, "decode", late)
    monkeypatch.setattr(assemblies, "decode_executor", lambda _: ThreadPoolExecutor(1).submit)


def one_array() -> LinkSettings:
    return link("receive.receiver=soft", "receive.decode.in_background=true", distance_m=60.0)


def pushed(frames: Sequence[Frame], settings: LinkSettings) -> tuple[Any, list[Packet]]:
    receiver = make_receiver(settings.signal, settings.receive)
    return receiver, [packet for frame in frames for packet in receiver.push(frame)]


def test_frames_are_taken_while_a_packet_is_decoded(monkeypatch: pytest.MonkeyPatch) -> None:
    free = threading.Event()

    def hold(number: int) -> None:
        if number == 1:
            assert free.wait(HANG_S)

    settings = one_array()
    frames = film(settings, 3 * PACKET + 10)
    in_a_thread(monkeypatch, hold)
    receiver, packets = pushed(frames[: PACKET + 80], settings)
    assert not packets, "the first packet is still being decoded, and its successor's frames were taken"
    free.set()
    packets += [packet for frame in frames[PACKET + 80 :] for packet in receiver.push(frame)]
    packets += receiver.finish()
    assert [packet.first_frame for packet in packets] == [0, PACKET, 2 * PACKET]


class WhenAsked(Future[Any]):
    """A future that computes pending work up to this item when its result is requested."""

    def __init__(self, handed: list["WhenAsked"], work: Callable[[], Any]) -> None:
        super().__init__()
        self._handed, self._work = handed, work

    def result(self, timeout: float | None = None) -> Any:
        while not self.done():
            first = self._handed.pop(0)
            first.set_result(first._work())
        return super().result(timeout)


@dataclass
class OnDemand:
    """An executor that works on demand."""

    handed: list[WhenAsked] = field(default_factory=list)

    def submit(self, call: Callable[..., Any], /, *args: Any) -> WhenAsked:
        self.handed.append(WhenAsked(self.handed, partial(call, *args)))
        return self.handed[-1]


@pytest.mark.parametrize(
    ("change", "orientation", "waits"),
    [
        ("transmit.identities=[7]", UPRIGHT, False),
        # the rotated header has another identity: LED sampling, if enabled, resolves the ambiguity
        ("transmit.identities=[3]", UPRIGHT, False),
        ("transmit.identities=[7]", ORIENTATIONS[1], False),
        ("transmit.identities=[3]; receive.soft.led_by_led=false", UPRIGHT, True),
        ("transmit.identities=[7]; receive.soft.led_by_led=false", ORIENTATIONS[1], True),
        # dark areas may be hidden LEDs or no LEDs
        ("channel.arrays.0.hidden=[0,0,0.5,0.5]", UPRIGHT, True),
    ],
)
def test_following_waits_for_a_first_packet_where_its_header_leaves_a_doubt(
    change: str, orientation: Orientation, waits: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings, demand = link("receive.receiver=soft", *change.split("; "), distance_m=40.0), OnDemand()
    frames = [replace(frame, pixels=orientation.turned(frame.pixels)) for frame in film(settings, 2 * PACKET + 80)]
    monkeypatch.setattr(assemblies, "decode_executor", lambda _: demand.submit)
    receiver, packets = pushed(frames[: PACKET + 80], settings)
    assert [packet.first_frame for packet in packets] == ([0] if waits else [])
    packets += [packet for frame in frames[PACKET + 80 :] for packet in receiver.push(frame)]
    packets += receiver.finish()
    assert [packet.status for packet in packets] == ["ok"] * 3


def test_half_a_pattern_out_of_step_following_waits_for_the_first_packet_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """No header pair alternates half a pattern out of step, but the light clock measures the header."""
    array = {"x_m": 0.0, "y_m": 0.0, "start_s": 0.0025}
    settings, demand = link("receive.receiver=soft", arrays=[array], distance_m=40.0), OnDemand()
    frames = film(settings, 3 * PACKET + 80)
    monkeypatch.setattr(assemblies, "decode_executor", lambda _: demand.submit)
    receiver, packets = pushed(frames[: 2 * PACKET + 80], settings)
    assert [packet.header_score for packet in packets] == [0.0]
    packets += [packet for frame in frames[2 * PACKET + 80 :] for packet in receiver.push(frame)]
    packets += receiver.finish()
    assert [packet.status for packet in packets[:3]] == ["ok"] * 3


def test_what_a_packet_teaches_reaches_the_next_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """The next packet uses the learnt LED gains even before tracking receives them."""
    packet_decode, seen = SoftPacket.decode, list[int]()

    def noted(self: SoftPacket, led_gains: LedGains | None, *arguments: Any) -> Any:
        seen.append(0 if led_gains is None else led_gains.packets)
        return packet_decode(self, led_gains, *arguments)

    settings, demand = link("receive.receiver=soft", distance_m=60.0), OnDemand()
    frames = film(settings, 2 * PACKET + 80)
    monkeypatch.setattr(SoftPacket, "decode", noted)
    monkeypatch.setattr(assemblies, "decode_executor", lambda _: demand.submit)
    list(receive_frames(frames, settings.signal, settings.receive))
    assert seen[:2] == [0, 1]


def test_a_process_that_ends_at_a_quick_check_is_told_of_in_one_line() -> None:
    future = Future[Any]()
    future.set_exception(BrokenProcessPool("gone"))
    with pytest.raises(HeliographError, match="the process that decodes packets has ended"):
        wait_for(future)


KEY: ArrayKey = (3, UPRIGHT, 0)


@dataclass
class Scripted:
    """Observations with a scripted decoding result; they record decoder states."""

    decoded: Decoded
    form: PacketFormat = field(default_factory=lambda: PacketFormat(SignalSettings()))
    mode: int = 0
    states: list[tuple[LedGains | None, SoftBuffer]] = field(default_factory=list)

    def decode(self, led_gains: LedGains | None, buffer: SoftBuffer | None, _observe: Any, /) -> Decoded:
        assert buffer is not None
        self.states.append((led_gains, buffer))
        return self.decoded


def decode(decoder: PacketDecoder, decoded: Decoded, key: ArrayKey = KEY) -> tuple[LedGains | None, SoftBuffer]:
    """Return LED gains and buffer used for a packet."""
    packet = Scripted(decoded)
    decoder.decode(cast(Any, packet), key)
    return packet.states[0]


def test_a_state_without_a_solution_changes_nothing() -> None:
    def fails() -> Any:
        raise np.linalg.LinAlgError

    decoder, after = PacketDecoder(), LedGains.sound(SIDE)
    decode(decoder, Decoded({}, learn=lambda: after))
    learnt = decoder.learn(KEY)
    assert learnt is not None
    assert np.array_equal(learnt.values, after.values)
    assert decoder.learn(KEY) is None
    assert decode(decoder, Decoded({}, learn=fails))[0] is after
    assert decoder.learn(KEY) is None
    assert decode(decoder, Decoded({}))[0] is after


def test_a_pickled_decoder_has_a_state_of_its_own_that_stays() -> None:
    here, led_gains = PacketDecoder(), LedGains.sound(SIDE)
    there = pickle.loads(pickle.dumps(here))
    decode(there, Decoded({}, learn=lambda: led_gains))
    there.learn(KEY)
    assert pickle.loads(pickle.dumps(here)) is there
    assert decode(there, Decoded({}))[0] is led_gains
    assert decode(here, Decoded({}))[0] is None


def test_a_decoder_keeps_the_states_of_the_arrays_and_the_buffers_of_the_identities_decoded_last() -> None:
    decoder, led_gains = PacketDecoder(), LedGains.sound(SIDE)
    for number in range(MAX_ARRAYS + 2):
        key = number % 30, ORIENTATIONS[number // 30], number
        buffer = SoftBuffer((), {("high", cast(Any, number)): ()})
        decode(decoder, Decoded({}, buffer=buffer, learn=lambda: led_gains), key)
        decoder.learn(key)
    keys = [(k % 30, ORIENTATIONS[k // 30], k) for k in range(MAX_ARRAYS + 2)]
    states = [decode(decoder, Decoded({}), key) for key in keys]
    assert [gains is not None for gains, _ in states] == [False] * 2 + [True] * MAX_ARRAYS
    kept = [bool(buffer.codewords) for _, buffer in states]
    assert kept == [False] * (MAX_ARRAYS + 2 - MAX_BUFFERS) + [True] * MAX_BUFFERS
    # a redetected array keeps its buffer and starts with a new state
    gains, buffer = decode(decoder, Decoded({}), (*keys[-1][:2], -1))
    assert buffer is states[-1][1]
    assert gains is None


def test_what_breaks_off_decoding_breaks_off_receiving(monkeypatch: pytest.MonkeyPatch) -> None:
    def breaks(number: int) -> None:
        if number == 2:
            raise ZeroDivisionError("a bug")

    settings = one_array()
    frames = film(settings, 2 * PACKET + 10)
    in_a_thread(monkeypatch, breaks)
    with pytest.raises(ZeroDivisionError, match="a bug"):
        list(receive_frames(frames, settings.signal, settings.receive))


def test_a_packet_without_a_solution_is_lost_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(number: int) -> None:
        if number == 2:
            raise np.linalg.LinAlgError("no solution")

    settings = one_array()
    frames = film(settings, 4 * PACKET + 10)
    in_a_thread(monkeypatch, fails)
    packets = list(receive_frames(frames, settings.signal, settings.receive))
    assert [(packet.status, packet.reason) for packet in packets] == [
        ("ok", ""),
        ("crc_fail", "no solution"),
        ("ok", ""),
        ("ok", ""),
    ]


def test_the_led_brightness_of_a_packet_reaches_the_next_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tracking receives LED gains learnt in the background."""
    updated = list[tuple[LedGains, LedGains]]()

    def noted(led_gains: LedGains | None, learnt: LedGains | None) -> LedGains | None:
        after = update_brightness(led_gains, learnt)
        if after is not None and learnt is not None:
            updated.append((learnt, after))
        return after

    monkeypatch.setattr(array, "update_brightness", noted)
    settings = one_array()
    list(receive_frames(film(settings, 4 * PACKET + 10), settings.signal, settings.receive))
    assert updated
    for learnt, after in updated:
        assert np.array_equal(learnt.brightness, after.brightness)


def test_a_process_that_dies_is_told_in_a_line_and_begun_anew() -> None:
    settings = one_array()
    frames = film(settings, PACKET + 10)
    (packet,) = receive_frames(frames, settings.signal, settings.receive)
    dying: Any = call_in_process(partial(os._exit, 1))
    lost = PendingPacket(packet, cast(Any, None), dying, dying, ignore, None)
    with pytest.raises(HeliographError, match=r"^the process that decodes packets has ended.*in_background = false"):
        lost.packet()
    assert [one.status for one in receive_frames(frames, settings.signal, settings.receive)] == ["ok"]


def test_what_another_process_has_seen_before_stays_there() -> None:
    """Soft combining works across processes for packets too dim to decode individually."""
    read = []
    for beside in (False, True):
        changes = (
            f"receive.decode.in_background={str(beside).lower()}",
            "receive.receiver=soft",
            "receive.detect.score=0.5",
        )
        settings = link(*changes, distance_m=170.0, arrays=[{"x_m": 0.0, "y_m": 0.0}])
        packets = list(receive_frames(film(settings, 4 * PACKET + 10), settings.signal, settings.receive))
        read.append([known(packet) for packet in packets])
    assert read[0] == read[1]
    assert read[0]
