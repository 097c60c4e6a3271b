"""Settings as frozen, checked dataclasses, made from TOML or from ``key=value`` text.

A settings class is a ``pydantic.dataclasses.dataclass(frozen=True, kw_only=True, config=CONFIG)``: pydantic
checks its fields when it is made. This module reads and writes the text, merges mappings, and turns an error
of pydantic into one line that names the rule, the wrong value and the nearest known key.
"""

import difflib
import json
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, fields, is_dataclass
from typing import Annotated, Any, TypeVar, get_args

from pydantic import ConfigDict, Field, TypeAdapter, ValidationError

from heliograph.base.errors import SettingsError

CONFIG = ConfigDict(extra="forbid", allow_inf_nan=False)
"""Configuration of every settings class: unknown keys, infinities and NaN are errors."""

Positive = Annotated[float, Field(gt=0)]
"""A number above 0."""

Fraction = Annotated[float, Field(ge=0, le=1)]
"""Fraction of a whole."""

_CLOSE_KEY = 0.6
"""Least ratio of `difflib`, 0 to 1, at which a known dotted key is proposed for an unknown one: difflib's default.

Of 2996 misspellings of the link's keys (a letter left out, doubled or wrong; with and without their path), 91.7 %
lead to the right key; at half this value 87.2 %, at 1, where only the second try finds any, 84.6 %."""

_CLOSE_LEAF = 0.5
"""The same for the part after the last dot, which is tried second. Chosen: at half this value as many of those
misspellings lead to the right key, at 1 only 59.7 %."""

T = TypeVar("T")


def from_mapping(cls: type[T], mapping: Mapping[str, Any]) -> T:
    """Make settings from nested mappings.

    Parameters
    ----------
    cls
        Settings class, or a plain dataclass, of which one is made.
    mapping
        Values by field name; a settings class within it takes a mapping of its own. Missing keys keep their defaults.

    Returns
    -------
    T
        Settings of class `cls`.

    Raises
    ------
    SettingsError
        A key is unknown, or a value has the wrong type or is out of range.
    """
    if is_dataclass(cls) and not hasattr(cls, "__pydantic_config__") and isinstance(mapping, Mapping):
        # a plain dataclass, as that of a receiver of one's own, would pass over keys that it lacks
        for key in set(mapping) - {field.name for field in fields(cls)}:
            raise SettingsError(f"unknown setting '{key}'{_nearest(key, cls)}")
    try:
        return TypeAdapter(cls).validate_python(dict(mapping) if isinstance(mapping, Mapping) else mapping)
    except ValidationError as error:
        raise SettingsError(_one_line(error, cls)) from None


def to_mapping(settings: Any) -> dict[str, Any]:
    """Return settings as nested dictionaries of plain values, the inverse of `from_mapping`.

    Parameters
    ----------
    settings
        Settings of any class; those within them become dictionaries too.
    """
    return asdict(settings)


def parse_toml(text: str) -> dict[str, Any]:
    """Parse TOML text to nested dictionaries.

    Parameters
    ----------
    text
        A whole TOML document.

    Raises
    ------
    SettingsError
        The text is not TOML; the message names the line.
    """
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise SettingsError(f"not valid TOML: {error}") from None


def parse_assignment(text: str) -> dict[str, Any]:
    """Turn ``a.b=3`` into ``{"a": {"b": 3}}``.

    Parameters
    ----------
    text
        Dotted key, ``=`` and value. The value is read as TOML or, where it is none, as bare text.

    Raises
    ------
    SettingsError
        There is no ``=``, or a part of the key is empty.
    """
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
    """Merge changes into a value: mappings merge by key, a list changes item by item, other values are replaced.

    Parameters
    ----------
    base
        Value to change; it stays as it is.
    over
        Changes. A mapping on a list has the items' numbers, from 0, as its keys; the number after the last adds an
        item.

    Returns
    -------
    Any
        The merged value.

    Raises
    ------
    SettingsError
        A key of a mapping on a list is not the number of an item.
    """
    if isinstance(base, Mapping) and isinstance(over, Mapping):
        return {**base, **{key: merge(base.get(key), value) for key, value in over.items()}}
    if isinstance(base, Sequence) and not isinstance(base, str) and isinstance(over, Mapping):
        return _merge_items(base, over)
    return over


def keys_of(cls: type) -> Iterator[str]:
    """Yield the dotted keys of all plain values of a settings class; a list of settings counts as its item 0.

    Parameters
    ----------
    cls
        Settings class, or a plain dataclass; keys of a class within it follow the field's name and a dot.
    """
    for field in fields(cls):
        items = [kind for kind in get_args(field.type) if isinstance(kind, type) and is_dataclass(kind)]
        if isinstance(field.type, type) and is_dataclass(field.type):
            yield from (f"{field.name}.{key}" for key in keys_of(field.type))
        elif items:
            yield from (f"{field.name}.0.{key}" for key in keys_of(items[0]))
        else:
            yield field.name


def to_toml(mapping: Mapping[str, Any], prefix: str = "") -> str:
    """Write nested mappings of plain values as TOML; None is left out.

    Parameters
    ----------
    mapping
        Strings, numbers, booleans, sequences of them, and mappings or non-empty lists of mappings, by key.
    prefix
        Dotted name of the table that holds `mapping`, with a dot at its end; empty for the whole document.

    Returns
    -------
    str
        TOML that reads back as the same mapping; plain values come before tables.
    """
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
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")  # as in JSON, and DEL too
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
    value = first["input"]
    named = isinstance(value, Mapping) or (isinstance(value, str) and repr(value) in text)
    shown = "" if named or not key else f", not {value!r}"
    return f"setting '{key}': {text[0].lower()}{text[1:]}{shown}" if key else text


def _nearest(key: str, cls: type) -> str:
    item = re.search(r"\.\d+\.", key)
    known = [k.replace(".0.", item[0]) if item else k for k in keys_of(cls)]
    by_leaf = {k.rpartition(".")[2]: k for k in reversed(known)}
    close = difflib.get_close_matches(key, known, 1, _CLOSE_KEY)
    if not close:
        leaf = key.rpartition(".")[2]
        close = [by_leaf[k] for k in difflib.get_close_matches(leaf, list(by_leaf), 1, _CLOSE_LEAF)]
    return f"; did you mean '{close[0]}'?" if close else f"; known are {', '.join(sorted(f.name for f in fields(cls)))}"
