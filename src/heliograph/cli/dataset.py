"""Data sets for training."""

from pathlib import Path
from typing import Annotated

import typer

from heliograph.base.errors import SettingsError, shown
from heliograph.cli import console, options
from heliograph.cli.options import option
from heliograph.datasets.dataset import SHEET, done, write
from heliograph.datasets.plan import SPLITS, planned
from heliograph.sweeps.plan import parse_vary_options


def parse_shares(text: str) -> list[int]:
    """Return the shares of the splits."""
    try:
        return [int(part) for part in text.split(",")]
    except ValueError:
        raise SettingsError(f"--splits takes TRAIN,VALIDATION,TEST in whole shares, not {shown(text)}") from None


@options.command
def dataset(
    folder: Annotated[Path, typer.Argument(metavar="DIR", help="New folder for the data set.")],
    *,
    vary: list[str] | None = options.vary_option("Such as distances, scenes, faults. Each combination gets films."),
    films: int = option("Films of each combination.", default=10, min=1),
    splits: str = option("Shares of train, validation and test.", "SHARES", default="80,10,10"),
    packets: int | None = option(
        "Length of a film in packets; default: a packet at rest, the complete drive in motion.", min=1
    ),
    settings: options.SettingsOptions = options.STATIC,
    seed: options.Seed = 0,
    background: list[Path] | None = option(
        "Recorded footage for the background; may be repeated: each video serves a single split.", "VIDEO"
    ),
    imu: options.Imu = None,
    size: bool = option("Print the size and write no data.", None, "--size", default=False),
) -> None:
    """Write labelled films for training.

    Films have truth and cut-outs, and are split for training detectors and decoders.

    The size is printed first. The same command continues a stopped run. DATASHEET.md in DIR describes the data set.
    """
    overlay, values, shares = settings.overlay(), parse_vary_options(vary), parse_shares(splits)
    plan = planned(values, settings.preset, overlay, films, shares, packets, seed, background or [], imu)
    kept = len(done(plan, folder))
    volume = f"{plan.bytes / 1e9:.1f} GB" if plan.bytes >= 1e9 else f"{plan.bytes / 1e6:.1f} MB"
    existing = f", of which {kept} films exist" if kept else ""
    console.say(f"{folder}: {len(plan.films)} films, {plan.frames} frames, {volume}{existing}")
    if size:
        return
    advance = console.Progress()
    try:
        with console.progress("films", len(plan.films)) as advance:
            advance(kept)
            write(plan, folder, advance)
    except KeyboardInterrupt:
        complete = f"{int(advance.done)} of {len(plan.films)} films"
        console.exit_interrupted(f"interrupted after {complete}; the same command continues")
    splits = ", ".join(f"{sum(film.split == name for film in plan.films)} {name}" for name in SPLITS)
    console.say(f"{folder / SHEET}: seed {seed}; {splits}")
