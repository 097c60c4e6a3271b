"""Code blocks of the documentation as tests, the order of all tests, and registered parts of a single file."""

import os
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import pytest

# set before the NumPy import: two test processes with two BLAS threads each wait for each other, and the matrices are
# too small for threads. Tests of the thread limit set other counts
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

from sybil import Example, Sybil
from sybil.parsers import myst, rest


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Start with the files that have the most slow tests and examples: at the end no process waits for long."""
    slow = Counter(item.path for item in items if item.path.suffix != ".py" or item.get_closest_marker("slow"))
    items.sort(key=lambda item: -slow[item.path])


def _run(example: Example) -> None:
    from cli_runs import run_script

    run_script(example.parsed)


@pytest.fixture(scope="module", autouse=True)
def own_parts() -> Iterator[None]:
    """Begin each file without the registered parts of others, and without the failures of a worker in this process."""
    from heliograph.base import registry

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(registry, "_files", {})
        patch.setattr(registry, "_failures", None)
        for parts in registry._registries.values():
            patch.setattr(parts, "_registered", {})
            patch.setattr(parts, "origins", {})
        yield


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
