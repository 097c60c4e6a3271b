"""Signal settings: rejected values and error messages."""

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import pytest

from heliograph.base.config import from_mapping
from heliograph.base.errors import SettingsError
from heliograph.signal.packet import PacketFormat
from heliograph.signal.settings import LAYERS, MULTIPLICITY, RateSettings, SignalSettings


def test_defaults_are_the_papers_array_in_100_ms() -> None:
    settings = SignalSettings()
    assert (settings.side, settings.pattern_period_s, settings.modulation) == (16, 1e-3, "haar")
    assert settings.packet_patterns == 100
    assert settings.packet_s == pytest.approx(0.1)
    assert (settings.rate, sum(MULTIPLICITY)) == (RateSettings(high=1 / 3, middle=1 / 3, low=1 / 3), 4)
    assert len(LAYERS) == len(MULTIPLICITY) == 3


@pytest.mark.parametrize(("text", "rate"), [
    ("1/3", 1 / 3), ("2/3", 2 / 3), ("0.5", 0.5), (0.333, 0.333), (0.9, 0.9), ("9/10", 0.9),
])  # fmt: skip
def test_rates_may_be_fractions(text: Any, rate: float) -> None:
    settings = from_mapping(SignalSettings, {"rate": {"middle": text}})
    assert from_mapping(SignalSettings, asdict(settings)) == settings
    assert settings.rate.middle == pytest.approx(rate)


@pytest.mark.parametrize(("name", "values", "words"), [
    ("side", (18, 0, 132), "side"), ("pattern_period_s", (0.0, math.nan, math.inf), "pattern_period_s"),
    ("slot_order", ((0, 1, 2, 2), (0, 1, 2)), "permutation of 0 to 3"), ("header_pairs", (0,), "header_pairs"),
    ("data_pairs", (0, 4097), "data_pairs"), ("modulation", ("qam",), "modulation"),
    # 1e400 overflows float; Python raises a different exception
    ("rate", [{"high": rate} for rate in (0.3, 0.95, "1/0", "one third", "1e400")], r"rate\.high"),
    ("rates", ({"high": 0.5},), "unknown setting 'rates'; did you mean"),
])  # fmt: skip
def test_refused_in_one_line(name: str, values: Sequence[Any], words: str) -> None:
    for value in values:
        with pytest.raises(SettingsError, match=words) as caught:
            from_mapping(SignalSettings, {name: value})
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("side", [4, 8, 20, 64])
@pytest.mark.parametrize("rate", [1 / 3, 0.9])
def test_accepted_settings_make_a_format_or_name_the_setting_to_raise(side: int, rate: float) -> None:
    for pairs in [*range(1, 60, 2), 127, 1000, 4093, 4096]:
        settings = SignalSettings(side=side, data_pairs=pairs, rate=RateSettings(high=rate, middle=rate, low=rate))
        try:
            layers = PacketFormat(settings).layers
        except SettingsError as error:
            # a block with 104 bits needs 116 bits at rate 9/10
            assert "raise signal.data_pairs or the rate" in str(error)  # noqa: PT017  # either outcome is right
            assert (side // 2) ** 2 * pairs * rate < 108.1
        else:
            assert all(layer.code.k >= 104 for layer in layers.values())
