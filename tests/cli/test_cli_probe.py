"""`heliograph probe`, and diagnoses from `receive` without an array: text, HTML, JSON, exit status."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from cli_runs import Run, called, failed, interrupted, names, succeeded
from faulty_films import FAULTY, RIGHT, KeptFilm, film, link, write

from heliograph.cli.console import NO_ARRAY

pytestmark = pytest.mark.slow

Command = Callable[..., Run]


@pytest.fixture(scope="module")
def films(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("films")
    write(RIGHT["right"](), folder / "right.h5")
    write(FAULTY["out of step"](), folder / "out-of-step.h5")
    write(FAULTY["cut"](), folder / "cut.h5")
    write(FAULTY["mislabelled"](), folder / "mislabelled.h5")
    write(FAULTY["nothing blinks"](), folder / "still.h5")
    whole = (folder / "right.h5").read_bytes()
    (folder / "half.h5").write_bytes(whole[: len(whole) // 2])
    (folder / "words.mkv").write_bytes(b"no film" * 1000)
    return folder


@pytest.fixture
def run(capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Command:
    monkeypatch.chdir(tmp_path)
    return lambda *arguments: called(*arguments, capfd=capfd, monkeypatch=monkeypatch)


def told_nothing(told: Run) -> str:
    """Check that a run succeeded without an array; return its output."""
    assert told.returncode == NO_ARRAY, told.stdout + told.stderr
    assert told.stderr == ""
    return told.stdout


def test_a_film_that_is_read_is_told_all_that_it_shows(films: Path, run: Command, tmp_path: Path) -> None:
    out = succeeded(run("probe", films / "right.h5", "--output", tmp_path / "seen"))
    for word in ("1000 frames a second", "array 0: upright", "contrast 0.80", "codewords read: high 1 of 1", "to 62 m"):
        assert word in out
    assert names(tmp_path / "seen") == ["probe.html"]


def test_a_film_that_is_not_read_is_told_why_and_what_to_change(films: Path, run: Command) -> None:
    out = told_nothing(run("probe", films / "out-of-step.h5"))
    assert "out of step: patterns begin 0.50 of a pattern" in out
    assert "read it by --receiver soft" in out
    assert "array 0: upright" in succeeded(run("probe", films / "out-of-step.h5", "--receiver", "soft"))


def test_what_is_advised_helps(films: Path, run: Command) -> None:
    assert "--fps 1000" in run("probe", films / "mislabelled.h5").stdout
    assert "array 0: upright" in succeeded(run("probe", films / "mislabelled.h5", "--fps", "1000"))


def test_the_same_as_json(films: Path, run: Command) -> None:
    row = json.loads(told_nothing(run("probe", films / "cut.h5", "--json")))
    assert not row["array_read"]
    assert row["regions"][0]["causes"][0]["kind"] == "cut"
    assert row["advice"]


def test_receive_says_in_short_why_it_found_nothing(films: Path, run: Command, tmp_path: Path) -> None:
    out = told_nothing(run("receive", films / "cut.h5", "--output", tmp_path / "got"))
    assert "no array found" in out
    assert "cut: it reaches the frame's border" in out
    assert "  - turn the camera" in out
    summary = json.loads((tmp_path / "got" / "summary.json").read_text())
    assert summary["probe"]["regions"][0]["causes"][0]["kind"] == "cut"
    assert json.loads(told_nothing(run("receive", films / "cut.h5", "--json")))["probe"]["advice"]


@pytest.mark.parametrize("command", ["receive", "probe"])
def test_a_film_that_its_receiver_refuses_is_told_more_and_is_an_error(films: Path, run: Command, command: str) -> None:
    told = run(command, films / "mislabelled.h5")
    assert "the plain receiver needs one frame a pattern" in failed(told)
    assert "--fps 1000" in told.stdout


def test_what_is_read_needs_no_word(films: Path, run: Command) -> None:
    assert "probe" not in json.loads(succeeded(run("receive", films / "right.h5", "--json")))


def test_of_several_films_one_that_is_read_is_a_success(films: Path, run: Command) -> None:
    def rows(told: Run) -> list[dict[str, Any]]:
        return sorted(map(json.loads, told.stdout.splitlines()), key=lambda row: str(row["film"]))

    both = run("receive", films / "right.h5", films / "still.h5", "--workers", "1")
    assert both.returncode == 0
    right, still = rows(both)
    assert "probe" not in right
    assert still["probe"]["causes"][0]["kind"] == "still"
    neither = run("receive", films / "still.h5", "--workers", "1")
    assert neither.returncode == NO_ARRAY
    assert rows(neither)[0]["arrays"] == []


@pytest.mark.parametrize(
    ("film", "word"),
    [("half.h5", "ends in the middle"), ("words.mkv", "is not a video"), ("nobody.mkv", "there is no file")],
)
def test_what_is_no_film_gets_one_clear_line(films: Path, run: Command, film: str, word: str) -> None:
    assert word in failed(run("probe", films / film))


def test_options_that_cannot_be_get_one_clear_line(films: Path, run: Command, tmp_path: Path) -> None:
    film = films / "right.h5"
    assert "receive.nothing" in failed(run("probe", film, "--set", "receive.nothing=1"))
    assert "nobody" in failed(run("probe", film, "--receiver", "nobody"))
    assert "--crop" in failed(run("probe", film, "--crop", "a,b"))
    assert "--frames" in failed(run("probe", film, "--frames", "0"), 2)
    (tmp_path / "a-file").touch()
    assert "a-file" in failed(run("probe", film, "--output", tmp_path / "a-file"))


def test_ctrl_c_keeps_what_was_seen(tmp_path: Path) -> None:
    frames = film(link(camera={"width": 48, "height": 48}))
    longer = [replace(frames[k % len(frames)], index=k, time_s=k / 1000) for k in range(3000)]
    write(KeptFilm(longer), tmp_path / "long.h5")
    told = interrupted("probe", "long.h5", "--output", "seen", cwd=tmp_path, when=lambda: (tmp_path / "seen").exists())
    assert "interrupted" in failed(told, 130)
    assert set(names(tmp_path / "seen")) <= {"probe.html"}
