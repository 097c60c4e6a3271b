import hashlib
import json
import re
from pathlib import Path

import pytest

from heliograph.sweeps.plot import LAYER_COLOURS
from heliograph.web.built import PAGES, built
from heliograph.web.wording import COMMANDS

FRONT = Path(__file__).parents[2] / "web"
SOURCES = ("src", "parts", "public", "package-lock.json", "package.json", "tsconfig.json", "vite.config.ts")


def digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def test_built_pages_are_those_of_the_sources() -> None:
    note = json.loads(built()["build.json"])
    names = [FRONT / name for name in (*SOURCES, *(f"{page}.html" for page in PAGES))]
    files = [file for name in names for file in ([name] if name.is_file() else name.rglob("*")) if file.is_file()]
    sources = {file.relative_to(FRONT).as_posix(): digest(file.read_bytes()) for file in files}
    assert note["sources"] == sources, "the sources of the pages changed: run 'make web' and commit what it builds"
    assert note["built"] == {name: digest(data) for name, data in built().items() if name != "build.json"}


def test_lock_file_names_no_registry() -> None:
    assert "resolved" not in (FRONT / "package-lock.json").read_text(encoding="utf-8")


@pytest.mark.parametrize("page", PAGES)
def test_pages_hold_no_scripts_styles_settings_and_options(page: str) -> None:
    text = built()[f"{page}.html"].decode()
    assert not re.search(r"<script(?![^>]*\bsrc=)|<style|\sstyle=|\son\w+=|javascript:", text)
    assert not re.search(r"(src|href)=\"(https?:)?//", text)
    assert not COMMANDS.search(re.sub(r"<[^>]*>", " ", built()[f"{page}.html"].decode()))


def test_layers_have_the_colours_of_the_plots() -> None:
    style = (FRONT / "src" / "common" / "style.css").read_text(encoding="utf-8")
    for layer, colour in LAYER_COLOURS.items():
        assert f"--{layer}: {colour};" in style
