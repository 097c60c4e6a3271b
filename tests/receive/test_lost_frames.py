"""Lost frames, with and without timestamp gaps, in films with three packets."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from recorder import Recorder
from scenes import Floats, drawn_film, film, link

from heliograph.base.frames import Frame
from heliograph.receive import Packet, receive_frames


def renumbered(frames: Sequence[Frame]) -> list[Frame]:
    """Renumber frames as a camera unaware of lost frames."""
    return [replace(frame, index=k, time_s=k * 1e-3) for k, frame in enumerate(frames)]


def read(receiver: str, lost: Sequence[int], distance_m: float, stamped: bool) -> list[Packet]:
    """Return packets, 52 patterns each, with some frames lost."""
    settings = link(f"receive.receiver={receiver}", "signal.data_pairs=24", distance_m=distance_m)
    left = [frame for frame in film(settings, 160, 3, 12) if frame.index not in set(lost)]
    return list(receive_frames(left if stamped else renumbered(left), settings.signal, settings.receive))


@pytest.mark.parametrize(("receiver", "distance_m"), [("plain", 35.0), ("soft", 50.0), ("soft", 80.0)])
@pytest.mark.slow
def test_a_pair_without_one_of_its_frames_is_left_out(receiver: str, distance_m: float) -> None:
    rng, lost = np.random.default_rng(5), list[int]()
    for packet in range(3):
        pairs = 52 * packet + 4 + 2 * rng.permutation(24)[:6]
        lost += [int(k) + int(rng.integers(2)) for k in pairs[:4]] + [int(k) + j for k in pairs[4:] for j in (0, 1)]
    packets = read(receiver, lost, distance_m, stamped=True)
    assert [packet.pairs_seen for packet in packets] == pytest.approx([18 / 24] * 3)
    assert [packet.layers["high"][0].status for packet in packets] == ["ok"] * 3
    if distance_m < 80:
        assert [packet.status for packet in packets] == ["ok"] * 3


@pytest.mark.parametrize("lost", [{2}, {3}])
@pytest.mark.slow
def test_a_header_without_one_of_its_frames_is_found(lost: set[int]) -> None:
    settings, recorder = link("receive.receiver=soft", "signal.data_pairs=8"), Recorder()
    frames = [frame for frame in film(settings, 40) if frame.index not in lost]
    packets = list(receive_frames(frames, settings.signal, settings.receive, recorder))
    assert recorder.found_s == pytest.approx([0], abs=1e-9)
    assert packets[0].status == "ok"


@pytest.mark.parametrize("receiver", ["plain", "soft"])
@pytest.mark.parametrize(
    "lost",
    [
        pytest.param([20], id="a pattern"),
        pytest.param([21], id="an inverse"),
        pytest.param([20, 71, 130], id="one in each packet"),
        pytest.param([21, 22], id="two in a row"),
        pytest.param([20, 22], id="two of three"),
        pytest.param([53], id="in a header"),
        pytest.param([58, 59], id="an early pair, of which the next header tells"),
        pytest.param([76, 77], id="a pair, of which the next header tells"),
        pytest.param([90, 91], id="a late pair, of which the next header tells"),
    ],
)
@pytest.mark.slow
def test_frames_lost_without_a_gap(receiver: str, lost: list[int]) -> None:
    packets = read(receiver, lost, 35.0 if receiver == "plain" else 60.0, stamped=False)
    assert [packet.status for packet in packets] == ["ok"] * 3
    # in camera time, which ignores lost frames
    before = [sum(k < 52 * packet for k in lost) for packet in range(3)]
    starts = [52 * packet - before[packet] for packet in range(3)]
    assert [1e3 * packet.start_time_s for packet in packets] == pytest.approx(starts, abs=1.2 if lost == [53] else 0.2)


@pytest.mark.parametrize("hidden", [range(20, 21), range(21, 23), range(21, 26), range(30, 35), range(50, 57)])
@pytest.mark.slow
def test_what_hides_the_array_is_no_lost_frame(hidden: range) -> None:
    settings = link("receive.receiver=soft", "signal.data_pairs=24")

    def at_rest(t: Floats) -> Floats:
        return np.stack([47.3 + 0 * t, 48.8 + 0 * t], -1)

    frames = drawn_film(settings, 160, at_rest, hidden=[hidden])
    packets = list(receive_frames(frames, settings.signal, settings.receive))
    assert [packet.status for packet in packets] == ["ok"] * 3
    assert [1e3 * packet.start_time_s for packet in packets] == pytest.approx([0, 52, 104], abs=0.1)


@pytest.mark.slow
def test_a_copy_between_frames_is_no_lost_frame() -> None:
    settings = link("receive.receiver=soft", "signal.data_pairs=24")
    frames = film(settings, 160, 3, 12)
    packets = list(receive_frames(renumbered([*frames[:30], *frames[29:]]), settings.signal, settings.receive))
    assert [packet.status for packet in packets] == ["ok"] * 3
