"""Data sets for training."""

from pathlib import Path

from heliograph.base.errors import SettingsError, shown
from heliograph.cli import console
from heliograph.datasets.dataset import SHEET, done, write
from heliograph.datasets.plan import SPLITS, DatasetPlan


def parse_shares(text: str) -> list[int]:
    """Return the shares of the splits."""
    try:
        return [int(part) for part in text.split(",")]
    except ValueError:
        raise SettingsError(f"--splits takes TRAIN,VALIDATION,TEST in whole shares, not {shown(text)}") from None


def run_dataset(folder: Path, plan: DatasetPlan, seed: int, *, size_only: bool) -> None:
    """Print the size of a data set, and write the films that are missing."""
    kept = len(done(plan, folder))
    size = f"{plan.bytes / 1e9:.1f} GB" if plan.bytes >= 1e9 else f"{plan.bytes / 1e6:.1f} MB"
    existing = f", of which {kept} films exist" if kept else ""
    console.say(f"{folder}: {len(plan.films)} films, {plan.frames} frames, {size}{existing}")
    if size_only:
        return
    advance = console.Progress()
    try:
        with console.progress("films", len(plan.films)) as advance:
            advance(kept)
            write(plan, folder, advance)
    except KeyboardInterrupt:
        films = f"{int(advance.done)} of {len(plan.films)} films"
        console.exit_interrupted(f"interrupted after {films}; the same command continues")
    splits = ", ".join(f"{sum(film.split == name for film in plan.films)} {name}" for name in SPLITS)
    console.say(f"{folder / SHEET}: seed {seed}; {splits}")
