"""Batch reception: a line per film, isolated failures, skipping of completed films."""

import json
import os
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_runs import Run, called, failed, grown, heliograph, interrupted, lasting, names, succeeded, within
from made_recordings import write_pictures, write_tiff

from heliograph.cli.options import FilmOptions, ReceiveOptions, SettingsOptions
from heliograph.cli.receive_many import FilmWork, films_of, is_many
from heliograph.sweeps.executors import Workers

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("film")
    succeeded(within(folder, "simulate", "a.h5", *lasting(0.21), "--high", "red light"))
    return folder / "a.h5"


def rows(run: Run) -> dict[str, dict[str, object]]:
    read = [json.loads(line) for line in run.stdout.splitlines()]
    return {row["film"]: row for row in read}


@pytest.mark.parametrize("name", ["shots", "shots/img%04d.png", "m.mraw"])
def test_what_a_film_is_made_of_is_looked_at_again(name: str, tmp_path: Path) -> None:
    levels = np.zeros((3, 8, 8), np.uint8)
    write_pictures(tmp_path / "shots", levels)
    (tmp_path / "m.mraw").write_bytes(bytes(192))
    (tmp_path / "m.cih").write_text("#Camera Information Header")
    work = FilmWork(name, tmp_path / name, ReceiveOptions(FilmOptions(), SettingsOptions("static")))
    before = work.made_of()
    assert before
    assert work.made_of() == before
    part = tmp_path / "m.cih" if name == "m.mraw" else sorted((tmp_path / "shots").iterdir())[1]
    part.write_bytes(part.read_bytes() + b" ")
    assert work.made_of() != before


def test_a_folder_of_films_is_received_and_resumed(
    film: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("in").mkdir()
    for name in ("in/a.h5", "in/b.h5"):
        shutil.copy(film, name)
    Path("in/c.mkv").write_bytes(b"no film")
    Path("in/notes.txt").write_text("not looked at")
    line = ["receive", "in", "--output", "out", "--workers", "1", "--set", "receive.receiver=plain"]
    first = called(*line, capfd=capfd, monkeypatch=monkeypatch)
    assert "1 of 3 films could not be read to the end" in failed(first)
    found = rows(first)
    assert list(found) == ["in/a.h5", "in/b.h5", "in/c.mkv"]
    assert [found[name]["arrays"][0]["packets"] for name in ("in/a.h5", "in/b.h5")] == [2, 2]  # type: ignore[index]
    assert "not a video" in str(found["in/c.mkv"]["error"])
    assert names(tmp_path / "out") == [f"{name}/{file}" for name in ("a.h5", "b.h5") for file in RESULTS]

    # modified and failed films are repeated; other options repeat all films
    os.utime("in/b.h5", (1, 1))
    again = rows(called(*line, capfd=capfd, monkeypatch=monkeypatch))
    assert {name: row.get("kept") for name, row in again.items()} == {
        "in/a.h5": True,
        "in/b.h5": None,
        "in/c.mkv": None,
    }
    other = rows(called(*line, "--set", "receive.turbo.iterations=3", capfd=capfd, monkeypatch=monkeypatch))
    assert not any(row.get("kept") for row in other.values())


def test_stacks_and_folders_of_pictures_are_films_of_a_folder(tmp_path: Path) -> None:
    levels = np.zeros((3, 8, 8), np.uint8)
    shots = write_pictures(tmp_path / "shots", levels)
    assert films_of([shots]) == ([shots], [])
    assert not is_many([shots])
    assert is_many([tmp_path])  # parent of a picture folder
    assert films_of([tmp_path]) == ([shots], [])
    stacks = [write_tiff(tmp_path / name, levels) for name in ("b.tif", "c.tiff")]
    assert films_of([tmp_path]) == ([*stacks, shots], [])
    (tmp_path / "notes").mkdir()
    write_pictures(tmp_path, levels[:1], "loose%d.png")
    films, (left_out,) = films_of([tmp_path])
    assert films == [*stacks, shots]
    assert "ignoring 1 picture and 1 folder in this folder of films" in left_out
    # single pages are the frames of one film
    pages = write_pictures(tmp_path / "pages", levels, "page%d.tif")
    assert films_of([pages]) == ([pages], [])


RESULTS = ["array-0-high-0.bin", "packets.jsonl", "summary.json"]


def test_workers_read_films_side_by_side(film: Path, tmp_path: Path) -> None:
    shutil.copy(film, tmp_path / "b.h5")
    run = heliograph("receive", film, "b.h5", "--workers", "2", "--receiver", "plain", cwd=tmp_path)
    assert len(rows(run)) == 2
    assert {len(row["arrays"]) for row in rows(run).values()} == {1}  # type: ignore[arg-type]
    assert succeeded(run).count("\n") == 2


@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
def test_films_are_received_on_a_cluster(
    film: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    distributed = pytest.importorskip("distributed")
    monkeypatch.chdir(tmp_path)
    shutil.copy(film, "b.h5")
    Path("c.mkv").write_bytes(b"no film")
    line: list[str | Path] = ["receive", film, "b.h5", "c.mkv", "--output", "out", "--scheduler"]
    with distributed.LocalCluster(n_workers=1, threads_per_worker=1, dashboard_address=":0") as cluster:
        # the worker keeps its initial working directory
        Path("client").mkdir()
        shutil.move("b.h5", "client")
        shutil.move("c.mkv", "client")
        monkeypatch.chdir("client")
        Path("s.toml").write_text("receive.receiver = 'plain'\n")
        line += [cluster.scheduler_address, "--settings", "s.toml"]
        run = called(*line, capfd=capfd, monkeypatch=monkeypatch)
    assert run.returncode == 1
    assert "1 of 3 films could not be read to the end" in run.stderr
    found = rows(run)
    assert [len(found[name]["arrays"]) for name in (str(film), "b.h5")] == [1, 1]  # type: ignore[arg-type]
    assert "not a video" in str(found["c.mkv"]["error"])
    assert names(Path("out")) == [f"{name}/{file}" for name in ("a.h5", "b.h5") for file in RESULTS]
    assert not Path("../out").exists()


class Elsewhere(Workers):
    """Worker on another machine, with equal paths but a separate disk."""

    def __init__(self, disk: Path):
        self.disk = disk

    def submit(self, job: Any, work: Any) -> Any:
        def moved(path: Path) -> Path:
            return self.disk / path.relative_to("/")

        results = replace(work.options.results, output=moved(work.options.results.output))
        work = replace(work, path=moved(work.path), options=replace(work.options, results=results))
        return super().submit(job, work)


@pytest.mark.parametrize("film_is_there", [True, False])
def test_results_that_do_not_arrive_are_missed(
    film: Path,
    film_is_there: bool,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    client, disk = tmp_path / "client", tmp_path / "disk"
    there = disk / client.relative_to("/")
    there.mkdir(parents=True)
    client.mkdir()
    shutil.copy(film, client)
    if film_is_there:
        shutil.copy(film, there)
    monkeypatch.chdir(client)
    monkeypatch.setattr("heliograph.cli.receive_many.open_workers", lambda *_: Elsewhere(disk))
    line = ("receive", "a.h5", "--receiver", "plain", "--output", "out", "--scheduler", "tcp://192.0.2.1:1")
    run = called(*line, capfd=capfd, monkeypatch=monkeypatch)
    row = rows(run)["a.h5"]
    if film_is_there:
        assert "the results of 1 of 1 films are not in out" in failed(run)
        assert len(row["arrays"]) == 1  # type: ignore[arg-type]
    else:
        assert "1 of 1 films could not be read" in failed(run)
        assert (
            row["error"]
            == f"the worker has no file {client / 'a.h5'}: all machines need this folder under the same name"
        )
    assert not (client / "out").exists()


def test_ctrl_c_keeps_the_films_that_are_done(film: Path, tmp_path: Path) -> None:
    shutil.copy(film, tmp_path / "a.h5")
    succeeded(within(tmp_path, "simulate", "long.h5", *lasting(2), "--high", "red light"))
    line = ("receive", "a.h5", "long.h5", "--workers", "1", "--receiver", "plain", "--output", "out")
    run = interrupted(*line, cwd=tmp_path, when=grown(tmp_path, "out/long.h5/.*partial*"))
    assert "interrupted after 1 of 2 films; the same command continues" in failed(run, 130)
    assert list(rows(run)) == ["a.h5"]
    assert names(tmp_path / "out" / "a.h5") == RESULTS
    assert not list((tmp_path / "out").glob("*/.*partial*"))
    # the completed film is skipped, the interrupted film is repeated
    again = rows(within(tmp_path, *line))
    assert [again[name].get("kept") for name in ("a.h5", "long.h5")] == [True, None]
    assert again["long.h5"]["frames"] == 2000


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("a.h5", "b.h5", "--follow"), "accept a single film"),
        (("a.h5", "camera:genicam"), "camera:genicam is a live camera: receive it separately"),
        (("camera:genicam", "--workers", "1"), "is a live camera: receive it separately"),
        (("a.h5", "b/a.h5", "--output", "out"), "several films have the name a.h5"),
        (("a.h5", "b.h5", "--workers", "2", "--scheduler", "tcp://127.0.0.1:1"), "not both"),
        (("a.h5", "b.h5", "--set", "receive.receiver=nobody"), "nobody"),
    ],
)
def test_what_cannot_be_is_said_once(
    arguments: tuple[str, ...],
    words: str,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    run = called("receive", *arguments, capfd=capfd, monkeypatch=monkeypatch)
    assert words in failed(run, run.returncode)
    assert run.returncode in (1, 2)
    assert not names(tmp_path)
