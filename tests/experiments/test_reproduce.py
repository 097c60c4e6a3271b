"""Reproduction of the paper's experiments: names, folders, report, interruption."""

import json
from html import unescape
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace

import pytest
from matplotlib.figure import Figure
from typer.testing import CliRunner

from heliograph.base.errors import HeliographError, MediaError
from heliograph.cli.main import app
from heliograph.experiments import reproduce as book
from heliograph.experiments.report import Context, ExperimentResult, Finding, Table


def test_experiments_are_chosen_by_name() -> None:
    assert book.chosen([]) == [name for name in book.EXPERIMENTS if name != "scenes"]
    assert book.chosen(["fig12", "Fig11", "fig3"]) == ["fig11", "fig3"]
    with pytest.raises(HeliographError, match="unknown experiment 'fig133'; did you mean 'fig13'"):
        book.chosen(["fig133"])
    for module, _ in book.EXPERIMENTS.values():
        assert callable(import_module(f"heliograph.experiments.{module}").run)


def test_folder_without_clips_is_refused(tmp_path: Path) -> None:
    with pytest.raises(MediaError, match=r"has no driving/\*\.mp4"):
        book.recordings_in(tmp_path)
    assert book.recordings_in(None) == {}


@pytest.mark.slow
def test_report_pictures_and_data(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["reproduce", "fig5", "table1", "--quick", "--output", str(tmp_path)])
    assert result.exit_code == 0, result.output
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "data:image/svg+xml;base64," in page
    assert "http" not in page
    assert "A quick run" in page
    assert (tmp_path / "fig5-1.svg").read_bytes().startswith(b"<?xml")
    findings = json.loads((tmp_path / "tables.json").read_text())["findings"]
    assert {f["verdict"] for f in findings} <= {"holds", "differs", "shown"}
    assert all(f["claim"] in unescape(page) for f in findings)
    assert not list(tmp_path.glob(".*"))
    again = CliRunner().invoke(app, ["reproduce", "fig5", "table1", "--quick", "--output", str(tmp_path)])
    assert "2 of 2 experiments are complete in" in again.output
    assert (tmp_path / "report.html").read_text(encoding="utf-8") == page


KEYS = ["fig5", "fig3"]
MADE = ExperimentResult(
    text="text", findings=[Finding("claim", "12 of 13 | more", "holds")], tables=[Table("table", ["a"], [["1"]])],
    data={"n": [1, 2.5, None]}, pictures=[(Figure(figsize=(1, 1)), "a picture")],
)  # fmt: skip


def runs(monkeypatch: pytest.MonkeyPatch, complete: int = 2) -> list[str]:
    """Record the names of executed experiments; raise KeyboardInterrupt after the complete experiments."""
    begun: list[str] = []

    def run(name: str) -> ExperimentResult:
        begun.append(name.removeprefix("heliograph.experiments."))
        if len(begun) > complete:
            raise KeyboardInterrupt
        return MADE

    monkeypatch.setattr(
        book, "import_module", lambda name: SimpleNamespace(run=lambda _: run(name), __doc__="Summary.\n\nMore.")
    )
    return begun


def reproduced(context: Context, folder: Path) -> list[ExperimentResult]:
    before = book.done_before(KEYS, context, folder)
    return book.reproduce(KEYS, context, folder, lambda key, title: None, before)


@pytest.mark.slow
def test_an_interrupted_run_keeps_results_and_continues(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    context, pages = Context(seed=3), (tmp_path / "report.html", tmp_path / "report.md")
    assert book.done_before(["fig5"], context, tmp_path / "none") == {}
    for complete in (1, 0):  # the second run only repeats the report of the earlier result
        begun = runs(monkeypatch, complete)
        with pytest.raises(KeyboardInterrupt):
            reproduced(context, tmp_path)
        assert begun == ["patterns.packet", "patterns.received"][-1 - complete :]
        html, markdown = (page.read_text(encoding="utf-8") for page in pages)
        assert "12 of 13 | more" in html
        assert "12 of 13 \\| more" in markdown
        assert "Not run yet: fig3." in html
        assert "Not run yet: fig3." in markdown
        for page in pages:
            page.unlink()
    begun, results = runs(monkeypatch), reproduced(context, tmp_path)
    assert begun == ["patterns.received"]
    assert {result.key: result.title for result in results} == {key: book.EXPERIMENTS[key][1] for key in KEYS}
    for result in results:
        assert result.text == "text More."
        assert (result.findings, result.tables, result.data) == (MADE.findings, MADE.tables, MADE.data)
        ((picture, caption),) = result.drawn
        assert picture.startswith(b"<?xml")
        assert caption == "a picture"
    content = pages[0].read_bytes()
    assert b"Not run yet" not in content
    assert (reproduced(context, tmp_path), len(begun), pages[0].read_bytes()) == (results, 1, content)


@pytest.mark.parametrize("change", ["seed", "quick", "clip", "code", "picture", "json", "no mapping"])
def test_other_or_damaged_results_are_not_reused(change: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    runs(monkeypatch)
    reproduced(context := Context(), tmp_path)
    if change == "seed":
        context = Context(seed=1)
    elif change == "quick":
        context = Context(quick=False)
    elif change == "clip":
        (tmp_path / "a.mp4").write_bytes(b"film")
        context = Context(clips={"a": tmp_path / "a.mp4"})
    elif change == "code":
        monkeypatch.setattr(book, "build", lambda: "0.0.0")
    elif change == "picture":
        (tmp_path / "fig5-1.svg").unlink()
    else:
        (tmp_path / "fig5.json").write_text({"json": "{", "no mapping": "[1]"}[change])
    assert "fig5" not in book.done_before(KEYS, context, tmp_path)
