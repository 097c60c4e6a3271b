"""Assembly of the plain and soft receivers, and receivers in several threads."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from scenes import codewords, comparable, drawn_film, film, link, pitch_at, received, statuses
from threadpoolctl import threadpool_info, threadpool_limits

from heliograph.base.errors import HeliographError, SettingsError
from heliograph.base.frames import Frame
from heliograph.base.threads import in_one_thread, one_thread
from heliograph.link.settings import load_settings
from heliograph.receive.api import make_receiver
from heliograph.receive.decode import turbo_equaliser
from heliograph.receive.equalise import led_gains, single_mode
from heliograph.receive.equalise.lmmse import Estimate, equalise
from heliograph.receive.packet import Packet
from heliograph.receive.settings import ReceiveSettings
from heliograph.signal.settings import SignalSettings


@pytest.mark.slow
def test_soft_receiver_reads_all_layers_at_100_m_and_the_plain_only_the_high() -> None:
    far, names = ["channel.distance_m=100", "receive.detect.min_side_px=4"], ("soft", "plain")
    soft, plain = (codewords(load_settings("static", None, [f"receive.receiver={one}", *far])) for one in names)
    assert soft == [(1, 0), (2, 0), (1, 0)]
    assert plain[1:] == [(2, 2), (1, 1)]


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
    # at the lower rate, the soft receiver fails too
    assert period_s < 1e-3 or "soft" not in str(caught.value)


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
    slower, settings = 33.3, link(f"receive.receiver={receiver}", "signal.data_pairs=16")
    signal = replace(settings.signal, pattern_period_s=slower * settings.signal.pattern_period_s)
    # two packets with 36 patterns, four slots each
    count, hidden = 312 // exposed_slots, 240 // exposed_slots
    hidden_frames = [range(hidden, hidden + 6)]
    frames = drawn_film(
        settings, count, lambda t: np.stack([40.3 + 100 * t, 48.8 - 60 * t], -1),
        hidden=hidden_frames, exposed_slots=exposed_slots,
    )  # fmt: skip
    packets = received(frames, settings)
    slowed = [replace(frame, time_s=slower * frame.time_s) for frame in frames]
    again = received(slowed, replace(settings, signal=signal))
    assert statuses(packets) == ["ok", "ok"]
    assert packets[1].pairs_seen < 1
    for packet, slow in zip(comparable(packets), comparable(again), strict=True):
        assert slow.start_time_s == pytest.approx(slower * packet.start_time_s, abs=1e-9)
        assert slow.pose.full_vector() == pytest.approx(packet.pose.full_vector(), abs=1e-9)
        for name in ("layers", "first_frame", "last_frame", "identity", "status", "pairs_seen"):
            assert getattr(slow, name) == getattr(packet, name), name


def blas_threads() -> int:
    """Return the largest thread count; some BLAS builds are single-threaded."""
    return max(int(info["num_threads"]) for info in threadpool_info() if info["user_api"] == "blas")


@pytest.fixture
def two_threads() -> Iterator[None]:
    with threadpool_limits(limits=2, user_api="blas"):
        yield


@pytest.mark.usefixtures("two_threads")
def test_overlapping_limits_end_in_any_order() -> None:
    first, second = one_thread(), one_thread()
    with first:
        second.__enter__()
        assert blas_threads() == 1
    assert blas_threads() == 1, "the second is still at work"
    second.__exit__(None, None, None)
    assert blas_threads() == 2, "BLAS has what it had before"


@pytest.mark.usefixtures("two_threads")
def test_limit_ends_after_an_error() -> None:
    with pytest.raises(ZeroDivisionError), one_thread():
        _ = 1 / 0
    assert blas_threads() == 2


@pytest.mark.usefixtures("two_threads")
@pytest.mark.slow
def test_receivers_in_four_threads_read_the_same_as_in_sequence() -> None:
    settings = [link(f"receive.receiver={name}", "signal.data_pairs=16") for name in ("plain", "soft") * 2]
    films = [film(one, 40, seed, roi_margin_px=20) for seed, one in enumerate(settings)]

    def read(number: int) -> list[Packet]:
        return comparable(received(films[number], settings[number]))

    sequential = [read(number) for number in range(4)]
    assert all(sequential)
    with ThreadPoolExecutor(4) as threads:
        assert list(threads.map(read, range(4))) == sequential
    assert blas_threads() == 2


def test_ctrl_c_in_compiled_code_raises_keyboard_interrupt() -> None:
    """In compiled code, KeyboardInterrupt appears as the cause of a (possibly nested) SystemError."""

    def interrupted() -> Iterator[int]:
        yield 1
        try:
            raise SystemError("amid it") from KeyboardInterrupt()
        except SystemError as error:
            raise SystemError("around it") from error

    items = in_one_thread(interrupted)()
    assert next(items) == 1
    with pytest.raises(KeyboardInterrupt):
        next(items)


def test_other_system_errors_are_unchanged() -> None:
    def broken() -> Iterator[int]:
        raise SystemError("broken")
        yield 1

    with pytest.raises(SystemError, match="broken"):
        next(in_one_thread(broken)())
