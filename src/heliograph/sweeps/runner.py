"""Blocks of a sweep computed by any number of workers, resumable, with progress on a terminal."""

import contextlib
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Future, wait
from typing import Any

from heliograph.base.errors import HeliographError
from heliograph.measure.counts import BlockCounts
from heliograph.sweeps.executors import Workers
from heliograph.sweeps.points import build, run_job
from heliograph.sweeps.store import Store
from heliograph.sweeps.tally import PointTally

PointProgress = Callable[[Sequence[PointTally]], None]


def silent(tallies: Sequence[PointTally], /) -> None:
    """Report no progress."""


def recall_all(tallies: Sequence[PointTally], store: Store) -> None:
    """Count what the store holds of each point, and keep the points' settings in it."""
    for tally in tallies:
        store.note(tally.point)
        _recall(tally, store)


def run(tallies: Sequence[PointTally], store: Store, workers: Workers, progress: PointProgress = silent) -> None:
    """Count until all points have enough; the tallies hold the results so far at any time."""
    progress(tallies)
    flying: dict[Future[dict[str, Any]], tuple[PointTally, int]] = {}
    losses = 0
    while _fill(flying, tallies, store, workers):
        ended, _ = wait(flying, return_when=FIRST_COMPLETED)
        lost = [_take(future, *flying.pop(future), store) for future in ended]
        losses = losses + 1 if all(lost) else 0
        # times in a row that workers may be lost without a block done in between
        if losses >= 4:
            raise HeliographError(
                f"worker processes died {losses} times in a row; is memory short? Take fewer workers, and in a script "
                "call sweep() under 'if __name__ == \"__main__\":'"
            )
        if any(lost):
            flying.clear()  # all are lost with the pool; whatever was done is in the store or done again
            workers.restart()
        progress(tallies)


def _fill(
    flying: dict[Future[dict[str, Any]], tuple[PointTally, int]],
    tallies: Sequence[PointTally],
    store: Store,
    workers: Workers,
) -> bool:
    """Hand in blocks until all workers have one; whether any is under way."""
    slots = workers.slots
    while len(flying) < slots:
        chosen = _next(flying, tallies, slots)
        if chosen is None:
            break
        tally, block = chosen
        if _recall(tally, store):  # another sweep on this store may be ahead
            continue
        flying[workers.submit(run_job, tally.point.job(block))] = tally, block
    return bool(flying)


def _next(
    flying: Mapping[Future[dict[str, Any]], tuple[PointTally, int]], tallies: Sequence[PointTally], slots: int
) -> tuple[PointTally, int] | None:
    """The next block: of the first points that lack some, the one with fewest under way."""
    ahead: dict[int, list[int]] = {}
    for tally, block in flying.values():
        ahead.setdefault(id(tally), []).append(block)
    open_ones = [tally for tally in tallies if not tally.done][:slots]
    if not open_ones:
        return None
    tally = min(open_ones, key=lambda t: len(ahead.get(id(t), ())))
    block = tally.blocks
    while tally.has(block) or block in ahead.get(id(tally), ()):
        block += 1
    return tally, block


def _take(future: Future[dict[str, Any]], tally: PointTally, block: int, store: Store) -> bool:
    """Count and keep a block; whether it was lost with its worker."""
    try:
        result = future.result()
    except BrokenExecutor:
        return True
    except CancelledError:
        raise HeliographError("the connection to the Dask scheduler was lost; the results so far are kept") from None
    except HeliographError as error:
        raise HeliographError(f"{tally.point.text}: {error}") from None
    except Exception as error:  # of a worker anywhere: no memory, no heliograph, killed once too often
        reason = " ".join(str(error).split())[:200]
        raise HeliographError(f"{tally.point.text}: a worker failed with {type(error).__name__}: {reason}") from error
    if result["version"] != build():
        raise HeliographError(f"a worker has heliograph {result['version']}, not {build()}; install the same on all")
    counts = BlockCounts.from_plain(result["counts"])
    store.add(tally.point, block, counts, result["seconds"])
    tally.add(block, counts, result["seconds"])
    return False


def _recall(tally: PointTally, store: Store) -> bool:
    """Count what the store holds; whether there was anything new."""
    new = {block: row for block, row in store.blocks(tally.point, tally.blocks).items() if not tally.has(block)}
    for block, (counts, seconds) in new.items():
        tally.add(block, counts, seconds)
    return bool(new)


SCALE = 1000
"""Parts of a point in the progress bar."""


def on_a_terminal() -> bool:
    """Whether somebody sees what is written to standard error."""
    return sys.stderr is not None and sys.stderr.isatty()


@contextlib.contextmanager
def bar(points: int, shown: bool | None = None) -> Iterator[PointProgress]:
    """A bar on standard error, with the points done and the time left."""
    if not (on_a_terminal() if shown is None else shown):
        yield silent
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    # a block may take longer than Rich's half a minute, without which it has no speed
    screen = Console(stderr=True, force_terminal=True)
    # time in s over which the speed is averaged that the time left is estimated from
    period = 3600.0
    with Progress(*columns, console=screen, transient=True, speed_estimate_period=period) as progress:
        task = progress.add_task("sweeping", total=SCALE * points)

        def show(tallies: Sequence[PointTally]) -> None:
            done = f"{sum(t.done for t in tallies)} of {points} points"
            progress.update(task, description=done, completed=round(SCALE * sum(t.fraction for t in tallies)))

        yield show
