"""Reception of a single array: occlusion, missing frames, films that end within a packet."""

import itertools
from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from recorder import Recorder
from scenes import drawn_film, film, link

from heliograph.base.frames import Frame
from heliograph.link.settings import LinkSettings
from heliograph.receive import Packet, receive_frames
from heliograph.receive.decode.codeword import ERASED
from heliograph.receive.decode.plain_packet import PlainPacket
from heliograph.receive.decode.soft_packet import SoftPacket
from heliograph.receive.track.track import TrackedPair
from heliograph.receive.track.tracker import Tracker

Floats = NDArray[np.float64]


def at_rest(t: Floats) -> Floats:
    return np.stack([47.3 + 0 * t, 48.8 + 0 * t], -1)


def read(frames: Iterable[Frame], settings: LinkSettings) -> tuple[list[Packet], Recorder]:
    recorder = Recorder()
    return list(receive_frames(frames, settings.signal, settings.receive, recorder)), recorder


@pytest.mark.slow
def test_hidden_for_30_ms_is_coasted_over() -> None:
    settings = link()
    packets, recorder = read(drawn_film(settings, 200, at_rest, hidden=[range(40, 70)]), settings)
    assert recorder.lost_s == []
    assert len(recorder.found_s) == 1
    assert all(word.status == "ok" for word in packets[0].layers["high"])
    assert packets[0].pairs_seen == pytest.approx(1 - 15 / 48)
    assert packets[1].status == "ok"
    assert [t.seen for t in recorder.tracked[20:35]] == [False] * 15


@pytest.mark.slow
def test_hidden_for_200_ms_is_lost_and_found_again() -> None:
    settings = link()
    packets, recorder = read(drawn_film(settings, 420, at_rest, hidden=[range(80, 280)]), settings)
    assert len(recorder.lost_s) == 1
    assert 0.12 < recorder.lost_s[0] < 0.14
    assert recorder.found_s == pytest.approx([0.0, 0.3])
    assert [round(p.start_time_s, 6) for p in packets] == [0.0, 0.3]
    assert packets[0].pairs_seen == pytest.approx(38 / 48)
    assert packets[1].status == "ok"


@pytest.mark.parametrize("missing", [{30}, {31}, {30, 31}, {98, 99}, {99}, {51, 60}])
@pytest.mark.slow
def test_pairs_that_are_missing_cost_no_more_than_themselves(missing: set[int]) -> None:
    settings = link()
    packets, recorder = read((f for f in film(settings, 204) if f.index not in missing), settings)
    assert [p.pairs_seen for p in packets] == pytest.approx([1 - len({frame // 2 for frame in missing}) / 48, 1])
    assert [p.status for p in packets] == ["ok", "ok"]
    assert [round(p.start_time_s, 6) for p in packets] == [0.0, 0.1]
    assert len(recorder.found_s) == 1


@pytest.mark.parametrize("missing", [range(70, 110), range(96, 104), range(60, 240), range(150, 270), range(50, 190)])
@pytest.mark.slow
def test_a_long_gap_keeps_packets_apart(missing: range) -> None:
    settings = link()
    packets, _ = read((f for f in film(settings, 400) if f.index not in missing), settings)
    for packet in packets:
        # all frames belong to the packet identified by the start time
        first = round(packet.start_time_s * 1000)
        assert first % 100 == 0
        assert first <= packet.first_frame <= packet.last_frame < first + 100
    starts = [round(p.start_time_s, 6) for p in packets]
    assert starts == sorted(set(starts))
    whole = [k for k in range(4) if not set(missing) & set(range(100 * k, 100 * k + 100))]
    assert {round(0.1 * k, 6) for k in whole} <= {s for p, s in zip(packets, starts, strict=True) if p.status == "ok"}


@pytest.mark.parametrize(("frames", "packets"), [(51, 0), (52, 1), (99, 1), (100, 1), (151, 1), (152, 2)])
@pytest.mark.slow
def test_a_film_cut_within_a_packet(frames: int, packets: int) -> None:
    settings = link()
    got, _ = read(film(settings, frames), settings)
    # 24 of 48 data pairs, after 2 header pairs, suffice for an attempt
    assert len(got) == packets
    rest = min((frames % 100) // 2 - 2, 48)
    if packets and rest > 0:
        assert got[-1].pairs_seen == pytest.approx(rest / 48 if rest >= 24 else 1)


@pytest.mark.slow
def test_an_array_that_goes_out_of_the_picture_is_lost() -> None:
    def leaving(t: Floats) -> Floats:
        return np.stack([47.3 + 500 * t, 48.8 + 0 * t], -1)

    settings = link()
    packets, recorder = read(drawn_film(settings, 260, leaving), settings)
    assert len(recorder.lost_s) == 1
    assert all(p.start_time_s < 0.2 for p in packets)


def test_what_is_no_array_is_given_up() -> None:
    settings = link("signal.data_pairs=16")
    rng = np.random.default_rng(0)
    frames = film(settings, 6)
    flicker = [Frame(k, k * 1e-3, rng.integers(0, 200, (120, 160)).astype(np.uint8)) for k in range(6, 160)]
    packets, recorder = read([*frames, *flicker], settings)
    assert len(recorder.found_s) == len(recorder.lost_s) == 1
    assert len(packets) <= 3
    assert all(word.status != "ok" for p in packets for words in p.layers.values() for word in words)


@pytest.mark.parametrize("receiver", ["plain", "soft"])
@pytest.mark.slow
def test_a_packet_whose_equations_have_no_solution_is_lost_alone(
    receiver: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    settings, calls = link(f"receive.receiver={receiver}"), itertools.count()
    taken: type[PlainPacket | SoftPacket] = PlainPacket if receiver == "plain" else SoftPacket
    decode = taken.decode

    def failing(self: Any, *arguments: Any) -> Any:
        if next(calls) == 0:
            raise np.linalg.LinAlgError("no solution")
        return decode(self, *arguments)

    monkeypatch.setattr(taken, "decode", failing)
    packets, _ = read(film(settings, 204), settings)
    assert [(p.status, p.reason) for p in packets] == [("crc_fail", "no solution"), ("ok", "")]
    assert all((word.raw == ERASED).all() for words in packets[0].layers.values() for word in words)
    assert "packet at frame 0 is not read: no solution" in caplog.text


@pytest.mark.slow
def test_an_array_whose_pose_has_no_solution_is_found_again(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    settings = link()
    follow, calls = Tracker.follow, itertools.count()

    def failing(self: Tracker, *arguments: Any) -> TrackedPair:
        if next(calls) == 20:
            raise np.linalg.LinAlgError("no solution")
        return follow(self, *arguments)

    monkeypatch.setattr(Tracker, "follow", failing)
    packets, recorder = read(film(settings, 304), settings)
    assert [packet.status for packet in packets] == ["ok", "ok"]
    assert len(recorder.lost_s) == 1
    assert "is given up at 0.04" in caplog.text
