"""Points of a sweep from fixed and varied settings, validated before the computation."""

import itertools
import math
import re
from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from decimal import Decimal
from functools import reduce
from numbers import Integral
from pathlib import Path
from typing import Any

from heliograph.base.config import merge
from heliograph.base.errors import SettingsError, brief, shown
from heliograph.base.toml_text import parse_assignment, parse_value
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import load_footage, load_imu, transmitters
from heliograph.receive.detect.alternation import size_limits
from heliograph.receive.registry import RECEIVERS, is_bound
from heliograph.sweeps.points import Point, Recorded

MAX_VALUES = 10_000  # maximum number of values of a key, and of points in a grid

# unambiguous in each digit, for linear matching time
_NUMBER = r"[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?"
_RANGE = re.compile(rf"\s*({_NUMBER})\s*:\s*({_NUMBER})(?:\s*:\s*({_NUMBER}))?\s*")


def parse_vary(text: str) -> tuple[str, list[Any]]:
    """Parse ``key=value,value,...`` into key and values."""
    key, sign, values = text.partition("=")
    if not sign or not key.strip() or not values.strip():
        raise SettingsError(f"'{brief(text)}' varies nothing; write key=value,value or key=first:last:step")
    parsed = (value for part in _split(values) for value in _parse_values(part, text))
    return key.strip(), _limited(key.strip(), parsed)


def parse_vary_options(texts: Iterable[str] | None) -> dict[str, list[Any]]:
    """Return the values of varied settings by key."""
    vary: dict[str, list[Any]] = {}
    for key, values in map(parse_vary, texts or ()):
        if key in vary:
            raise SettingsError(f"'{key}' is varied twice; write its values in one --vary")
        vary[key] = values
    return vary


def grid(vary: Mapping[str, Iterable[Any]]) -> list[dict[str, Any]]:
    """Return all combinations of the values, the last key fastest; an empty combination for an empty grid."""
    lists = value_lists(vary)
    if math.prod(map(len, lists.values())) > MAX_VALUES:
        raise SettingsError(f"a sweep has at most {MAX_VALUES} points; take a larger step or fewer keys")
    return [dict(zip(lists, values, strict=True)) for values in itertools.product(*lists.values())]


def value_lists(vary: Mapping[str, Iterable[Any]]) -> dict[str, list[Any]]:
    """Return the values of each key as a list of plain Python values."""
    if not isinstance(vary, Mapping):
        raise SettingsError(f'a sweep varies lists, such as {{"channel.distance_m": [40, 60]}}, not {shown(vary)}')
    for key in vary:
        _check_key(key)
    if {"receiver", "receive.receiver"} <= vary.keys():
        raise SettingsError("'receiver' is short for 'receive.receiver', which varies as well")
    return {key: _plain(key, values) for key, values in vary.items()}


def varied(preset: str, over: Mapping[str, Any], choice: Mapping[str, Any]) -> LinkSettings:
    """Return the settings of a point."""
    changes = {"receive.receiver" if key == "receiver" else key: value for key, value in choice.items()}
    preset = str(changes.pop("preset", preset))
    return load_settings(preset, merge(over, merge_changes(changes)))


def nested(key: str, value: Any) -> Any:
    """Return a value under a dotted key as nested mappings."""
    _check_key(key)
    parse_assignment(f"{key}=0")  # reports invalid keys
    return reduce(lambda tree, part: {part.strip(): tree}, reversed(key.split(".")), value)


def _check_key(key: object) -> None:
    if not isinstance(key, str):
        raise SettingsError(f"a key is text, such as 'channel.distance_m', not {shown(key)}")


def _plain(key: str, values: Any) -> list[Any]:
    if hasattr(values, "tolist"):
        values = values.tolist()
    if isinstance(values, (str, bytes, Mapping)) or not isinstance(values, Iterable):
        raise SettingsError(f"'{brief(key)}' varies over a list of values, not {brief(values)}")
    plain = [value.tolist() if hasattr(value, "tolist") else value for value in _limited(key, values)]
    if not plain:
        raise SettingsError(f"'{brief(key)}' varies over a list of values, not an empty one")
    known = set()
    for value in plain:
        if (item := _hashable(value)) in known:
            raise SettingsError(f"'{brief(key)}' has the value {brief(repr(value))} twice")
        known.add(item)
    return plain


def _limited(key: str, values: Iterable[Any]) -> list[Any]:
    """Return at most MAX_VALUES values as a list."""
    out = list(itertools.islice(values, MAX_VALUES + 1))
    if len(out) > MAX_VALUES:
        raise SettingsError(f"'{brief(key)}' has more than {MAX_VALUES} values; take a larger step or fewer values")
    return out


def _hashable(value: Any) -> Any:
    """Return a hashable substitute, equal for equal values such as 1 and 1.0."""
    if isinstance(value, (list, tuple)):
        return tuple(map(_hashable, value))
    if isinstance(value, Mapping):
        return frozenset((key, _hashable(item)) for key, item in value.items())
    return value if isinstance(value, Hashable) else repr(value)


def _split(text: str) -> Iterator[str]:
    """Split at commas outside brackets and quotes."""
    depth, start = 0, 0
    for token in re.finditer(r"""[][{},]|"(?:\\.|[^"\\])*+"?|'[^']*+'?""", text, re.DOTALL):
        depth += (token[0] in "[{") - (token[0] in "]}")
        if token[0] == "," and not depth:
            yield text[start : token.start()]
            start = token.end()
    yield text[start:]


def _parse_values(part: str, text: str) -> Iterator[Any]:
    if found := _RANGE.fullmatch(part):
        first, last, step = found.groups()
        yield from _range(first, last, step or "0", text)
    elif part.strip():
        yield parse_value(part.strip())
    else:
        raise SettingsError(f"'{brief(text)}' has an empty value between its commas")


def _range(first: str, last: str, step: str, text: str) -> Iterator[int | float]:
    """Yield the values from first to last; last is included if a step reaches the value exactly."""
    # decimals represent 0.1:0.3:0.1 exactly
    a, b, h = map(Decimal, (first, last, step))
    if any(x and abs(x.adjusted()) > 30 for x in (a, b, h)):
        raise SettingsError(f"'{brief(text)}': the numbers of a range have at most 30 digits")
    if not h or (b - a) / h < 0:
        raise SettingsError(f"'{brief(text)}': a range is first:last:step, and the step leads from first to last")
    if (b - a) / h >= MAX_VALUES:
        raise SettingsError(f"'{brief(text)}' has more than {MAX_VALUES} values; take a larger step")
    for i in range(int((b - a) / h) + 1):
        value = a + i * h
        yield int(value) if all(x == x.to_integral_value() for x in (a, h)) else float(value)


def size_warning(points: Sequence[Point]) -> str:
    """Return a warning about points with arrays outside the size range of the receiver, or an empty text."""
    excluded = [f"{point.text}: {text}" for point in points if (text := _size_conflict(point.settings))]
    if not excluded:
        return ""
    named = "; ".join(excluded[:3])
    more = f"; and {len(excluded) - 3} more" if len(excluded) > 3 else ""
    return (
        f"{len(excluded)} of {len(points)} points have an array outside the detection range ({named}{more}); change "
        "receive.detect.min_side_px or max_side_px, or the distance"
    )


def _size_conflict(settings: LinkSettings) -> str:
    """Return the image side of an array outside the size range of the receiver, or an empty text."""
    receive, channel = settings.receive, settings.channel
    if receive.receiver not in RECEIVERS.built_in or is_bound(receive.receiver):
        return ""
    smallest, largest = receive.smallest_side_px, receive.detect.max_side_px
    lowest, highest = size_limits(smallest, largest)
    side = settings.signal.side * channel.emitter.pitch_m * channel.camera.focal_px  # px at 1 m
    ends = (channel.distance_m, channel.stop_m) if channel.moves else (channel.distance_m,)
    for array in channel.arrays:
        distances = [end + array.z_offset_m for end in ends]
        if channel.trajectories or array.vz_m_s or min(distances) <= 0:
            continue
        if side / min(distances) < lowest or side / max(distances) > highest:
            return f"{side / min(distances):.3g} px a side, the receiver detects {smallest:g} to {largest:g} px"
    return ""


def plan(
    vary: Mapping[str, Iterable[Any]],
    preset: str = "static",
    over: Mapping[str, Any] | None = None,
    seed: int = 0,
    background: Path | None = None,
    imu: Path | None = None,
) -> list[Point]:
    """Return the validated points of a sweep."""
    if not isinstance(seed, Integral) or not 0 <= seed < 2**63:
        raise SettingsError(f"the seed is a whole number from 0 to 2^63 - 1, not {shown(seed)}")
    recordings, channel_changes = {}, dict[str, Any]()
    if background is not None:
        load_footage(background)
        recordings["footage"] = Recorded.of(background)
        channel_changes["background"] = {"kind": "footage"}
    if imu is not None:
        load_imu(imu)
        recordings["imu"] = Recorded.of(imu)
        channel_changes["shake"] = "imu"
    tree = merge({"channel": channel_changes}, over or {})
    points = []
    for choice in grid(vary):
        try:
            settings = varied(preset, tree, choice)
        except SettingsError as error:
            position = ", ".join(f"{key}={value}" for key, value in choice.items())
            raise SettingsError(f"{error} (at {position})" if position else str(error)) from None
        channel = settings.channel
        if channel.background.kind == "footage" and "footage" not in recordings:
            raise SettingsError("channel.background.kind=footage needs a recording: give it by --background VIDEO")
        if channel.shake == "imu" and "imu" not in recordings:
            raise SettingsError("channel.shake=imu needs a recording: give it by --imu CSV")
        transmitters(settings, [{} for _ in settings.transmit.identities])  # checks the packet size
        points.append(Point(choice, settings, int(seed), recordings))
    return points


def merge_changes(changes: Mapping[str, Any] | Sequence[str]) -> Mapping[str, Any]:
    """Return changes of settings, by key or as texts, as a nested mapping."""
    if isinstance(changes, Mapping):
        parts = [nested(key, value) for key, value in changes.items()]
    elif isinstance(changes, Iterable):
        parts = [parse_assignment(text) for text in ([changes] if isinstance(changes, str) else changes)]
    else:
        raise SettingsError(f'changes are values by key, such as {{"signal.side": 8}}, not {shown(changes)}')
    return reduce(merge, parts, {})
