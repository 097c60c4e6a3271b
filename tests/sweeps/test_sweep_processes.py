"""The sweep command with real processes: worker counts, killed workers, Ctrl-C, a cluster."""

import json
import os
import signal
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import pytest
from cli_runs import called, heed_ctrl_c
from waiting import HANG_S, wait_until

from heliograph.sweeps.store import NAME

pytestmark = pytest.mark.slow

BIN = Path(sys.executable).parent
CODEWORDS = 12
"""Stop rule: high-priority codewords per point."""
POINTS = ("--vary", "channel.distance_m=60:70:10", "--set", "signal.data_pairs=8", "--max-codewords", str(CODEWORDS))
BLOCKS = 2 * CODEWORDS
"""Blocks for both points, with a packet each, since high-priority errors are rare."""


def command(*more: str) -> list[str]:
    return [str(BIN / "heliograph"), "sweep", *POINTS, "--json", *more]


def start(*more: str) -> "subprocess.Popen[str]":
    pipe = subprocess.PIPE
    return subprocess.Popen(
        command(*more), stdout=pipe, stderr=pipe, text=True, start_new_session=True, preexec_fn=heed_ctrl_c
    )


@pytest.fixture(scope="module")
def reference() -> Any:
    """Return the points from an uninterrupted run with a single worker."""
    done = subprocess.run(command("--workers", "1"), capture_output=True, text=True, check=True, timeout=HANG_S)
    return json.loads(done.stdout)


def stored(folder: Path) -> list[int]:
    """Return the number of computations per stored block."""
    if not (folder / NAME).exists():
        return []
    with closing(sqlite3.connect(folder / NAME, timeout=HANG_S)) as db:
        if not db.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]:
            return []
        return [row[0] for row in db.execute("SELECT computed FROM blocks").fetchall()]


def worker_processes(parent: int) -> list[int]:
    """Return child processes except the pool's resource tracker."""
    found = []
    for entry in Path("/proc").iterdir():
        try:
            fields = (entry / "stat").read_text().rpartition(")")[2].split()
            if int(fields[1]) == parent and b"spawn_main" in (entry / "cmdline").read_bytes():
                found.append(int(entry.name))
        except (OSError, ValueError, IndexError):
            continue
    return found


def runs(pid: int) -> bool:
    try:
        return (Path("/proc") / str(pid) / "stat").read_text().rpartition(")")[2].split()[0] not in "ZX"
    except OSError:
        return False


needs_proc = pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="needs /proc to find worker processes")


def test_points_stop_where_they_should(reference: Any) -> None:
    assert [p["settings"]["channel.distance_m"] for p in reference] == [60, 70]
    for point in reference:
        for layer in point["layers"].values():
            assert layer["codeword_errors"] >= 50 or layer["codewords"] >= CODEWORDS
            assert layer["fer_ci"][0] <= layer["fer"] <= layer["fer_ci"][1]
    assert reference[0]["net_bits_per_second"] > reference[-1]["net_bits_per_second"] > 0


@needs_proc
def test_killed_workers_are_replaced_and_a_killed_sweep_goes_on(reference: Any, tmp_path: Path) -> None:
    process = start("--workers", "2", "--output", str(tmp_path))
    wait_until(lambda: len(stored(tmp_path)) >= 2)
    (first, *_) = before = worker_processes(process.pid)
    os.kill(first, signal.SIGKILL)
    wait_until(lambda: len(stored(tmp_path)) >= 6)
    wait_until(lambda: not set(worker_processes(process.pid)) & set(before))
    workers = worker_processes(process.pid)
    process.kill()
    process.communicate(timeout=HANG_S)
    wait_until(lambda: not any(map(runs, workers)))  # workers end with their parent
    assert len(stored(tmp_path)) >= 6
    done = subprocess.run(command("--workers", "1", "--output", str(tmp_path)), capture_output=True, text=True,
                          check=True, timeout=HANG_S)  # fmt: skip
    assert json.loads(done.stdout) == reference
    assert json.loads((tmp_path / "points.json").read_text()) == reference
    assert set(stored(tmp_path)) == {1}
    assert BLOCKS <= len(stored(tmp_path)) <= BLOCKS + 2


@needs_proc
def test_ctrl_c_shows_the_results_so_far(tmp_path: Path) -> None:
    # long enough to be interrupted
    process = start("--workers", "2", "--max-codewords", "20000", "--output", str(tmp_path))
    wait_until(lambda: len(stored(tmp_path)) >= 2)
    workers = worker_processes(process.pid)
    os.killpg(process.pid, signal.SIGINT)
    out, err = process.communicate(timeout=HANG_S)
    assert process.returncode == 130
    assert len(err.splitlines()) == 1
    assert "interrupted" in err
    points = json.loads(out)
    assert sum(point["blocks"] for point in points) >= 1
    assert json.loads((tmp_path / "points.json").read_text()) == points
    assert not any(map(runs, workers))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--vary", "channel.distanc_m=1"], "did you mean 'channel.distance_m'"),
        (["--vary", "channel.distance_m=1:2"], "first:last:step"),
        (["--vary", "receiver=plane"], "plane"),
        (["--max-seconds", "0"], "max_seconds"),
        (["--scheduler", "nowhere"], "tcp://"),
        (["--vary", "channel.distance_m=9", "--vary", "channel.distance_m=8"], "twice"),
    ],
)
def test_wrong_input_is_one_line(
    options: list[str], said: str, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    done = called("sweep", *options, capfd=capfd, monkeypatch=monkeypatch)
    assert done.returncode in (1, 2)
    assert done.stdout == ""
    assert len(done.stderr.splitlines()) == 1
    assert said in done.stderr


@contextmanager
def dask(*arguments: str) -> "Iterator[subprocess.Popen[bytes]]":
    environment = {**os.environ, "PYTHONWARNINGS": "ignore"}
    process = subprocess.Popen(
        [BIN / "dask", *arguments, "--no-dashboard"], env=environment, stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL, start_new_session=True,
    )  # fmt: skip
    try:
        yield process
    finally:
        process.kill()
        process.wait()


def test_a_cluster_survives_a_killed_worker(reference: Any, tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    about = tmp_path / "scheduler.json"
    with dask("scheduler", "--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(about)):
        wait_until(lambda: about.exists() and about.read_text().rstrip().endswith("}"))
        address = json.loads(about.read_text())["address"]
        workers = ("worker", address, "--nthreads", "1", "--no-nanny", "--local-directory", str(tmp_path))
        with dask(*workers) as one, dask(*workers):
            process = start("--scheduler", address, "--output", str(tmp_path))
            wait_until(lambda: len(stored(tmp_path)) >= 3)
            one.kill()
            out, err = process.communicate(timeout=HANG_S)
    assert process.returncode == 0, err
    assert json.loads(out) == reference
    assert set(stored(tmp_path)) == {1}
    assert len(stored(tmp_path)) >= BLOCKS
