"""Receiver settings: rejection of settings without effect."""

from dataclasses import dataclass
from typing import Any

import pytest

from heliograph.base.config import from_mapping
from heliograph.base.errors import SettingsError
from heliograph.receive import ReceiveSettings, register_receiver


@dataclass(frozen=True)
class Every:
    frames: int = 1


@pytest.fixture(autouse=True)
def mine() -> None:
    register_receiver("mine", lambda *_: pytest.fail("no receiver is asked for"), Every, ["calibration"])


@pytest.mark.parametrize(
    ("settings", "key"),
    [
        ({"soft": {"feedback": "none"}}, "receive.soft.feedback"),
        ({"soft": {"combining": False}}, "receive.soft.combining"),
        ({"calibration": {"exposure_s": 5e-4}}, "receive.calibration.exposure_s"),
        ({"receiver": "soft", "plain": {"equaliser": "inverse"}}, "receive.plain.equaliser"),
        ({"receiver": "soft", "custom": {"frames": 3}}, "receive.custom.frames"),
        ({"receiver": "mine", "soft": {"combining": False}}, "receive.soft.combining"),
        ({"receiver": "mine", "detect": {"score": 0.8}}, "receive.detect.score"),
        ({"receiver": "mine", "track": {"coast_patterns": 9}}, "receive.track.coast_patterns"),
        ({"receiver": "mine", "decode": {"algorithm": "log-map"}}, "receive.decode.algorithm"),
    ],
)
def test_a_key_without_effect_is_refused(settings: dict[str, Any], key: str) -> None:
    with pytest.raises(SettingsError, match=f"{key} has no effect") as error:
        from_mapping(ReceiveSettings, settings)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"plain": {"equaliser": "inverse"}},
        {"receiver": "soft", "soft": {"feedback": "none", "combining": False}},
        {"receiver": "soft", "calibration": {"exposure_s": 5e-4}},
        {"receiver": "mine", "custom": {"frames": 3}, "calibration": {"exposure_s": 5e-4}},
        # an explicit default value has no effect
        {"receiver": "soft", "plain": {"equaliser": "none"}},
    ],
)
def test_keys_of_the_receiver_chosen_are_taken(settings: dict[str, Any]) -> None:
    assert from_mapping(ReceiveSettings, settings).receiver == settings.get("receiver", "plain")


@pytest.mark.parametrize(
    ("settings", "side_px"),
    [
        ({}, 8),
        ({"receiver": "soft"}, 4),
        ({"receiver": "mine"}, 4),
        ({"detect": {"min_side_px": 5}}, 5),
        ({"receiver": "soft", "detect": {"min_side_px": 12}}, 12),
    ],
)
def test_the_smallest_array_depends_on_the_receiver_unless_it_is_set(settings: dict[str, Any], side_px: float) -> None:
    assert from_mapping(ReceiveSettings, settings).smallest_side_px == side_px


@pytest.mark.parametrize("settings", [{"max_side_px": 8}, {"min_side_px": 20, "max_side_px": 20}])
def test_the_smallest_array_is_smaller_than_the_largest(settings: dict[str, Any]) -> None:
    with pytest.raises(SettingsError, match="must be below"):
        from_mapping(ReceiveSettings, {"detect": settings})


def test_settings_can_be_keys() -> None:
    one, other = (from_mapping(ReceiveSettings, {"receiver": "mine", "custom": {"frames": k}}) for k in (3, 3))
    assert {one: 1}[other] == 1
