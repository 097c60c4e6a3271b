"""Run each example unchanged in an empty folder."""

import runpy
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"

PICTURES = {
    "error_rates": [],
    "own_receiver": ["own_receiver.png"],
    "own_code": ["own_code.png"],
    "eight_by_eight": ["eight_by_eight.csv", "eight_by_eight.png"],
    "any_panel": ["any_panel.png"],
    "data_set": ["data_set", "data_set.png"],
}


SERVED = {"fake_camera"}
"""Examples that serve frames until stopped; tests/cli/test_live_aravis.py receives these frames."""


def test_each_example_is_run() -> None:
    assert {path.stem for path in EXAMPLES.glob("*.py")} == {*PICTURES, *SERVED}


@pytest.mark.parametrize("name", PICTURES)
@pytest.mark.filterwarnings("default")
@pytest.mark.slow
def test_example_prints_results_and_writes_its_files(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("xarray")
    pytest.importorskip("ldpc")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [f"{name}.py", "--few"])
    runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")
    assert capsys.readouterr().out
    assert sorted(path.name for path in tmp_path.iterdir()) == PICTURES[name]
