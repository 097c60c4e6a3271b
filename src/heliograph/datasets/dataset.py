"""Write a data set into a folder; one that was stopped goes on where it was."""

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from heliograph.base.errors import MediaError
from heliograph.base.files import clear_write_errors, room_for, shown_name, write_whole
from heliograph.datasets.film import write_planned
from heliograph.datasets.plan import DatasetPlan, PlannedFilm, planned
from heliograph.datasets.sheet import datasheet, film_table
from heliograph.sweeps.plan import laid_over

PLAN, TABLE, SHEET = "dataset.json", "films.csv", "DATASHEET.md"
"""Files beside the films: all that they follow from, their list, and what the data set is."""

MOST_PLAN = 1 << 26
"""Most bytes of a plan that is read: 10 000 combinations of values take 60 MB."""


def write_dataset(
    folder: str | Path,
    vary: Mapping[str, Iterable[Any]],
    preset: str = "static",
    set: Mapping[str, Any] | Sequence[str] = (),
    films: int = 10,
    splits: Sequence[int] = (80, 10, 10),
    packets: int | None = None,
    seed: int = 0,
    backgrounds: Sequence[str | Path] = (),
    imu: str | Path | None = None,
) -> DatasetPlan:
    """Write films with their truth and cut-outs as HDF5, with splits and a datasheet.

    Films that the folder has already of the same data set are kept: what was stopped goes on.

    Parameters
    ----------
    folder
        Where it goes; made if it does not exist.
    vary
        Values by dotted key, such as ``{"channel.distance_m": [20, 40]}``: every combination gets films.
    preset, set
        What does not vary: a preset, and values by dotted key or texts such as "channel.camera.width=320".
    films
        Films of each combination.
    splits
        Shares of train, validation and test.
    packets
        Length of a film in packets; None: one where nothing moves, else the whole drive.
    seed
        Of all that is random, 0 to 2^40 - 1; film N has the seed 10^6 seed + N.
    backgrounds
        Footage for backgrounds; each file serves one split alone.
    imu
        Recorded motion of a car; None where there is none.

    Returns
    -------
    What it consists of.

    Raises
    ------
    SettingsError
        An argument is none of these.
    MediaError
        The folder holds another data set, there is no room, or a file cannot be read or written.
    """
    plan = planned(vary, preset, laid_over(set), films, splits, packets, seed, [Path(one) for one in backgrounds],
                   Path(imu) if imu is not None else None)  # fmt: skip
    write(plan, Path(folder))
    return plan


def done(plan: DatasetPlan, folder: Path) -> list[int]:
    """Numbers of the films that a folder has already."""
    try:
        known = _read_plan(folder / PLAN)
        strange = known is None and folder.exists() and (not folder.is_dir() or any(folder.iterdir()))
    except OSError as error:
        raise MediaError(f"cannot read {folder}: {error.strerror or error}") from None
    if strange:
        raise MediaError(f"{folder} is not empty, and holds no data set: choose a new folder")
    if known is not None and known != _plain(plan):
        before = known if isinstance(known, dict) else {}
        differing = ", ".join(key for key in plan.about if before.get(key) != _plain(plan)[key])
        raise MediaError(
            f"{folder} holds another data set (it differs in {differing}): choose another folder, or remove it"
        )
    return [film.number for film in plan.films if (folder / film.name).is_file()]


def write(plan: DatasetPlan, folder: Path, progress: Callable[[float], None] = lambda _: None) -> None:
    """Write the films that are missing, then the table and the datasheet."""
    kept = frozenset(done(plan, folder))
    there = next(one for one in (folder, *folder.absolute().parents) if one.is_dir())
    room_for(there / folder.name, sum(film.bytes for film in plan.films if film.number not in kept))
    with clear_write_errors(folder):
        for split in {film.split for film in plan.films}:
            (folder / split).mkdir(parents=True, exist_ok=True)
    write_whole(folder / PLAN, json.dumps(_plain(plan)).encode())
    count = len(kept)
    for film in plan.films:
        if film.number in kept:
            continue
        write_planned(folder / film.name, film, _part_of(film, count, progress))
        count += 1
        progress(count)
    sources = sorted({shown_name(one.path) for film in plan.films for one in film.point.recordings.values()})
    write_whole(folder / TABLE, film_table(plan).encode())
    write_whole(folder / SHEET, datasheet(plan, sources).encode())


def _part_of(film: PlannedFilm, before: int, progress: Callable[[float], None]) -> Callable[[int], None]:
    """Progress of a film's frames as that of all films, of which so many were done before."""
    return lambda frames: progress(before + min(frames / max(film.frames, 1), 1.0))


def _plain(plan: DatasetPlan) -> Any:
    """What a plan follows from, as it is once it was JSON."""
    return json.loads(json.dumps(plan.about))


def _read_plan(path: Path) -> Any:
    """The plan of a folder; None where it has none, and something else where it is none."""
    try:
        return json.loads(path.read_bytes()) if path.stat().st_size <= MOST_PLAN else {}
    except (FileNotFoundError, NotADirectoryError):
        return None
    except ValueError:
        return {}
