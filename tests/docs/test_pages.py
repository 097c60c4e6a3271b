import re
import runpy
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"

ROW = re.compile(
    r"^\| (?P<term>[^|]+?) \| (?P<symbol>[^|]*?) ?\| (?P<meaning>[^|]+?) \| (?P<where>\S+) \|$", re.MULTILINE
)
TERMS = [row for row in ROW.findall((DOCS / "glossary.md").read_text()) if row[0] != "term" and "---" not in row[0]]


def test_settings_page_is_what_the_code_says() -> None:
    made = runpy.run_path(str(ROOT / "scripts" / "make_settings.py"))["page"]()
    assert (DOCS / "settings.md").read_text() == made, "run make settings"


def test_glossary_has_its_terms() -> None:
    assert len(TERMS) > 80
    assert len({term for term, *_ in TERMS}) == len(TERMS)


@pytest.mark.parametrize("row", TERMS, ids=lambda row: row[0].replace(" ", "-"))
def test_term_is_defined_where_the_glossary_says(row: tuple[str, str, str, str]) -> None:
    where = row[3]
    if "#" in where:
        page, _, anchor = where.partition("#")
        titles = re.findall(r"^#+ (.+)$", (DOCS / page).read_text(), re.MULTILINE)
        assert anchor in {re.sub(r"[^\w]+", "-", title.lower()).strip("-") for title in titles}
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


LINK = re.compile(r"\]\((?!https?:)([^)#\s]+)(?:#[^)]*)?\)")


@pytest.mark.parametrize("page", [*sorted(DOCS.rglob("*.md")), ROOT / "README.md", ROOT / "CONTRIBUTING.md"], ids=str)
def test_links_between_pages_lead_somewhere(page: Path) -> None:
    if "_build" in page.parts:
        return
    for target in LINK.findall(page.read_text()):
        assert (page.parent / target).exists() or target.endswith("cli.md"), f"{page.name}: {target}"
