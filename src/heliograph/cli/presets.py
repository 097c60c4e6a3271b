"""Presets as a list, or as TOML with comments."""

from dataclasses import asdict
from typing import Annotated

import typer

from heliograph.base.toml_text import to_toml
from heliograph.cli import console, options
from heliograph.cli.describe import comment
from heliograph.link.settings import PRESETS, LinkSettings, load_settings


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
