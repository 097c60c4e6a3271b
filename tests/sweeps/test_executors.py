"""Jobs per work item, in this process and in worker processes."""

import os
import subprocess
import sys

import numba
import pytest
from processes import HAS_PROC, is_running
from waiting import wait_until

from heliograph.base.errors import HeliographError
from heliograph.base.workers import THREAD_LIMITS, limit_threads
from heliograph.experiments.report import Context
from heliograph.sweeps.executors import each


@pytest.mark.slow
def test_workers_return_results_in_order_and_have_a_thread_each() -> None:
    shares: list[float] = []
    assert each(2, os.getenv, [*THREAD_LIMITS, "HELIOGRAPH_UNSET"], shares.append) == ["1"] * len(THREAD_LIMITS) + [
        None
    ]
    assert shares[-1] == 1
    assert shares == sorted(shares)


def test_single_worker_is_this_process() -> None:
    seen: list[tuple[str, float]] = []
    context = Context(progress=lambda title, share: seen.append((title, share)))
    assert context.each("half", abs, [-1, 1], (0.5, 1.0)) == [1, 1]
    assert seen == [("half", 0.75), ("half", 1.0)]
    assert each(2, abs, []) == []
    assert each(2, lambda _: os.getpid(), [0]) == [os.getpid()]


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


@pytest.mark.slow
def test_kernel_can_be_compiled_after_the_threads_were_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    limit_threads()  # starts Numba threads, which fixes the thread count
    for name, value in THREAD_LIMITS.items():
        monkeypatch.setenv(name, value)
    assert numba.njit(lambda x: x + 1)(1) == 2
