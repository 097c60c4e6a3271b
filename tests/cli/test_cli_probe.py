"""`heliograph probe`, and diagnoses from `receive` without an array: text, HTML, JSON, exit status."""

import json
from pathlib import Path
from typing import Any

import pytest
from cli_runs import Call, Run, failed, names, succeeded
from faulty_films import FAULTY, kept, link, write

from heliograph.cli.console import NO_ARRAY

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def films(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("films")
    write(kept(link()), folder / "right.h5")
    for name, fault in (("out-of-step", "out of step"), ("cut", "cut"), ("mislabelled", "mislabelled"),
                        ("still", "nothing blinks")):  # fmt: skip
        write(FAULTY[fault](), folder / f"{name}.h5")
    return folder


def told_nothing(told: Run) -> str:
    """Check that a run succeeded without an array; return its output."""
    assert told.returncode == NO_ARRAY, told.stdout + told.stderr
    assert told.stderr == ""
    return told.stdout


def test_probe_describes_a_readable_film(films: Path, call: Call, tmp_path: Path) -> None:
    out = succeeded(call("probe", films / "right.h5", "--output", tmp_path / "seen"))
    for word in ("1000 frames a second", "array 0: upright", "contrast 0.80", "codewords read: high 1 of 1", "to 63 m"):
        assert word in out
    assert names(tmp_path / "seen") == ["probe.html"]


def test_probe_explains_an_unreadable_film_and_the_remedy(films: Path, call: Call) -> None:
    out = told_nothing(call("probe", films / "out-of-step.h5", "--receiver", "plain"))
    assert "out of step: patterns begin 0.50 of a pattern" in out
    assert "read it by --receiver soft" in out
    assert "array 0: upright" in succeeded(call("probe", films / "out-of-step.h5"))


def test_the_advised_frame_rate_helps(films: Path, call: Call) -> None:
    mislabelled = films / "mislabelled.h5"
    assert "array 0: upright" in succeeded(call("probe", mislabelled, "--fps", "1000"))
    assert "array 0: 1 packet" in succeeded(call("receive", mislabelled, "--fps", "1000"))


def test_probe_prints_json(films: Path, call: Call) -> None:
    row = json.loads(told_nothing(call("probe", films / "still.h5", "--json")))
    assert not row["array_read"]
    assert row["causes"][0]["kind"] == "still"
    assert row["advice"]


def test_receive_explains_a_missing_array_in_short(films: Path, call: Call, tmp_path: Path) -> None:
    out = told_nothing(call("receive", films / "cut.h5", "--output", tmp_path / "got"))
    assert "no array found" in out
    assert "cut: it reaches the frame's border" in out
    assert "  - turn the camera" in out
    summary = json.loads((tmp_path / "got" / "summary.json").read_text())
    assert summary["probe"]["regions"][0]["causes"][0]["kind"] == "cut"
    assert summary["probe"]["advice"]


@pytest.mark.parametrize("command", ["receive", "probe"])
def test_a_refused_film_is_an_error_with_advice(films: Path, call: Call, command: str) -> None:
    told = call(command, films / "mislabelled.h5")
    assert "the plain receiver needs one frame per pattern" in failed(told)
    assert "--fps 1000" in told.stdout


def test_one_readable_film_of_several_is_a_success(films: Path, call: Call) -> None:
    def rows(told: Run) -> list[dict[str, Any]]:
        return sorted(map(json.loads, told.stdout.splitlines()), key=lambda row: str(row["film"]))

    both = call("receive", films / "right.h5", films / "still.h5", "--workers", "1")
    assert both.returncode == 0
    right, still = rows(both)
    assert "probe" not in right
    assert still["probe"]["causes"][0]["kind"] == "still"
    neither = call("receive", films / "still.h5", "--workers", "1")
    assert (neither.returncode, rows(neither)[0]["arrays"]) == (NO_ARRAY, [])
