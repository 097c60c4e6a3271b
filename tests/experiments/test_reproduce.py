"""The paper's experiments as a whole: names, folders, report, interruption."""

import json
from pathlib import Path
from types import SimpleNamespace

import pytest
from typer.testing import CliRunner

from heliograph.base.errors import HeliographError, MediaError
from heliograph.cli.main import app
from heliograph.experiments import reproduce as book
from heliograph.experiments.result import Context, ExperimentResult, Finding


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
    assert all(f["claim"] in page.replace("&#x27;", "'").replace("&quot;", '"') for f in findings)
    assert not list(tmp_path.glob(".*"))


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
