"""Sweeps: error rates over a grid of settings, by any number of workers, to be broken off and resumed at will."""

import csv
import io
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, CancelledError, Future, wait
from pathlib import Path
from typing import TYPE_CHECKING, Any

from heliograph.base.errors import HeliographError
from heliograph.base.files import write_whole
from heliograph.measure.counts import BlockCounts
from heliograph.sweeps.executors import Workers, open_workers
from heliograph.sweeps.plan import laid_over, plan
from heliograph.sweeps.points import PointTally, StopRule, build, run_job
from heliograph.sweeps.store import Store
from heliograph.sweeps.vary import listed

if TYPE_CHECKING:
    import xarray

LOSSES = 4
"""Times in a row that workers may be lost without a block done in between."""

Progress = Callable[[Sequence[PointTally]], None]


def silent(tallies: Sequence[PointTally], /) -> None:
    """Report no progress."""


def run(tallies: Sequence[PointTally], store: Store, workers: Workers, progress: Progress = silent) -> None:
    """Count until all points have enough; the tallies hold the results so far at any time.

    Parameters
    ----------
    tallies
        One a point.
    store
        Blocks in it are not computed again, and all that are computed go there.
    workers
        Compute.
    progress
        Called with the tallies after each block.

    Raises
    ------
    HeliographError
        A block cannot be computed, or workers are lost again and again.
    """
    for tally in tallies:
        store.note(tally.point)
        _recall(tally, store)
    progress(tallies)
    flying: dict[Future[dict[str, Any]], tuple[PointTally, int]] = {}
    losses = 0
    while _fill(flying, tallies, store, workers):
        ended, _ = wait(flying, return_when=FIRST_COMPLETED)
        lost = [_take(future, *flying.pop(future), store) for future in ended]
        losses = losses + 1 if all(lost) else 0
        if losses >= LOSSES:
            raise HeliographError(
                f"worker processes died {losses} times in a row; is memory short? Take fewer workers, and in a script "
                "call sweep() under 'if __name__ == \"__main__\":'"
            )
        if any(lost):
            flying.clear()  # all are lost with the pool; whatever was done is in the store or done again
            workers.restart()
        progress(tallies)


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
) -> "xarray.Dataset":
    """Error rates over a grid of settings as an xarray Dataset.

    Parameters
    ----------
    vary
        Values by dotted key, such as ``{"channel.distance_m": [40, 60, 80], "receiver": ["plain"]}``.
    preset
        Preset to start from.
    set
        What else to change: values by dotted key, or texts such as ``"signal.data_pairs=16"``.
    seed
        Of all that is random; the result depends on it, not on the workers.
    workers
        Processes; 1 computes in this one, None takes one a core. In a script, more than one need a call under
        ``if __name__ == "__main__":``.
    scheduler
        Address of a Dask scheduler in place of `workers` (then None).
    output
        Folder of the store that makes the sweep resumable; None keeps nothing.
    min_errors, max_codewords, max_seconds
        See `StopRule`.
    background, imu
        Recordings for the channel.

    Returns
    -------
    Dataset with a dimension for each varied key and "layer"; units and provenance in its attributes.

    Raises
    ------
    HeliographError
        A setting is wrong, or the extra "analysis" is not installed.
    """
    from heliograph.sweeps.dataset import need_xarray, to_dataset

    need_xarray()
    rule = StopRule(min_errors=min_errors, max_codewords=max_codewords, max_seconds=max_seconds)
    grid = listed(vary)
    points = plan(grid, preset, laid_over(set), seed, _path(background), _path(imu))
    tallies = [PointTally(point, rule) for point in points]
    count(tallies, _path(output), None if scheduler and workers == 1 else workers, scheduler)
    return to_dataset(grid, tallies)


def count(
    tallies: Sequence[PointTally],
    output: Path | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Progress = silent,
) -> None:
    """Open store and workers, `run`, and write the results so far however it ends.

    Parameters
    ----------
    tallies, progress
        See `run`.
    output
        Folder of the store; None keeps nothing.
    workers, scheduler
        See `open_workers`.
    """
    with Store(output) as store:
        crew = open_workers(workers, scheduler)
        try:
            run(tallies, store, crew, progress)
        finally:
            crew.close()
            if output is not None:
                write_results(output, tallies)


def write_results(folder: Path, tallies: Sequence[PointTally]) -> None:
    """Write points.json and points.csv, each whole or not at all."""
    reports = [tally.report() for tally in tallies]
    write_whole(folder / "points.json", (json.dumps(reports, indent=1) + "\n").encode())
    rows = [
        {**point["settings"], "layer": name, **_flat(layer), "net_bits_per_second": point["net_bits_per_second"]}
        for point in reports
        for name, layer in point["layers"].items()
    ]
    text = io.StringIO()
    table = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    table.writeheader()
    table.writerows(rows)
    write_whole(folder / "points.csv", text.getvalue().encode())


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


def _flat(layer: Mapping[str, Any]) -> dict[str, Any]:
    """A layer's report with intervals as two columns each."""
    flat = {name: value for name, value in layer.items() if not name.endswith("_ci")}
    for rate in ("ber", "fer"):
        flat[f"{rate}_low"], flat[f"{rate}_high"] = layer[f"{rate}_ci"]
    return flat


def _path(path: Path | str | None) -> Path | None:
    return None if path is None else Path(path)
