"""Execution of the blocks of a sweep by workers, resumable, with a progress bar."""

import contextlib
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Future, wait
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from heliograph.base.errors import HeliographError
from heliograph.measure.counts import BlockCounts
from heliograph.sweeps.executors import Workers
from heliograph.sweeps.points import build, run_job
from heliograph.sweeps.store import Store
from heliograph.sweeps.tally import PointTally

PointProgress = Callable[[Sequence[PointTally]], None]
Jobs = dict[Future[dict[str, Any]], tuple[PointTally, int]]


def silent(tallies: Sequence[PointTally], /) -> None:
    """Report no progress."""


def recall_all(tallies: Sequence[PointTally], store: Store) -> None:
    """Add the stored blocks of each point, and store the settings of the points."""
    for tally in tallies:
        store.note(tally.point)
        _recall(tally, store)


def run(tallies: Sequence[PointTally], store: Store, workers: Workers, progress: PointProgress = silent) -> None:
    """Compute blocks until all points are complete; the tallies always have the results so far."""
    progress(tallies)
    jobs: Jobs = {}
    losses = 0
    while _submit(jobs, tallies, store, workers):
        finished, _ = wait(jobs, return_when=FIRST_COMPLETED)
        lost = [not _collect(future, *jobs.pop(future), store) for future in finished]
        losses = losses + 1 if all(lost) else 0
        if losses >= 4:
            raise HeliographError(
                f"worker processes died {losses} times in a row; is memory short? Take fewer workers, and in a script "
                "call sweep() under 'if __name__ == \"__main__\":'"
            )
        if any(lost):
            jobs.clear()  # the other jobs of the pool are lost as well
            workers.restart()
        progress(tallies)


def _submit(jobs: Jobs, tallies: Sequence[PointTally], store: Store, workers: Workers) -> bool:
    """Submit blocks until all slots are busy; return True if jobs are pending."""
    slots = workers.slots
    while len(jobs) < slots:
        # of the first incomplete points, that with the fewest jobs
        pending = [tally for tally in tallies if not tally.done][:slots]
        if not pending:
            break
        busy = {id(tally): {block for other, block in jobs.values() if other is tally} for tally in pending}
        tally = min(pending, key=lambda t: len(busy[id(t)]))
        if _recall(tally, store):  # from a concurrent sweep on this store
            continue
        block = tally.blocks
        while tally.has(block) or block in busy[id(tally)]:
            block += 1
        jobs[workers.submit(run_job, tally.point.job(block))] = tally, block
    return bool(jobs)


def _collect(future: Future[dict[str, Any]], tally: PointTally, block: int, store: Store) -> bool:
    """Count and store a block; return False if the worker died."""
    try:
        result = future.result()
    except BrokenExecutor:
        return False
    except CancelledError:
        raise HeliographError("the connection to the Dask scheduler was lost; the results so far are kept") from None
    except HeliographError as error:
        raise HeliographError(f"{tally.point.text}: {error}") from None
    except Exception as error:  # any failure of a worker
        reason = " ".join(str(error).split())[:200]
        raise HeliographError(f"{tally.point.text}: a worker failed with {type(error).__name__}: {reason}") from error
    if result["version"] != build():
        raise HeliographError(f"a worker has heliograph {result['version']}, not {build()}; install the same on all")
    counts = BlockCounts.from_plain(result["counts"])
    store.add(tally.point, block, counts, result["seconds"])
    tally.add(block, counts, result["seconds"])
    return True


def _recall(tally: PointTally, store: Store) -> bool:
    """Add the stored blocks of a point; return True if any is new."""
    new = {block: row for block, row in store.blocks(tally.point, tally.blocks).items() if not tally.has(block)}
    for block, (counts, seconds) in new.items():
        tally.add(block, counts, seconds)
    return bool(new)


@contextlib.contextmanager
def bar(points: int, shown: bool | None = None) -> Iterator[PointProgress]:
    """Show a progress bar on standard error with the completed points and the remaining time."""
    if shown is None:
        shown = sys.stderr is not None and sys.stderr.isatty()
    if not shown:
        yield silent
        return
    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    screen = Console(stderr=True, force_terminal=True)
    # the default period of 30 s is too short for long blocks
    with Progress(*columns, console=screen, transient=True, speed_estimate_period=3600.0) as progress:
        task = progress.add_task("sweeping", total=1000 * points)

        def show(tallies: Sequence[PointTally]) -> None:
            done = f"{sum(t.done for t in tallies)} of {points} points"
            progress.update(task, description=done, completed=round(1000 * sum(t.fraction for t in tallies)))

        yield show
