"""Table of published systems."""

import csv
from pathlib import Path

DOCS = Path(__file__).parents[2] / "docs"


def test_every_system_has_a_source_and_stands_on_the_page_and_in_the_figure() -> None:
    with (DOCS / "published-systems.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    page, figure = ((DOCS / name).read_text() for name in ("published-systems.md", "pictures/published-systems.svg"))
    assert len({row["system"] for row in rows}) == len(rows) >= 15
    for row in rows:
        assert row["source"]
        assert row["read"] in ("text", "abstract", "citation")
        numbers = [float(row[key]) for key in ("distance_m", "rate_bit_s", "electrons_bit") if row[key]]
        assert numbers
        assert all(number > 0 for number in numbers)
        assert f"| {row['system']} | {row['year']} |" in page
        if row["rate_bit_s"] and (row["distance_m"] or row["electrons_bit"]):
            # Matplotlib writes a text as outlines after a comment
            assert f"<!-- {row['system'].split(' (')[0]} -->" in figure
