"""Writer of a data set with a datasheet; an interrupted run resumes."""

import csv
import io
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jinja2

from heliograph.base.errors import MediaError
from heliograph.base.files import clear_write_errors, room_for, shown_name, write_whole
from heliograph.datasets.film import write_planned
from heliograph.datasets.plan import CUTOUT_SIDES, SPLITS, DatasetPlan, planned
from heliograph.sweeps.plan import merge_changes

PLAN, TABLE, SHEET = "dataset.json", "films.csv", "DATASHEET.md"
"""Files of the data set: plan, list of films, datasheet."""


def datasheet(plan: DatasetPlan, sources: Sequence[str]) -> str:
    """Return the datasheet."""
    template = (Path(__file__).parent / "datasheet.md.j2").read_text(encoding="utf-8")
    return jinja2.Template(template, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True).render(
        plan=plan,
        splits={name: [film for film in plan.films if film.split == name] for name in SPLITS},
        kinds=sorted({point.settings.channel.background.kind for point in plan.points}),
        sources=sources,
        sides=CUTOUT_SIDES,
    )


def film_table(plan: DatasetPlan) -> str:
    """Return the list of films as CSV: number, file, split, seed, frames and varied values."""
    out = io.StringIO()
    keys = list(plan.points[0].choice)
    rows = csv.writer(out, lineterminator="\n")
    rows.writerow(["number", "file", "split", "seed", "frames", *keys])
    for film in plan.films:
        rows.writerow([film.number, film.name, film.split, film.seed, film.frames, *film.point.choice.values()])
    return out.getvalue()


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
    """Write films with truth and cut-outs as HDF5, with splits and a datasheet.

    An interrupted run resumes: existing films of the same data set are kept.

    Parameters
    ----------
    folder
        Output folder; created if missing.
    vary
        Values by dotted key, such as ``{"channel.distance_m": [20, 40]}``, for films of every combination.
    preset, set
        Fixed settings: a preset, and values by dotted key or texts such as "channel.camera.width=320".
    films
        Number of films per combination.
    splits
        Shares of train, validation and test.
    packets
        Length of a film in packets; by default, a packet for a static scene, and the full drive for a moving scene.
    seed
        Random seed, 0 to 2^40 - 1; film N has the seed 10^6 seed + N.
    backgrounds
        Footage for backgrounds; each file is used in a single split.
    imu
        Recorded motion of a car, if any.

    Returns
    -------
    Plan of the data set.

    Raises
    ------
    SettingsError
        An argument is invalid.
    MediaError
        The folder has another data set, the disk is full, or a file cannot be read or written.
    """
    scenes, motion = [Path(name) for name in backgrounds], None if imu is None else Path(imu)
    plan = planned(vary, preset, merge_changes(set), films, splits, packets, seed, scenes, motion)
    write(plan, Path(folder))
    return plan


def done(plan: DatasetPlan, folder: Path) -> list[int]:
    """Return the numbers of the existing films in a folder."""
    try:
        known = _read_plan(folder / PLAN)
        foreign = known is None and folder.exists() and (not folder.is_dir() or any(folder.iterdir()))
    except OSError as error:
        raise MediaError(f"cannot read {folder}: {error.strerror or error}") from None
    if foreign:
        raise MediaError(f"{folder} is not empty, and holds no data set: choose a new folder")
    if known is not None and known != _plain(plan):
        before = known if isinstance(known, dict) else {}
        differing = ", ".join(key for key in plan.about if before.get(key) != _plain(plan)[key])
        raise MediaError(
            f"{folder} holds another data set (it differs in {differing}): choose another folder, or remove it"
        )
    return [film.number for film in plan.films if (folder / film.name).is_file()]


def write(plan: DatasetPlan, folder: Path, progress: Callable[[float], None] = lambda _: None) -> None:
    """Write the missing films, then the table and the datasheet."""
    kept = frozenset(done(plan, folder))
    parent = next(path for path in (folder, *folder.absolute().parents) if path.is_dir())
    room_for(parent / folder.name, sum(film.bytes for film in plan.films if film.number not in kept))
    with clear_write_errors(folder):
        for split in {film.split for film in plan.films}:
            (folder / split).mkdir(parents=True, exist_ok=True)
    write_whole(folder / PLAN, json.dumps(_plain(plan)).encode())
    missing = [film for film in plan.films if film.number not in kept]
    for count, film in enumerate(missing, len(kept)):
        write_planned(folder / film.name, film, count, progress)
        progress(count + 1)
    sources = sorted({shown_name(r.path) for film in plan.films for r in film.point.recordings.values()})
    write_whole(folder / TABLE, film_table(plan).encode())
    write_whole(folder / SHEET, datasheet(plan, sources).encode())


def _plain(plan: DatasetPlan) -> Any:
    """Return the inputs of a plan after a round trip through JSON."""
    return json.loads(json.dumps(plan.about))


def _read_plan(path: Path) -> Any:
    """Return the plan of a folder; None if the file is missing, {} if invalid."""
    try:
        # 10 000 combinations take 60 MB
        return json.loads(path.read_bytes()) if path.stat().st_size <= 1 << 26 else {}
    except (FileNotFoundError, NotADirectoryError):
        return None
    except ValueError:
        return {}
