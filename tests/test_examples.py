"""Run each example unchanged in an empty folder."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from waiting import HANG_S

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
@pytest.mark.slow
def test_an_example_runs_and_writes_what_it_says(name: str, tmp_path: Path) -> None:
    pytest.importorskip("xarray")
    if name == "own_code":
        pytest.importorskip("ldpc")
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, str(EXAMPLES / f"{name}.py"), "--few"]
    ran = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=HANG_S)
    assert ran.returncode == 0, ran.stderr
    assert sorted(path.name for path in tmp_path.iterdir()) == PICTURES[name]
    assert ran.stdout
