"""Every code block of the documentation runs: Python in one namespace a page, commands in the page's own folder."""

import logging
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path

import pytest

# set before the NumPy import: two test processes with two BLAS threads each wait for each other, and the matrices are
# too small for threads. Tests of the thread limit set other counts
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from sybil import Example, Sybil
from sybil.parsers import myst, rest

STATEMENT = re.compile(r".*<<'END'\n(?:.*\n)*?END\n|.*\n")
"""A line of a block of commands, or a text that the shell writes to a file."""


def _is_own(statement: str) -> bool:
    return statement.startswith("heliograph ") and not set("|&;$<>*") & set(statement)


def _run(example: Example) -> None:
    """Run commands, those of this package in this process to save the start of an interpreter for each."""
    from cli_runs import within

    # the environment's own programs come first on the path
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])
    for is_own, statements in groupby(STATEMENT.findall(example.parsed.replace("\\\n", " ")), _is_own):
        for words in (shlex.split(line, comments=True) for line in statements) if is_own else ():
            ran = within(Path.cwd(), *words[1:])
            logging.disable(logging.NOTSET)  # a sweep switches it off
            assert ran.returncode == 0, ran.stdout + ran.stderr
        if not is_own:
            done = subprocess.run(
                ["sh", "-ec", "".join(statements)],
                capture_output=True, text=True, env={**os.environ, "PATH": path}, check=False,
            )  # fmt: skip
            assert done.returncode == 0, done.stdout + done.stderr


@pytest.fixture(scope="module")
def page_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """An empty folder in which a page's examples run one after the other."""
    here, folder = Path.cwd(), tmp_path_factory.mktemp("page")
    os.chdir(folder)
    yield folder
    os.chdir(here)


MARKDOWN = Sybil(
    parsers=[myst.PythonCodeBlockParser(), myst.CodeBlockParser("sh", _run), myst.SkipParser()],
    patterns=["README.md", "CONTRIBUTING.md", "docs/*.md", "docs/**/*.md"],
    excludes=["docs/_build/**"],
    fixtures=["page_folder"],
)
RESTRUCTURED = Sybil(
    parsers=[rest.PythonCodeBlockParser(), rest.CodeBlockParser("sh", _run), rest.SkipParser()],
    pattern="docs/**/*.rst",
    excludes=["docs/_build/**"],
    fixtures=["page_folder"],
)

pytest_collect_file = (MARKDOWN + RESTRUCTURED).pytest()
