"""What a sweep varies: ``key=1,2,3`` and ``key=25:120:5`` to values, and their grid to settings."""

import itertools
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from decimal import Decimal
from typing import Any

from heliograph.base.config import merge, parse_assignment
from heliograph.base.errors import SettingsError
from heliograph.link.settings import LinkSettings, load_settings

SHORT = {"receiver": "receive.receiver"}
"""Short names of keys."""

MOST = 10_000
"""Most values of a range, and most points of a grid: more is a slip of the pen."""

_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_RANGE = re.compile(rf"\s*({_NUMBER})\s*:\s*({_NUMBER})(?:\s*:\s*({_NUMBER}))?\s*")


def parse_vary(text: str) -> tuple[str, list[Any]]:
    """Turn ``key=value,value,...`` into key and values; a value may be a range first:last:step.

    Raises
    ------
    SettingsError
        There is no key or no value, or a range has no end.
    """
    key, sign, values = text.partition("=")
    if not sign or not key.strip() or not values.strip():
        raise SettingsError(f"'{text}' varies nothing; write key=value,value or key=first:last:step")
    return key.strip(), [value for part in _parts(values) for value in _values(part, text)]


def grid(vary: Mapping[str, Sequence[Any]]) -> list[dict[str, Any]]:
    """All combinations of the values of each key, the last key fastest; one empty one where nothing varies.

    Raises
    ------
    SettingsError
        A key has no values or one twice, or there are too many combinations.
    """
    size = 1
    for key, values in vary.items():
        _check_values(key, values)
        size *= len(values)
        if size > MOST:
            raise SettingsError(f"a sweep has at most {MOST} points; take a larger step or fewer keys")
    return [dict(zip(vary, values, strict=True)) for values in itertools.product(*vary.values())]


def varied(preset: str, over: Mapping[str, Any], choice: Mapping[str, Any]) -> LinkSettings:
    """Settings of a preset with `over` laid on it and then a point's `choice` of dotted keys.

    Raises
    ------
    SettingsError
        A preset or key is unknown, a value wrong or out of range.
    """
    name = choice.get("preset", preset)
    for key, value in choice.items():
        if key != "preset":
            over = merge(over, nested(SHORT.get(key, key), value))
    return load_settings(str(name), over)


def nested(key: str, value: Any) -> Any:
    """A value under a dotted key as nested mappings."""
    parse_assignment(f"{key}=0")  # names what is wrong with a key
    for part in reversed(key.split(".")):
        value = {part.strip(): value}
    return value


def _check_values(key: str, values: Sequence[Any]) -> None:
    if isinstance(values, str) or not len(values):
        raise SettingsError(f"'{key}' varies over a list of values, not {values!r}")
    doubled = [value for i, value in enumerate(values) if value in list(values)[:i]]
    if doubled:
        raise SettingsError(f"'{key}' has the value {doubled[0]!r} twice")


def _parts(text: str) -> Iterator[str]:
    """Cut at commas that stand in no bracket and no quotes."""
    depth, quote, start = 0, "", 0
    for i, letter in enumerate(text):
        if quote or letter in "\"'":
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
        yield _value(part.strip())
    else:
        raise SettingsError(f"'{text}' has an empty value between its commas")


def _range(first: str, last: str, step: str, text: str) -> Iterator[int | float]:
    """First to last, which is one of them where a step hits it."""
    # decimals, so that 0.1:0.3:0.1 hits its end
    a, b, h = map(Decimal, (first, last, step))
    if not h or (b - a) / h < 0:
        raise SettingsError(f"'{text}': a range is first:last:step, and the step leads from first to last")
    if (b - a) / h >= MOST:
        raise SettingsError(f"'{text}' has more than {MOST} values; take a larger step")
    for i in range(int((b - a) / h) + 1):
        value = a + i * h
        yield int(value) if all(x == x.to_integral_value() for x in (a, h)) else float(value)


def _value(text: str) -> Any:
    try:
        return tomllib.loads(f"v = {text}")["v"]
    except tomllib.TOMLDecodeError:
        return text
