"""The link of a screen and a phone: settings on which pages *Transmit* and *Receive* agree by size and rate alone."""

from collections.abc import Mapping
from typing import Any

from heliograph.link.settings import LinkSettings, load_settings
from heliograph.signal.settings import LAYERS

LEAST_RATE_HZ, MOST_RATE_HZ = 0.5, 240.0
"""Patterns a second that the pages take: from remote desktops to the fastest displays."""

PRESET = "phone"

SMALL_SIDE, SMALL_RATE = 8, 3 / 4
"""Rate of packets of 8 x 8 cells: at 1/2 a codeword holds four bytes of a file, at 3/4 ten. Chosen: of a screen nearby
the cells' noise is small."""


def screen_settings(side: int, rate_hz: float) -> LinkSettings:
    """Return the settings of a screen's light, and of the receiver of its films."""
    signal: dict[str, Any] = {"side": side, "pattern_period_s": 1 / rate_hz}
    over: dict[str, Mapping[str, Any]] = {"signal": signal}
    if side == SMALL_SIDE:
        over["transmit"] = {"formats": [{"mode": "short", **dict.fromkeys(LAYERS, SMALL_RATE)}]}
    return load_settings(PRESET, over)
