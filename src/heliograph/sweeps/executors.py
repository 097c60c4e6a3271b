"""Executors for blocks: this process, worker processes, or a Dask cluster.

A worker imports this module first and limits the threads before NumPy loads: heavy imports are inside functions.
"""

import contextlib
import os
import re
from collections.abc import Callable, Iterable
from concurrent.futures import Future, as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import TypeVar

from heliograph.base.errors import HeliographError
from heliograph.base.registry import register_again, registered
from heliograph.base.workers import limit_threads, worker_environment, worker_processes

Work = TypeVar("Work")
Result = TypeVar("Result")


def cores() -> int:
    """Return the number of available cores."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def enough_workers(count: int) -> int:
    """Limit a number of worker processes to two per core."""
    return min(count, 2 * cores())


def fewer_workers(count: int | None) -> str:
    """Return a warning if `enough_workers` reduces the number of workers, or an empty text."""
    if count is None or count <= enough_workers(count):
        return ""
    available = f"{cores()} cores" if cores() > 1 else "one core"
    return f"{count} workers are more than {available} can feed: {enough_workers(count)} are started"


def open_workers(count: int | None = None, scheduler: str | None = None) -> "Workers":
    """Return workers for a number of processes, by default a process per core, or for a Dask scheduler."""
    if scheduler is not None:
        if count is not None:
            raise HeliographError("a scheduler provides the workers: give --workers or --scheduler, not both")
        return Cluster(scheduler)
    if count is None:
        count = cores()
    if count < 1:
        raise HeliographError(f"a sweep takes at least 1 worker, not {count}")
    return Workers() if count == 1 else Pool(enough_workers(count))


def each(
    count: int, job: Callable[[Work], Result], works: Iterable[Work], done: Callable[[float], None] = lambda _: None
) -> list[Result]:
    """Apply a job to each work item in at most `count` processes; return the results in order."""
    items, results = list(works), list[Result]()
    count = min(enough_workers(count), len(items))
    if count <= 1:
        for item in items:
            results.append(job(item))
            done(len(results) / len(items))
        return results
    with contextlib.closing(Pool(count)) as pool:
        futures = [pool.submit(job, item) for item in items]
        try:
            for number, future in enumerate(as_completed(futures), 1):
                future.result()
                done(number / len(items))
        except BrokenProcessPool:
            raise HeliographError("a worker process was lost; the memory may be too small: take fewer") from None
        return [future.result() for future in futures]


class Workers:
    """Sequential jobs in this process; the base class of other workers."""

    # Number of concurrent jobs
    slots = 1

    def submit(self, job: Callable[[Work], Result], work: Work) -> "Future[Result]":
        """Submit a job."""
        future: Future[Result] = Future()
        try:
            future.set_result(job(work))
        except Exception as error:
            future.set_exception(error)
        return future

    def restart(self) -> None:
        """Replace lost workers; submitted jobs are lost."""

    def close(self) -> None:
        """Stop immediately; running jobs are lost."""


class Pool(Workers):
    """Spawned worker processes."""

    def __init__(self, count: int):
        self.slots = count
        self._executor = worker_processes(count)

    def submit(self, job: Callable[[Work], Result], work: Work) -> "Future[Result]":
        """Submit a job; the first job starts the processes."""
        try:
            with worker_environment():
                return self._executor.submit(job, work)
        except BrokenProcessPool as error:
            future: Future[Result] = Future()
            future.set_exception(error)
            return future

    def restart(self) -> None:
        """Replace the pool: a lost process breaks the executor."""
        self.close()
        self._executor = worker_processes(self.slots)

    def close(self) -> None:
        """Terminate the processes."""
        processes = list((getattr(self._executor, "_processes", None) or {}).values())
        self._executor.shutdown(wait=False, cancel_futures=True)
        for process in processes:
            process.terminate()
        for process in processes:
            process.join()


class Cluster(Workers):
    """Workers of a Dask scheduler, which repeats the jobs of lost workers."""

    def __init__(self, address: str):
        try:
            from distributed import Client
        except ImportError:
            raise HeliographError("a Dask scheduler needs Dask: pip install 'heliograph[cluster]'") from None
        if not re.fullmatch(r"\w+://.+:\d+", address):
            raise HeliographError(f"'{address}' is no address of a scheduler, such as tcp://127.0.0.1:8786")
        try:
            self._client = Client(address, timeout=10.0, set_as_default=False)  # type: ignore[no-untyped-call]  # dask has no types
        except (OSError, ValueError, TypeError) as error:  # a timeout is an OSError
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise HeliographError(
                f"no Dask scheduler at {address} ({reason}); start one with 'dask scheduler'"
            ) from None
        self._executor = self._client.get_executor(retries=2, pure=False)  # type: ignore[no-untyped-call]  # dask has no types
        self._parts = registered()

    @property
    def slots(self) -> int:  # type: ignore[override]  # the workers of a cluster come and go
        """Number of threads of the current workers, at least 1."""
        try:
            return max(1, sum(self._client.nthreads().values()))  # type: ignore[no-untyped-call]  # dask has no types
        except OSError as error:
            raise HeliographError(f"the connection to the Dask scheduler was lost ({error})") from None

    def submit(self, job: Callable[[Work], Result], work: Work) -> "Future[Result]":
        """Submit a job."""
        return self._executor.submit(_run_limited, self._parts, job, work)

    def close(self) -> None:
        """Cancel the jobs and disconnect; the cluster continues."""
        self._executor.shutdown(wait=False)
        self._client.close()  # type: ignore[no-untyped-call]  # dask has no types


def _run_limited(parts: tuple[str, ...], job: Callable[[Work], Result], work: Work) -> Result:
    """Run a job in an external worker process."""
    limit_threads()
    register_again(parts)
    return job(work)
