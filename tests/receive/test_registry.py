"""Receiver registry and settings: built-in, custom and luminance receivers, choice, and settings without effect."""

import itertools
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from pydantic.dataclasses import dataclass
from scipy.ndimage import map_coordinates

from heliograph.base.config import CONFIG, from_mapping
from heliograph.base.errors import HeliographError, SettingsError
from heliograph.base.frames import Frame
from heliograph.link.settings import load_settings
from heliograph.link.simulate import default_messages, simulate
from heliograph.receive.api import choose_receiver, make_receiver, own_settings, receive_frames, register_receiver
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.luminance_receiver import LuminanceReceiver
from heliograph.receive.packet import Packet
from heliograph.receive.registry import RECEIVERS
from heliograph.receive.settings import ReceiveSettings
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


def test_custom_receiver_is_chosen_by_name() -> None:
    settings, shown = ReceiveSettings(receiver=counting()), list[Any]()
    packets = list(receive_frames(FRAMES, SIGNAL, settings, shown.append))
    assert [(p.first_frame, p.last_frame) for p in packets] == [(0, 2), (3, 5), (6, 6)]
    assert shown == FRAMES[::3]
    assert isinstance(make_receiver(SIGNAL, settings), Counting)
    assert settings.receiver in RECEIVERS.names()


def test_custom_receiver_has_settings() -> None:
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


def test_unknown_receiver_is_refused_in_one_line() -> None:
    with pytest.raises(SettingsError, match="did you mean 'plain'") as error:
        from_mapping(ReceiveSettings, {"receiver": "plian"})
    assert "\n" not in str(error.value)


@pytest.fixture
def mine() -> None:
    register_receiver("mine", lambda *_: pytest.fail("the settings make no receiver"), Every, ["calibration"])


@pytest.mark.parametrize(("settings", "key"), [
    ({"soft": {"feedback": "none"}}, "soft.feedback"), ({"soft": {"combining": False}}, "soft.combining"),
    ({"calibration": {"exposure_s": 5e-4}}, "calibration.exposure_s"),
    ({"receiver": "soft", "plain": {"equaliser": "inverse"}}, "plain.equaliser"),
    ({"receiver": "soft", "custom": {"frames": 3}}, "custom.frames"),
    ({"receiver": "mine", "soft": {"combining": False}}, "soft.combining"),
    ({"receiver": "mine", "detect": {"score": 0.8}}, "detect.score"),
    ({"receiver": "mine", "track": {"coast_patterns": 9}}, "track.coast_patterns"),
    ({"receiver": "mine", "decode": {"algorithm": "log-map"}}, "decode.algorithm"),
])  # fmt: skip
@pytest.mark.usefixtures("mine")
def test_key_without_effect_is_refused(settings: dict[str, Any], key: str) -> None:
    with pytest.raises(SettingsError, match=f"receive.{key} has no effect") as error:
        from_mapping(ReceiveSettings, settings)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("settings", [
    {}, {"plain": {"equaliser": "inverse"}},
    {"receiver": "soft", "soft": {"feedback": "none", "combining": False}, "calibration": {"exposure_s": 5e-4}},
    {"receiver": "mine", "custom": {"frames": 3}, "calibration": {"exposure_s": 5e-4}},
    # an explicit default value has no effect
    {"receiver": "soft", "plain": {"equaliser": "none"}},
])  # fmt: skip
@pytest.mark.usefixtures("mine")
def test_keys_of_the_chosen_receiver_are_accepted(settings: dict[str, Any]) -> None:
    found, again = (from_mapping(ReceiveSettings, settings) for _ in range(2))
    assert found.receiver == settings.get("receiver", "plain")
    # settings are hashable
    assert {found: 1}[again] == 1


@pytest.mark.parametrize(("settings", "side_px"), [
    ({}, 8), ({"receiver": "soft"}, 4), ({"receiver": "mine"}, 4), ({"detect": {"min_side_px": 5}}, 5),
    ({"receiver": "soft", "detect": {"min_side_px": 12}}, 12),
])  # fmt: skip
@pytest.mark.usefixtures("mine")
def test_smallest_array_depends_on_the_receiver_unless_it_is_set(settings: dict[str, Any], side_px: float) -> None:
    assert from_mapping(ReceiveSettings, settings).smallest_side_px == side_px


@pytest.mark.parametrize("settings", [{"max_side_px": 8}, {"min_side_px": 20, "max_side_px": 20}])
def test_smallest_array_must_be_below_the_largest(settings: dict[str, Any]) -> None:
    with pytest.raises(SettingsError, match="must be below"):
        from_mapping(ReceiveSettings, {"detect": settings})


@pytest.mark.parametrize(("changes", "rate_hz", "name"), [
    ({}, 1000, "soft"), ({}, 3700, "soft"), ({}, 985, "soft"), ({}, 970, "plain"), ({}, 500, "plain"),
    ({}, 30, "screen"), ({}, 240, "screen"),
    ({"pattern_period_s": 0.1}, 30, "soft"), ({"pattern_period_s": 0.02}, 30, "screen"),
    ({"modulation": "ook"}, 1000, "plain"), ({"header": "all_on"}, 1000, "plain"),
])  # fmt: skip
def test_choice_follows_signal_and_frame_rate(changes: Any, rate_hz: float, name: str) -> None:
    assert choose_receiver(replace(SignalSettings(), **changes), rate_hz)[0] == name


LINK = load_settings(
    "static",
    {"channel": {"camera": {"width": 96, "height": 96}, "duration_s": 0.12, "arrays": [{"x_m": 0.0, "y_m": 0.0}]}},
)


class Sampled(LuminanceReceiver):
    def luminances(self, pattern: Any, inverse: Any, leds: Any) -> Any:
        first, second = (
            map_coordinates(image, (at[..., 1], at[..., 0]), order=3)
            for image, at in zip((pattern, inverse), leds, strict=True)
        )
        return 7 * (first - second)  # any unit


class Wrong(LuminanceReceiver):
    def luminances(self, pattern: Any, inverse: Any, leds: Any) -> Any:
        return (pattern - inverse)[:3, :3] * leds.size


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    register_receiver("sampled", Sampled, reads=["decode"])
    register_receiver("wrong", Wrong)
    return [frame for frame, _ in simulate(LINK, default_messages(LINK), 3)]


@pytest.mark.slow
@pytest.mark.parametrize("in_background", [False, True])
def test_packets_are_those_of_plain(frames: list[Frame], in_background: bool) -> None:
    settings = ReceiveSettings(receiver="sampled", decode={"in_background": in_background})  # type: ignore[arg-type]
    custom, plain = (
        [(p.status, p.identity, p.start_time_s, p.has_codeword) for p in receive_frames(frames, LINK.signal, one)]
        for one in (settings, ReceiveSettings(receiver="plain"))
    )
    assert custom == plain
    assert custom[0][-1]


@pytest.mark.slow
def test_a_wrong_shape_is_named(frames: list[Frame]) -> None:
    with pytest.raises(HeliographError, match=r"Wrong\.luminances must return 16 x 16 finite numbers"):
        list(receive_frames(frames, LINK.signal, ReceiveSettings(receiver="wrong")))
