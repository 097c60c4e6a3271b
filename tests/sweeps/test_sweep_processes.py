"""Sweeps in worker processes and on a cluster: custom components, killed workers, Ctrl-C."""

import json
import os
import signal
import sqlite3
import subprocess
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

import numba
import pytest
from cli_runs import COMMAND, heed_ctrl_c
from processes import HAS_PROC, is_running, worker_processes
from waiting import HANG_S, wait_until

from heliograph.base import registry
from heliograph.base.errors import HeliographError
from heliograph.base.workers import THREAD_LIMITS, limit_threads
from heliograph.experiments.report import Context
from heliograph.sweeps.executors import each
from heliograph.sweeps.plan import merge_changes, plan
from heliograph.sweeps.store import NAME
from heliograph.sweeps.sweep import count
from heliograph.sweeps.tally import PointTally, StopRule

OWN = """
from dataclasses import dataclass, replace
import heliograph
from heliograph.signal.code import CODES

@dataclass(frozen=True)
class Renaming:
    identity: int = 7

class Renamed:
    # the plain receiver; its packets get another identity
    def __init__(self, signal, settings, observe):
        self._plain = heliograph.make_receiver(signal, replace(settings, receiver="plain", custom={}), observe)
        self._identity = heliograph.own_settings(settings).identity
    @property
    def detections(self):
        return self._plain.detections
    def push(self, frame):
        return (replace(packet, identity=self._identity) for packet in self._plain.push(frame))
    def finish(self):
        return (replace(packet, identity=self._identity) for packet in self._plain.finish())

heliograph.register_receiver("renamed", Renamed, Renaming)
heliograph.register_motion("still", lambda drive: None)
heliograph.register_code("turbo-again", CODES["turbo"])
"""
VARY = {"receiver": ["plain", "renamed"], "signal.code": ["turbo", "turbo-again"]}
SMALL = ["signal.data_pairs=8", "channel.shake=still", "channel.distance_m=20", "channel.duration_s=0.05"]

Kill = Callable[[], object]


@pytest.fixture(scope="module", autouse=True)
def parts_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Load custom components from a file, as --load does."""
    file = tmp_path_factory.mktemp("parts") / "own.py"
    file.write_text(OWN)
    registry.load_parts(file)
    return file


def counted(kill: Kill = lambda: None, output: Path | None = None, **crew: Any) -> list[dict[str, Any]]:
    """Count errors at each point, and call `kill` once after some blocks."""
    pending = [kill]

    def progress(tallies: Sequence[PointTally]) -> None:
        if pending and sum(tally.blocks for tally in tallies) >= 2:
            pending.pop()()

    tallies = tallies_of(VARY, 4)
    count(tallies, output, progress=progress, **crew)
    assert not pending
    return [tally.report() for tally in tallies]


def tallies_of(vary: Mapping[str, Any], max_codewords: int) -> list[PointTally]:
    points = plan(vary, "static", merge_changes(SMALL))
    return [PointTally(point, StopRule(max_codewords=max_codewords)) for point in points]


@pytest.fixture(scope="module")
def reference(parts_file: Path) -> list[dict[str, Any]]:
    """Return the points from an uninterrupted run in this process."""
    return counted(workers=1)


def stored(folder: Path) -> list[int]:
    """Return the number of computations per stored block."""
    if not (folder / NAME).exists():
        return []
    with closing(sqlite3.connect(folder / NAME, timeout=HANG_S)) as db:
        if not db.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]:
            return []
        return [row[0] for row in db.execute("SELECT computed FROM blocks").fetchall()]


@pytest.mark.slow
def test_custom_receiver_code_and_motion_run_in_this_process(reference: list[dict[str, Any]]) -> None:
    high = [point["layers"]["high"] for point in reference]
    codewords = high[0]["codewords"]
    assert codewords >= 4
    # no packet from array 0 arrives where the receiver renames it
    errors = [(layer["codewords"], layer["codeword_errors"]) for layer in high]
    assert errors == [(codewords, 0)] * 2 + [(codewords, codewords)] * 2


@contextmanager
def dask_worker(address: str, folder: Path) -> "Iterator[subprocess.Popen[bytes]]":
    options = ("--nthreads", "1", "--no-nanny", "--no-dashboard", "--local-directory", str(folder))
    process = subprocess.Popen(
        [Path(sys.executable).with_name("dask"), "worker", address, *options],
        env={**os.environ, "PYTHONWARNINGS": "ignore"}, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        yield process
    finally:
        process.kill()
        process.wait()


@pytest.mark.slow
def test_cluster_survives_a_killed_worker_and_has_custom_parts(reference: list[dict[str, Any]], tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    with distributed.LocalCluster(n_workers=0, host="127.0.0.1", dashboard_address=":0") as cluster:
        address = cluster.scheduler_address
        with dask_worker(address, tmp_path) as one, dask_worker(address, tmp_path):
            wait_until(lambda: len(cluster.scheduler.workers) == 2)
            assert counted(one.kill, tmp_path, scheduler=address) == reference
    assert set(stored(tmp_path)) == {1}


@pytest.mark.slow
@pytest.mark.skipif(not HAS_PROC, reason="needs /proc to find worker processes")
def test_a_killed_worker_is_replaced_ctrl_c_shows_results_and_sweeps_resume(parts_file: Path, tmp_path: Path) -> None:
    changes = [word for change in SMALL for word in ("--set", change)]
    # long enough to be interrupted
    options = ["--vary", "channel.distance_m=60:70:10", "--max-codewords", "20000", "--workers", "2", "--json"]
    process = subprocess.Popen(
        [*COMMAND, "--load", str(parts_file), "sweep", *options, *changes, "--output", str(tmp_path)],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True, preexec_fn=heed_ctrl_c,
    )  # fmt: skip

    def wait_for_blocks(count: int) -> None:
        wait_until(lambda: len(stored(tmp_path)) >= count or process.poll() is not None)

    wait_for_blocks(2)
    first = worker_processes(process.pid)
    os.kill(first[0], signal.SIGKILL)
    wait_until(lambda: not any(map(is_running, first)))
    wait_for_blocks(len(stored(tmp_path)) + 2)
    workers = worker_processes(process.pid)
    os.killpg(process.pid, signal.SIGINT)
    out, err = process.communicate(timeout=HANG_S)
    assert (process.returncode, len(err.splitlines())) == (130, 1)
    assert "interrupted" in err
    points = json.loads(out)
    assert sum(point["blocks"] for point in points) >= 1
    assert json.loads((tmp_path / "points.json").read_text()) == points
    assert (len(first), len(workers), set(first) & set(workers)) == (2, 2, set())
    assert not any(map(is_running, workers))

    reports = []
    for output in (tmp_path, None):
        tallies = tallies_of({"channel.distance_m": [60, 70]}, 6)
        count(tallies, output, workers=1)
        reports.append([tally.report() for tally in tallies])
    resumed, uninterrupted = reports
    assert resumed == uninterrupted
    with closing(sqlite3.connect(tmp_path / NAME)) as db:
        keys = db.execute("SELECT count(DISTINCT key) FROM blocks").fetchone()
    assert keys == (2,), "the resumed sweep has the same points"
    assert set(stored(tmp_path)) == {1}
    for point in resumed:
        for layer in point["layers"].values():
            assert layer["codeword_errors"] >= 50 or layer["codewords"] >= 6
            assert layer["fer_ci"][0] <= layer["fer"] <= layer["fer_ci"][1]
    assert resumed[0]["net_bits_per_second"] > resumed[1]["net_bits_per_second"] > 0


@pytest.mark.slow
def test_workers_return_results_in_order_and_have_a_thread_each() -> None:
    shares: list[float] = []
    limits = each(2, os.getenv, [*THREAD_LIMITS, "HELIOGRAPH_UNSET"], shares.append)
    assert (limits, shares[-1], shares) == (["1"] * len(THREAD_LIMITS) + [None], 1, sorted(shares))


def test_single_worker_is_this_process() -> None:
    seen: list[tuple[str, float]] = []
    context = Context(progress=lambda title, share: seen.append((title, share)))
    assert (context.each("half", abs, [-1, 1], (0.5, 1.0)), seen) == ([1, 1], [("half", 0.75), ("half", 1.0)])
    assert (each(2, abs, []), each(2, lambda _: os.getpid(), [0])) == ([], [os.getpid()])


def test_error_of_a_job_reaches_the_caller() -> None:
    with pytest.raises(ValueError, match="invalid literal"):
        each(1, int, ["two", "3"])


@pytest.mark.slow
def test_lost_worker_is_one_line() -> None:
    with pytest.raises(HeliographError, match="lost"):
        each(2, os._exit, [3, 4])


PARENT = """
import os, time
from heliograph.base.workers import worker_environment, worker_processes
with worker_environment():
    print(worker_processes(1).submit(os.getpid).result(), flush=True)
time.sleep(1000)
"""


@pytest.mark.slow
@pytest.mark.skipif(not HAS_PROC, reason="needs /proc to find worker processes")
def test_worker_ends_with_a_killed_parent() -> None:
    with subprocess.Popen([sys.executable, "-c", PARENT], stdout=subprocess.PIPE) as parent:
        assert parent.stdout is not None
        worker = int(parent.stdout.readline())
        assert is_running(worker)
        parent.kill()
    wait_until(lambda: not is_running(worker))


CREATION = """
import multiprocessing, signal
from heliograph.base.workers import worker_environment
with worker_environment():
    multiprocessing.get_context("spawn").Lock()  # starts a process that tracks resources
    print(signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, ()))
"""


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="needs signal masks")
def test_first_worker_of_a_process_is_created_with_ctrl_c_blocked() -> None:
    run = subprocess.run([sys.executable, "-c", CREATION], capture_output=True, text=True)
    assert (run.stdout, run.stderr) == ("True\n", "")


@pytest.mark.slow
def test_kernel_can_be_compiled_after_the_threads_were_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    limit_threads()  # starts Numba threads, which fixes the thread count
    for name, value in THREAD_LIMITS.items():
        monkeypatch.setenv(name, value)
    assert numba.njit(lambda x: x + 1)(1) == 2
