"""Run jobs per work item, in this process and in worker processes."""

import os

import numba
import pytest

from heliograph.base.errors import HeliographError
from heliograph.base.workers import THREAD_LIMITS, limit_threads
from heliograph.experiments.report import Context
from heliograph.sweeps.executors import each


def end(code: int) -> int:
    os._exit(code)


@pytest.mark.parametrize("count", [1, 2])
@pytest.mark.slow
def test_results_keep_their_order_and_progress_ends_at_all(count: int) -> None:
    shares: list[float] = []
    assert each(count, abs, [-1, 2, -3], shares.append) == [1, 2, 3]
    assert shares == pytest.approx([1 / 3, 2 / 3, 1])


def test_of_nothing_comes_nothing() -> None:
    assert each(2, abs, []) == []


@pytest.mark.slow
def test_workers_have_a_thread_each() -> None:
    assert each(2, os.getenv, list(THREAD_LIMITS)) == ["1"] * len(THREAD_LIMITS)


@pytest.mark.parametrize("count", [1, 2])
@pytest.mark.slow
def test_what_a_job_raises_is_raised(count: int) -> None:
    with pytest.raises(ValueError, match="invalid literal"):
        each(count, int, ["1", "two", "3"])


@pytest.mark.slow
def test_a_lost_worker_is_one_line() -> None:
    with pytest.raises(HeliographError, match="lost"):
        each(2, end, [3, 4])


def test_an_experiment_reports_its_span() -> None:
    seen: list[tuple[str, float]] = []
    context = Context(progress=lambda title, share: seen.append((title, share)))
    assert context.each("half", abs, [-1, 1], (0.5, 1.0)) == [1, 1]
    assert seen == [("half", 0.75), ("half", 1.0)]


@pytest.mark.slow
def test_a_kernel_can_be_compiled_once_threads_were_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    limit_threads()  # starts Numba threads, which fixes the thread count
    for name, value in THREAD_LIMITS.items():
        monkeypatch.setenv(name, value)
    assert numba.njit(lambda x: x + 1)(1) == 2
