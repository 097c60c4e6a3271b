"""Settings as frozen, checked dataclasses.

A settings class is a ``pydantic.dataclasses.dataclass(frozen=True, kw_only=True, config=CONFIG)`` under
`clear_errors`: pydantic checks its fields when it is made. This module merges mappings, and turns an error of pydantic
into one line that names the rule, the wrong value and the nearest known key. `toml_text` reads and writes the text.
"""

import difflib
import functools
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, fields, is_dataclass
from typing import Annotated, Any, TypeVar, get_args, get_type_hints

from pydantic import ConfigDict, Field, TypeAdapter, ValidationError

from heliograph.base.errors import MOST_SHOWN, SettingsError, brief

CONFIG = ConfigDict(extra="forbid", allow_inf_nan=False)
"""Configuration of every settings class: unknown keys, infinities and NaN are errors."""

FocalM = Annotated[float, Field(ge=1e-4, le=10)]
"""Focal length in m, from a tenth of a millimetre to that of the longest telescopic lenses."""

PixelM = Annotated[float, Field(ge=1e-7, le=1e-3)]
"""Side of a pixel in m: below 0.1 um light makes no image, and no sensor has pixels of 1 mm."""

PitchM = Annotated[float, Field(ge=1e-4, le=10)]
"""Distance between LEDs in m."""

Fraction = Annotated[float, Field(ge=0, le=1)]
"""Fraction of a whole."""

_CLOSE_LEAF = 0.65
"""Least ratio of `difflib`, 0 to 1, of the parts after the last dot at which a known key is proposed for an unknown.

Of 4046 misspellings of the link's keys (a letter left out, doubled or wrong; with and without their path), 94.4 % lead
to the right key; at 0.7 93.5 %. Of 40 words that are none, such as channel.foo, 11 lead to a key; at 0.5 29."""

_WITH_UNIT = 0.95
"""The ratio for a key that lacks nothing but its unit, as speed for speed_m_s."""

_LONGEST_KEY = 100
"""Most characters of a key for which a known one is proposed."""

T = TypeVar("T")


def clear_errors(cls: type[T]) -> type[T]:
    """Let a settings class, called by hand, raise a SettingsError of one line in place of pydantic's; a decorator.

    Parameters
    ----------
    cls
        Settings class, a dataclass of pydantic; its constructor is replaced.
    """
    checked = cls.__init__

    @functools.wraps(checked)
    def init(self: T, /, *args: Any, **values: Any) -> None:
        try:
            checked(self, *args, **values)
        except ValidationError as error:
            raise _clear(error, cls) from None

    cls.__init__ = init  # type: ignore[assignment]  # a decorator cannot keep the parameters of each class
    return cls


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
            raise SettingsError(f"unknown setting '{brief(key)}'{_nearest(str(key), cls)}")
    for key in _no_numbers(cls, mapping):
        raise SettingsError(f"setting '{brief(key)}': a number or text, not true or false")
    try:
        return TypeAdapter(cls).validate_python(dict(mapping) if isinstance(mapping, Mapping) else mapping)
    except ValidationError as error:
        raise _clear(error, cls) from None
    except (OverflowError, RecursionError):
        raise SettingsError("a value is too large, or its tables lie too deep") from None


def to_mapping(settings: Any) -> dict[str, Any]:
    """Return settings as nested dictionaries of plain values, the inverse of `from_mapping`.

    Parameters
    ----------
    settings
        Settings of any class; those within them become dictionaries too.
    """
    return asdict(settings)


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


def _merge_items(base: Sequence[Any], over: Mapping[str, Any]) -> list[Any]:
    items = list(base)
    for number, value in over.items():
        key = str(number)
        if not (key.isdecimal() and len(key) <= len(str(len(items))) and int(key) <= len(items)):
            raise SettingsError(f"'{brief(key)}' is not an item of a list of {len(items)}; number items from 0")
        index = int(key)
        items[index : index + 1] = [merge(items[index] if index < len(items) else {}, value)]
    return items


def _clear(error: ValidationError, cls: type) -> SettingsError:
    return SettingsError(" ".join(_one_line(error, cls).split()))


def _one_line(error: ValidationError, cls: type) -> str:
    first = error.errors()[0]
    # beside a value's key Pydantic names the kind that it tried
    parts = [str(part) for part in first["loc"]]
    key = ".".join(part for part in parts if not re.search(r"\[|^(constrained|function)-", part))[:MOST_SHOWN]
    if first["type"] in ("unexpected_keyword_argument", "extra_forbidden"):
        return f"unknown setting '{key}'{_nearest(key, cls)}"
    if first["type"] == "unexpected_positional_argument":
        return f"settings are given by name, such as {next(keys_of(cls))}=..., not {brief(first['input'])} alone"
    text = " ".join(first["msg"].removeprefix("Value error, ").split())
    if len(text) > 4 * MOST_SHOWN:  # it quotes a long value
        text = f"{text[: 4 * MOST_SHOWN - 3]}..."
    value = first["input"]
    named = isinstance(value, Mapping) or (isinstance(value, str) and repr(value) in text)
    shown = "" if named or not key else f", not {brief(value) if not isinstance(value, str) else repr(brief(value))}"
    return f"setting '{key}': {text[0].lower()}{text[1:]}{shown}" if key else text


def _nearest(key: str, cls: type) -> str:
    item = re.search(r"\.\d+\.", key)
    plain = [k.replace(".0.", item[0]) if item else k for k in keys_of(cls)]
    known = [*plain, *{k[: at.start()] for k in plain for at in re.finditer(r"\.", k)}]  # tables too
    leaf = key.rpartition(".")[2]
    close = []
    for one in known if len(key) <= _LONGEST_KEY else ():
        name = one.rpartition(".")[2]
        ratio = _WITH_UNIT if name.startswith(f"{leaf}_") else _ratio(leaf, name)
        if ratio >= _CLOSE_LEAF:
            close.append((ratio + _ratio(key, one), one))
    if close:
        return f"; did you mean '{max(close)[1]}'?"
    table = key.rpartition(".")[0] + "."
    beside = [one.removeprefix(table).partition(".")[0] for one in plain if one.startswith(table)]
    listed = sorted(set(beside)) or sorted(field.name for field in fields(cls))
    return f"; known are {', '.join(listed)}"


def _ratio(one: str, other: str) -> float:
    return difflib.SequenceMatcher(None, one, other).ratio()


def _no_numbers(cls: Any, value: Any, key: str = "") -> Iterator[str]:
    """Yield the dotted keys at which true or false stand in place of numbers or text: Python takes them for 1 and 0."""
    if isinstance(cls, type) and is_dataclass(cls):
        kinds = get_type_hints(cls) if isinstance(value, Mapping) else {}
        for name in kinds.keys() & set(value if isinstance(value, Mapping) else ()):
            yield from _no_numbers(kinds[name], value[name], f"{key}.{name}" if key else name)
        return
    rooms = [kind for kind in get_args(cls) if isinstance(kind, type) and is_dataclass(kind)]
    value = value.tolist() if hasattr(value, "tolist") else value  # NumPy has a true and a false of its own
    if isinstance(value, (list, tuple)):
        for i, one in enumerate(value):
            yield from _no_numbers(rooms[0] if rooms else cls, one, f"{key}.{i}")
    elif isinstance(value, bool) and not _takes_bool(cls):
        yield key


def _takes_bool(kind: Any) -> bool:
    if kind in (bool, Any) or isinstance(kind, TypeVar):
        return True
    return any(_takes_bool(part) for part in get_args(kind))
