"""What a data set says of itself: a datasheet in Markdown, and a table of its films."""

import csv
import io
from collections.abc import Sequence
from typing import Any

from heliograph import __version__
from heliograph.datasets.plan import CUTOUT_SIDES, SPLITS, DatasetPlan, PlannedFilm

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


SHEET = """# Datasheet

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
    return SHEET.format(
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
