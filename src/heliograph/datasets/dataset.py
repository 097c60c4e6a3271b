"""Write a data set with its datasheet into a folder; an interrupted run resumes."""

import csv
import io
import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from heliograph import __version__
from heliograph.base.errors import MediaError
from heliograph.base.files import clear_write_errors, room_for, shown_name, write_whole
from heliograph.datasets.film import write_planned
from heliograph.datasets.plan import CUTOUT_SIDES, SPLITS, DatasetPlan, PlannedFilm, planned
from heliograph.sweeps.plan import merge_changes

READ = """import h5py, pathlib

for path in sorted(pathlib.Path("train").glob("*.h5")):
    with h5py.File(path) as film:
        for k, frame in enumerate(film["frames"]):
            corners = film["truth/corners"][k]  # (arrays, 4, 2) px, x and y
            cutout = film["cutouts/pixels"][k, 0]  # about the first array
            first, last = film["truth/patterns"][k, 0]  # patterns that the frame shows of it
            sent = film["sent/0/levels"][first - film["sent/0"].attrs["first_pattern"]]  # (n, n), 0 to 4
"""
"""How a data set is read, with h5py alone."""

LAYOUT = (
    ("frames", "frame, row, column", "gray levels"),
    ("times_s", "frame", "start of each exposure by the camera's clock, s"),
    ("truth/index, time_s", "frame", "number of the frame, dropped ones counted; true start of its exposure, s"),
    ("truth/corners", "frame, array, 4, 2",
     "x and y in px of the LED area's corners at the middle of the exposure: upper left, upper right, lower right, "
     "lower left as the array counts; an integer is a pixel's centre"),
    ("truth/homography", "frame, array, 3, 3", "metres on the array, right and down from its centre, to px"),
    ("truth/distance_m", "frame, array", "depth of its centre, m"),
    ("truth/visible", "frame, array", "whether all of it is in the frame and faces the camera"),
    ("truth/patterns", "frame, array, 2", "first and last pattern shown within the exposure; -1 for none"),
    ("cutouts/pixels", "frame, array, row, column", "pixels about the true place; 0 beyond the frame"),
    ("cutouts/origin", "frame, array, 2", "x and y of a cut-out's first pixel in the frame"),
    ("sent/K/levels", "pattern, LED row, LED column",
     "what array K sent, 0 to 4; its attributes identity and first_pattern name the array and the first row's pattern"),
    ("sent/K/messages/LAYER", "byte", "the message of a layer: high, middle, low"),
)  # fmt: skip
"""Data sets of a file, their axes and what they hold."""


TEMPLATE = """# Datasheet

Simulated films of LED arrays that send data to a camera, with the truth of each frame and cut-outs, to train and to
judge detectors and decoders.

## What it has

{splits}

{films} films, {frames:,} frames, {megabytes:,.1f} MB of pixels. `films.csv` lists the films.

## What varies

{points}

Each file has all of its settings as JSON in the attribute `settings`, and what varies in `varied`.

## Splits

Film N has the seed {first_seed} + N. Its messages, noise, road, place and drawn scene come of its seed. So no two
films, and no two splits, share any of these. Backgrounds:

{scenes}

{recordings}

## How it was made

By `heliograph dataset` of heliograph {version} with the seed {seed}. The same command, version and recordings make the
same films, level for level.

## A file

HDF5, one film a file. What reads films of heliograph reads it: `heliograph receive train/000000.h5`.

{layout}

A cut-out has {sides:g} sides of the array where its image is largest. Gray levels go from 0 to 2^bits - 1. `bits`,
`rate_hz`, `seed` and `split` are attributes.

```python
{read}```

## What it is not

- Not filmed. Nothing is learned from it of what the simulator leaves out, such as rolling shutters, rain or colour.
- Cut-outs lie about the true place, which no receiver knows. Move them by a pixel or two in training.
- Films of one row differ by seed alone, not by all that differs on roads. Vary what matters to you.
"""
"""The datasheet, but for what is known of the data set."""

SCENES = {
    "flat": "an even gray, the same in all films",
    "footage": "recorded footage, of which each file is in one split alone",
}
"""Backgrounds by kind; any other is drawn anew for each film."""


def datasheet(plan: DatasetPlan, sources: Sequence[str]) -> str:
    """The datasheet."""
    by_split = {name: [film for film in plan.films if film.split == name] for name in SPLITS}
    splits = [(name, len(by), sum(film.frames for film in by), _seeds(by)) for name, by in by_split.items() if by]
    kinds = sorted({one.settings.channel.background.kind for one in plan.points})
    each = ", ".join(map(str, plan.about["splits"].values()))
    points = [(one.text if one.choice else "one kind", each) for one in plan.points]
    named = f"Recordings: {', '.join(sources)}." if sources else "No recordings were used."
    shared = " The motion of the car is that of one recording in all splits." if plan.about["imu"] else ""
    return TEMPLATE.format(
        splits=_table(("split", "films", "frames", "seeds"), splits),
        films=len(plan.films),
        frames=plan.frames,
        megabytes=plan.bytes / 1e6,
        points=_table(("films of", "in train, validation, test"), points),
        first_seed=plan.films[0].seed,
        scenes="\n".join(f"- {kind}: {SCENES.get(kind, 'drawn anew for each film')}" for kind in kinds),
        recordings=named + shared,
        version=__version__,
        seed=plan.about["seed"],
        layout=_table(("data set", "axes", "holds"), LAYOUT),
        sides=CUTOUT_SIDES,
        read=READ,
    )


def film_table(plan: DatasetPlan) -> str:
    """A line for each film, as CSV: number, file, split, seed, frames, and what varies."""
    out = io.StringIO()
    keys = list(plan.points[0].choice)
    rows = csv.writer(out, lineterminator="\n")
    rows.writerow(["number", "file", "split", "seed", "frames", *keys])
    for film in plan.films:
        rows.writerow([film.number, film.name, film.split, film.seed, film.frames, *film.point.choice.values()])
    return out.getvalue()


def _seeds(films: Sequence[PlannedFilm]) -> str:
    return ", ".join(str(film.seed) for film in films[:3]) + (", ..." if len(films) > 3 else "")


def _table(head: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    cells = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(str(cell).replace("|", "\\|") for cell in row) + " |" for row in cells)


PLAN, TABLE, SHEET = "dataset.json", "films.csv", "DATASHEET.md"
"""Files beside the films: all that they follow from, their list, and what the data set is."""


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
    plan = planned(vary, preset, merge_changes(set), films, splits, packets, seed, [Path(one) for one in backgrounds],
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
        # most bytes of a plan that is read: 10 000 combinations of values take 60 MB
        return json.loads(path.read_bytes()) if path.stat().st_size <= (1 << 26) else {}
    except (FileNotFoundError, NotADirectoryError):
        return None
    except ValueError:
        return {}
