"""The receiver "auto" chooses by signal and frame rate, and gives the packets of the chosen receiver."""

from dataclasses import replace
from itertools import islice

import numpy as np
import pytest

from heliograph.base.errors import HeliographError
from heliograph.base.frames import Frame
from heliograph.link.settings import load_settings
from heliograph.link.simulate import default_messages, simulate
from heliograph.receive import ReceiveSettings, make_receiver, receive_frames
from heliograph.receive.auto import choose_receiver
from heliograph.receive.events import ChooseEvent
from heliograph.signal.settings import SignalSettings

SIGNAL = SignalSettings()
AUTO = ReceiveSettings(receiver="auto")


@pytest.mark.parametrize(("changes", "rate_hz", "name"), [
    ({}, 1000, "soft"), ({}, 1010, "soft"), ({}, 3700, "soft"), ({}, 985, "soft"),
    ({}, 30, "screen"), ({}, 240, "screen"), ({}, 500, "plain"),
    ({"pattern_period_s": 0.1}, 30, "soft"), ({"pattern_period_s": 0.02}, 30, "screen"),
    ({"modulation": "ook"}, 1000, "plain"), ({"header": "all_on"}, 1000, "plain"),
])  # fmt: skip
def test_choice_follows_signal_and_frame_rate(changes: dict[str, object], rate_hz: float, name: str) -> None:
    assert choose_receiver(replace(SIGNAL, **changes), 1 / rate_hz)[0] == name  # type: ignore[arg-type]


@pytest.mark.slow
def test_packets_are_those_of_the_chosen_receiver() -> None:
    link = load_settings(
        "static",
        {"channel": {"camera": {"width": 96, "height": 96}, "duration_s": 0.12, "arrays": [{"x_m": 0.0, "y_m": 0.0}]}},
    )
    frames = [frame for frame, _ in simulate(link, default_messages(link), 3)]
    events = list[object]()
    packets = list(receive_frames(frames, link.signal, AUTO, events.append))
    expected = list(receive_frames(frames, link.signal, ReceiveSettings(receiver="soft")))
    assert [(p.status, p.start_time_s, p.pose) for p in packets] == [
        (p.status, p.start_time_s, p.pose) for p in expected
    ]
    assert packets
    assert events[0] == ChooseEvent("soft", "1000 frames/s, 1000 patterns/s")


def test_camera_may_fill_the_same_array_before_the_choice() -> None:
    pixels, receiver = np.zeros((32, 32), np.uint8), make_receiver(SIGNAL, AUTO)
    for index in range(10):
        pixels[:] = index
        assert not list(receiver.push(Frame(index, index / 1000, pixels)))
    held = receiver._held  # type: ignore[attr-defined]
    assert [int(frame.pixels[0, 0]) for frame in held] == list(range(10))
    assert not list(receiver.finish())


def test_wrong_frames_are_refused_before_the_choice() -> None:
    pixels = np.zeros((32, 32), np.uint8)
    receiver = make_receiver(SIGNAL, AUTO)
    list(receiver.push(Frame(0, 0.0, pixels)))
    with pytest.raises(HeliographError, match="frames must follow in time"):
        list(receiver.push(Frame(1, 0.0, pixels)))


def test_a_film_without_frames_has_no_packets() -> None:
    assert not list(make_receiver(SIGNAL, AUTO).finish())
    assert not list(islice(receive_frames([], SIGNAL, AUTO), 1))
