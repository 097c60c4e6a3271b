"""Sweeps: error rates over a grid of settings, as a Dataset and as files."""

import csv
import io
import json
import os
import warnings
from collections.abc import Iterable, Mapping, Sequence
from contextlib import closing
from numbers import Integral
from pathlib import Path
from typing import TYPE_CHECKING, Any

from heliograph.base.errors import HeliographError, shown
from heliograph.base.files import write_whole
from heliograph.sweeps.executors import fewer_workers, open_workers
from heliograph.sweeps.plan import merge_changes, plan, size_warning, value_lists
from heliograph.sweeps.runner import PointProgress, bar, recall_all, run, silent
from heliograph.sweeps.store import Store
from heliograph.sweeps.tally import PointTally, StopRule, flat_report

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
        Number of processes; 1 for this process, None for one per core. In a script, several processes need a call under
        ``if __name__ == "__main__":``.
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
    if not isinstance(workers, Integral | None):
        raise HeliographError(f"workers are a whole number, or None for one a core, not {shown(workers)}")
    if not isinstance(scheduler, str | None):
        raise HeliographError(f"a scheduler is an address, such as 'tcp://127.0.0.1:8786', not {shown(scheduler)}")
    rule = StopRule(min_errors=min_errors, max_codewords=max_codewords, max_seconds=max_seconds)
    grid = value_lists(vary)
    points = plan(grid, preset, merge_changes(set), seed, _path(background), _path(imu))
    tallies = [PointTally(point, rule) for point in points]
    for text in filter(None, (size_warning(points), fewer_workers(workers))):
        warnings.warn(text, stacklevel=2)
    with bar(len(tallies), progress) as advance:
        count(tallies, _path(output), None if scheduler and workers == 1 else workers, scheduler, advance)
    return to_dataset(grid, tallies)


def count(
    tallies: Sequence[PointTally],
    output: Path | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: PointProgress = silent,
) -> None:
    """Open store and workers, `run`, and write the results, also after an interruption."""
    # if the workers fail to open, no folder is created
    with closing(open_workers(workers, scheduler)) as crew, closing(Store(output)) as store:
        recall_all(tallies, store)
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
        point["settings"] | {"layer": name} | flat_report(layer)
        | {key: point[key] for key in ("packets", "detected", "net_bits_per_second")}
        for point in reports for name, layer in point["layers"].items()
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
