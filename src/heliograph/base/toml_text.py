"""Read and write settings as text: TOML, and ``key=value`` from a command line."""

import re
import tomllib
from collections.abc import Mapping
from typing import Any

import tomli_w

from heliograph.base.errors import SettingsError, brief, shown

MAX_DEPTH = 32  # nested tables; settings have four levels
_DEEP = f"not valid TOML: tables or lists lie more than {MAX_DEPTH} deep"
_LARGE = "not valid TOML: a whole number has more than 64 bits"

_PART = r"""(?:[\w-]++|"(?:[^"\\\n]|\\.)*+"|'[^'\n]*+')[ \t]*+"""
# keys with more than `MAX_DEPTH` parts, for which tomllib takes quadratic time
_DEEP_KEY = re.compile(rf"(?:^|[\[{{,])[ \t]*+(?:{_PART}\.[ \t]*+){{{MAX_DEPTH + 1}}}", re.MULTILINE)


def parse_toml(text: str) -> dict[str, Any]:
    """Parse TOML; raise a SettingsError for invalid text, deep tables or numbers with more than 64 bits."""
    if _DEEP_KEY.search(text):
        raise SettingsError(_DEEP)
    try:
        tree = tomllib.loads(text)
    except RecursionError:
        raise SettingsError(_DEEP) from None
    except tomllib.TOMLDecodeError as error:
        raise SettingsError(f"not valid TOML: {brief(error)}") from error
    except ValueError:  # more digits than Python converts
        raise SettingsError(_LARGE) from None
    _check_bounds(tree)
    return tree


def parse_assignment(text: str) -> dict[str, Any]:
    """Parse ``a.b=3`` to ``{"a": {"b": 3}}``; raise a SettingsError for other text."""
    if not isinstance(text, str):
        raise SettingsError(f"an assignment is text, such as channel.distance_m=60, not {shown(text)}")
    key, sign, value = text.partition("=")
    path = [part.strip() for part in key.split(".")]
    if not sign or not all(path):
        raise SettingsError(f"'{brief(text)}' is not an assignment; write key=value, such as channel.distance_m=60")
    tree = parse_value(value)
    for part in reversed(path):
        tree = {part: tree}
    _check_bounds(tree)
    return dict(tree)


def parse_value(text: str) -> Any:
    """Parse a value as TOML, or else as bare text; raise a SettingsError if the value is too deep or too large."""
    # plain text may have many dots; only lists and tables hold keys
    if _DEEP_KEY.search(text) and not text.lstrip().startswith(("[", "{")):
        return text.strip()
    try:
        tree = parse_toml(f"v = {text}")
    except SettingsError as error:
        if isinstance(error.__cause__, tomllib.TOMLDecodeError):
            return text.strip()
        raise
    return tree["v"] if len(tree) == 1 else text.strip()  # a second line is a second key


def to_toml(mapping: Mapping[str, Any]) -> str:
    """Write nested mappings as TOML; parsing returns the same mapping. None values are omitted."""
    text = tomli_w.dumps(_without_none(mapping))
    # write number lists on a single line
    return re.sub(r'\[\n\s+([^\[\]{}"]*),\n\s*\]', lambda items: f"[{' '.join(items[1].split())}]", text)


def _without_none(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _without_none(item) for key, item in value.items() if item is not None}
    return [_without_none(item) for item in value] if isinstance(value, (list, tuple)) else value


def _check_bounds(value: Any, depth: int = 0) -> None:
    """Raise a SettingsError if a tree is deeper, or an integer larger, than settings allow."""
    if depth > MAX_DEPTH:
        raise SettingsError(_DEEP)
    if isinstance(value, int) and not -(1 << 63) <= value < 1 << 63:
        raise SettingsError(_LARGE)
    for item in value.values() if isinstance(value, dict) else value if isinstance(value, list) else ():
        _check_bounds(item, depth + 1)
