"""Assembly of the plain and soft receivers."""

from dataclasses import replace
from functools import partial
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import codewords, comparable, drawn_film, film, link, pitch_at, received, statuses
from threadpoolctl import threadpool_info, threadpool_limits

from heliograph.base.errors import HeliographError, SettingsError
from heliograph.base.frames import Frame
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.receive import ReceiveSettings, make_receiver
from heliograph.receive.decode import turbo_equaliser
from heliograph.receive.equalise import led_gains, single_mode
from heliograph.receive.equalise.lmmse import Estimate, equalise
from heliograph.signal.settings import SignalSettings


def preset(name: str, receiver: str, *changes: str) -> LinkSettings:
    return load_settings(name, None, [f"receive.receiver={receiver}", *changes])


@pytest.mark.slow
def test_soft_receiver_reads_all_layers_at_100_m_and_the_plain_only_the_high() -> None:
    assert codewords(preset("static", "soft", "channel.distance_m=100")) == [(1, 0), (2, 0), (1, 0)]
    plain = preset("static", "plain", "channel.distance_m=100", "receive.detect.min_side_px=4")
    assert [lost for _, lost in codewords(plain)[1:]] == [2, 1]


@pytest.mark.slow
def test_noisy_pairs_of_a_far_array_count_as_visible() -> None:
    settings = link("signal.data_pairs=24", "receive.receiver=soft", distance_m=190.0)
    (packet,) = received(film(settings, 53, roi_margin_px=30), settings)
    assert packet.pairs_seen == 1
    assert packet.layers["high"][0].status == "ok"


def blinking(period_s: float) -> list[Frame]:
    return [Frame(k, period_s * k, np.full((40, 40), k, np.uint8)) for k in range(20)]


@pytest.mark.parametrize("period_s", [0.04, 0.6e-3])
def test_plain_receiver_refuses_other_rates_than_one_frame_a_pattern(period_s: float) -> None:
    plain = make_receiver(SignalSettings())
    with pytest.raises(HeliographError, match="the plain receiver needs one frame per pattern") as caught:
        [list(plain.push(frame)) for frame in blinking(period_s)]
    if period_s > 1e-3:
        assert "soft" not in str(caught.value), "the soft receiver cannot read this rate either"


def test_soft_receiver_accepts_higher_rates() -> None:
    soft = make_receiver(SignalSettings(), ReceiveSettings(receiver="soft"))
    assert [list(soft.push(frame)) for frame in blinking(0.6e-3)] == [[]] * 20


@pytest.mark.parametrize(
    ("setting", "read", "other"), [("modulation", "haar", "ook"), ("header", "m_sequence", "all_on")]
)
def test_soft_receiver_refuses_another_signal_in_one_line(setting: str, read: str, other: str) -> None:
    signal = load_settings("static", None, [f"signal.{setting}={other}"]).signal
    with pytest.raises(SettingsError, match=rf'reads signal\.{setting} = "{read}", not "{other}"') as caught:
        make_receiver(signal, ReceiveSettings(receiver="soft"))
    assert "\n" not in str(caught.value)


def test_soft_receiver_limits_blas_to_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    """Multithreaded BLAS is slow for small matrices."""
    threads = {module: set[int]() for module in (turbo_equaliser, led_gains, single_mode)}

    def counting(module: ModuleType, *arguments: Any) -> Estimate:
        threads[module] |= {info["num_threads"] for info in threadpool_info() if info["user_api"] == "blas"}
        return equalise(*arguments)

    for module in threads:
        monkeypatch.setattr(module, "equalise", partial(counting, module))
    single = "signal.data_pairs=8", "transmit.formats=[{mode='single'}]"
    settings = link("receive.receiver=soft", *single, distance_m=40.0)
    with threadpool_limits(limits=2, user_api="blas"):
        received(film(settings, 21, roi_margin_px=12), settings)
    assert list(threads.values()) == [{1}] * 3


@pytest.mark.parametrize("cut_px", [0, 1])
@pytest.mark.slow
def test_array_at_the_edge_of_the_image_is_read(cut_px: int) -> None:
    """Missing pixels have no weight."""
    settings = link("receive.receiver=soft", "signal.data_pairs=16", distance_m=70.0)
    frames = film(settings, 77)
    right = round(79.5 + 8 * pitch_at(70.0) - cut_px)
    # from here on, frames are sensor windows
    frames = [replace(f, pixels=f.pixels[:, 1:right].copy(), origin=(1, 0)) if f.index > 37 else f for f in frames]
    assert statuses(received(frames, settings)) == ["ok", "ok"]


@pytest.mark.parametrize(("receiver", "exposed_slots"), [("plain", 4), ("soft", 3)])
@pytest.mark.slow
def test_times_count_in_patterns(receiver: str, exposed_slots: int) -> None:
    """Slow motion gives equal packets if patterns slow down equally. The array moves and is hidden for a while."""

    def path(t: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.stack([40.3 + 100 * t, 48.8 - 60 * t], -1)

    slower = 33.3
    settings = link(f"receive.receiver={receiver}", "signal.data_pairs=16")
    signal = replace(settings.signal, pattern_period_s=slower * settings.signal.pattern_period_s)
    slow_settings = replace(settings, signal=signal)
    # two packets with 36 patterns, four slots each
    count, hidden = 312 // exposed_slots, 240 // exposed_slots
    frames = drawn_film(settings, count, path, hidden=[range(hidden, hidden + 6)], exposed_slots=exposed_slots)
    packets = received(frames, settings)
    again = received([replace(frame, time_s=slower * frame.time_s) for frame in frames], slow_settings)
    assert statuses(packets) == ["ok", "ok"]
    assert packets[1].pairs_seen < 1
    assert [packet.layers for packet in comparable(again)] == [packet.layers for packet in comparable(packets)]
    for packet, slow in zip(packets, again, strict=True):
        assert (slow.first_frame, slow.last_frame) == (packet.first_frame, packet.last_frame)
        assert (slow.identity, slow.status, slow.pairs_seen) == (packet.identity, packet.status, packet.pairs_seen)
        assert slow.start_time_s == pytest.approx(slower * packet.start_time_s, abs=1e-9)
        assert slow.pose.full_vector() == pytest.approx(packet.pose.full_vector(), abs=1e-9)
