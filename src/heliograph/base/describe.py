"""Settings described: each key with its unit, what it may be, its default and its meaning, as the code itself says."""

import inspect
import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from docstring_parser import parse
from pydantic import TypeAdapter

UNITS = {
    "m_s": "m/s",
    "m": "m",
    "s": "s",
    "px": "px",
    "deg": "degrees",
    "ppm": "ppm",
    "e": "electrons",
    "patterns": "patterns",
    "hz": "Hz",
    "fps": "frames/s",
}
"""Units by the ending of a key."""

BOUNDS = {
    "ge": "minimum",
    "gt": "exclusiveMinimum",
    "le": "maximum",
    "lt": "exclusiveMaximum",
    "multiple_of": "multipleOf",
}
"""Bounds of an annotated type, and what a JSON schema calls them."""


@dataclass(frozen=True, slots=True)
class KeyDescription:
    """A settings key.

    Attributes
    ----------
    key
        Dotted key; an item of a list of tables has the number 0.
    unit
        Its unit, empty where it has none.
    allowed
        What values it may have.
    default
        Its default as TOML; empty where it may be left out.
    meaning
        What its docstring says.
    """

    key: str
    unit: str
    allowed: str
    default: str
    meaning: str


def describe(cls: type) -> list[KeyDescription]:
    """Describe all keys of a settings class, without those of whole tables, in the order of the class.

    Parameters
    ----------
    cls
        Settings class whose docstring has an Attributes section.
    """
    schema = TypeAdapter(cls).json_schema()
    return list(_keys(cls, schema, schema.get("$defs", {}), ""))


def commented(toml: str, cls: type) -> str:
    """Add the meaning of each key to TOML text, as a comment behind its value; keys without a value as comments alone.

    Parameters
    ----------
    toml
        TOML of settings, a key per line.
    cls
        Class of these settings; its docstring says what each key means.
    """
    meanings = {re.sub(r"\.0\.", ".", one.key): one for one in describe(cls)}
    lines: list[str] = []
    for table, body in _tables(toml):
        given = [line.partition(" = ")[0] for line in body]
        for name, line in zip(given, body, strict=True):
            known = meanings.get(table + name)
            lines.append(f"{line}  # {_comment(known)}" if known else line)
        lines += [
            f"# {key.removeprefix(table)} =   # {_comment(known)}"
            for key, known in meanings.items()
            if key.rpartition(".")[0] + "." == table
            and key.removeprefix(table) not in given
            and not known.default
            and known.allowed != "table"
        ]
        lines.append("")
    return "\n".join(lines).rstrip()


def _tables(toml: str) -> Iterator[tuple[str, list[str]]]:
    """Yield the lines of each table of TOML text, with the table's dotted name and a dot; without empty lines."""
    table, body = "", list[str]()
    for line in filter(None, toml.splitlines()):
        if header := re.fullmatch(r"\[+([\w.-]+)\]+", line):
            if body:
                yield table, body
            table, body = header[1] + ".", []
        body.append(line)
    yield table, body


def _keys(cls: type, schema: Mapping[str, Any], rooms: Mapping[str, Any], prefix: str) -> Iterator[KeyDescription]:
    meanings = {one.arg_name: one.description or "" for one in parse(inspect.getdoc(cls) or "").params}
    for name, about in schema["properties"].items():
        # a schema leaves out the bounds of a type whose values are converted first
        about = {**_bounds_of(inspect.get_annotations(cls, eval_str=True)[name]), **about}
        kind = _kind_of(cls, name)
        items = about.get("items", {}) if about.get("type") == "array" else {}
        if table := _ref(about):
            yield from _keys(kind, rooms[table], rooms, f"{prefix}{name}.")
            continue
        meaning = " ".join(meanings.get(name, "").split())
        yield KeyDescription(prefix + name, _unit(name), _allowed(about), _default(about), meaning)
        if table := _ref(items):
            yield from _keys(kind, rooms[table], rooms, f"{prefix}{name}.0.")


def _kind_of(cls: type, name: str) -> Any:
    """Settings class of a field, or of the items of its list."""
    kind = inspect.get_annotations(cls, eval_str=True)[name]
    return next((part for part in getattr(kind, "__args__", ()) if inspect.isclass(part)), kind)


def _bounds_of(kind: Any) -> dict[str, Any]:
    """Bounds of an annotated type, as a JSON schema has them."""
    limits = [one for part in getattr(kind, "__metadata__", ()) for one in getattr(part, "metadata", ())]
    return {key: getattr(one, name) for one in limits for name, key in BOUNDS.items() if hasattr(one, name)}


def _ref(about: Mapping[str, Any]) -> str:
    """Name of the settings class that a schema refers to, or nothing."""
    # older pydantic wraps a reference that has a default
    (part,) = about.get("allOf", [about])
    return str(part.get("$ref", "")).rpartition("/")[2]


def _unit(name: str) -> str:
    endings = [ending for ending in UNITS if name == ending or name.endswith("_" + ending)]
    return UNITS[max(endings, key=len)] if endings else ""


def _allowed(about: Mapping[str, Any]) -> str:
    options = about.get("anyOf")
    if options:
        return " or ".join("left out" if one.get("type") == "null" else _allowed(one) for one in options)
    if "enum" in about or "const" in about:
        return ", ".join(json.dumps(value) for value in about.get("enum", [about.get("const")]))
    if about.get("type") == "array":
        return _list(about)
    if about.get("type") == "object" or _ref(about):
        return "table"
    kinds = {"integer": "whole number", "number": "number", "boolean": "true, false", "string": "text"}
    return f"{kinds.get(str(about.get('type')), 'any')}{_bounds(about)}"


def _list(about: Mapping[str, Any]) -> str:
    if about.get("maxItems") == 0:
        return "empty list"
    items = {_allowed(item) for item in about.get("prefixItems", [about.get("items", {})])}
    if len(items) > 1:
        return "list"
    count = f"{about['maxItems']} " if "maxItems" in about else ""
    several = re.sub("^(whole number|number|list|table|text)", r"\1s", items.pop())
    return f"list of {count}{several}"


def _bounds(about: Mapping[str, Any]) -> str:
    low, high = about.get("minimum"), about.get("maximum")
    above, below = about.get("exclusiveMinimum"), about.get("exclusiveMaximum")
    parts = [f"{text} {value:g}" for text, value in (("from", low), ("above", above), ("to", high), ("below", below))
             if value is not None]  # fmt: skip
    if "multipleOf" in about:
        parts.append(f"in steps of {about['multipleOf']:g}")
    return " " + " ".join(parts) if parts else ""


def _default(about: Mapping[str, Any]) -> str:
    value = about.get("default")
    if isinstance(value, list) and any(isinstance(item, dict) for item in value):
        return "one table, as below"
    return "" if value is None else json.dumps(value)


def _comment(about: KeyDescription) -> str:
    """First sentence of a key's meaning, with its unit where the sentence leaves it out."""
    sentence = re.split(r"(?<=\.)\s", about.meaning, maxsplit=1)[0].rstrip(".;").replace("``", "")
    return sentence if not about.unit or f"in {about.unit}" in sentence else f"{sentence} ({about.unit})"
