"""Packets decoded in a thread beside the frames that follow."""

import threading
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pytest
from recorder import Recorder
from scenes import film, link

from heliograph.base.frames import Frame
from heliograph.link.settings import LinkSettings
from heliograph.receive import Packet, make_receiver, receive_frames
from heliograph.receive.packet_reader import SoftReader
from heliograph.receive.reader_protocol import PacketReader

PACKET = 100
"""Frames of a packet."""


def settings_of(receiver: str, beside: bool) -> LinkSettings:
    arrays: list[dict[str, Any]] = [{"x_m": -0.45, "y_m": 0.0}, {"x_m": 0.45, "y_m": 0.0}]
    changes = (
        f"receive.receiver={receiver}",
        f"receive.decode.beside={str(beside).lower()}",
        "transmit.identities=[3, 7]",
    )
    return link(*changes, arrays=arrays, distance_m=60.0)


def known(packet: Packet) -> tuple[Any, ...]:
    """All that a packet says."""
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


def waiting(monkeypatch: pytest.MonkeyPatch, before: Callable[[int], None]) -> None:
    """The soft reader calls a function, with the number of its call, before it decodes."""
    decode, calls = SoftReader.decode, Counter[str]()

    def late(self: SoftReader, observe: Any, /) -> Any:
        calls["n"] += 1
        before(calls["n"])
        return decode(self, observe)

    monkeypatch.setattr(SoftReader, "decode", late)


def one_array() -> LinkSettings:
    return link("receive.receiver=soft", "receive.decode.beside=true", distance_m=60.0)


def pushed(frames: Sequence[Frame], settings: LinkSettings) -> tuple[Any, list[Packet]]:
    receiver = make_receiver(settings.signal, settings.receive)
    return receiver, [packet for frame in frames for packet in receiver.push(frame)]


def test_frames_are_taken_while_a_packet_is_decoded(monkeypatch: pytest.MonkeyPatch) -> None:
    free, threads = threading.Event(), set[str]()

    def hold(number: int) -> None:
        threads.add(threading.current_thread().name)
        if number == 2:  # the first packet is waited for: before it nothing shows that there is an array
            assert free.wait(60)

    settings = one_array()
    frames = film(settings, 3 * PACKET + 10)
    waiting(monkeypatch, hold)
    receiver, packets = pushed(frames[: 2 * PACKET + 80], settings)
    assert len(packets) == 1, "the second packet is still being decoded, and its successor's frames were taken"
    free.set()
    packets += [packet for frame in frames[2 * PACKET + 80 :] for packet in receiver.push(frame)]
    packets += receiver.finish()
    assert [packet.first_frame for packet in packets] == [0, PACKET, 2 * PACKET]
    assert threading.current_thread().name not in threads


def test_what_breaks_off_decoding_breaks_off_receiving(monkeypatch: pytest.MonkeyPatch) -> None:
    def breaks(number: int) -> None:
        if number == 2:
            raise ZeroDivisionError("a bug")

    settings = one_array()
    frames = film(settings, 2 * PACKET + 10)
    waiting(monkeypatch, breaks)
    with pytest.raises(ZeroDivisionError, match="a bug"):
        list(receive_frames(frames, settings.signal, settings.receive))


def test_a_packet_without_a_solution_is_lost_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(number: int) -> None:
        if number == 2:
            raise np.linalg.LinAlgError("no solution")

    settings = one_array()
    frames = film(settings, 4 * PACKET + 10)
    waiting(monkeypatch, fails)
    packets = list(receive_frames(frames, settings.signal, settings.receive))
    assert [(packet.status, packet.reason) for packet in packets] == [
        ("ok", ""),
        ("crc_fail", "no solution"),
        ("ok", ""),
        ("ok", ""),
    ]


def test_the_led_brightness_of_a_packet_reaches_the_next_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a packet teaches is taken over by the reader that followed meanwhile."""
    taught: list[tuple[PacketReader, Any]] = []
    learn_from = SoftReader.learn_from

    def noted(self: SoftReader, before: Any) -> None:
        learn_from(self, before)
        taught.append((before, self._gains().brightness))

    monkeypatch.setattr(SoftReader, "learn_from", noted)
    settings = one_array()
    list(receive_frames(film(settings, 4 * PACKET + 10), settings.signal, settings.receive))
    assert taught
    for before, brightness in taught:
        assert isinstance(before, SoftReader)
        assert np.array_equal(brightness.values, before._gains().brightness.faded().values)
