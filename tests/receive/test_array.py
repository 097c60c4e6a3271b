"""Reception of a single array: occlusion, missing frames, films that end within a packet."""

import itertools
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from recorder import Recorder
from scenes import at_rest, drawn_film, film, link, received, statuses, words_of

from heliograph.base.frames import Frame
from heliograph.link.settings import LinkSettings
from heliograph.receive.decode.per_led import PlainPacket
from heliograph.receive.decode.soft_packet import SoftPacket
from heliograph.receive.packet import ERASED, Packet
from heliograph.receive.track.tracker import Tracker

PLAIN = link("signal.data_pairs=24")
SOFT = link("receive.receiver=soft", "signal.data_pairs=24")
PACKET = 52  # frames per packet: two header pairs and 24 data pairs


@cache
def still_film(distance_m: float = 35.0) -> list[Frame]:
    return film(link("signal.data_pairs=24", distance_m=distance_m), 4 * PACKET + 4, 3, 12)


def without(missing: Sequence[int] | set[int], frames: int = 4 * PACKET) -> list[Frame]:
    return [frame for frame in still_film()[:frames] if frame.index not in missing]


def starts_ms(packets: Sequence[Packet]) -> list[float]:
    return [round(1e3 * packet.start_time_s, 3) for packet in packets]


def test_occlusion_for_24_ms_is_coasted_over() -> None:
    recorder = Recorder()
    packets = received(drawn_film(PLAIN, 2 * PACKET, at_rest, hidden=[range(24, 48)]), PLAIN, recorder)
    assert (recorder.lost_s, len(recorder.found_s)) == ([], 1)
    assert (packets[0].layers["high"][0].status, packets[1].status) == ("ok", "ok")
    assert packets[0].pairs_seen == pytest.approx(1 - 12 / 24)
    assert [t.seen for t in recorder.tracked[12:24]] == [False] * 12


@pytest.mark.slow
def test_array_occluded_for_110_ms_is_lost_and_found_again() -> None:
    recorder = Recorder()
    packets = received(drawn_film(PLAIN, 4 * PACKET + 4, at_rest, hidden=[range(40, 150)]), PLAIN, recorder)
    assert recorder.lost_s == [pytest.approx(0.09, abs=0.01)]
    assert recorder.found_s == pytest.approx([0.0, 0.156])
    assert starts_ms(packets) == [0, 156]
    assert packets[0].pairs_seen == pytest.approx(18 / 24)
    assert packets[1].status == "ok"


SIX_PAIRS = {PACKET * packet + k for packet in (0, 1) for k in (8, 15, 21, 30, 40, 41, 46, 47)}


@pytest.mark.parametrize(("settings", "missing"), [
    *((PLAIN, missing) for missing in ({20}, {21}, {20, 21}, {50, 51}, {51}, {27, 34}, SIX_PAIRS)),
    # a header that lacks a frame
    *((SOFT, missing) for missing in (SIX_PAIRS, {2}, {3})),
])  # fmt: skip
def test_missing_frames_cost_only_their_pairs(settings: LinkSettings, missing: set[int]) -> None:
    recorder = Recorder()
    packets = received(without(missing, 2 * PACKET + 4), settings, recorder)
    lost = Counter(number // (PACKET // 2) for number in {k // 2 for k in missing if k % PACKET >= 4})
    assert [p.pairs_seen for p in packets] == pytest.approx([1 - lost[packet] / 24 for packet in (0, 1)])
    assert statuses(packets) == ["ok", "ok"]
    assert starts_ms(packets) == pytest.approx([0, 52], abs=0.3 if settings is SOFT else 1e-9)
    assert recorder.found_s == pytest.approx([0], abs=1e-9)


@pytest.mark.parametrize("missing", [range(36, 58), range(50, 54), range(30, 130)])
@pytest.mark.slow
def test_long_gap_keeps_packets_apart(missing: range) -> None:
    packets = received(without(missing), PLAIN)
    starts = starts_ms(packets)
    assert starts == sorted(set(starts))
    for packet, start in zip(packets, starts, strict=True):
        # all frames belong to the packet identified by the start time
        assert start % PACKET == 0
        assert start <= packet.first_frame <= packet.last_frame < start + PACKET
    whole = {start for start in range(0, 4 * PACKET, PACKET) if not set(missing) & set(range(start, start + PACKET))}
    assert whole <= {start for packet, start in zip(packets, starts, strict=True) if packet.status == "ok"}


@pytest.mark.parametrize(("frames", "count"), [(27, 0), (28, 1), (51, 1), (52, 1), (79, 1), (80, 2)])
def test_film_cut_within_a_packet_gives_it_if_half_of_the_pairs_are_there(frames: int, count: int) -> None:
    packets = received(still_film()[:frames], PLAIN)
    assert len(packets) == count
    rest = min((frames % PACKET) // 2 - 2, 24)
    if packets and rest > 0:
        assert packets[-1].pairs_seen == pytest.approx(rest / 24 if rest >= 12 else 1)


@pytest.mark.slow
def test_array_leaving_the_image_is_lost() -> None:
    recorder = Recorder()
    frames = drawn_film(PLAIN, 180, lambda t: np.stack([47.3 + 500 * t, 48.8 + 0 * t], -1))
    packets = received(frames, PLAIN, recorder)
    assert len(recorder.lost_s) == 1
    assert all(p.start_time_s < 0.15 for p in packets)


def test_track_of_noise_is_given_up() -> None:
    rng, recorder = np.random.default_rng(0), Recorder()
    frames = film(PLAIN, 6)
    noise = [Frame(k, k * 1e-3, rng.integers(0, 200, (120, 160)).astype(np.uint8)) for k in range(6, 160)]
    packets = received([*frames, *noise], PLAIN, recorder)
    assert len(recorder.found_s) == len(recorder.lost_s) == 1
    assert len(packets) <= 3
    assert all(word.status != "ok" for packet in packets for word in words_of(packet))


@pytest.fixture
def unsolved(monkeypatch: pytest.MonkeyPatch) -> Callable[[type, str, int], None]:
    """Return a function that makes one call of a method fail."""

    def patch(owner: type, method: str, number: int) -> None:
        original, calls = getattr(owner, method), itertools.count()

        def failing(self: Any, *arguments: Any) -> Any:
            if next(calls) == number:
                raise np.linalg.LinAlgError("no solution")
            return original(self, *arguments)

        monkeypatch.setattr(owner, method, failing)

    return patch


@pytest.mark.parametrize(("settings", "kind"), [(PLAIN, PlainPacket), (SOFT, SoftPacket)], ids=["plain", "soft"])
def test_packet_whose_equations_have_no_solution_costs_no_other(
    settings: LinkSettings, kind: type, unsolved: Any, caplog: pytest.LogCaptureFixture
) -> None:
    unsolved(kind, "decode", 0)
    packets = received(still_film()[: 2 * PACKET + 4], settings)
    assert [(p.status, p.reason) for p in packets] == [("crc_fail", "no solution"), ("ok", "")]
    assert all((word.raw == ERASED).all() for word in words_of(packets[0]))
    assert "packet at frame 0 is not read: no solution" in caplog.text


def test_array_whose_pose_has_no_solution_is_found_again(unsolved: Any, caplog: pytest.LogCaptureFixture) -> None:
    unsolved(Tracker, "follow", 10)
    recorder = Recorder()
    assert statuses(received(still_film()[: 3 * PACKET + 4], PLAIN, recorder)) == ["ok", "ok"]
    assert len(recorder.lost_s) == 1
    assert "is given up at 0.02" in caplog.text


def renumbered(frames: Sequence[Frame]) -> list[Frame]:
    """Renumber frames as a camera unaware of lost frames."""
    return [replace(frame, index=k, time_s=k * 1e-3) for k, frame in enumerate(frames)]


LOST = {
    "a pattern": [20],
    "an inverse": [21],
    "two in a row": [21, 22],
    "two of three": [20, 22],
    "one in each packet": [20, 71, 130],
    "in a header": [53],
    "an early pair that only the next header reveals": [58, 59],
    "a pair that only the next header reveals": [76, 77],
    "a late pair that only the next header reveals": [90, 91],
}


@pytest.mark.parametrize(("settings", "lost"), [
    *(pytest.param(PLAIN, lost, id=f"plain, {name}") for name, lost in LOST.items()),
    *(pytest.param(SOFT, lost, id=f"soft, {name}") for name, lost in list(LOST.items())[4:7:2]),
])  # fmt: skip
def test_frames_lost_without_a_gap_in_time_cost_no_packet(settings: LinkSettings, lost: list[int]) -> None:
    packets = received(renumbered(without(lost, 3 * PACKET + 4)), settings)
    assert statuses(packets) == ["ok"] * 3
    # in camera time, which ignores lost frames
    starts = [PACKET * packet - sum(k < PACKET * packet for k in lost) for packet in range(3)]
    assert starts_ms(packets) == pytest.approx(starts, abs=1.2 if lost == [53] else 0.2)


@pytest.mark.parametrize("hidden", [range(20, 21), range(21, 26), range(50, 57)])
@pytest.mark.slow
def test_occlusion_is_not_taken_for_lost_frames(hidden: range) -> None:
    packets = received(drawn_film(SOFT, 2 * PACKET + 4, at_rest, hidden=[hidden], distance_m=35.0), SOFT)
    assert statuses(packets) == ["ok"] * 2
    assert starts_ms(packets) == pytest.approx([0, 52], abs=0.1)


def test_repeated_frame_is_not_taken_for_a_lost_one() -> None:
    frames = still_film()[: 2 * PACKET + 4]
    assert statuses(received(renumbered([*frames[:30], *frames[29:]]), SOFT)) == ["ok"] * 2
