"""Ctrl-C ends each command cleanly and keeps the results so far."""

import json
import signal
import time
from pathlib import Path

import pytest
from cli_runs import failed, grown, interrupted, lasting, names, succeeded, within

from heliograph.link.truth import open_truth
from heliograph.media import open_film

INTERRUPTED = 130


@pytest.mark.parametrize("by", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.slow
def test_simulate_keeps_the_film_so_far(tmp_path: Path, by: signal.Signals) -> None:
    started = grown(tmp_path, ".*partial*", 200_000)
    run = interrupted("simulate", "a.mkv", *lasting(300), cwd=tmp_path, when=started, by=by)
    assert "a.mkv holds the " in failed(run, INTERRUPTED)
    assert names(tmp_path) == ["a.mkv", "a.mkv.truth.npz"]
    with open_film(tmp_path / "a.mkv") as film:
        frames = len(list(film))
    assert frames > 10
    assert abs(frames - len(list(open_truth(tmp_path / "a.mkv.truth.npz").rows()))) <= 1


@pytest.mark.slow
def test_receive_shows_and_keeps_the_results_so_far(tmp_path: Path) -> None:
    (tmp_path / "high").write_bytes(b"first")
    succeeded(within(tmp_path, "simulate", "a.mkv", *lasting(1.5), "--high", "high"))
    first = grown(tmp_path, "out/array-0-high-0.bin")
    run = interrupted("receive", "a.mkv", "--output", "out", "--json", cwd=tmp_path, when=first)
    assert "the results so far are above" in failed(run, INTERRUPTED)
    report = json.loads(run.stdout)
    assert 100 <= report["frames"] < 1500
    assert report["error"] == json.loads((tmp_path / "out/summary.json").read_text())["error"] == "interrupted"
    assert report["arrays"][0]["packets"] >= 1
    assert names(tmp_path / "out") == ["array-0-high-0.bin", "packets.jsonl", "summary.json"]
    assert (tmp_path / "out/array-0-high-0.bin").read_bytes() == b"first"
    assert len((tmp_path / "out/packets.jsonl").read_text().splitlines()) == report["arrays"][0]["packets"]


@pytest.mark.parametrize("name", ["a.npy", "a.mkv"])
@pytest.mark.slow
def test_transmit_leaves_nothing(tmp_path: Path, name: str) -> None:
    started = grown(tmp_path, ".*partial*")
    run = interrupted("transmit", name, "--packets", "100000", cwd=tmp_path, when=started)
    assert "interrupted" in failed(run, INTERRUPTED)
    assert names(tmp_path) == []


@pytest.mark.slow
def test_demo_keeps_the_film_so_far(tmp_path: Path) -> None:
    started = grown(tmp_path, "d/.*partial*", 20_000)
    run = interrupted("demo", "--output", "d", *lasting(60), cwd=tmp_path, when=started)
    assert "interrupted; d/drive.mp4 holds the frames so far" in failed(run, INTERRUPTED)
    assert names(tmp_path / "d") == ["drive.mp4", "drive.mp4.truth.npz"]


@pytest.mark.slow
def test_demo_reports_what_was_received(tmp_path: Path) -> None:
    truth = tmp_path / "d/drive.mp4.truth.npz"

    def receiving() -> bool:
        return truth.exists() and time.time() - truth.stat().st_mtime > 0.3

    run = interrupted("demo", "--output", "d", *lasting(2), cwd=tmp_path, when=receiving)
    assert "d holds the results so far" in failed(run, INTERRUPTED)
    assert {"drive.mp4", "drive.mp4.truth.npz", "report.html"} <= set(names(tmp_path / "d"))
