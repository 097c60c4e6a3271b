"""Link settings: a tree with named presets, TOML and key=value overrides."""

from collections.abc import Iterable, Mapping
from difflib import get_close_matches
from typing import Any

from pydantic import model_validator
from pydantic.dataclasses import dataclass

from heliograph.base.config import CONFIG, clear_errors, from_mapping, merge, to_mapping
from heliograph.base.errors import SettingsError, shown
from heliograph.base.toml_text import parse_assignment
from heliograph.channel.settings import ChannelSettings
from heliograph.receive.settings import ReceiveSettings
from heliograph.signal.formats import SHORT_PAIRS
from heliograph.signal.settings import SignalSettings
from heliograph.transmit import TransmitSettings

MAX_UNSEEN = 1_000_000
"""Maximum number of patterns before the first frame or between frames; all are computed."""


@clear_errors
@dataclass(frozen=True, kw_only=True, config=CONFIG)
class LinkSettings:
    """Settings of the link; the defaults are the reference link.

    Attributes
    ----------
    signal
        Signal settings of transmitter and receiver.
    transmit
        Transmitters: identity of each array and packet formats.
    channel
        Scene, vehicle and camera of the simulation.
    receive
        The receiver, independent of `channel`.
    """

    signal: SignalSettings = SignalSettings()
    transmit: TransmitSettings = TransmitSettings()
    channel: ChannelSettings = ChannelSettings()
    receive: ReceiveSettings = ReceiveSettings()

    @model_validator(mode="after")
    def _consistent(self) -> "LinkSettings":
        arrays, identities = len(self.channel.arrays), self.transmit.identities
        if len(identities) != arrays:
            raise ValueError(
                f"transmit.identities must name an identity for each array: {arrays} in channel.arrays, "
                f"{len(identities)} identities {list(identities)}"
            )
        if len(set(identities)) != arrays:
            raise ValueError(f"transmit.identities must differ, not {list(identities)}")
        camera, period_s = self.channel.camera, self.signal.pattern_period_s
        for k, place in enumerate(self.channel.arrays):
            unseen = (camera.start_s - place.start_s) / period_s
            if unseen > MAX_UNSEEN:
                raise ValueError(
                    f"array {k} shows {unseen:.4g} patterns before the first frame, at most {MAX_UNSEEN:g}; raise "
                    f"channel.arrays.{k}.start_s or signal.pattern_period_s, or lower channel.camera.start_s"
                )
        if camera.frame_period_s / period_s > MAX_UNSEEN:
            raise ValueError(
                f"an array shows {camera.frame_period_s / period_s:.4g} patterns from frame to frame, at most "
                f"{MAX_UNSEEN:g}; raise channel.camera.fps or signal.pattern_period_s"
            )
        return self


def _phone(fps: int, patterns: int, height: int = 720) -> dict[str, Any]:
    """Return settings for a screen as transmitter and a handheld phone as receiver."""
    width = 16 * height // 9
    return {
        "signal": {"pattern_period_s": 1 / patterns, "data_pairs": SHORT_PAIRS, "light": "steady"},
        "transmit": {"formats": [{"mode": "short", "high": 1 / 2, "middle": 1 / 2, "low": 1 / 2}]},
        "channel": {
            "distance_m": 1.0,
            "speed_m_s": 0.0,
            "duration_s": 10.0,
            "shake": "hand",
            "arrays": [{"x_m": 0.0, "y_m": 0.0, "yaw_deg": 10.0, "pitch_deg": -5.0, "roll_deg": 2.0}],
            "camera": {
                "fps": fps,
                "exposure_s": 0.5 / fps,
                "start_s": 0.0123,
                "width": width,
                "height": height,
                "focal_m": 0.004,
                "pixel_m": 0.004 / (0.75 * width),
                "blur_px": 0.8,
                "clock_ppm": 30.0,
                "jitter_s": 0.0005,
                "row_time_s": min(0.02, 0.9 / fps) / height,
                "gain_swing": 0.1,
                "white_balance_swing": 0.1,
            },
            "emitter": {
                "pitch_m": 0.02,
                "shape": "cell",
                "response_s": 0.005,
                "all_on": 0.8,
                "panel_level": 0.02,
                "panel_margin_m": 0.04,
                "colour": [0.9, 1.0, 1.25],
            },
            "sensor": {"gamma": 2.2, "full_well_e": 6000.0, "dark_noise_e": 5.0},
            "background": {"kind": "flat", "level": 0.1, "colour": [1.3, 1.0, 0.6]},
        },
        "receive": {"receiver": "screen", "calibration": {"pixel_m": 0.004 / (0.75 * width), "focal_m": 0.004}},
    }


PRESETS: Mapping[str, tuple[str, Mapping[str, Any]]] = {
    "paper": ("The driving trial of Nagura et al. 2010: 80 m to 25 m at 30 km/h, road of class B", {}),
    "static": (
        "The paper's camera at rest, 50 m away, for 1 s",
        {"channel": {"distance_m": 50.0, "speed_m_s": 0.0, "duration_s": 1.0, "shake": "none"}},
    ),
    "motorway": (
        "The driving trial at 100 km/h, from 120 m on, road of class A",
        {"channel": {"distance_m": 120.0, "speed_m_s": 27.78, "road_class": "A"}},
    ),
    "night": (
        "The driving trial by night: dark background, LEDs four times dimmer",
        {"channel": {"background": {"level": 0.0}, "emitter": {"panel_level": 0.0, "all_on": 0.2}}},
    ),
    "two-arrays": (
        "The driving trial with two arrays of different identities side by side",
        {
            "transmit": {"identities": [0, 7]},
            "channel": {"arrays": [{"x_m": 1.5, "y_m": -1.0}, {"x_m": -1.5, "y_m": -0.8, "start_s": 0.0373}]},
        },
    ),
    "phone": ("A screen filmed by a phone in a hand: 10 patterns/s at 30 frames/s", _phone(30, 10)),
    "phone-15": ("The same at 15 patterns/s", _phone(30, 15)),
    "phone-60": ("The same at 30 patterns/s and 60 frames/s", _phone(60, 30)),
    "phone-240": ("The same at 60 patterns/s and 240 frames/s", _phone(240, 60)),
    "phone-slow": ("The same at 2 patterns/s, for slow displays and remote desktops", _phone(30, 2)),
    "crossing": (
        "A camera passes an array, turned by 20 degrees, 25 m away at 25 km/h",
        {
            "channel": {
                "distance_m": 25.0,
                "speed_m_s": 0.0,
                "shake": "none",
                "duration_s": 1.18,
                "arrays": [{"x_m": -4.1, "y_m": 0.0, "vx_m_s": 6.94, "yaw_deg": 20.0}],
            }
        },
    ),
}
"""Presets by name: description, and changes to the reference link."""


def preset(name: str) -> dict[str, Any]:
    """Return the changes of a preset to the defaults."""
    if name not in PRESETS:
        close = get_close_matches(name, PRESETS, 1)
        hint = f"did you mean '{close[0]}'?" if close else f"there are {', '.join(PRESETS)}"
        raise SettingsError(f"unknown preset '{name}'; {hint}")
    return dict(PRESETS[name][1])


def load_settings(
    name: str = "paper", over: Mapping[str, Any] | None = None, assignments: Iterable[str] = ()
) -> LinkSettings:
    """Load a preset and apply a mapping (from TOML) and then ``key=value`` texts.

    Parameters
    ----------
    name
        Name of the preset, one of `PRESETS`.
    over
        Nested mapping of changes.
    assignments
        Texts such as ``"channel.distance_m=60"`` or ``"channel.arrays.0.x_m=2"``.

    Raises
    ------
    SettingsError
        A preset or key is unknown, a value is wrong or out of range, or an argument has the wrong type.
    """
    if not isinstance(name, str):
        raise SettingsError(f"a preset is one of {', '.join(PRESETS)}, not {shown(name)}")
    if not isinstance(over, Mapping | None):
        raise SettingsError(f'changes are nested mappings, such as {{"signal": {{"side": 8}}}}, not {shown(over)}')
    if isinstance(assignments, str) or not isinstance(assignments, Iterable):
        raise SettingsError(f'assignments are a list, such as ["signal.side=8"], not {shown(assignments)}')
    tree = merge(to_mapping(LinkSettings()), preset(name))
    for change in [over or {}, *map(parse_assignment, assignments)]:
        tree = merge(tree, change)
    return from_mapping(LinkSettings, tree)
