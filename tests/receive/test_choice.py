"""The receiver for a film is chosen by signal and frame rate."""

from dataclasses import replace
from typing import Any

import pytest

from heliograph.receive.api import choose_receiver
from heliograph.signal.settings import SignalSettings


@pytest.mark.parametrize(("changes", "rate_hz", "name"), [
    ({}, 1000, "soft"), ({}, 3700, "soft"), ({}, 985, "soft"), ({}, 970, "plain"), ({}, 500, "plain"),
    ({}, 30, "screen"), ({}, 240, "screen"),
    ({"pattern_period_s": 0.1}, 30, "soft"), ({"pattern_period_s": 0.02}, 30, "screen"),
    ({"modulation": "ook"}, 1000, "plain"), ({"header": "all_on"}, 1000, "plain"),
])  # fmt: skip
def test_choice_follows_signal_and_frame_rate(changes: Any, rate_hz: float, name: str) -> None:
    assert choose_receiver(replace(SignalSettings(), **changes), rate_hz)[0] == name
