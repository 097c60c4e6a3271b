"""Receiver API: equivalent entry points."""

import gc
import tracemalloc
from collections.abc import Iterable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from recorder import Recorder
from scenes import film, link
from waiting import run_alone

from heliograph.base.errors import HeliographError
from heliograph.base.frames import Frame
from heliograph.receive import Packet, make_receiver, receive_frames
from heliograph.receive.events import DecodeEvent, DetectEvent, ExtractEvent, TrackEvent
from heliograph.signal.settings import SignalSettings

SIGNAL = SignalSettings()


@cache
def two_and_a_half_packets() -> tuple[Frame, ...]:
    return tuple(film(link(distance_m=60.0), 260))


def plain(packets: Iterable[Packet]) -> list[Any]:
    """Convert packets to comparable values, arrays to bytes."""
    return [
        replace(
            p,
            layers={
                n: [(w.status, w.block, w.bits.tobytes(), w.raw.tobytes(), w.margin) for w in words]  # type: ignore[misc]
                for n, words in p.layers.items()
            },
        )
        for p in packets
    ]


def codewords(packets: Iterable[Packet]) -> list[Any]:
    return [
        (p.identity, p.status, p.first_frame, p.last_frame, [w.block for words in p.layers.values() for w in words])
        for p in packets
    ]


@pytest.mark.slow
def test_every_entrance_gives_the_same() -> None:
    frames = two_and_a_half_packets()
    whole = plain(receive_frames(frames, SIGNAL))
    assert [p.status for p in whole] == ["ok", "ok", "ok"]
    pushed = make_receiver(SIGNAL)
    got = [p for frame in frames for p in pushed.push(frame)]
    got += pushed.finish()
    assert plain(got) == whole
    parts, rest = make_receiver(SIGNAL), list(frames)
    chunked: list[Packet] = []
    for size in (1, 7, 93, 100, 2, 57):
        chunk, rest = rest[:size], rest[size:]
        chunked += [p for frame in chunk for p in parts.push(frame)]
    assert plain([*chunked, *parts.finish()]) == whole
    assert plain(receive_frames(iter(frames), SIGNAL)) == whole


def test_packets_come_as_soon_as_they_are_complete() -> None:
    taken = 0

    def frames() -> Iterable[Frame]:
        nonlocal taken
        for taken, frame in enumerate(two_and_a_half_packets()):  # noqa: B007 - read outside
            yield frame

    assert [taken for _ in receive_frames(frames(), SIGNAL)] == [99, 199, 259]


@pytest.mark.slow
def test_receivers_share_nothing() -> None:
    frames, other = two_and_a_half_packets(), film(link("transmit.identities=[9]", distance_m=40.0), 260, seed=5)
    alone, beside = plain(receive_frames(frames, SIGNAL)), plain(receive_frames(other, SIGNAL))
    a, b = make_receiver(SIGNAL), make_receiver(SIGNAL)
    got_a, got_b = list[Packet](), list[Packet]()
    for one, two in zip(frames, other, strict=True):
        got_a += a.push(one)
        got_b += b.push(two)
    assert plain([*got_a, *a.finish()]) == alone
    assert plain([*got_b, *b.finish()]) == beside
    assert {p.identity for p in beside} == {9}


def test_observers_see_all_stages_and_change_nothing() -> None:
    frames, recorder = two_and_a_half_packets(), Recorder()
    watched = plain(receive_frames(frames, SIGNAL, observe=recorder))
    assert watched == plain(receive_frames(frames, SIGNAL))
    # two packets with 50 pairs (48 data pairs) and one with 30 pairs
    counts = {kind: len(recorder.of(kind)) for kind in (DetectEvent, TrackEvent, ExtractEvent, DecodeEvent)}
    assert counts == {DetectEvent: 1, TrackEvent: 130, ExtractEvent: 124, DecodeEvent: 3}
    assert sum(counts.values()) == len(recorder.events)
    assert plain(event.packet for event in recorder.of(DecodeEvent)) == watched


def test_frames_are_not_written_to() -> None:
    frames = film(link(), 110)
    before = [f.pixels.copy() for f in frames]
    for f in frames:
        f.pixels.setflags(write=False)
    assert [p.status for p in receive_frames(frames, SIGNAL)] == ["ok"]
    assert all(np.array_equal(f.pixels, b) for f, b in zip(frames, before, strict=True))


@pytest.mark.parametrize(
    ("index", "time_s", "words"),
    [
        (4, 0.004, "must follow in time"),
        (3, 0.007, "must follow in time"),
        (6, 0.005, "must follow in time"),
    ],
)
def test_frames_that_go_back_are_refused(index: int, time_s: float, words: str) -> None:
    receiver, pixels = make_receiver(SIGNAL), np.zeros((40, 40), np.uint8)
    for k in (4, 5):
        assert list(receiver.push(Frame(k, k * 1e-3, pixels))) == []
    with pytest.raises(HeliographError, match=words) as error:
        list(receiver.push(Frame(index, time_s, pixels)))
    assert "\n" not in str(error.value)
    # the receiver resumes after the last valid frame
    assert list(receiver.push(Frame(6, 0.006, pixels))) == []


@pytest.mark.parametrize("bits", [8, 10, 12])
def test_bits_of_the_camera(bits: int) -> None:
    frames = film(link(f"channel.sensor.bits={bits}"), 110)
    assert frames[0].pixels.dtype == (np.uint8 if bits == 8 else np.uint16)
    packets = list(receive_frames(frames, SIGNAL))
    assert [(p.identity, p.status) for p in packets] == [(0, "ok")]
    assert packets[0].distance_m == pytest.approx(50.0, rel=0.005)


@pytest.mark.parametrize("shake", ["none", "road"])
@pytest.mark.parametrize("margin", [12, 30])
@pytest.mark.slow
def test_windows_give_what_whole_frames_give(margin: int, shake: str) -> None:
    drive = {"shake": "road", "speed_m_s": 20.0, "road_class": "C", "stop_m": 1.0} if shake == "road" else {}
    # an off-axis array drifts through the image while approaching
    settings = link(distance_m=45.0, arrays=[{"x_m": 0.6, "y_m": -0.4}], **drive)
    whole = film(settings, 230, seed=2)
    parts = film(settings, 230, seed=2, roi_margin_px=margin)
    assert len({f.origin for f in parts}) > (1 if shake == "road" else 0)
    assert max(f.pixels.size for f in parts) < whole[0].pixels.size
    from_parts = list(receive_frames(parts, SIGNAL))
    assert codewords(from_parts) == codewords(receive_frames(whole, SIGNAL))
    assert [p.status for p in from_parts] == ["ok", "ok"]


@pytest.mark.slow
def test_two_arrays_are_read_side_by_side() -> None:
    places = [{"x_m": -0.5, "y_m": 0.1}, {"x_m": 0.5, "y_m": -0.1, "start_s": 0.037}]
    settings = link("transmit.identities=[4, 21]", distance_m=40.0, arrays=places)
    packets = list(receive_frames(film(settings, 350), SIGNAL))
    by_identity = {k: [p for p in packets if p.identity == k] for k in (4, 21)}
    assert len(packets) == sum(map(len, by_identity.values()))
    for number, side, start in ((4, -1, 0.0), (21, 1, 0.037)):
        full = [p for p in by_identity[number] if p.pairs_seen == 1]
        assert [p.status for p in full] == ["ok"] * 3
        assert [p.start_time_s for p in full] == pytest.approx([start, start + 0.1, start + 0.2])
        blocks = [w.block for p in full for words in p.layers.values() for w in words]
        assert {b.identity for b in blocks if b} == {number}
        assert all((p.pose.x - 79.5) * side > 20 for p in full)


@pytest.mark.slow
def test_memory_does_not_grow_with_the_film() -> None:
    # 432 frames with 19,200 bytes each
    assert run_alone(receive_and_trace) < 100_000


def receive_and_trace() -> int:
    """Return the receiver's memory growth in bytes over twelve packets."""
    # repeat two packets with new numbers, so that the film needs no further memory
    frames = film(link("signal.data_pairs=16"), 72)
    signal = SignalSettings(data_pairs=16)
    receiver = make_receiver(signal)

    def run(first: int, last: int) -> int:
        count = 0
        for k in range(first, last):
            frame = replace(frames[k % 72], index=k, time_s=k * 1e-3)
            count += sum(1 for _ in receiver.push(frame))
        return count

    assert run(0, 72 * 2) == 4
    tracemalloc.start()
    run(72 * 2, 72 * 3)
    gc.collect()  # collect reference cycles
    early = tracemalloc.get_traced_memory()[0]
    assert run(72 * 3, 72 * 9) == 12
    gc.collect()
    return tracemalloc.get_traced_memory()[0] - early


@pytest.mark.parametrize("receiver", ["plain", "soft"])
def test_times_may_jump_by_any_length(receiver: str) -> None:
    """A clock jump ends the packet and the track; the next header gives a new detection."""
    settings = link(f"receive.receiver={receiver}", "signal.data_pairs=8", distance_m=40.0)
    jump = 10**12
    # the jump occurs after three quarters of the second packet
    frames = [
        replace(f, index=f.index + jump * (k >= 35), time_s=f.time_s + 1e-3 * jump * (k >= 35))
        for k, f in enumerate(film(settings, 65))
    ]
    packets = list(receive_frames(frames, settings.signal, settings.receive))
    assert [p.identity for p in packets] == [0, 0, 0]
    assert (packets[0].status, packets[2].status) == ("ok", "ok")
    assert packets[1].last_frame < 40 < jump < packets[2].first_frame


def test_empty_and_short_films() -> None:
    assert list(receive_frames([], SIGNAL)) == []
    assert list(receive_frames(film(link(), 20), SIGNAL)) == []


def test_frames_smaller_than_any_array() -> None:
    tiny = [Frame(k, k * 1e-3, np.full((5, 3), 40 * (k % 2), np.uint8)) for k in range(20)]
    assert list(receive_frames(tiny, SIGNAL)) == []


@pytest.mark.slow
def test_a_search_for_blinking_squares_passes_nobody_elses_data_as_its_own() -> None:
    # the receiver finds a filled square and must not report data for identity 0
    frames = film(link("transmit.identities=[9]", distance_m=45.0), 120)
    packets = list(receive_frames(frames, SignalSettings(header="all_on")))
    # tracking succeeds with the wrong identity, and packets hold one high, two middle and one low codeword
    assert packets
    assert {p.identity for p in packets} == {0}
    assert {p.status for p in packets} <= {"no_header", "no_array"}
    for packet in packets:
        assert [w.status for words in packet.layers.values() for w in words] == ["crc_fail"] * 4
