"""Settings as text: the presets as a list or as TOML, and each key with unit, allowed values, default and meaning."""

import inspect
import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, is_dataclass
from typing import Annotated, Any, get_args

import typer
from docstring_parser import parse
from pydantic import TypeAdapter

from heliograph.base.toml_text import to_toml
from heliograph.cli import console, options
from heliograph.link.settings import PRESETS, LinkSettings, load_settings

UNITS = {"m_s": "m/s", "mm_h": "mm/h", "m": "m", "s": "s", "px": "px", "deg": "degrees", "ppm": "ppm", "e": "electrons",
         "patterns": "patterns", "hz": "Hz", "fps": "frames/s"}  # fmt: skip
"""Units by the ending of a key; a longer ending comes first."""

_TYPES = {"integer": "integer", "number": "number", "boolean": "true, false", "string": "text"}
_BOUNDS = {"minimum": "from", "ge": "from", "exclusiveMinimum": "above", "gt": "above",
           "maximum": "to", "le": "to", "exclusiveMaximum": "below", "lt": "below"}  # fmt: skip
"""Words for bounds in a JSON schema; A type with a converter has the keywords of Pydantic."""


@dataclass(frozen=True, slots=True)
class KeyDescription:
    """Description of a settings key."""

    # Dotted key; an item of a list of tables has the number 0
    key: str
    # Unit; empty for none
    unit: str
    # Allowed values in words
    allowed: str
    # Default as TOML; empty if the key may be left out
    default: str
    # Text of the docstring
    meaning: str


def describe(cls: type, prefix: str = "") -> Iterator[KeyDescription]:
    """Describe all keys of a settings class with an Attributes section in the docstring, in the order of the class."""
    parameters = parse(inspect.getdoc(cls) or "").params
    meanings = {about.arg_name: " ".join((about.description or "").split()) for about in parameters}
    types = inspect.get_annotations(cls, eval_str=True)
    for name, schema in TypeAdapter(cls).json_schema()["properties"].items():
        if is_dataclass(types[name]):
            yield from describe(types[name], f"{prefix}{name}.")
            continue
        unit = next((unit for ending, unit in UNITS.items() if f"_{name}".endswith(f"_{ending}")), "")
        yield KeyDescription(prefix + name, unit, _allowed(schema), _default(schema), meanings.get(name, ""))
        if schema.get("type") == "array":
            for item in get_args(types[name]):
                if isinstance(item, type) and is_dataclass(item):
                    yield from describe(item, f"{prefix}{name}.0.")


def comment(toml: str, cls: type) -> str:
    """Add the meaning of each key of a settings class to TOML text, and comments for keys that are left out."""
    descriptions = {about.key.replace(".0.", "."): about for about in describe(cls)}
    tables = []
    for text in re.split(r"\n+(?=\[)", toml.strip()):
        header = re.match(r"\[+([\w.-]+)\]+", text)
        prefix = f"{header[1]}." if header else ""
        lines, given = [], set[str]()
        for line in filter(None, text.splitlines()):
            key = prefix + line.partition(" = ")[0]
            given.add(key)
            lines.append(f"{line}  # {_summary(descriptions[key])}" if key in descriptions else line)
        for key, about in descriptions.items():
            path, _, name = key.rpartition(".")
            if prefix == f"{path}." and key not in given and not about.default and about.allowed != "table":
                lines.append(f"# {name} =   # {_summary(about)}")
        tables.append("\n".join(lines))
    return "\n\n".join(tables)


def _summary(about: KeyDescription) -> str:
    """Return the first sentence of the meaning of a key, with the unit unless the sentence has it."""
    sentence = re.split(r"(?<=\.)\s", about.meaning, maxsplit=1)[0].rstrip(".;").replace("``", "")
    return sentence if not about.unit or f"in {about.unit}" in sentence else f"{sentence} ({about.unit})"


def _allowed(schema: Mapping[str, Any]) -> str:
    """Return the allowed values of a schema in words."""
    if options := schema.get("anyOf"):
        return " or ".join("left out" if option.get("type") == "null" else _allowed(option) for option in options)
    if "enum" in schema or "const" in schema:
        return ", ".join(json.dumps(value) for value in schema.get("enum", [schema.get("const")]))
    if schema.get("type") == "array":
        return _allowed_items(schema)
    if schema.get("type") == "object" or "$ref" in schema:
        return "table"
    bounds = [f"{word} {schema[key]:g}" for key, word in _BOUNDS.items() if schema.get(key) is not None]
    steps = [f"in steps of {schema['multipleOf']:g}"] if "multipleOf" in schema else []
    return " ".join([_TYPES.get(str(schema.get("type")), "any"), *bounds, *steps])


def _allowed_items(schema: Mapping[str, Any]) -> str:
    if schema.get("maxItems") == 0:
        return "empty list"
    items = {_allowed(item) for item in schema.get("prefixItems", [schema.get("items", {})])}
    if len(items) > 1:
        return "list"
    count = f"{schema['maxItems']} " if "maxItems" in schema else ""
    return f"list of {count}" + re.sub("^(integer|number|list|table|text)", r"\1s", items.pop())


def _default(schema: Mapping[str, Any]) -> str:
    value = schema.get("default")
    if isinstance(value, list) and any(isinstance(item, dict) for item in value):
        return "one table, as below"
    return "" if value is None else json.dumps(value)


@options.command
def presets(
    name: Annotated[
        str | None,
        typer.Argument(
            help="Preset to print as TOML, with the meaning of each setting.", autocompletion=options.complete_preset
        ),
    ] = None,
    as_json: options.Json = False,
) -> None:
    """List the presets, or print all settings of a preset."""
    texts = {key: text for key, (text, _) in PRESETS.items()}
    tree = texts if name is None else asdict(load_settings(name))
    if as_json:
        console.say_json(tree)
    elif name is None:
        console.say_lines("\n".join(f"{key:12} {text}" for key, text in texts.items()))
    else:
        console.say_lines(comment(to_toml(tree), LinkSettings))
