import re
import runpy
from dataclasses import fields
from importlib import import_module
from pathlib import Path

import pytest
from benchmarks.constants import constants, page

from heliograph.media.live.settings import CameraSettings

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"

ROW = re.compile(
    r"^\| (?P<term>[^|]+?) \| (?P<symbol>[^|]*?) ?\| (?P<meaning>[^|]+?) \| (?P<where>\S+) \|$", re.MULTILINE
)
TERMS = [row for row in ROW.findall((DOCS / "glossary.md").read_text()) if row[0] != "term" and "---" not in row[0]]


def test_settings_page_is_what_the_code_says() -> None:
    made = runpy.run_path(str(ROOT / "scripts" / "make_settings.py"))["page"]()
    assert (DOCS / "settings.md").read_text() == made, "run make settings"


def test_the_page_on_cameras_has_each_setting() -> None:
    named = set(re.findall(r"^\| `(\w+)` \|", (DOCS / "cameras.md").read_text(), re.MULTILINE))
    # those have options of their own, or names of the camera's
    assert named == {field.name for field in fields(CameraSettings)} - {"duration_s", "channel", "features"}


def test_glossary_has_its_terms() -> None:
    assert len(TERMS) > 80
    assert len({term for term, *_ in TERMS}) == len(TERMS)


def test_each_symbol_of_the_glossary_stands_for_one_term() -> None:
    symbols = [one.strip() for _, column, *_ in TERMS for one in re.split("[,;=]", column) if one.strip()]
    assert [one for one in symbols if symbols.count(one) > 1] == []


@pytest.mark.parametrize("row", TERMS, ids=lambda row: row[0].replace(" ", "-"))
def test_term_is_defined_where_the_glossary_says(row: tuple[str, str, str, str]) -> None:
    where = row[3]
    if "#" in where:
        page, _, anchor = where.partition("#")
        assert anchor in anchors((DOCS / page).read_text())
        return
    parts, found = where.split("."), None
    for end in range(len(parts), 0, -1):
        try:
            found = import_module(".".join(["heliograph", *parts[:end]]))
        except ModuleNotFoundError:
            continue
        break
    assert found is not None
    for name in parts[end:]:
        assert _has(found, name), f"{where} has no {name}"
        found = getattr(found, name, None)


def _has(found: object, name: str) -> bool:
    """Whether something has an attribute, be it only in its annotations or its docstring."""
    annotated = name in getattr(found, "__annotations__", {}) or f"{name}\n" in (found.__doc__ or "")
    return hasattr(found, name) or annotated


ANCHORED_LEVELS = 3
"""Levels of headings that get anchors on the site: `myst_heading_anchors` of docs/conf.py."""

LINK = re.compile(r"\]\((?!https?:)([^)#\s]*)(?:#([^)\s]*))?\)")
PAGES = [*sorted(DOCS.rglob("*.md")), *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md"))]


def anchors(text: str) -> set[str]:
    """Anchors of a page's headings, as MyST and GitHub make them."""
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


def test_each_constant_of_the_receivers_stands_with_its_value() -> None:
    rows = dict(re.findall(r"^\| `([^`]+)` \| (.+?) \|", (DOCS / "constants.md").read_text(), re.M))
    assert rows == {one.key: one.text for one in constants()}


def test_what_the_page_of_constants_says_is_what_its_command_writes() -> None:
    made = page({"as it is": {"1": {"a scene": [1, 0, 0]}}}, [])
    before = "Codewords read with all constants as they are"
    assert (DOCS / "constants.md").read_text().partition(before)[0] == made.partition(before)[0]
