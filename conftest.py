"""Every code block of the documentation runs: Python in one namespace a page, commands in the page's own folder."""

import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from sybil import Example, Sybil
from sybil.parsers.myst import CodeBlockParser, PythonCodeBlockParser, SkipParser


def _run(example: Example) -> None:
    """Run commands with the environment's own programs first on the path."""
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    done = subprocess.run(
        ["sh", "-ec", example.parsed], capture_output=True, text=True, env={**os.environ, "PATH": path}, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.fixture(scope="module")
def page_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """An empty folder in which a page's examples run one after the other."""
    here, folder = Path.cwd(), tmp_path_factory.mktemp("page")
    os.chdir(folder)
    yield folder
    os.chdir(here)


def _sybil(**where: Any) -> Sybil:
    parsers = [PythonCodeBlockParser(), CodeBlockParser("sh", _run), SkipParser()]
    return Sybil(parsers=parsers, fixtures=["page_folder"], **where)


pytest_collect_file = _sybil(pattern="*.md", excludes=["_build/**"]).pytest()
