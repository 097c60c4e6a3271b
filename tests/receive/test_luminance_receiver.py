"""A receiver that only reads luminances: windows, LED positions, and packets like those of "plain"."""

from typing import Any

import pytest
from scipy.ndimage import map_coordinates

from heliograph.base.errors import HeliographError
from heliograph.base.frames import Frame
from heliograph.link.settings import load_settings
from heliograph.link.simulate import default_messages, simulate
from heliograph.receive import LuminanceReceiver, ReceiveSettings, receive_frames, register_receiver

LINK = load_settings(
    "static",
    {"channel": {"camera": {"width": 96, "height": 96}, "duration_s": 0.12, "arrays": [{"x_m": 0.0, "y_m": 0.0}]}},
)


class Sampled(LuminanceReceiver):
    """Samples both frames at the LEDs."""

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
    own = list(receive_frames(frames, LINK.signal, settings))
    plain = list(receive_frames(frames, LINK.signal, ReceiveSettings(receiver="plain")))
    assert own
    assert [(p.status, p.identity, p.start_time_s) for p in own] == [
        (p.status, p.identity, p.start_time_s) for p in plain
    ]
    assert own[0].has_codeword


@pytest.mark.slow
def test_a_wrong_shape_is_named(frames: list[Frame]) -> None:
    with pytest.raises(HeliographError, match=r"Wrong\.luminances returns 16 x 16 finite numbers"):
        list(receive_frames(frames, LINK.signal, ReceiveSettings(receiver="wrong")))
