"""Receiver registry: built-in and custom receivers."""

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from pydantic.dataclasses import dataclass

from heliograph.base.config import CONFIG, from_mapping
from heliograph.base.errors import SettingsError
from heliograph.base.frames import Frame
from heliograph.receive import Packet, Pose, ReceiveSettings, make_receiver, own_settings, receive_frames
from heliograph.receive.api import register_receiver
from heliograph.receive.registry import RECEIVERS
from heliograph.signal.settings import SignalSettings

SIGNAL = SignalSettings()
FRAMES = [Frame(k, k * 1e-3, np.zeros((4, 4), np.uint8)) for k in range(7)]
NUMBERS = itertools.count()


@dataclass(frozen=True, kw_only=True, config=CONFIG)
class Every:
    frames: int = 3


class Counting:
    """Return a packet every few frames, and the remainder at the end."""

    def __init__(self, signal: SignalSettings, settings: ReceiveSettings, observe: Any):
        assert signal == SIGNAL
        self._every, self._seen = own_settings(settings).frames, list[Frame]()
        self._observe = observe

    def push(self, frame: Frame) -> Iterator[Packet]:
        self._seen.append(frame)
        if len(self._seen) == self._every:
            yield from self.finish()

    def finish(self) -> Iterator[Packet]:
        if self._seen:
            first, last = self._seen[0], self._seen[-1]
            self._seen = []
            self._observe(first)
            yield Packet(0, "ok", first.time_s, first.index, last.index, Pose(0, 0, 1), 1.0, 1.0, 1.0, 1.0, {})


def counting() -> str:
    name = f"counting-{next(NUMBERS)}"
    register_receiver(name, Counting, Every)
    return name


def test_a_receiver_of_ones_own_is_chosen_by_its_name() -> None:
    settings, shown = ReceiveSettings(receiver=counting()), list[Any]()
    packets = list(receive_frames(FRAMES, SIGNAL, settings, shown.append))
    assert [(p.first_frame, p.last_frame) for p in packets] == [(0, 2), (3, 5), (6, 6)]
    assert shown == FRAMES[::3]
    assert isinstance(make_receiver(SIGNAL, settings), Counting)
    assert settings.receiver in RECEIVERS.names()


def test_it_has_settings_of_its_own() -> None:
    settings = ReceiveSettings(receiver=counting(), custom={"frames": 5})
    assert own_settings(settings) == Every(frames=5)
    assert len(list(receive_frames(FRAMES, SIGNAL, settings))) == 2
    with pytest.raises(SettingsError, match=r"'frmes'; did you mean 'frames'"):
        from_mapping(ReceiveSettings, {"receiver": settings.receiver, "custom": {"frmes": 5}})
    name = f"plain-{next(NUMBERS)}"
    register_receiver(name, Counting)
    assert own_settings(ReceiveSettings(receiver=name)) is None
    with pytest.raises(SettingsError, match=r"custom\.frames has no effect"):
        from_mapping(ReceiveSettings, {"receiver": name, "custom": {"frames": 5}})


@pytest.mark.parametrize(
    ("name", "message"), [("plian", "did you mean 'plain'"), ("soft2", "did you mean 'soft'"), ("", "there are plain")]
)
def test_an_unknown_receiver_is_refused_in_one_line(name: str, message: str) -> None:
    with pytest.raises(SettingsError, match=message) as error:
        from_mapping(ReceiveSettings, {"receiver": name})
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("name", ["plain", "soft"])
def test_receivers_of_the_package_keep_their_names(name: str) -> None:
    with pytest.raises(SettingsError, match="one of the package"):
        register_receiver(name, Counting)


@pytest.mark.parametrize("name", ["", "my receiver", "a=b"])
def test_a_name_is_a_name(name: str) -> None:
    with pytest.raises(SettingsError, match="letters, digits"):
        register_receiver(name, Counting)
