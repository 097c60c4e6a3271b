"""Assembly of the plain and soft receivers."""

from dataclasses import replace
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import drawn_film, film, pitch_at
from scenes import link as scene
from threadpoolctl import threadpool_info, threadpool_limits

from heliograph.base.errors import HeliographError, SettingsError
from heliograph.base.frames import Frame
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.measure.bench import run_block
from heliograph.receive import Packet, ReceiveSettings, make_receiver, receive_frames
from heliograph.receive.decode import turbo_equaliser as iterate
from heliograph.receive.equalise import led_gains
from heliograph.receive.equalise import single_mode as decision_directed
from heliograph.receive.equalise.lmmse import Estimate, equalise
from heliograph.signal.settings import SignalSettings


def link(preset: str, receiver: str, *changes: str) -> LinkSettings:
    return load_settings(preset, None, [f"receive.receiver={receiver}", *changes])


def wrong(settings: LinkSettings, seed: int = 1) -> dict[str, int]:
    counts = run_block(settings, seed)
    assert counts.false_codewords == counts.false_packets == 0
    return {name: layer.codeword_errors for name, layer in counts.layers.items()}


def test_all_layers_are_read_at_100_m_where_the_plain_receiver_reads_none_but_the_high() -> None:
    assert wrong(link("static", "soft", "channel.distance_m=100")) == {"high": 0, "middle": 0, "low": 0}
    plain = wrong(link("static", "plain", "channel.distance_m=100", "receive.detect.min_side_px=4"))
    assert (plain["middle"], plain["low"]) == (2, 1)


@pytest.mark.slow
def test_it_reads_while_driving() -> None:
    settings = link("motorway", "soft", "channel.distance_m=90", "channel.duration_s=0.3")
    assert run_block(settings, 1).layers["high"].codewords == 3
    assert wrong(settings) == {"high": 0, "middle": 0, "low": 0}


@pytest.mark.parametrize("distance_m", [180, 215])
@pytest.mark.slow
def test_far_away_no_pair_is_taken_for_an_array_out_of_sight(distance_m: float) -> None:
    settings = link("static", "soft", f"channel.distance_m={distance_m}")
    (packet,) = receive_frames(film(settings, 101), settings.signal, settings.receive)
    assert packet.pairs_seen == 1
    assert packet.layers["high"][0].status == "ok"


@pytest.mark.slow
def test_near_both_receivers_read_all() -> None:
    for receiver in ("plain", "soft"):
        assert wrong(link("static", receiver, "channel.distance_m=25")) == {"high": 0, "middle": 0, "low": 0}


def test_where_no_receiver_reads_none_is_advised() -> None:
    """The frame rate is too low for the soft receiver too."""
    frames = [Frame(k, 0.04 * k, np.full((40, 40), k, np.uint8)) for k in range(20)]
    plain = make_receiver(SignalSettings())
    with pytest.raises(HeliographError, match="needs one frame a pattern") as caught:
        [list(plain.push(frame)) for frame in frames]
    assert "soft" not in str(caught.value)


def test_receivers_are_chosen_by_name() -> None:
    """The plain receiver needs one frame per pattern; the soft receiver accepts any higher rate."""
    frames = [Frame(k, 0.6e-3 * k, np.full((40, 40), k, np.uint8)) for k in range(20)]
    plain, soft = make_receiver(SignalSettings()), make_receiver(SignalSettings(), ReceiveSettings(receiver="soft"))
    with pytest.raises(HeliographError, match="the plain receiver needs one frame a pattern"):
        [list(plain.push(frame)) for frame in frames]
    assert [list(soft.push(frame)) for frame in frames] == [[]] * 20


@pytest.mark.parametrize(
    ("setting", "read", "other"), [("modulation", "haar", "ook"), ("header", "m_sequence", "all_on")]
)
def test_another_light_is_refused_in_one_line(setting: str, read: str, other: str) -> None:
    signal = load_settings("static", None, [f"signal.{setting}={other}"]).signal
    with pytest.raises(SettingsError, match=rf'reads signal\.{setting} = "{read}", not "{other}"') as caught:
        make_receiver(signal, ReceiveSettings(receiver="soft"))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("room", [iterate, led_gains, decision_directed])
@pytest.mark.slow
def test_its_algebra_runs_in_one_thread(room: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    """Multithreaded BLAS is slow for small matrices."""
    threads: list[int] = []

    def counting(*given: Any) -> Estimate:
        threads.extend(info["num_threads"] for info in threadpool_info() if info["user_api"] == "blas")
        return equalise(*given)

    monkeypatch.setattr(room, "equalise", counting)
    settings = link("static", "soft", "channel.distance_m=50", "transmit.formats=[{mode='single'}]")
    with threadpool_limits(limits=2, user_api="blas"):
        list(receive_frames(film(settings, 101), settings.signal, settings.receive))
    assert threads
    assert set(threads) == {1}


@pytest.mark.parametrize("cut_px", [0, 1])
@pytest.mark.slow
def test_an_array_at_the_rim_of_the_picture_is_read(cut_px: int) -> None:
    """Missing pixels have no weight."""
    settings = scene("receive.receiver=soft", distance_m=80.0)
    frames = film(settings, 205)
    first = next(iter(receive_frames(frames, settings.signal, settings.receive)))
    right = round(first.pose.x + 8 * pitch_at(80.0) - cut_px)
    # from here on, frames are sensor windows
    frames = [replace(f, pixels=f.pixels[:, 1:right].copy(), origin=(1, 0)) if f.index > 101 else f for f in frames]
    packets = list(receive_frames(frames, settings.signal, settings.receive))
    assert [p.status for p in packets] == ["ok", "ok"]


def content(packet: Packet) -> list[Any]:
    """Return packet content except times."""
    words = [word for by in packet.layers.values() for word in by]
    bits = [(w.status, w.block, w.iterations, w.bits.tobytes(), w.raw.tobytes()) for w in words]
    return [packet.identity, packet.status, packet.first_frame, packet.last_frame, packet.pairs_seen, bits]


@pytest.mark.parametrize(("receiver", "exposed_slots"), [("plain", 4), ("soft", 4), ("soft", 3)])
@pytest.mark.slow
def test_times_count_in_patterns(receiver: str, exposed_slots: int) -> None:
    """Slow motion gives equal packets if patterns slow down equally. The array moves and is hidden for a while."""

    def path(t: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.stack([40.3 + 100 * t, 48.8 - 60 * t], -1)

    slower = 33.3
    settings = scene(f"receive.receiver={receiver}", "signal.data_pairs=24")
    signal = settings.signal
    slow_signal = replace(signal, pattern_period_s=slower * signal.pattern_period_s)
    # two packets with 52 patterns, four slots each
    count, hidden = 448 // exposed_slots, 336 // exposed_slots
    frames = drawn_film(settings, count, path, hidden=[range(hidden, hidden + 6)], exposed_slots=exposed_slots)
    slow_frames = [replace(frame, time_s=slower * frame.time_s) for frame in frames]
    packets = list(receive_frames(frames, signal, settings.receive))
    again = list(receive_frames(slow_frames, slow_signal, settings.receive))
    assert [packet.status for packet in packets] == ["ok", "ok"]
    assert packets[1].pairs_seen < 1
    assert [content(packet) for packet in again] == [content(packet) for packet in packets]
    for packet, slow in zip(packets, again, strict=True):
        assert slow.start_time_s == pytest.approx(slower * packet.start_time_s, abs=1e-9)
        assert slow.pose.full_vector() == pytest.approx(packet.pose.full_vector(), abs=1e-9)
