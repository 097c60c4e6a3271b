"""Settings as frozen pydantic dataclasses with `CONFIG` and `clear_errors`; `toml_text` reads and writes the text."""

import contextlib
import re
from collections.abc import Iterator, Mapping
from dataclasses import fields, is_dataclass
from difflib import get_close_matches
from textwrap import shorten
from typing import Annotated, Any, TypeVar, get_args, get_type_hints

from pydantic import ConfigDict, Field, TypeAdapter, ValidationError

from heliograph.base.errors import SettingsError, brief

CONFIG = ConfigDict(extra="forbid", allow_inf_nan=False)  # unknown keys, infinities and NaN are errors

Fraction = Annotated[float, Field(ge=0, le=1)]
FocalM = Annotated[float, Field(ge=1e-4, le=10)]  # focal length, up to the longest telephoto lenses
PixelM = Annotated[float, Field(ge=1e-7, le=1e-3)]  # pixel pitch; light forms no image below 0.1 um
PitchM = Annotated[float, Field(ge=1e-4, le=10)]  # distance between LEDs

_RENAMED = {"beside": "in_background", "busy_part": "cpu_share", "own": "custom"}  # new names of settings by old name
T = TypeVar("T")


def clear_errors(cls: type[T]) -> type[T]:
    """Decorate a settings class: the constructor raises a SettingsError with a single-line message."""
    cls.__init__ = _one_line_errors(cls)(cls.__init__)  # type: ignore[method-assign]  # parameters differ by class
    return cls


@contextlib.contextmanager
def _one_line_errors(cls: type) -> Iterator[None]:
    try:
        yield
    except ValidationError as error:
        raise _to_settings_error(error, cls) from None


def from_mapping(cls: type[T], mapping: Mapping[str, Any]) -> T:
    """Create settings from nested mappings; missing keys keep the defaults.

    Raise a SettingsError if a key is unknown, or a value has the wrong type or is out of range.
    """
    if is_dataclass(cls) and not hasattr(cls, "__pydantic_config__"):  # pydantic would ignore unknown keys
        cls.__pydantic_config__ = CONFIG  # type: ignore[attr-defined]  # pydantic reads this attribute from any dataclass
    for key in _misplaced_booleans(cls, mapping):
        raise SettingsError(f"setting '{key}': a number or text, not true or false")
    with _one_line_errors(cls):
        return TypeAdapter(cls).validate_python(dict(mapping) if isinstance(mapping, Mapping) else mapping)


def merge(base: Any, over: Any) -> Any:
    """Merge changes into a value: mappings merge by key, lists change item by item, other values are replaced.

    A mapping merges into a list by item number, starting at 0; the number after the last adds an item.
    """
    if isinstance(base, Mapping) and isinstance(over, Mapping):
        return {**base, **{key: merge(base.get(key), value) for key, value in over.items()}}
    if not (isinstance(base, (list, tuple)) and isinstance(over, Mapping)):
        return over
    items = list(base)
    for key, value in over.items():
        if str(key) not in map(str, range(len(items) + 1)):
            raise SettingsError(f"'{brief(str(key))}' is not an item of a list of {len(items)}; number items from 0")
        index = int(key)
        items[index : index + 1] = [merge(items[index] if index < len(items) else {}, value)]
    return items


def keys_of(cls: type) -> Iterator[str]:
    """Yield the dotted keys of all plain values in a settings class; a list of settings counts as item 0."""
    for field in fields(cls):
        kinds = [(field.name, field.type), *((f"{field.name}.0", kind) for kind in get_args(field.type))]
        tables = [(name, kind) for name, kind in kinds if isinstance(kind, type) and is_dataclass(kind)]
        yield from [f"{name}.{key}" for name, kind in tables for key in keys_of(kind)] or [field.name]


def _to_settings_error(error: ValidationError, cls: type) -> SettingsError:
    """Convert the first pydantic error to a line with the rule, the wrong value and the nearest known key."""
    first = error.errors()[0]
    # pydantic adds the attempted type to the key
    parts = [part for part in map(str, first["loc"]) if not re.search(r"\[|^(constrained|function)-", part)]
    key, value = brief(".".join(parts)), first["input"]
    if first["type"] in ("unexpected_keyword_argument", "extra_forbidden"):
        return _unknown_key(key, cls)
    if first["type"] == "unexpected_positional_argument":
        return SettingsError(f"settings are given by name, such as {next(keys_of(cls))}=..., not {brief(value)} alone")
    text = shorten(first["msg"].removeprefix("Value error, "), 320, placeholder="...")  # may quote a long value
    if not key:
        return SettingsError(text)
    named = isinstance(value, Mapping) or (isinstance(value, str) and repr(value) in text)
    given = repr(brief(value)) if isinstance(value, str) else brief(value)
    return SettingsError(f"setting '{key}': {text[0].lower()}{text[1:]}" + ("" if named else f", not {given}"))


def _unknown_key(key: str, cls: type) -> SettingsError:
    """Return the error for an unknown key, with the nearest known key or all keys of the table."""
    parent, dot, leaf = key.rpartition(".")
    item = re.search(r"\.\d+\.", key)
    keys = [known.replace(".0.", item[0]) if item else known for known in keys_of(cls)]
    if (renamed := f"{parent}{dot}{_RENAMED.get(leaf)}") in keys:
        return SettingsError(f"unknown setting '{key}'; it is called '{renamed}' now")
    tables = {known[: end.start()] for known in keys for end in re.finditer(r"\.", known)}
    names = {known: known.rpartition(".")[2] for known in {*keys, *tables}}
    with_unit = {name for name in names.values() if name.startswith(f"{leaf}_")}  # speed_m_s for speed
    close = {leaf} & {*names.values()} or with_unit or get_close_matches(leaf, {*names.values()}, 1, cutoff=0.65)
    if near := get_close_matches(key, [known for known, name in names.items() if name in close], 1, cutoff=0):
        return SettingsError(f"unknown setting '{key}'; did you mean '{near[0]}'?")
    members = {known.removeprefix(parent + dot).partition(".")[0] for known in keys if known.startswith(parent + dot)}
    known = ", ".join(sorted(members or {field.name for field in fields(cls)}))
    return SettingsError(f"unknown setting '{key}'; known are {known}")


def _misplaced_booleans(kind: Any, given: Any, key: str = "") -> Iterator[str]:
    """Yield the dotted keys of booleans in place of numbers or text, which pydantic reads as 1 and 0."""
    given = given.tolist() if hasattr(given, "tolist") else given  # booleans of NumPy
    if isinstance(given, Mapping) and is_dataclass(kind):
        for name, inner in get_type_hints(kind).items():
            if name in given:
                yield from _misplaced_booleans(inner, given[name], f"{key}.{name}" if key else name)
    elif isinstance(given, (list, tuple)):
        item = next(filter(is_dataclass, get_args(kind)), kind)
        for i, value in enumerate(given):
            yield from _misplaced_booleans(item, value, f"{key}.{i}")
    elif isinstance(given, bool) and not is_dataclass(kind) and not _takes_bool(kind):
        yield key


def _takes_bool(kind: Any) -> bool:
    return kind in (bool, Any) or isinstance(kind, TypeVar) or any(map(_takes_bool, get_args(kind)))
