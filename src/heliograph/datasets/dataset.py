"""Writer of a data set with a datasheet; an interrupted run resumes."""

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
            cutout = film["cutouts/pixels"][k, 0]  # around the first array
            first, last = film["truth/patterns"][k, 0]  # visible patterns of the array
            sent = film["sent/0/levels"][first - film["sent/0"].attrs["first_pattern"]]  # (n, n), 0 to 4
"""
"""Example code for reading a data set with h5py."""

LAYOUT = (
    ("frames", "frame, row, column", "gray levels"),
    ("times_s", "frame", "start of each exposure by the camera clock, s"),
    ("truth/index, time_s", "frame", "frame number, dropped frames included; true start of the exposure, s"),
    ("truth/corners", "frame, array, 4, 2",
     "x and y in px of the corners of the LED area at mid-exposure: upper left, upper right, lower right, lower left "
     "of the array; integers are pixel centres"),
    ("truth/homography", "frame, array, 3, 3", "m in the array plane, right and down from the centre, to px"),
    ("truth/distance_m", "frame, array", "depth of the centre, m"),
    ("truth/visible", "frame, array", "true if the array faces the camera, with all LEDs in the frame"),
    ("truth/patterns", "frame, array, 2", "first and last pattern during the exposure; -1 if dark"),
    ("cutouts/pixels", "frame, array, row, column", "pixels around the true position; 0 outside the frame"),
    ("cutouts/origin", "frame, array, 2", "x and y of the first pixel of a cut-out in the frame"),
    ("sent/K/levels", "pattern, LED row, LED column",
     "levels of array K, 0 to 4; attributes: identity, and first_pattern, the pattern of the first row"),
    ("sent/K/messages/LAYER", "byte", "the message of a layer: high, middle, low"),
)  # fmt: skip
"""Data sets of a file: name, axes, content."""

TEMPLATE = """# Datasheet

Simulated films of LED arrays for training and testing detectors and decoders, with the truth of each frame and
cut-outs.

## Content

{splits}

{films} films, {frames:,} frames, {megabytes:,.1f} MB of pixels. `films.csv` lists the films.

## Varied settings

{points}

The attribute `settings` of a file has all settings as JSON, `varied` the varied settings.

## Splits

Film N has the seed {first_seed} + N, which determines messages, noise, road, position and drawn scene. Films and splits
share no seed. Backgrounds:

{scenes}

{recordings}

## Generation

By `heliograph dataset` of heliograph {version} with the seed {seed}. The same command, version and recordings give
equal films.

## File format

HDF5, a film per file. Heliograph reads the files like other films: `heliograph receive train/000000.h5`.

{layout}

A cut-out has {sides:g} times the side of the largest image of the array. Gray levels range from 0 to 2^bits - 1.
`bits`, `rate_hz`, `seed` and `split` are attributes.

```python
{read}```

## Limitations

- The films are simulated. Effects outside the simulator are absent.
- Cut-outs are centred on the true position, unknown to a receiver. Shift cut-outs by a pixel or two in training.
- Films of a row differ by seed only. Vary further settings for the diversity of real roads.
"""
"""Template of the datasheet."""

SCENES = {
    "flat": "uniform gray, equal in all films",
    "footage": "recorded footage; each file is in a single split",
}
"""Backgrounds by kind; other kinds are drawn for each film."""


def datasheet(plan: DatasetPlan, sources: Sequence[str]) -> str:
    """Return the datasheet."""
    by_split = {name: [film for film in plan.films if film.split == name] for name in SPLITS}
    splits = [(name, len(by), sum(film.frames for film in by), _seeds(by)) for name, by in by_split.items() if by]
    kinds = sorted({point.settings.channel.background.kind for point in plan.points})
    counts = ", ".join(map(str, plan.about["splits"].values()))
    points = [(point.text if point.choice else "all films", counts) for point in plan.points]
    named = f"Recordings: {', '.join(sources)}." if sources else "No recordings were used."
    shared = " All splits use the same recorded car motion." if plan.about["imu"] else ""
    return TEMPLATE.format(
        splits=_table(("split", "films", "frames", "seeds"), splits),
        films=len(plan.films),
        frames=plan.frames,
        megabytes=plan.bytes / 1e6,
        points=_table(("films of", "in train, validation, test"), points),
        first_seed=plan.films[0].seed,
        scenes="\n".join(f"- {kind}: {SCENES.get(kind, 'drawn for each film')}" for kind in kinds),
        recordings=named + shared,
        version=__version__,
        seed=plan.about["seed"],
        layout=_table(("data set", "axes", "content"), LAYOUT),
        sides=CUTOUT_SIDES,
        read=READ,
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


def _seeds(films: Sequence[PlannedFilm]) -> str:
    return ", ".join(str(film.seed) for film in films[:3]) + (", ..." if len(films) > 3 else "")


def _table(head: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    cells = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(str(cell).replace("|", "\\|") for cell in row) + " |" for row in cells)


PLAN, TABLE, SHEET = "dataset.json", "films.csv", "DATASHEET.md"
"""Files of the data set: plan, list of films, datasheet."""


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
    count = len(kept)
    for film in plan.films:
        if film.number in kept:
            continue
        write_planned(folder / film.name, film, _film_progress(film, count, progress))
        count += 1
        progress(count)
    sources = sorted({shown_name(r.path) for film in plan.films for r in film.point.recordings.values()})
    write_whole(folder / TABLE, film_table(plan).encode())
    write_whole(folder / SHEET, datasheet(plan, sources).encode())


def _film_progress(film: PlannedFilm, before: int, progress: Callable[[float], None]) -> Callable[[int], None]:
    """Convert the frames of a film to the progress of all films."""
    return lambda frames: progress(before + min(frames / max(film.frames, 1), 1.0))


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
