"""Who computes blocks: this process, worker processes of this machine, or a Dask cluster.

All have the interface of `concurrent.futures`. Nothing heavy is imported here: a worker imports this module first,
and sets its thread limits before NumPy is there.
"""

import contextlib
import os
import re
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import Protocol, TypeVar

from heliograph.base.errors import HeliographError
from heliograph.base.registry import register_again, registered
from heliograph.base.workers import limit_threads, worker_environment, worker_processes

Work = TypeVar("Work")
Result = TypeVar("Result")


class Workers(Protocol):
    """Computes jobs."""

    @property
    def slots(self) -> int:
        """Jobs worked on at a time."""

    def submit(self, job: Callable[[Work], Result], work: Work) -> "Future[Result]":
        """Hand a job in."""

    def restart(self) -> None:
        """Begin again after workers were lost; what was handed in is lost."""

    def close(self) -> None:
        """Stop at once; what is not finished is lost."""


def enough_workers(count: int) -> int:
    """Worker processes to start where some are asked for: no more than the cores can feed."""
    # most worker processes for each core: more begin late, as they share the cores, and compute no faster
    return min(count, 2 * cores())


def fewer_workers(count: int | None) -> str:
    """A line that says how many workers start in place of those asked for; empty where all of them do."""
    if count is None or count <= enough_workers(count):
        return ""
    there = f"{cores()} cores" if cores() > 1 else "one core"
    return f"{count} workers are more than {there} can feed: {enough_workers(count)} are started"


def open_workers(count: int | None = None, scheduler: str | None = None) -> Workers:
    """Workers as asked for, but no more than `enough_workers`."""
    if scheduler is not None:
        if count is not None:
            raise HeliographError("a scheduler has its own workers: give --workers or --scheduler, not both")
        return Cluster(scheduler)
    if count is None:
        count = cores()
    if count < 1:
        raise HeliographError(f"a sweep takes at least 1 worker, not {count}")
    return Here() if count == 1 else Pool(enough_workers(count))


def each(
    count: int, job: Callable[[Work], Result], works: Iterable[Work], done: Callable[[float], None] = lambda _: None
) -> list[Result]:
    """Results of a job for each of some works, in their order."""
    todo = list(works)
    crew = min(enough_workers(count), len(todo))
    if crew <= 1:
        return list(_reported((job(work) for work in todo), len(todo), done))
    with contextlib.closing(Pool(crew)) as pool:
        futures = [pool.submit(job, work) for work in todo]
        try:
            for _ in _reported((future.result() for future in as_completed(futures)), len(todo), done):
                pass
        except BrokenProcessPool:
            raise HeliographError("a worker process was lost; there may be too little memory: take fewer") from None
        return [future.result() for future in futures]


def _reported(results: Iterator[Result], count: int, done: Callable[[float], None]) -> Iterator[Result]:
    for number, result in enumerate(results, 1):
        done(number / count)
        yield result


def cores() -> int:
    """Cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Here:
    """Computes in this process, one job after the other."""

    slots = 1

    def submit(self, job: Callable[[Work], Result], work: Work) -> "Future[Result]":
        """Do a job."""
        future: Future[Result] = Future()
        try:
            future.set_result(job(work))
        except Exception as error:
            future.set_exception(error)
        return future

    def restart(self) -> None:
        """Nothing is ever lost."""

    def close(self) -> None:
        """Nothing to stop."""


class Pool:
    """Worker processes, each a new interpreter (never forked: threads and locks of this process stay here)."""

    def __init__(self, count: int):
        self.slots = count
        self._executor = self._start()

    def submit(self, job: Callable[[Work], Result], work: Work) -> "Future[Result]":
        """Hand a job in; the first one starts the processes."""
        try:
            with worker_environment():
                return self._executor.submit(job, work)
        except BrokenProcessPool as error:
            future: Future[Result] = Future()
            future.set_exception(error)
            return future

    def restart(self) -> None:
        """Replace the pool: one lost process breaks it."""
        self.close()
        self._executor = self._start()

    def close(self) -> None:
        """End the processes, whatever they do."""
        processes = list((getattr(self._executor, "_processes", None) or {}).values())
        self._executor.shutdown(wait=False, cancel_futures=True)
        for process in processes:
            process.terminate()
        for process in processes:
            process.join()

    def _start(self) -> Executor:
        return worker_processes(self.slots)


class Cluster:
    """Workers of a Dask scheduler; it repeats by itself what a lost worker had."""

    def __init__(self, address: str):
        try:
            from distributed import Client
        except ImportError:
            raise HeliographError("a Dask scheduler needs Dask: pip install 'dask[distributed]'") from None
        if not re.fullmatch(r"\w+://.+:\d+", address):
            raise HeliographError(f"'{address}' is no address of a scheduler; write one such as tcp://127.0.0.1:8786")
        try:
            # how long to wait for a scheduler
            self._client = Client(address, timeout=10.0, set_as_default=False)  # type: ignore[no-untyped-call]  # dask has no types
        except (OSError, ValueError, TypeError) as error:  # a timeout is an OSError
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise HeliographError(
                f"no Dask scheduler at {address} ({reason}); start one with 'dask scheduler'"
            ) from None
        self._executor = self._client.get_executor(retries=2, pure=False)  # type: ignore[no-untyped-call]  # dask has no types
        self._parts = registered()

    @property
    def slots(self) -> int:
        """Threads of all workers there are now; one job waits if there are none."""
        try:
            return max(1, sum(self._client.nthreads().values()))  # type: ignore[no-untyped-call]  # dask has no types
        except OSError as error:
            raise HeliographError(f"the connection to the Dask scheduler was lost ({error})") from None

    def submit(self, job: Callable[[Work], Result], work: Work) -> "Future[Result]":
        """Hand a job in."""
        return self._executor.submit(_limited, self._parts, job, work)

    def restart(self) -> None:
        """Begin again with the workers there are."""

    def close(self) -> None:
        """Drop what is not finished and leave; the cluster stays."""
        self._executor.shutdown(wait=False)
        self._client.close()  # type: ignore[no-untyped-call]  # dask has no types


def _limited(parts: tuple[str, ...], job: Callable[[Work], Result], work: Work) -> Result:
    """Do a job in a worker that others set up."""
    limit_threads()
    register_again(parts)
    return job(work)
