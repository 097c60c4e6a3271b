"""Points of a sweep from fixed and varied settings, checked before the computation."""

import itertools
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from decimal import Decimal
from numbers import Integral
from pathlib import Path
from typing import Any

from heliograph.base.config import merge
from heliograph.base.errors import SettingsError, brief, shown
from heliograph.base.toml_text import parse_assignment, parse_value
from heliograph.link.settings import LinkSettings, load_settings
from heliograph.link.simulate import load_footage, load_imu, transmitters
from heliograph.receive.detect.alternation import size_limits
from heliograph.receive.registry import RECEIVERS
from heliograph.sweeps.points import Point, Recorded

SHORT = {"receiver": "receive.receiver"}
"""Short names of keys."""

MOST = 10_000
"""Most values of a key, and most points of a grid: more is a slip of the pen."""

MOST_DIGITS = 30
"""Most digits of a range's number before the point, and zeros after it: no setting has more."""

# each digit has one place in it: a long row of digits with two places would be tried in quadratic time
_NUMBER = r"[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?"
_RANGE = re.compile(rf"\s*({_NUMBER})\s*:\s*({_NUMBER})(?:\s*:\s*({_NUMBER}))?\s*")


def parse_vary(text: str) -> tuple[str, list[Any]]:
    """Turn ``key=value,value,...`` into key and values."""
    key, sign, values = text.partition("=")
    if not sign or not key.strip() or not values.strip():
        raise SettingsError(f"'{brief(text)}' varies nothing; write key=value,value or key=first:last:step")
    return key.strip(), _few(key.strip(), (value for part in _parts(values) for value in _values(part, text)))


def grid(vary: Mapping[str, Iterable[Any]]) -> list[dict[str, Any]]:
    """All combinations of the values of each key, the last key fastest; one empty one where nothing varies."""
    plain = listed(vary)
    if math.prod(map(len, plain.values())) > MOST:
        raise SettingsError(f"a sweep has at most {MOST} points; take a larger step or fewer keys")
    return [dict(zip(plain, values, strict=True)) for values in itertools.product(*plain.values())]


def listed(vary: Mapping[str, Iterable[Any]]) -> dict[str, list[Any]]:
    """Values of each key as a list, those of NumPy as Python's, which settings and JSON accept."""
    if not isinstance(vary, Mapping):
        raise SettingsError(f'a sweep varies lists, such as {{"channel.distance_m": [40, 60]}}, not {shown(vary)}')
    for key in vary:
        _check_key(key)
    doubled = [short for short, key in SHORT.items() if short in vary and key in vary]
    if doubled:
        raise SettingsError(f"'{doubled[0]}' is short for '{SHORT[doubled[0]]}', which varies as well")
    return {key: _plain(key, values) for key, values in vary.items()}


def varied(preset: str, over: Mapping[str, Any], choice: Mapping[str, Any]) -> LinkSettings:
    """Settings of a point."""
    name = choice.get("preset", preset)
    for key, value in choice.items():
        if key != "preset":
            over = merge(over, nested(SHORT.get(key, key), value))
    return load_settings(str(name), over)


def nested(key: str, value: Any) -> Any:
    """A value under a dotted key as nested mappings."""
    _check_key(key)
    parse_assignment(f"{key}=0")  # names what is wrong with a key
    for part in reversed(key.split(".")):
        value = {part.strip(): value}
    return value


def _check_key(key: object) -> None:
    if not isinstance(key, str):
        raise SettingsError(f"a key is text, such as 'channel.distance_m', not {shown(key)}")


def _plain(key: str, values: Any) -> list[Any]:
    if hasattr(values, "tolist"):
        values = values.tolist()
    if isinstance(values, (str, bytes, Mapping)) or not isinstance(values, Iterable):
        raise SettingsError(f"'{brief(key)}' varies over a list of values, not {brief(values)}")
    plain = [value.tolist() if hasattr(value, "tolist") else value for value in _few(key, values)]
    if not plain:
        raise SettingsError(f"'{brief(key)}' varies over a list of values, not an empty one")
    met = set()
    for value in plain:
        known = _hashable(value)
        if known in met:
            raise SettingsError(f"'{brief(key)}' has the value {brief(repr(value))} twice")
        met.add(known)
    return plain


def _few(key: str, values: Iterable[Any]) -> list[Any]:
    """List values, of which no more are made than there may be."""
    few = list(itertools.islice(values, MOST + 1))
    if len(few) > MOST:
        raise SettingsError(f"'{brief(key)}' has more than {MOST} values; take a larger step or fewer values")
    return few


def _hashable(value: Any) -> Any:
    """Return something to be kept in a set, equal for equal values such as 1 and 1.0."""
    if isinstance(value, (list, tuple)):
        return tuple(map(_hashable, value))
    if isinstance(value, Mapping):
        return frozenset((key, _hashable(one)) for key, one in value.items())
    try:
        hash(value)
    except TypeError:
        return repr(value)
    return value


def _parts(text: str) -> Iterator[str]:
    """Cut at commas that stand in no bracket and no quotes."""
    depth, quote, start, escaped = 0, "", 0, False
    for i, letter in enumerate(text):
        if escaped:
            escaped = False
        elif quote == '"' and letter == "\\":
            escaped = True
        elif quote or letter in "\"'":
            quote = "" if letter == quote else quote or letter
        elif letter in "[{":
            depth += 1
        elif letter in "]}":
            depth -= 1
        elif letter == "," and not depth:
            yield text[start:i]
            start = i + 1
    yield text[start:]


def _values(part: str, text: str) -> Iterator[Any]:
    found = _RANGE.fullmatch(part)
    if found:
        first, last, step = found.groups()
        yield from _range(first, last, step or "0", text)
    elif part.strip():
        yield parse_value(part.strip())
    else:
        raise SettingsError(f"'{brief(text)}' has an empty value between its commas")


def _range(first: str, last: str, step: str, text: str) -> Iterator[int | float]:
    """Yield the values from first to last by a step; last is one of them if a step reaches it exactly."""
    # decimals, so that 0.1:0.3:0.1 hits its end
    a, b, h = map(Decimal, (first, last, step))
    if any(x and abs(x.adjusted()) > MOST_DIGITS for x in (a, b, h)):
        raise SettingsError(f"'{brief(text)}': the numbers of a range have at most {MOST_DIGITS} digits")
    if not h or (b - a) / h < 0:
        raise SettingsError(f"'{brief(text)}': a range is first:last:step, and the step leads from first to last")
    if (b - a) / h >= MOST:
        raise SettingsError(f"'{brief(text)}' has more than {MOST} values; take a larger step")
    for i in range(int((b - a) / h) + 1):
        value = a + i * h
        yield int(value) if all(x == x.to_integral_value() for x in (a, h)) else float(value)


NAMED = 3
"""Points that a warning names; the others are counted."""


def not_looked_for(points: Sequence[Point]) -> str:
    """A line about the points whose arrays no receiver looks for; empty where there are none."""
    found = [(point, text) for point in points if (text := _outside(point.settings))]
    if not found:
        return ""
    named = "; ".join(f"{point.text}: {text}" for point, text in found[:NAMED])
    more = f"; and {len(found) - NAMED} more" if len(found) > NAMED else ""
    return (
        f"{len(found)} of {len(points)} points have an array that is not looked for ({named}{more}); change "
        "receive.detect.min_side_px or max_side_px, or the distance"
    )


def sides_px(settings: LinkSettings) -> list[tuple[float, float]]:
    """Smallest and largest side of the arrays' images in px, over the way from the first distance to the last."""
    channel = settings.channel
    length = settings.signal.side * channel.emitter.pitch_m * channel.camera.focal_px
    ways = (channel.distance_m, channel.stop_m) if channel.moves else (channel.distance_m,)
    places = [[way + array.z_offset_m for way in ways] for array in channel.arrays if not array.vz_m_s]
    return [(length / max(way), length / min(way)) for way in places if min(way) > 0]


def _outside(settings: LinkSettings) -> str:
    """The array that the receiver never looks for, and what it looks for; empty where there is none."""
    receive = settings.receive
    if not RECEIVERS.is_built_in(receive.receiver):
        return ""  # it may look for what it likes
    smallest, largest = receive.smallest_side_px, receive.detect.max_side_px
    lowest, highest = size_limits(smallest, largest)
    for least, most in sides_px(settings):
        if most < lowest or least > highest:
            return f"{most:.3g} px a side, looked for are {smallest:g} to {largest:g} px"
    return ""


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
