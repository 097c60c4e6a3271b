import re
import runpy
from dataclasses import fields
from pathlib import Path

import matplotlib.pyplot as plt
import nbformat
import pytest
from cli_runs import run_script

from heliograph.media.live.settings import CameraSettings

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"


@pytest.mark.slow
def test_settings_page_matches_the_code() -> None:
    made = runpy.run_path(str(ROOT / "scripts" / "make_settings.py"))["page"]()
    assert (DOCS / "settings.md").read_text() == made, "run make settings"


def test_the_page_on_cameras_has_each_setting() -> None:
    named = set(re.findall(r"^\| `(\w+)` \|", (DOCS / "cameras.md").read_text(), re.MULTILINE))
    # these fields have separate options or camera feature names
    assert named == {field.name for field in fields(CameraSettings)} - {"duration_s", "channel", "features"}


def test_features_name_existing_tests() -> None:
    named = re.findall(r"(tests/\S+\.py)::(\w+)", (ROOT / "tests" / "README.md").read_text())
    assert len(named) > 40
    for path, name in named:
        assert re.search(rf"def {name}\b", (ROOT / path).read_text()), f"{path} has no {name}"


ANCHORED_LEVELS = 3  # heading levels with anchors on the site: `myst_heading_anchors` in docs/conf.py
LINK = re.compile(r"\]\((?!https?:)([^)#\s]*)(?:#([^)\s]*))?\)")
PAGES = [
    *sorted(DOCS.rglob("*.md")),
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "tests/README.md")),
]


def anchors(text: str) -> set[str]:
    """Return heading anchors as MyST and GitHub generate them."""
    found: set[str] = set()
    prose = re.sub(r"^```.*?^```$", "", text, flags=re.MULTILINE | re.DOTALL)
    for marks, title in re.findall(r"^(#+) (.+)$", prose, re.MULTILINE):
        slug = re.sub(r"[^\w\- ]", "", title.strip().lower()).replace(" ", "-")
        same = [slug, *(f"{slug}-{number}" for number in range(1, 100))]
        if len(marks) <= ANCHORED_LEVELS:
            found.add(next(one for one in same if one not in found))
    return found


def test_anchors_are_those_of_the_site() -> None:
    text = (
        "# A page\n## What is lost, and why\n```\n# no heading\n```\n### Times of `k.py`, 2\n## A page\n#### Too deep\n"
    )
    assert anchors(text) == {"a-page", "what-is-lost-and-why", "times-of-kpy-2", "a-page-1"}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_between_pages_lead_somewhere(page: Path) -> None:
    if "_build" in page.parts:
        return
    for target, anchor in LINK.findall(page.read_text()):
        there = page.parent / target if target else page
        assert there.exists() or target.endswith("cli.md"), f"{page.name}: {target}"
        if anchor and there.suffix == ".md" and there.exists():
            assert anchor in anchors(there.read_text()), f"{page.name}: {target}#{anchor}"


NOTEBOOKS = sorted((DOCS / "notebooks").glob("*.ipynb"))


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks_store_outputs_and_no_trace_of_a_machine(path: Path) -> None:
    notebook = nbformat.read(path, as_version=4)
    assert set(notebook.metadata) <= {"kernelspec", "language_info"}
    assert all(not cell.metadata for cell in notebook.cells)
    assert any("image/png" in output.get("data", {}) for cell in notebook.cells for output in cell.get("outputs", []))
    assert not any(folder in path.read_text() for folder in ("/home/", "/tmp/", "/work/", "/root/"))


@pytest.mark.slow
@pytest.mark.filterwarnings("default")
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_notebooks_run(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The cells run in this process, which saves the start of a kernel for each notebook."""
    monkeypatch.chdir(tmp_path)
    namespace: dict[str, object] = {"__name__": "__main__"}
    for cell in nbformat.read(path, as_version=4).cells:
        if cell.cell_type == "code" and cell.source.startswith("%%sh\n"):
            run_script(f"{cell.source.removeprefix('%%sh')}\n")
        elif cell.cell_type == "code":
            exec(compile(cell.source, str(path), "exec"), namespace)
    plt.close("all")
