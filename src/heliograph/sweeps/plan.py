"""The points of a sweep from what varies and what does not, checked before anything is computed."""

from collections.abc import Iterable, Mapping, Sequence
from numbers import Integral
from pathlib import Path
from typing import Any

from heliograph.base.config import merge
from heliograph.base.errors import SettingsError, shown
from heliograph.base.toml_text import parse_assignment
from heliograph.link.recordings import load_footage, load_imu
from heliograph.link.settings import LinkSettings
from heliograph.link.simulate import transmitters
from heliograph.sweeps.points import Point, Recorded
from heliograph.sweeps.vary import grid, nested, varied


def plan(
    vary: Mapping[str, Iterable[Any]],
    preset: str = "static",
    over: Mapping[str, Any] | None = None,
    seed: int = 0,
    background: Path | None = None,
    imu: Path | None = None,
) -> list[Point]:
    """Points of a sweep, all of them checked."""
    if not isinstance(seed, Integral) or not 0 <= seed < 2**63:
        raise SettingsError(f"the seed is a whole number from 0 to 2^63 - 1, not {shown(seed)}")
    recordings = _recordings(background, imu)
    use: dict[str, Any] = {"channel": {"background": {"kind": "footage"}}} if background else {}
    use = merge(use, {"channel": {"shake": "imu"}} if imu else {})
    tree = merge(use, over or {})
    return [_point(choice, _settings(choice, preset, tree), int(seed), recordings) for choice in grid(vary)]


def laid_over(changes: Mapping[str, Any] | Sequence[str]) -> Mapping[str, Any]:
    """Changes of settings as one nested mapping."""
    if isinstance(changes, str):
        changes = [changes]
    if isinstance(changes, Mapping):
        parts = [nested(key, value) for key, value in changes.items()]
    elif not isinstance(changes, Iterable):
        raise SettingsError(f'changes are values by key, such as {{"signal.side": 8}}, not {shown(changes)}')
    else:
        parts = [parse_assignment(text) for text in changes]
    tree: Any = {}
    for part in parts:
        tree = merge(tree, part)
    return tree


def _settings(choice: Mapping[str, Any], preset: str, over: Mapping[str, Any]) -> LinkSettings:
    """Settings of a point; an error names the point where it is one of several."""
    try:
        return varied(preset, over, choice)
    except SettingsError as error:
        where = ", ".join(f"{key}={value}" for key, value in choice.items())
        raise SettingsError(f"{error} (at {where})" if where else str(error)) from None


def _point(choice: Mapping[str, Any], settings: LinkSettings, seed: int, recordings: Mapping[str, Recorded]) -> Point:
    channel = settings.channel
    if channel.background.kind == "footage" and "footage" not in recordings:
        raise SettingsError("channel.background.kind=footage needs a recording: give it by --background VIDEO")
    if channel.shake == "imu" and "imu" not in recordings:
        raise SettingsError("channel.shake=imu needs a recording: give it by --imu CSV")
    transmitters(settings, [{} for _ in settings.transmit.identities])  # a packet may be too small for a codeword
    return Point(choice, settings, seed, recordings)


def _recordings(background: Path | None, imu: Path | None) -> dict[str, Recorded]:
    """Recordings with their digests, once it is known that they can be read."""
    found = {}
    for name, path, load in (("footage", background, load_footage), ("imu", imu, load_imu)):
        if path is not None:
            load(path)
            found[name] = Recorded.of(path)
    return found
