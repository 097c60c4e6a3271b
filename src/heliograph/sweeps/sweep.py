"""Sweeps: error rates over a grid of settings, as a function and as files."""

import contextlib
import csv
import io
import json
import os
import warnings
from collections.abc import Iterable, Mapping, Sequence
from numbers import Integral
from pathlib import Path
from typing import TYPE_CHECKING, Any

from heliograph.base.errors import HeliographError, shown
from heliograph.base.files import write_whole
from heliograph.sweeps.executors import fewer_workers, open_workers
from heliograph.sweeps.plan import laid_over, listed, not_looked_for, plan
from heliograph.sweeps.runner import PointProgress, bar, recall_all, run, silent
from heliograph.sweeps.store import Store
from heliograph.sweeps.tally import PointTally, StopRule

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
        Processes; 1 computes in this one, None takes one per core. In a script, more than one need a call under
        ``if __name__ == "__main__":``.
    scheduler
        Address of a Dask scheduler in place of `workers` (then None).
    output
        Folder of the store that makes the sweep resumable; None keeps nothing.
    min_errors, max_codewords, max_seconds
        When a point has enough: wrong codewords, codewords and computing time in s, as of `StopRule`.
    background, imu
        Files of footage and of motion for the channel; None where there are none.
    progress
        Whether a bar shows how far it is; None: on a terminal only.

    Returns
    -------
    Dataset with a dimension for each varied key and "layer"; units and provenance in its attributes. `plot_rates` draws
    it.

    Raises
    ------
    HeliographError
        A setting is wrong, or xarray is not installed.

    Warns
    -----
    UserWarning
        Points have arrays too small or too large to be looked for, or fewer workers start than were asked for.
    """
    from heliograph.sweeps.dataset import need_xarray, to_dataset

    need_xarray()
    _check(workers, scheduler)
    rule = StopRule(min_errors=min_errors, max_codewords=max_codewords, max_seconds=max_seconds)
    grid = listed(vary)
    points = plan(grid, preset, laid_over(set), seed, _path(background), _path(imu))
    tallies = [PointTally(point, rule) for point in points]
    for text in filter(None, (not_looked_for(points), fewer_workers(workers))):
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
    """Open store and workers, `run`, and write the results so far however it ends."""
    # workers that are not there leave no folder behind
    with contextlib.closing(open_workers(workers, scheduler)) as crew, Store(output) as store:
        recall_all(tallies, store)
        try:
            run(tallies, store, crew, progress)
        finally:
            if output is not None:
                write_results(output, tallies)


def write_results(folder: Path, tallies: Sequence[PointTally]) -> None:
    """Write points.json and points.csv, each whole or not at all."""
    reports = [tally.report() for tally in tallies]
    write_whole(folder / "points.json", (json.dumps(reports, indent=1) + "\n").encode())
    rows = [
        {
            **point["settings"],
            "layer": name,
            **_flat(layer),
            **{key: point[key] for key in ("packets", "detected", "net_bits_per_second")},
        }
        for point in reports
        for name, layer in point["layers"].items()
    ]
    text = io.StringIO()
    table = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    table.writeheader()
    table.writerows(rows)
    write_whole(folder / "points.csv", text.getvalue().encode())


def _flat(layer: Mapping[str, Any]) -> dict[str, Any]:
    """A layer's report with intervals as two columns each."""
    flat = {name: value for name, value in layer.items() if not name.endswith("_ci")}
    for name in [name for name in layer if name not in flat]:
        rate = name.removesuffix("_ci")
        flat[f"{rate}_low"], flat[f"{rate}_high"] = layer[name]
    return flat


def _check(workers: object, scheduler: object) -> None:
    if not isinstance(workers, Integral | None):
        raise HeliographError(f"workers are a whole number, or None for one a core, not {shown(workers)}")
    if not isinstance(scheduler, str | None):
        raise HeliographError(f"a scheduler is an address, such as 'tcp://127.0.0.1:8786', not {shown(scheduler)}")


def _path(path: Path | str | None) -> Path | None:
    if not isinstance(path, str | os.PathLike | None):
        raise HeliographError(f"output, background and imu are paths, not {shown(path)}")
    return None if path is None else Path(path)
