"""Link settings: a tree with named presets, TOML and key=value overrides."""

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from difflib import get_close_matches
from functools import reduce
from importlib.resources import files
from pathlib import Path
from typing import Any

from pydantic import model_validator
from pydantic.dataclasses import dataclass

from heliograph.base.config import CONFIG, clear_errors, from_mapping, merge
from heliograph.base.errors import MediaError, SettingsError, shown
from heliograph.base.toml_text import parse_assignment
from heliograph.channel.settings import ChannelSettings
from heliograph.link.tables import load_trajectory
from heliograph.receive.settings import ReceiveSettings
from heliograph.signal.settings import SignalSettings
from heliograph.transmit import TransmitSettings

MAX_UNSEEN = 1_000_000  # maximum number of patterns before the first frame or between frames; all are computed


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
            if (unseen := (camera.start_s - place.start_s) / period_s) > MAX_UNSEEN:
                raise ValueError(
                    f"array {k} shows {unseen:.4g} patterns before the first frame, at most {MAX_UNSEEN:g}; raise "
                    f"channel.arrays.{k}.start_s or signal.pattern_period_s, or lower channel.camera.start_s"
                )
        if (unseen := camera.frame_period_s / period_s) > MAX_UNSEEN:
            raise ValueError(
                f"an array shows {unseen:.4g} patterns from frame to frame, at most {MAX_UNSEEN:g}; raise "
                "channel.camera.fps or signal.pattern_period_s"
            )
        return self


def _load_presets() -> dict[str, tuple[str, dict[str, Any]]]:
    """Read ``presets.toml``: description and changes by name, with the changes of a base preset first."""
    presets: dict[str, tuple[str, dict[str, Any]]] = {}
    text = files("heliograph.link").joinpath("presets.toml").read_text(encoding="utf-8")
    for name, changes in tomllib.loads(text).items():
        description, base = changes.pop("description"), changes.pop("base", None)
        presets[name] = description, merge(presets[base][1], changes) if base else changes
    return presets


PRESETS: Mapping[str, tuple[str, Mapping[str, Any]]] = _load_presets()
"""Presets by name: description, and changes to the reference link."""


def list_presets() -> dict[str, str]:
    """Return the presets of `load_settings` with descriptions."""
    return {name: description for name, (description, _) in PRESETS.items()}


def preset(name: str) -> dict[str, Any]:
    """Return the changes of a preset to the defaults."""
    if name not in PRESETS:
        close = get_close_matches(name, PRESETS, 1)
        hint = f"did you mean '{close[0]}'?" if close else f"there are {', '.join(PRESETS)}"
        raise SettingsError(f"unknown preset '{name}'; {hint}")
    return dict(PRESETS[name][1])


def names_receiver(*changes: Mapping[str, Any]) -> bool:
    """Return True if changes of the settings choose or configure a receiver."""
    groups = set[str]().union(*(change.get("receive") or {} for change in changes))
    return bool(groups & {"receiver", "plain", "soft", "screen", "custom"})


def load_settings(
    name: str = "paper", over: Mapping[str, Any] | None = None, assignments: Iterable[str] = ()
) -> LinkSettings:
    """Load a preset and apply a mapping (from TOML) and then ``key=value`` texts.

    The points of a trajectory file, relative to the working directory, become part of the settings.

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
        A preset or key is unknown, a value is wrong or out of range, an argument has the wrong type, or a trajectory
        cannot be read.
    """
    if not isinstance(name, str):
        raise SettingsError(f"a preset is one of {', '.join(PRESETS)}, not {shown(name)}")
    if not isinstance(over, Mapping | None):
        raise SettingsError(f'changes are nested mappings, such as {{"signal": {{"side": 8}}}}, not {shown(over)}')
    if isinstance(assignments, str) or not isinstance(assignments, Iterable):
        raise SettingsError(f'assignments are a list, such as ["signal.side=8"], not {shown(assignments)}')
    changes = [preset(name), over or {}, *map(parse_assignment, assignments)]
    tree = reduce(merge, changes, asdict(LinkSettings()))
    return from_mapping(LinkSettings, {**tree, "channel": _with_trajectories(tree["channel"])})


def _with_trajectories(channel: Any) -> Any:
    """Return the channel with the points of trajectory files in place of their names; invalid trees are unchanged."""
    if not isinstance(channel, Mapping):
        return channel
    arrays = channel.get("arrays")
    if isinstance(arrays, list | tuple):
        arrays = [_with_points(place, f"channel.arrays.{k}") for k, place in enumerate(arrays)]
    return _with_points({**channel, "arrays": arrays}, "channel")


def _with_points(place: Any, key: str) -> Any:
    if not isinstance(place, Mapping) or not isinstance(place.get("trajectory"), str | Path):
        return place
    try:
        return {**place, "trajectory": load_trajectory(Path(place["trajectory"]))}
    except MediaError as error:
        raise SettingsError(f"setting '{key}.trajectory': {error}") from None
