"""Read and write settings as text: TOML, and ``key=value`` from a command line."""

import re
import tomllib
from collections.abc import Mapping
from typing import Any

import tomli_w

from heliograph.base.errors import SettingsError, brief, shown

MAX_DEPTH = 32
"""Tables within tables; settings have four."""

_DEEP = f"tables or lists lie more than {MAX_DEPTH} deep"

_NO_KEY = re.compile(
    r'"{3}(?:[^\\"]|\\.|"(?!""))*+(?:"{3,5}|\\?\Z)'
    r"|'{3}.*?(?:'{3,5}|\Z)"
    r'|"[^"\\\n]*(?:\\[^\n][^"\\\n]*)*"?'
    r"|'[^'\n]*'?"
    r"|#[^\n]*",
    re.DOTALL,
)
"""Quoted text and comments of TOML, whose dots separate no keys. Unterminated text ends with the line or the document,
so the search never backtracks."""


def parse_toml(text: str) -> dict[str, Any]:
    """Parse TOML; raise a SettingsError for other text, too deep tables or numbers of more than 64 bits."""
    if _has_deep_key(text):
        raise SettingsError(f"not valid TOML: {_DEEP}")
    try:
        tree = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise SettingsError(f"not valid TOML: {brief(error)}") from None
    except ValueError:  # more digits than Python turns into a number
        raise SettingsError("not valid TOML: a whole number has more than 64 bits") from None
    except RecursionError:
        raise SettingsError(f"not valid TOML: {_DEEP}") from None
    _check_bounds(tree)
    return tree


def parse_assignment(text: str) -> dict[str, Any]:
    """Turn ``a.b=3`` into ``{"a": {"b": 3}}``; raise a SettingsError if it is no assignment."""
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
    """Read a value as TOML, or else as bare text; raise a SettingsError if it is too deep or too large."""
    if _has_deep_key(text):
        # only lists and tables hold keys: other text may have many dots, or a second line
        return parse_toml(f"v = {text}") if text.lstrip().startswith(("[", "{")) else text.strip()
    try:
        tree = tomllib.loads(f"v = {text}")
    except tomllib.TOMLDecodeError:
        return text.strip()
    except (ValueError, RecursionError):
        tree = parse_toml(f"v = {text}")  # raises the error that tells the reason
    if len(tree) > 1:  # a second line holds a second key
        return text.strip()
    _check_bounds(tree)
    return tree["v"]


def to_toml(mapping: Mapping[str, Any]) -> str:
    """Write nested mappings as TOML that reads back as the same mapping; None is left out."""
    text = tomli_w.dumps(_without_none(mapping))
    # lists of numbers on one line
    return re.sub(r'\[\n\s+([^\[\]{}"]*),\n\s*\]', lambda items: f"[{' '.join(items[1].split())}]", text)


def _without_none(value: Any) -> Any:
    if isinstance(value, Mapping):
        return {key: _without_none(item) for key, item in value.items() if item is not None}
    return [_without_none(item) for item in value] if isinstance(value, (list, tuple)) else value


def _has_deep_key(text: str) -> bool:
    """Return True if a key has more than `MAX_DEPTH` parts: tomllib would take quadratic time for it."""
    return any(part.count(".") > MAX_DEPTH for part in re.split(r"[=\n,\[\]{}]", _NO_KEY.sub('""', text)))


def _check_bounds(tree: Any) -> None:
    """Raise a SettingsError if a tree is deeper, or an integer larger, than settings allow."""
    layer, depth = [tree], 0
    while layer:
        if depth > MAX_DEPTH:
            raise SettingsError(_DEEP)
        if any(isinstance(value, int) and not -(1 << 63) <= value < 1 << 63 for value in layer):
            raise SettingsError("a whole number has more than 64 bits")
        inner = [value for value in layer if isinstance(value, (dict, list))]
        layer = [item for value in inner for item in (value.values() if isinstance(value, dict) else value)]
        depth += 1
