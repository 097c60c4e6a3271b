"""Ctrl-C ends each command cleanly and keeps the results so far."""

import json
import shutil
import signal
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from cli_runs import SMALL, failed, grown, interrupted, interrupted_at, lasting, names, succeeded, within
from faulty_films import KeptFilm, film, link, write

from heliograph.cli import main
from heliograph.link.truth import open_truth
from heliograph.media import open_film

pytestmark = pytest.mark.slow

INTERRUPTED = 130
RESULTS = ["array-0-high-0.bin", "packets.jsonl", "summary.json"]


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Create a film of two packets."""
    folder = tmp_path_factory.mktemp("drive")
    succeeded(within(folder, "simulate", "a.h5", *lasting(0.25), "--high", "text:first"))
    return folder / "a.h5"


def test_a_signal_ends_a_process(tmp_path: Path) -> None:
    run = interrupted("simulate", "a.mkv", *lasting(300), cwd=tmp_path, when=grown(tmp_path, ".*partial*", 20_000))
    assert "a.mkv holds the " in failed(run, INTERRUPTED)
    assert names(tmp_path) == ["a.mkv", "a.mkv.truth.npz"]


@pytest.mark.parametrize("by", [signal.SIGINT, signal.SIGTERM])
def test_simulate_keeps_the_film_so_far(tmp_path: Path, by: signal.Signals) -> None:
    run = interrupted_at(tmp_path, "simulate", "a.mkv", *lasting(300), title="simulating", step=12, by=by)
    assert failed(run, INTERRUPTED) == "heliograph: interrupted; a.mkv holds the 12 frames so far"
    assert names(tmp_path) == ["a.mkv", "a.mkv.truth.npz"]
    with open_film(tmp_path / "a.mkv") as film:
        assert abs(len(list(film)) - 12) <= 1
    assert abs(len(list(open_truth(tmp_path / "a.mkv.truth.npz").rows())) - 12) <= 1


def test_receive_shows_and_keeps_the_results_so_far(drive: Path, tmp_path: Path) -> None:
    line = ("receive", drive, "--output", "out", "--json", "--replay", "replay.html")
    run = interrupted_at(tmp_path, *line, title="receiving", step=210)
    assert "interrupted after 210 frames; the results so far are above" in failed(run, INTERRUPTED)
    report, out = json.loads(run.stdout), tmp_path / "out"
    assert report["error"] == json.loads((out / "summary.json").read_text())["error"] == "interrupted"
    assert (report["frames"], report["arrays"][0]["packets"] >= 1) == (210, True)
    assert (names(out), (out / "array-0-high-0.bin").read_bytes()) == (RESULTS, b"first")
    assert "</html>" in (tmp_path / "replay.html").read_text()[-100:]
    assert len((out / "packets.jsonl").read_text().splitlines()) == report["arrays"][0]["packets"]


def test_receive_keeps_the_completed_films(drive: Path, tmp_path: Path) -> None:
    shutil.copy(drive, tmp_path / "a.h5")
    succeeded(within(tmp_path, "simulate", "long.h5", *lasting(0.35), "--high", "text:first"))
    line = ("receive", "a.h5", "long.h5", "--workers", "1", "--receiver", "plain", "--output", "out")
    run = interrupted_at(tmp_path, *line, title="receiving", step=300)
    assert "interrupted after 1 of 2 films; the same command continues" in failed(run, INTERRUPTED)
    assert [json.loads(row)["film"] for row in run.stdout.splitlines()] == ["a.h5"]
    assert names(tmp_path / "out" / "a.h5") == RESULTS
    again = {row["film"]: row for row in map(json.loads, within(tmp_path, *line).stdout.splitlines())}
    assert [again[name].get("kept") for name in ("a.h5", "long.h5")] == [True, None]
    assert again["long.h5"]["frames"] == 350


@pytest.mark.parametrize("name", ["a.npy", "a.mkv", "a.h"])
def test_transmit_leaves_no_partial_file(tmp_path: Path, name: str) -> None:
    run = interrupted_at(tmp_path, "transmit", name, "--packets", "1000", title="transmitting", step=50)
    assert "interrupted" in failed(run, INTERRUPTED)
    assert names(tmp_path) == []


def test_demo_keeps_the_film_so_far(tmp_path: Path) -> None:
    run = interrupted_at(tmp_path, "demo", "--output", "d", *lasting(60), title="simulating", step=20)
    assert "interrupted; d/drive.mp4 holds the frames so far" in failed(run, INTERRUPTED)
    assert names(tmp_path / "d") == ["drive.mp4", "drive.mp4.truth.npz"]


def test_demo_reports_the_packets_so_far(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    reports = list[Any]()  # the pictures of the page take seconds
    monkeypatch.setattr("heliograph.experiments.demo.write_page", lambda *values: reports.append(values))
    run = interrupted_at(tmp_path, "demo", "--output", "d", *lasting(0.11), title="receiving", step=105)
    assert "d holds the results so far" in failed(run, INTERRUPTED)
    assert {"drive.mp4", "drive.mp4.truth.npz"} <= set(names(tmp_path / "d"))
    assert ("array 0: 1 packet" in run.stdout, len(reports)) == (True, 1)


def test_the_same_command_continues_a_data_set(tmp_path: Path) -> None:
    line = ("dataset", "a", *SMALL, "--set", "channel.camera.width=64", "--set", "channel.camera.height=48",
            "--set", "signal.data_pairs=8", "--films", "3", "--splits", "1,1,1")  # fmt: skip
    run = interrupted_at(tmp_path, *line, title="films", step=2)
    assert failed(run, INTERRUPTED) == "heliograph: interrupted after 2 of 3 films; the same command continues"
    there = names(tmp_path / "a")
    assert "DATASHEET.md" not in there
    assert f"of which {len(there) - 1} films exist" in succeeded(within(tmp_path, *line))
    assert len(names(tmp_path / "a")) == 3 + 3


def test_probe_shows_the_findings_so_far(tmp_path: Path) -> None:
    write(KeptFilm(film(link(camera={"width": 48, "height": 48}))), tmp_path / "long.h5")
    run = interrupted_at(tmp_path, "probe", "long.h5", title="probing", step=120)
    assert "interrupted after 120 frames; the findings so far are above" in failed(run, INTERRUPTED)
    assert "long.h5: 120 frames" in run.stdout


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="signals cannot be held")
def test_imports_end_before_ctrl_c_takes_effect(monkeypatch: pytest.MonkeyPatch) -> None:
    names = list[str]()

    def import_interrupted(name: str) -> Any:
        signal.raise_signal(signal.SIGINT)
        names.append(name)
        return import_module(name)

    monkeypatch.setattr(main, "import_module", import_interrupted)
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # background jobs ignore the signal
    try:
        with pytest.raises(KeyboardInterrupt):
            main.load_command("presets")
    finally:
        signal.signal(signal.SIGINT, before)
    assert names == ["heliograph.cli.presets"]
