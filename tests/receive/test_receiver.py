"""Receiver API: equivalent entry points, pixel buffers, times, and diagnosis."""

import gc
import itertools
import math
import operator
import tracemalloc
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from types import FunctionType, ModuleType
from typing import Any

import numpy as np
import pytest
from recorder import Recorder
from scenes import comparable, film, link, received, statuses, words_of

from heliograph.base.errors import HeliographError
from heliograph.base.frames import Frame
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.receive.api import make_receiver, receive_frames
from heliograph.receive.array import ArrayReceiver
from heliograph.receive.events import DecodeEvent, DetectEvent, ExtractEvent, TrackEvent
from heliograph.receive.packet import Packet
from heliograph.receive.settings import ReceiveSettings
from heliograph.receive.sync.pairing import FramePair, MeasuredHeader
from heliograph.signal.settings import SignalSettings

ReadPair = FramePair | MeasuredHeader | None

SIGNAL = SignalSettings(data_pairs=24)
PACKET = 52  # frames per packet: two header pairs and 24 data pairs


def small(*changes: str, **channel: Any) -> LinkSettings:
    return link("signal.data_pairs=24", *changes, **{"distance_m": 35.0, **channel})


@cache
def two_and_a_half_packets() -> tuple[Frame, ...]:
    return tuple(film(small(), 2 * PACKET + 32, roi_margin_px=12))


@cache
def expected_packets() -> list[Packet]:
    return comparable(receive_frames(two_and_a_half_packets(), SIGNAL))


def test_pushed_frames_give_the_same_packets_as_soon_as_they_are_complete() -> None:
    receiver = make_receiver(SIGNAL)
    packets = [(k, packet) for k, frame in enumerate(two_and_a_half_packets()) for packet in receiver.push(frame)]
    assert [k for k, _ in packets] == [51, 103]
    assert comparable([*(packet for _, packet in packets), *receiver.finish()]) == expected_packets()
    assert statuses(expected_packets()) == ["ok", "ok", "ok"]


def test_packets_of_an_iterator_come_as_soon_as_they_are_complete() -> None:
    frames = iter(two_and_a_half_packets())
    packets = [(operator.length_hint(frames), packet) for packet in receive_frames(frames, SIGNAL)]
    assert [left for left, _ in packets] == [84, 32, 0]
    assert comparable(packet for _, packet in packets) == expected_packets()


@pytest.mark.slow
def test_interleaved_receivers_share_no_state() -> None:
    frames = two_and_a_half_packets()
    other = film(small("transmit.identities=[9]", distance_m=40.0), len(frames), seed=5, roi_margin_px=12)
    expected = [expected_packets(), comparable(receive_frames(other, SIGNAL))]
    receivers, packets = [make_receiver(SIGNAL) for _ in range(2)], [list[Packet](), list[Packet]()]
    for pair in zip(frames, other, strict=True):
        for receiver, found, frame in zip(receivers, packets, pair, strict=True):
            found += receiver.push(frame)
    assert [comparable([*found, *one.finish()]) for one, found in zip(receivers, packets, strict=True)] == expected
    assert {p.identity for p in expected[1]} == {9}


def test_observers_see_all_stages_and_change_nothing() -> None:
    frames, recorder = two_and_a_half_packets(), Recorder()
    watched = comparable(receive_frames(frames, SIGNAL, observe=recorder))
    assert watched == expected_packets()
    # two packets with 26 pairs (24 data pairs) and one with 16 pairs
    counts = {kind: len(recorder.of(kind)) for kind in (DetectEvent, TrackEvent, ExtractEvent, DecodeEvent)}
    assert counts == {DetectEvent: 1, TrackEvent: 68, ExtractEvent: 62, DecodeEvent: 3}
    assert sum(counts.values()) == len(recorder.events)
    assert comparable(event.packet for event in recorder.of(DecodeEvent)) == watched


@pytest.mark.parametrize(("receiver", "index", "time_s"), [
    *((receiver, *back) for receiver in ("plain", "soft", "screen") for back in ((4, 0.004), (6, 0.005))),
    # the plain receiver relies on frame numbers
    ("plain", 3, 0.007),
])  # fmt: skip
def test_frames_that_go_back_are_refused(receiver: str, index: int, time_s: float) -> None:
    stream, rng = make_receiver(SIGNAL, ReceiveSettings(receiver=receiver)), np.random.default_rng(0)

    def push(index: int, time_s: float) -> list[Packet]:
        return list(stream.push(Frame(index, time_s, rng.integers(0, 255, (40, 40)).astype(np.uint8))))

    assert push(4, 0.004) == push(5, 0.005) == []
    with pytest.raises(HeliographError, match="must follow in time") as error:
        push(index, time_s)
    assert "\n" not in str(error.value)
    # the receiver resumes after the last valid frame
    assert push(6, 0.006) == []


@pytest.mark.parametrize("bits", [10, 12])
def test_16_bit_pixels_are_read(bits: int) -> None:
    frames = film(small(f"channel.sensor.bits={bits}"), PACKET + 4, roi_margin_px=12)
    assert frames[0].pixels.dtype == np.uint16
    packets = list(receive_frames(frames, SIGNAL))
    assert [(p.identity, p.status) for p in packets] == [(0, "ok")]
    assert packets[0].distance_m == pytest.approx(35.0, rel=0.005)


@pytest.mark.parametrize(("margin", "drive"), [
    (30, {}), (12, {"shake": "road", "speed_m_s": 20.0, "road_class": "C", "stop_m": 1.0}),
])  # fmt: skip
@pytest.mark.slow
def test_windows_give_the_codewords_of_whole_frames(margin: int, drive: dict[str, Any]) -> None:
    # an off-axis array drifts through the image while approaching
    settings = small(distance_m=45.0, arrays=[{"x_m": 0.6, "y_m": -0.4}], **drive)
    parts, whole = (film(settings, 2 * PACKET + 4, seed=2, roi_margin_px=one) for one in (margin, None))
    assert len({f.origin for f in parts}) > bool(drive)
    assert max(f.pixels.size for f in parts) < whole[0].pixels.size
    read, expected = (
        [(p.identity, p.status, p.first_frame, p.last_frame, [w.block for w in words_of(p)]) for p in packets]
        for packets in (receive_frames(parts, SIGNAL), receive_frames(whole, SIGNAL))
    )
    assert read == expected
    assert [status for _, status, *_ in read] == ["ok", "ok"]


@pytest.mark.slow
def test_memory_does_not_grow_with_the_film() -> None:
    # repeat two packets with new numbers, so that the film needs no further memory
    frames, receiver = film(link("signal.data_pairs=16"), 72), make_receiver(SignalSettings(data_pairs=16))

    def run(first: int, last: int) -> int:
        shown = (replace(frames[k % 72], index=k, time_s=k * 1e-3) for k in range(first, last))
        return sum(1 for frame in shown for _ in receiver.push(frame))

    assert run(0, 72 * 2) == 4
    tracemalloc.start()
    try:
        run(72 * 2, 72 * 3)
        gc.collect()  # collect reference cycles
        early = tracemalloc.get_traced_memory()[0]
        assert run(72 * 3, 72 * 6) == 6
        gc.collect()
        assert tracemalloc.get_traced_memory()[0] - early < 100_000
    finally:
        tracemalloc.stop()


@pytest.fixture
def pair_limit(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fail if receivers go through the pairs of a gap one by one."""
    count, take = itertools.count(), ArrayReceiver._take

    def counted(array: ArrayReceiver, number: int, pair: ReadPair) -> Iterator[object]:
        assert next(count) < 1000
        return take(array, number, pair)

    monkeypatch.setattr(ArrayReceiver, "_take", counted)


@pytest.mark.parametrize("receiver", ["plain", "soft"])
@pytest.mark.usefixtures("pair_limit")
@pytest.mark.slow
def test_times_may_jump_by_any_length(receiver: str) -> None:
    """A clock jump ends the packet and the track; the next header gives a new detection."""
    settings, jump = link(f"receive.receiver={receiver}", "signal.data_pairs=8", distance_m=40.0), 10**12
    frames = film(settings, 65, roi_margin_px=20)
    # the jump occurs after three quarters of the second packet
    frames[35:] = [replace(f, index=f.index + jump, time_s=f.time_s + 1e-3 * jump) for f in frames[35:]]
    packets = received(frames, settings)
    assert [p.identity for p in packets] == [0, 0, 0]
    assert (packets[0].status, packets[2].status) == ("ok", "ok")
    assert packets[1].last_frame < 40 < jump < packets[2].first_frame


@pytest.mark.parametrize("receiver", ["plain", "soft"])
@pytest.mark.usefixtures("pair_limit")
@pytest.mark.slow
def test_times_in_another_unit_are_refused(receiver: str) -> None:
    settings = link(f"receive.receiver={receiver}", "signal.data_pairs=8")
    frames = film(settings, 24, roi_margin_px=20)
    for factor in (1e3, 1e6, 1e9, 1e-6, 1e-9):
        with pytest.raises(HeliographError, match=r"give times in seconds, .*--fps"):
            received([replace(frame, time_s=frame.time_s * factor) for frame in frames], settings)


def test_film_too_short_or_small_gives_no_packet() -> None:
    tiny = [Frame(k, k * 1e-3, np.full((5, 3), 40 * (k % 2), np.uint8)) for k in range(20)]
    for frames in ([], two_and_a_half_packets()[:20], tiny):
        assert list(receive_frames(frames, SIGNAL)) == []


@pytest.mark.slow
def test_search_for_uniform_squares_reports_no_foreign_data() -> None:
    # the receiver finds a filled square and must not report data for identity 0
    frames = film(link("transmit.identities=[9]", distance_m=45.0), 120)
    packets = list(receive_frames(frames, SignalSettings(header="all_on")))
    # tracking succeeds with the wrong identity, and packets hold one high, two middle and one low codeword
    assert {p.identity for p in packets} == {0}
    assert set(statuses(packets)) <= {"no_header", "no_array"}
    assert [[w.status for w in words_of(packet)] for packet in packets] == [["crc_fail"] * 4] * len(packets)


@pytest.mark.parametrize(("receiver", "preset"), [("plain", "static"), ("soft", "static"), ("screen", "phone")])
@pytest.mark.slow
def test_receiver_keeps_no_array_of_the_caller(receiver: str, preset: str) -> None:
    settings = load_settings(preset, None, [f"receive.receiver={receiver}"])
    live = make_receiver(settings.signal, settings.receive)
    rng, pixels = np.random.default_rng(1), np.empty((48, 64), np.uint8)
    for k in range(20):
        pixels[:] = rng.integers(0, 255, pixels.shape)
        list(live.push(Frame(k, k / settings.channel.camera.fps, pixels)))
    kept = _arrays(live)
    assert any(array.shape == pixels.shape for array in kept), "the test sees the frames that the receiver keeps"
    assert not any(np.shares_memory(array, pixels) for array in kept)


def _arrays(root: object) -> list[np.ndarray]:
    """Return all arrays reachable from an object."""
    stack, known, arrays = [root], set[int](), list[np.ndarray]()
    while stack:
        value = stack.pop()
        if id(value) in known or isinstance(value, type | ModuleType | FunctionType):
            continue
        known.add(id(value))
        if isinstance(value, np.ndarray):
            arrays.append(value)
        stack += gc.get_referents(value)
    return arrays


@pytest.mark.parametrize(("distance_m", "lacks"), [(40.0, []), (95.0, ["middle", "low"])])
def test_packet_explains_which_codewords_lack_information(distance_m: float, lacks: list[str]) -> None:
    settings = link("receive.receiver=plain", distance_m=distance_m)
    (packet,) = received(film(settings, 101, roi_margin_px=30), settings)
    assert all(0 <= word.information <= 1 for word in words_of(packet))
    failed = [name for name, by in packet.layers.items() if any(word.status != "ok" for word in by)]
    assert failed == lacks
    first, *lines = packet.explain().splitlines()
    assert first.startswith(f"array {packet.identity}, {packet.distance_m:.1f} m")
    assert f"header score {packet.header_score:.2f}" in first
    assert 0 < packet.pose_std_px < 0.5
    assert f"position error {packet.pose_std_px:.2f} px" in first
    assert [line.split()[0] for line in lines] == ["high", "middle", "low"]
    for name, line in zip(packet.layers, lines, strict=True):
        assert ("the code needs about 0.43" in line) == (name in lacks)
        best = max((word.information for word in packet.layers[name] if word.status != "ok"), default=math.nan)
        assert (f"at most {best:.2f} bit per coded bit" in line) == (name in lacks)
