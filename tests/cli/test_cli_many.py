"""Batch reception: a line per film, isolated failures, skipping of completed films."""

import json
import os
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_runs import Call, Run, failed, lasting, names, succeeded, within
from made_recordings import write_pictures, write_tiff

from heliograph.base import registry
from heliograph.cli.options import FilmOptions, OutputOptions, ReceiveOptions, SettingsOptions
from heliograph.cli.receive import FilmWork, films_of, is_many
from heliograph.sweeps.executors import Workers

pytestmark = pytest.mark.slow

RESULTS = ("array-0-high-0.bin", "packets.jsonl", "summary.json")
BOTH = [f"{film}/{name}" for film in ("a.h5", "b.h5") for name in RESULTS]
PLAIN = ("--receiver", "plain")


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("film")
    succeeded(within(folder, "simulate", "a.h5", *lasting(0.21), "--high", "red light"))
    return folder / "a.h5"


def rows(run: Run) -> dict[str, dict[str, Any]]:
    return {row["film"]: row for row in map(json.loads, run.stdout.splitlines())}


def request(*options: Any) -> ReceiveOptions:
    return ReceiveOptions(FilmOptions(), SettingsOptions("static"), *options)


@pytest.mark.parametrize("name", ["shots", "shots/img%04d.png", "m.mraw"])
def test_a_change_of_any_file_of_a_film_changes_its_origin(name: str, tmp_path: Path) -> None:
    write_pictures(tmp_path / "shots", np.zeros((3, 8, 8), np.uint8))
    (tmp_path / "m.mraw").write_bytes(bytes(192))
    (tmp_path / "m.cih").write_text("#Camera Information Header")
    work = FilmWork(name, tmp_path / name, request())
    before = work.made_of()
    assert before == work.made_of() != {}
    part = tmp_path / ("m.cih" if name == "m.mraw" else "shots/img0002.png")
    part.write_bytes(part.read_bytes() + b" ")
    assert work.made_of() != before


def test_a_folder_of_films_is_received_and_resumed(film: Path, call: Call) -> None:
    Path("in").mkdir()
    for name in ("in/a.h5", "in/b.h5"):
        shutil.copy(film, name)
    Path("in/c.mkv").write_bytes(b"no film")
    Path("in/notes.txt").write_text("ignored")
    line = ["receive", "in", "--output", "out", "--workers", "1", "--set", "receive.receiver=plain"]
    first = call(*line)
    assert "1 of 3 films could not be read to the end" in failed(first)
    found = rows(first)
    assert list(found) == ["in/a.h5", "in/b.h5", "in/c.mkv"]
    assert [found[name]["arrays"][0]["packets"] for name in ("in/a.h5", "in/b.h5")] == [2, 2]
    assert "not a video" in found["in/c.mkv"]["error"]
    assert names(Path("out")) == BOTH

    # modified and failed films are repeated; other options repeat all films
    os.utime("in/b.h5", (1, 1))
    assert [row.get("kept") for row in rows(call(*line)).values()] == [True, None, None]
    assert not any(row.get("kept") for row in rows(call(*line, "--set", "receive.turbo.iterations=3")).values())


def test_stacks_and_folders_of_pictures_are_films_of_a_folder(tmp_path: Path) -> None:
    levels = np.zeros((3, 8, 8), np.uint8)
    shots = write_pictures(tmp_path / "shots", levels)
    assert (films_of([shots]), is_many([shots])) == (([shots], []), False)
    assert (films_of([tmp_path]), is_many([tmp_path])) == (([shots], []), True)  # parent of a picture folder
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


def test_worker_processes_receive_films(film: Path, call: Call) -> None:
    shutil.copy(film, "b.h5")
    run = call("receive", film, "b.h5", "--workers", "2", *PLAIN)
    assert ([len(row["arrays"]) for row in rows(run).values()], succeeded(run).count("\n")) == ([1, 1], 2)


@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
def test_a_cluster_receives_films(film: Path, call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    distributed = pytest.importorskip("distributed")
    monkeypatch.setattr(registry, "_failures", None)  # the worker is this process
    shutil.copy(film, "b.h5")
    Path("c.mkv").write_bytes(b"no film")
    Path("s.toml").write_text("receive.receiver = 'plain'\n")
    line = ("receive", film, "b.h5", "c.mkv", "--output", "out", "--settings", "s.toml", "--scheduler")
    alone = {"n_workers": 1, "threads_per_worker": 1, "dashboard_address": ":0", "processes": False}
    with distributed.LocalCluster(**alone, protocol="tcp") as cluster:
        run = call(*line, cluster.scheduler_address)
    assert "1 of 3 films could not be read to the end" in run.stderr
    found = rows(run)
    assert (run.returncode, [len(found[name]["arrays"]) for name in (str(film), "b.h5")]) == (1, [1, 1])
    assert "not a video" in found["c.mkv"]["error"]
    assert names(Path("out")) == BOTH


def test_a_worker_with_another_working_directory_has_absolute_paths() -> None:
    settings, folder = SettingsOptions("static", Path("s.toml")), Path("/client")
    sent = ReceiveOptions(FilmOptions(), settings, OutputOptions(Path("out"), Path("got")))
    moved = sent.for_film(Path("in/a.h5"), folder)
    assert moved.settings.settings_file == folder / "s.toml"
    assert moved.results == OutputOptions(folder / "out/a.h5", folder / "got")
    assert sent.for_film(Path("a.h5"), Path()).results.output == Path("out/a.h5")


class Elsewhere(Workers):
    """Worker on another machine, with a separate disk."""

    def submit(self, job: Any, work: Any) -> Any:
        return super().submit(job, replace(work, options=replace(work.options, results=OutputOptions())))


def test_missing_results_of_a_worker_are_an_error(film: Path, call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("heliograph.cli.receive.open_workers", lambda *_: Elsewhere())
    run = call("receive", film, *PLAIN, "--output", "out", "--scheduler", "tcp://192.0.2.1:1")
    assert "the results of 1 of 1 films are not in out" in failed(run)
    assert len(rows(run)[str(film)]["arrays"]) == 1
    assert not Path("out").exists()
