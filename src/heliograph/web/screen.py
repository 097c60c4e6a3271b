"""The link of a screen and a phone: settings on which pages *Transmit* and *Receive* agree by size and rate alone."""

from collections.abc import Mapping
from typing import Any

from heliograph.link.settings import LinkSettings, load_settings
from heliograph.signal.formats import SHORT_PAIRS

LEAST_RATE_HZ, MOST_RATE_HZ = 0.5, 240.0
"""Patterns a second that the pages take: from remote desktops to the fastest displays."""

PRESET = "phone"

SMALL_SIDE, SMALL = 8, {"data_pairs": 2 * SHORT_PAIRS, "rate": {"high": 2 / 3, "middle": 2 / 3, "low": 2 / 3}}
"""Packets of 8 x 8 cells: of the short mode they would have no room for a symbol of a file below the rate 9/10."""


def screen_settings(side: int, rate_hz: float) -> LinkSettings:
    """Return the settings of a screen's light, and of the receiver of its films.

    Parameters
    ----------
    side
        Cells in a row and in a column, one of `probe.cells.SIDES`.
    rate_hz
        Patterns a second, `LEAST_RATE_HZ` to `MOST_RATE_HZ`.

    Raises
    ------
    SettingsError
        They are out of range.
    """
    signal: dict[str, Any] = {"side": side, "pattern_period_s": 1 / rate_hz}
    over: dict[str, Mapping[str, Any]] = {"signal": signal}
    if side == SMALL_SIDE:
        over = {"signal": {**signal, **SMALL}, "transmit": {"formats": [{}]}}
    return load_settings(PRESET, over)
