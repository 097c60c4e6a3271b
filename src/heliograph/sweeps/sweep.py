"""Sweeps: error rates over a grid of settings, as a Dataset and as files."""

import contextlib
import csv
import io
import json
import os
import sys
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Future, wait
from numbers import Integral
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

from heliograph.base.errors import HeliographError, shown
from heliograph.base.files import write_whole
from heliograph.measure.counts import BlockCounts
from heliograph.sweeps.executors import Workers, fewer_workers, open_workers
from heliograph.sweeps.metrics import METRICS
from heliograph.sweeps.plan import merge_changes, plan, size_warning, value_lists
from heliograph.sweeps.points import build, run_job
from heliograph.sweeps.store import Store
from heliograph.sweeps.tally import PointTally, StopRule, flat_report

PointProgress = Callable[[Sequence[PointTally]], None]
Jobs = dict[Future[dict[str, Any]], tuple[PointTally, int]]


def silent(tallies: Sequence[PointTally], /) -> None:
    """Report no progress."""


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
    """Count and store a block, or note the refusal of the receiver; return False if the worker died."""
    try:
        result = future.result()
    except BrokenExecutor:
        return False
    except CancelledError:
        raise HeliographError("the connection to the Dask scheduler was lost; the results so far are kept") from None
    except HeliographError as error:
        raise HeliographError(f"{tally.point.text}: {error}") from None
    except Exception as error:  # any failure of a worker
        reason, where = " ".join(str(error).split())[:200], "".join(f" in {x}" for x in getattr(error, "__notes__", ()))
        raise HeliographError(
            f"{tally.point.text}: a worker failed with {type(error).__name__}{where}: {reason}"
        ) from error
    if result["version"] != build():
        raise HeliographError(f"a worker has heliograph {result['version']}, not {build()}; install the same on all")
    if refusal := result["refusal"]:
        if not tally.may_refuse or tally.blocks:
            raise HeliographError(f"{tally.point.text}: {refusal}")
        tally.refuse(refusal)
        return True
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
    """Show a progress bar on standard error, and print the remaining time after the first point."""
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
        start_s, stored, is_estimated = time.monotonic(), -1.0, False

        def show(tallies: Sequence[PointTally]) -> None:
            nonlocal stored, is_estimated
            done, completed = sum(t.done for t in tallies), sum(t.fraction for t in tallies)
            progress.update(task, description=f"{done} of {points} points", completed=round(1000 * completed))
            # points of an earlier run took no time
            stored = completed if stored < 0 else stored
            if not is_estimated and 0 < done < points and completed > stored:
                is_estimated = True
                rest_s = (time.monotonic() - start_s) * (points - completed) / (completed - stored)
                rest = f"{rest_s:.0f} s" if rest_s < 100 else f"{rest_s / 60:.0f} min"
                text = f"{done} of {points} points complete; estimate for the others: {rest}"
                progress.console.print(text, highlight=False)

        yield show


if TYPE_CHECKING:
    import xarray


def sweep(
    vary: Mapping[str, Iterable[Any]],
    preset: str = "static",
    set: Mapping[str, Any] | Sequence[str] = (),
    seed: int = 0,
    workers: int | None = 1,
    scheduler: str | None = None,
    output: Path | str | None = None,
    min_errors: int = 50,
    max_codewords: int = 1000,
    max_seconds: float | None = None,
    background: Path | str | None = None,
    imu: Path | str | None = None,
    progress: bool | None = None,
) -> "xarray.Dataset":
    """Measure error rates over a grid of settings as an xarray Dataset.

    Parameters
    ----------
    vary
        Values by dotted key, such as ``{"channel.distance_m": [40, 60, 80], "receiver": ["plain"]}``.
    preset
        Name of the preset.
    set
        Further changes: values by dotted key, or texts such as ``"signal.data_pairs=16"``.
    seed
        Random seed; results are independent of the workers.
    workers
        Number of processes; 1 for this process, None for a process per core. In a script, several processes need a
        call under ``if __name__ == "__main__":``.
    scheduler
        Address of a Dask scheduler in place of `workers` (then None).
    output
        Folder of the store for resuming the sweep; None for no store.
    min_errors, max_codewords, max_seconds
        Limits of a point: wrong codewords, codewords and computing time in s, see `StopRule`.
    background, imu
        Files of footage and motion for the channel, if any.
    progress
        True for a progress bar; None for a bar on a terminal only.

    Returns
    -------
    Dataset with a dimension for each varied key and "layer", and attributes for units and provenance; see `plot_rates`.

    Raises
    ------
    HeliographError
        A setting is invalid, or xarray is not installed.

    Warns
    -----
    UserWarning
        Points have arrays outside the detection range, or the cores cannot feed the number of workers.
    """
    from heliograph.sweeps.dataset import need_xarray, to_dataset

    need_xarray()
    rule = StopRule(min_errors=min_errors, max_codewords=max_codewords, max_seconds=max_seconds)
    grid = value_lists(vary)
    points = plan(grid, preset, merge_changes(set), seed, _path(background), _path(imu))
    tallies = [PointTally(point, rule) for point in points]
    if text := size_warning(points):
        warnings.warn(text, stacklevel=2)
    count_with_bar(tallies, output, workers, scheduler, progress, count)
    return to_dataset(grid, tallies)


def count_with_bar(
    tallies: Sequence[PointTally],
    output: Path | str | None,
    workers: int | None,
    scheduler: str | None,
    progress: bool | None,
    count: Callable[..., None],
) -> None:
    """Check the arguments of a public function and `count`."""
    if not isinstance(workers, Integral | None):
        raise HeliographError(f"workers are a whole number, or None for one a core, not {shown(workers)}")
    if not isinstance(scheduler, str | None):
        raise HeliographError(f"a scheduler is an address, such as 'tcp://127.0.0.1:8786', not {shown(scheduler)}")
    if text := fewer_workers(workers):
        warnings.warn(text, stacklevel=3)
    folder = _path(output)
    with bar(len(tallies), progress) as advance:
        count(tallies, folder, None if scheduler and workers == 1 else workers, scheduler, advance)


def count(
    tallies: Sequence[PointTally],
    output: Path | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: PointProgress = silent,
) -> None:
    """Open store and workers, `run`, and write the results, also after an interruption."""
    # if the workers fail to open, no folder is created
    with contextlib.closing(open_workers(workers, scheduler)) as crew, contextlib.closing(Store(output)) as store:
        for tally in tallies:
            _recall(tally, store)
        try:
            run(tallies, store, crew, progress)
        finally:
            if output is not None:
                write_results(output, tallies)


def write_results(folder: Path, tallies: Sequence[PointTally]) -> None:
    """Write points.json and points.csv atomically."""
    reports = [tally.report() for tally in tallies]
    write_whole(folder / "points.json", (json.dumps(reports, indent=1) + "\n").encode())
    rows = [
        point["settings"] | {"layer": name} | flat_report(layer) | {key: point[key] for key in METRICS}
        | tally.machine_times | {key: point[key] for key in ("blocks", "seed", "version", *tally.labels)}
        for tally, point in zip(tallies, reports, strict=True) for name, layer in point["layers"].items()
    ]  # fmt: skip
    text = io.StringIO()
    table = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    table.writeheader()
    table.writerows(rows)
    write_whole(folder / "points.csv", text.getvalue().encode())


def _path(path: Path | str | None) -> Path | None:
    if not isinstance(path, str | os.PathLike | None):
        raise HeliographError(f"output, background and imu are paths, not {shown(path)}")
    return None if path is None else Path(path)
