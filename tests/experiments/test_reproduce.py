"""Reproduction of the paper's experiments: names, folders, report, interruption."""

import json
from dataclasses import replace
from html import unescape
from pathlib import Path
from types import SimpleNamespace

import pytest
from typer.testing import CliRunner

from heliograph.base.errors import HeliographError, MediaError
from heliograph.cli.main import app
from heliograph.experiments import reproduce as book
from heliograph.experiments.report import Context, ExperimentResult, Finding, Table


def test_all_experiments_by_default_and_each_once() -> None:
    assert book.chosen([]) == list(book.EXPERIMENTS)
    assert book.chosen(["fig12", "Fig11", "fig3"]) == ["fig11", "fig3"]


def test_unknown_figure_names_the_nearest() -> None:
    with pytest.raises(HeliographError, match="unknown experiment 'fig133'; did you mean 'fig13'"):
        book.chosen(["fig133"])


def test_every_experiment_can_be_run() -> None:
    for module, _ in (*book.EXPERIMENTS.values(), *book.FURTHER.values()):
        assert callable(__import__(f"heliograph.experiments.{module}", fromlist=["run"]).run)


def test_folder_without_clips_is_refused(tmp_path: Path) -> None:
    with pytest.raises(MediaError, match=r"has no driving/\*\.mp4"):
        book.recordings_in(tmp_path)
    assert book.recordings_in(None) == {}


@pytest.mark.slow
def test_report_pictures_and_data(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["reproduce", "fig5", "table1", "--quick", "--output", str(tmp_path)])
    assert result.exit_code == 0, result.output
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "data:image/png;base64," in page
    assert "http" not in page
    assert "A quick run" in page
    assert (tmp_path / "fig5-1.png").read_bytes().startswith(b"\x89PNG")
    findings = json.loads((tmp_path / "tables.json").read_text())["findings"]
    assert {f["verdict"] for f in findings} <= {"holds", "differs", "shown"}
    assert all(f["claim"] in unescape(page) for f in findings)
    assert not list(tmp_path.glob(".*"))
    again = CliRunner().invoke(app, ["reproduce", "fig5", "table1", "--quick", "--output", str(tmp_path)])
    assert "2 of 2 experiments are complete in" in again.output
    assert (tmp_path / "report.html").read_text(encoding="utf-8") == page


def test_what_was_done_before_an_interruption_is_kept(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done = ExperimentResult("fig5", "first", "text", findings=[Finding("claim", "12 of 13 | more", "holds")])

    def module(name: str) -> SimpleNamespace:
        return SimpleNamespace(
            run=lambda _: done if name.endswith("packet") else (_ for _ in ()).throw(KeyboardInterrupt)
        )

    monkeypatch.setattr(book, "import_module", module)
    with pytest.raises(KeyboardInterrupt):
        book.reproduce(["fig5", "fig3"], Context(), tmp_path, lambda key, title: None)
    assert "12 of 13" in (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "12 of 13 \\| more" in (tmp_path / "report.md").read_text(encoding="utf-8")
    for name in ("report.html", "report.md"):
        assert "Not run yet: fig3." in (tmp_path / name).read_text(encoding="utf-8")


EARLIER = ExperimentResult(
    "fig5", "first", "text", [Finding("claim", "12 of 13", "holds")], (),
    [Table("table", ["a"], [["1"]])], {"n": [1, 2.5, None]}, [(b"\x89PNG", "a picture")],
)  # fmt: skip


def runs(monkeypatch: pytest.MonkeyPatch, broken: bool = False) -> list[str]:
    """Record the names of executed experiments; if `broken`, the second raises KeyboardInterrupt."""
    begun: list[str] = []

    def run(name: str) -> ExperimentResult:
        begun.append(name)
        if broken and len(begun) == 2:
            raise KeyboardInterrupt
        return replace(EARLIER, key={"packet": "fig5", "received": "fig3"}[name.rpartition(".")[2]])

    monkeypatch.setattr(book, "import_module", lambda name: SimpleNamespace(run=lambda _: run(name)))
    return begun


def reproduced(context: Context, folder: Path) -> list[ExperimentResult]:
    before = book.done_before(["fig5", "fig3"], context, folder)
    return book.reproduce(["fig5", "fig3"], context, folder, lambda key, title: None, before)


def test_an_interrupted_run_goes_on_with_what_is_missing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    context = Context(seed=3)
    assert book.done_before(["fig5"], context, tmp_path / "none") == {}
    runs(monkeypatch, broken=True)
    with pytest.raises(KeyboardInterrupt):
        reproduced(context, tmp_path)
    begun = runs(monkeypatch)
    results = reproduced(context, tmp_path)
    assert begun == ["heliograph.experiments.patterns.received"]
    assert results == [EARLIER, replace(EARLIER, key="fig3")]
    assert "Not run yet" not in (tmp_path / "report.html").read_text(encoding="utf-8")
    page = (tmp_path / "report.html").read_bytes()
    assert reproduced(context, tmp_path) == results
    assert len(begun) == 1
    assert (tmp_path / "report.html").read_bytes() == page


def test_a_run_that_ends_in_its_first_experiment_names_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    context = Context()
    runs(monkeypatch)
    book.reproduce(["fig5"], context, tmp_path, lambda key, title: None)

    def interrupt(_: Context) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(book, "import_module", lambda name: SimpleNamespace(run=interrupt))
    with pytest.raises(KeyboardInterrupt):
        reproduced(context, tmp_path)
    assert "Not run yet: fig3." in (tmp_path / "report.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("change", ["seed", "quick", "clip", "code", "picture", "json", "no mapping"])
def test_what_was_done_otherwise_or_is_damaged_is_run_again(
    change: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
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
        (tmp_path / "fig5-1.png").unlink()
    else:
        (tmp_path / "fig5.json").write_text({"json": "{", "no mapping": "[1]"}[change])
    assert "fig5" not in book.done_before(["fig5", "fig3"], context, tmp_path)


def test_recordings_that_are_not_there_leave_no_folder(tmp_path: Path) -> None:
    out = tmp_path / "out"
    result = CliRunner().invoke(app, ["reproduce", "fig5", "--data", str(tmp_path / "none"), "--output", str(out)])
    assert isinstance(result.exception, MediaError)
    assert not out.exists()
