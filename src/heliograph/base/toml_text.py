"""Settings as text: TOML, and ``key=value`` from a command line."""

import json
import re
import tomllib
from collections.abc import Mapping, Sequence
from typing import Any, cast

from heliograph.base.errors import SettingsError, brief, shown

_DEEPEST = 32
"""Most tables within tables. Chosen; settings have four."""

_NO_KEY = re.compile(
    r'"{3}(?:[^\\"]|\\.|"(?!""))*+(?:"{3,5}|\\?\Z)'
    r"|'{3}.*?(?:'{3,5}|\Z)"
    r'|"[^"\\\n]*(?:\\[^\n][^"\\\n]*)*"?'
    r"|'[^'\n]*'?"
    r"|#[^\n]*",
    re.DOTALL,
)
"""Quoted text and comments of TOML, whose dots part no key. What has no end reaches to that of its line or of the text,
so that nothing is looked at twice."""

_LARGEST = 1 << 63
"""Whole numbers are below this and not below its negative, as TOML has them: 64 bits."""


def parse_toml(text: str) -> dict[str, Any]:
    """Parse TOML text to nested dictionaries.

    Parameters
    ----------
    text
        A whole TOML document.

    Raises
    ------
    SettingsError
        The text is not TOML; the message names the line. Or a number has more than 64 bits, or its tables and lists
        lie too deep.
    """
    if _has_deep_key(text):
        raise SettingsError(f"not valid TOML: tables or lists lie more than {_DEEPEST} deep")
    try:
        tree = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise SettingsError(f"not valid TOML: {brief(error)}") from None
    except ValueError:  # more digits than Python turns into a number
        raise SettingsError("not valid TOML: a whole number has more than 64 bits") from None
    except RecursionError:
        raise SettingsError(f"not valid TOML: tables or lists lie more than {_DEEPEST} deep") from None
    return cast(dict[str, Any], _bounded(tree))


def _has_deep_key(text: str) -> bool:
    """Return whether a key has more parts than tables may lie deep: tomllib would take quadratic time for it."""
    return any(part.count(".") > _DEEPEST for part in re.split(r"[=\n,\[\]{}]", _NO_KEY.sub('""', text)))


def _bounded(tree: Any) -> Any:
    """Return what was read if it is no deeper, and its numbers are no larger, than settings can be."""
    layer, depth = [tree], 0
    while layer:
        if depth > _DEEPEST:
            raise SettingsError(f"tables or lists lie more than {_DEEPEST} deep")
        if any(isinstance(value, int) and not -_LARGEST <= value < _LARGEST for value in layer):
            raise SettingsError("a whole number has more than 64 bits")
        inner = [value for value in layer if isinstance(value, (dict, list))]
        layer = [one for value in inner for one in (value.values() if isinstance(value, dict) else value)]
        depth += 1
    return tree


def parse_assignment(text: str) -> dict[str, Any]:
    """Turn ``a.b=3`` into ``{"a": {"b": 3}}``.

    Parameters
    ----------
    text
        Dotted key, ``=`` and value. The value is read as TOML or, where it is none, as bare text.

    Raises
    ------
    SettingsError
        There is no ``=``, a part of the key is empty, or the value is a number of more than 64 bits or lies too deep.
    """
    if not isinstance(text, str):
        raise SettingsError(f"an assignment is text, such as channel.distance_m=60, not {shown(text)}")
    key, sign, value = text.partition("=")
    path = [part.strip() for part in key.split(".")]
    if not sign or not all(path):
        raise SettingsError(f"'{brief(text)}' is not an assignment; write key=value, such as channel.distance_m=60")
    leaf = parse_value(value)
    for part in reversed(path):
        leaf = {part: leaf}
    return cast(dict[str, Any], _bounded(leaf))


def parse_value(text: str) -> Any:
    """Read a value as TOML or, where it is none, as bare text.

    Parameters
    ----------
    text
        A number, text with or without quotes, a list or a table in one line.

    Raises
    ------
    SettingsError
        It is a number of more than 64 bits or lies too deep.
    """
    if _has_deep_key(text):
        # only lists and tables hold keys: anything else is text with many dots, or has a second line
        return parse_toml(f"v = {text}") if text.lstrip().startswith(("[", "{")) else text.strip()
    try:
        found = tomllib.loads(f"v = {text}")
    except tomllib.TOMLDecodeError:
        return text.strip()
    except (ValueError, RecursionError):
        found = parse_toml(f"v = {text}")  # names what is too large
    # a second line may hold a second key
    return _bounded(found["v"]) if len(found) == 1 else text.strip()


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
