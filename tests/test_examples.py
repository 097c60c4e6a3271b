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


RUN = """
import contextlib, os, runpy, sys
for example in sys.argv[1:]:
    name = os.path.basename(example).removesuffix(".py")
    os.makedirs(name)
    with contextlib.chdir(name), open("printed", "w") as printed, contextlib.redirect_stdout(printed):
        sys.argv = [example, "--few"]
        runpy.run_path(example, run_name="__main__")
"""
"""One process for all: each loads the same libraries."""


@pytest.mark.slow
def test_examples_run_and_write_what_they_say(tmp_path: Path) -> None:
    pytest.importorskip("xarray")
    pytest.importorskip("ldpc")
    command = [sys.executable, "-c", RUN, *(str(EXAMPLES / f"{name}.py") for name in PICTURES)]
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}
    ran = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=HANG_S)
    assert ran.returncode == 0, ran.stderr
    for name, written in PICTURES.items():
        assert sorted(path.name for path in (tmp_path / name).iterdir()) == sorted([*written, "printed"])
        assert (tmp_path / name / "printed").read_text()
