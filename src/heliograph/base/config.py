"""Settings as frozen, checked dataclasses.

A settings class is a ``pydantic.dataclasses.dataclass(frozen=True, kw_only=True, config=CONFIG)`` under
`clear_errors`. This module merges mappings, and turns an error of pydantic into a line with the rule, the wrong
value and the nearest known key. `toml_text` reads and writes the text.
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
"""Fraction, 0 to 1."""

_MIN_RATIO = 0.65
"""Ratio of `difflib` of the last parts of two keys from which the known key is proposed for the unknown. 94.4 % of 4046
misspelt keys lead to the right key, and 11 of 40 other words to any."""

_UNIT_RATIO = 0.95
"""Ratio of a key that lacks the unit only, as speed for speed_m_s."""

_MAX_KEY = 100
"""Characters of an unknown key up to which a known key is proposed."""

_RENAMED = {"beside": "in_background", "busy_part": "cpu_share", "own": "custom"}
"""New names of settings by old name."""

T = TypeVar("T")


def clear_errors(cls: type[T]) -> type[T]:
    """Decorate a settings class so that the constructor raises a SettingsError of one line."""
    checked = cls.__init__

    @functools.wraps(checked)
    def init(self: T, /, *args: Any, **values: Any) -> None:
        try:
            checked(self, *args, **values)
        except ValidationError as error:
            raise _to_settings_error(error, cls) from None

    cls.__init__ = init  # type: ignore[assignment]  # a decorator cannot keep the parameters of each class
    return cls


def from_mapping(cls: type[T], mapping: Mapping[str, Any]) -> T:
    """Make settings of a class from nested mappings; missing keys keep the defaults.

    Raise a SettingsError if a key is unknown, or a value has the wrong type or is out of range.
    """
    if is_dataclass(cls) and not hasattr(cls, "__pydantic_config__") and isinstance(mapping, Mapping):
        # a plain dataclass would ignore unknown keys
        for key in set(mapping) - {field.name for field in fields(cls)}:
            raise SettingsError(f"unknown setting '{brief(key)}'{_nearest(str(key), cls)}")
    for key in _no_numbers(cls, mapping):
        raise SettingsError(f"setting '{brief(key)}': a number or text, not true or false")
    try:
        return TypeAdapter(cls).validate_python(dict(mapping) if isinstance(mapping, Mapping) else mapping)
    except ValidationError as error:
        raise _to_settings_error(error, cls) from None
    except (OverflowError, RecursionError):
        raise SettingsError("a value is too large, or its tables lie too deep") from None


def to_mapping(settings: Any) -> dict[str, Any]:
    """Return settings as nested dictionaries, the inverse of `from_mapping`."""
    return asdict(settings)


def merge(base: Any, over: Any) -> Any:
    """Merge changes into a value: mappings merge by key, a list changes item by item, other values are replaced.

    A mapping merges into a list by the numbers of the items, from 0; the number after the last adds an item.
    """
    if isinstance(base, Mapping) and isinstance(over, Mapping):
        return {**base, **{key: merge(base.get(key), value) for key, value in over.items()}}
    if isinstance(base, Sequence) and not isinstance(base, str) and isinstance(over, Mapping):
        return _merge_items(base, over)
    return over


def keys_of(cls: type) -> Iterator[str]:
    """Yield the dotted keys of all plain values of a settings class; a list of settings counts as the item 0."""
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


def _to_settings_error(error: ValidationError, cls: type) -> SettingsError:
    return SettingsError(" ".join(_one_line(error, cls).split()))


def _one_line(error: ValidationError, cls: type) -> str:
    first = error.errors()[0]
    # pydantic adds the kind that it tried to the key
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
    """Return the advice for an unknown key: the nearest known key, or all keys of the table."""
    item = re.search(r"\.\d+\.", key)
    keys = [known.replace(".0.", item[0]) if item else known for known in keys_of(cls)]
    tables = {known[: dot.start()] for known in keys for dot in re.finditer(r"\.", known)}
    parent, dot, leaf = key.rpartition(".")
    if (renamed := f"{parent}{dot}{_RENAMED.get(leaf)}") in keys:
        return f"; it is called '{renamed}' now"
    close = []
    for known in {*keys, *tables} if len(key) <= _MAX_KEY else ():
        name = known.rpartition(".")[2]
        ratio = _UNIT_RATIO if name.startswith(f"{leaf}_") else _ratio(leaf, name)
        if ratio >= _MIN_RATIO:
            close.append((ratio + _ratio(key, known), known))
    if close:
        return f"; did you mean '{max(close)[1]}'?"
    table = key.rpartition(".")[0] + "."
    members = {known.removeprefix(table).partition(".")[0] for known in keys if known.startswith(table)}
    return f"; known are {', '.join(sorted(members or {field.name for field in fields(cls)}))}"


def _ratio(first: str, second: str) -> float:
    return difflib.SequenceMatcher(None, first, second).ratio()


def _no_numbers(cls: Any, value: Any, key: str = "") -> Iterator[str]:
    """Yield the dotted keys of booleans in place of numbers or text, which Python takes for 1 and 0."""
    if isinstance(cls, type) and is_dataclass(cls):
        kinds = get_type_hints(cls) if isinstance(value, Mapping) else {}
        for name in kinds.keys() & set(value if isinstance(value, Mapping) else ()):
            yield from _no_numbers(kinds[name], value[name], f"{key}.{name}" if key else name)
        return
    classes = [kind for kind in get_args(cls) if isinstance(kind, type) and is_dataclass(kind)]
    value = value.tolist() if hasattr(value, "tolist") else value  # booleans of NumPy
    if isinstance(value, (list, tuple)):
        for i, item in enumerate(value):
            yield from _no_numbers(classes[0] if classes else cls, item, f"{key}.{i}")
    elif isinstance(value, bool) and not _takes_bool(cls):
        yield key


def _takes_bool(kind: Any) -> bool:
    if kind in (bool, Any) or isinstance(kind, TypeVar):
        return True
    return any(_takes_bool(part) for part in get_args(kind))
