"""Settings as frozen, checked dataclasses; text from TOML or a command line turned into them.

A settings class is a ``pydantic.dataclasses.dataclass(frozen=True, kw_only=True, config=CONFIG)``: its
fields are checked when it is made. This module is the edge: it merges mappings, reads ``key=value``
text, and turns what pydantic says into one line that names the rule, the value met and the nearest key.
"""

import difflib
import json
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, fields, is_dataclass
from typing import Any, TypeVar, get_args

from pydantic import ConfigDict, TypeAdapter, ValidationError

from heliograph.base.errors import SettingsError

CONFIG = ConfigDict(extra="forbid", allow_inf_nan=False)

T = TypeVar("T")


def from_mapping(cls: type[T], mapping: Mapping[str, Any]) -> T:
    """Make settings of class `cls` from nested mappings.

    Raises
    ------
    SettingsError
        A key is unknown or a value is of the wrong type or out of range.
    """
    try:
        return TypeAdapter(cls).validate_python(dict(mapping) if isinstance(mapping, Mapping) else mapping)
    except ValidationError as error:
        raise SettingsError(_one_line(error, cls)) from None


def to_mapping(settings: Any) -> dict[str, Any]:
    """Nested dictionaries of plain values, the inverse of `from_mapping`."""
    return asdict(settings)


def parse_toml(text: str) -> dict[str, Any]:
    """Parse TOML text; a syntax error becomes a SettingsError with its line."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise SettingsError(f"not valid TOML: {error}") from None


def parse_assignment(text: str) -> dict[str, Any]:
    """Turn ``a.b=3`` into ``{"a": {"b": 3}}``; a value is read as TOML, else as bare text."""
    key, sign, value = text.partition("=")
    path = [part.strip() for part in key.split(".")]
    if not sign or not all(path):
        raise SettingsError(f"'{text}' is not an assignment; write key=value, such as channel.distance_m=60")
    leaf = _leaf(value)
    for part in reversed(path):
        leaf = {part: leaf}
    return leaf


def _leaf(text: str) -> Any:
    try:
        found = tomllib.loads(f"v = {text}")
    except tomllib.TOMLDecodeError:
        return text.strip()
    return found["v"] if len(found) == 1 else text.strip()  # a second line may hold a second key


def merge(base: Any, over: Any) -> Any:
    """`over` laid on `base`: mappings merge by key, a list takes changes by index, the rest is replaced."""
    if isinstance(base, Mapping) and isinstance(over, Mapping):
        return {**base, **{key: merge(base.get(key), value) for key, value in over.items()}}
    if isinstance(base, Sequence) and not isinstance(base, str) and isinstance(over, Mapping):
        return _merge_items(base, over)
    return over


def keys_of(cls: type) -> Iterator[str]:
    """All dotted keys of a settings class, leaves only; a list of settings by its item 0."""
    for field in fields(cls):
        items = [kind for kind in get_args(field.type) if isinstance(kind, type) and is_dataclass(kind)]
        if isinstance(field.type, type) and is_dataclass(field.type):
            yield from (f"{field.name}.{key}" for key in keys_of(field.type))
        elif items:
            yield from (f"{field.name}.0.{key}" for key in keys_of(items[0]))
        else:
            yield field.name


def to_toml(mapping: Mapping[str, Any], prefix: str = "") -> str:
    """Write nested mappings of plain values as TOML; None is left out."""
    tables = {k: v for k, v in mapping.items() if _is_table(v)}
    lines = [f"{k} = {_toml_value(v)}" for k, v in mapping.items() if k not in tables and v is not None]
    for key, value in tables.items():
        name = f"{prefix}{key}"
        parts = [value] if isinstance(value, Mapping) else value
        mark = "[{}]" if isinstance(value, Mapping) else "[[{}]]"
        lines += [f"\n{mark.format(name)}\n{to_toml(part, name + '.')}".rstrip() for part in parts]
    text = "\n".join(lines) + "\n"
    return text if prefix else text.lstrip("\n")


def _is_table(value: Any) -> bool:
    items = isinstance(value, Sequence) and not isinstance(value, str)
    return isinstance(value, Mapping) or (items and bool(value) and all(isinstance(v, Mapping) for v in value))


def _toml_value(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")  # escapes as TOML has them
    if isinstance(value, Sequence):
        return "[" + ", ".join(_toml_value(v) for v in value) + "]"
    return repr(value)


def _merge_items(base: Sequence[Any], over: Mapping[str, Any]) -> list[Any]:
    items = list(base)
    for key, value in over.items():
        if not key.isdecimal() or int(key) > len(items):
            raise SettingsError(f"'{key}' is not an item of a list of {len(items)}; number items from 0")
        index = int(key)
        items[index : index + 1] = [merge(items[index] if index < len(items) else {}, value)]
    return items


def _one_line(error: ValidationError, cls: type) -> str:
    first = error.errors()[0]
    key = ".".join(str(part) for part in first["loc"])
    if first["type"] in ("unexpected_keyword_argument", "extra_forbidden"):
        return f"unknown setting '{key}'{_nearest(key, cls)}"
    text = first["msg"].removeprefix("Value error, ")
    shown = "" if isinstance(first["input"], Mapping) or not key else f", not {first['input']!r}"
    return f"setting '{key}': {text[0].lower()}{text[1:]}{shown}" if key else text


def _nearest(key: str, cls: type) -> str:
    item = re.search(r"\.\d+\.", key)
    known = [k.replace(".0.", item[0]) if item else k for k in keys_of(cls)]
    by_leaf = {k.rpartition(".")[2]: k for k in reversed(known)}
    close = difflib.get_close_matches(key, known, 1, 0.6)
    if not close:
        close = [by_leaf[k] for k in difflib.get_close_matches(key.rpartition(".")[2], list(by_leaf), 1, 0.5)]
    return f"; did you mean '{close[0]}'?" if close else f"; known are {', '.join(sorted(f.name for f in fields(cls)))}"
