"""heliograph dataset."""

import sys
from pathlib import Path
from typing import Any

from heliograph.base.errors import SettingsError, shown
from heliograph.cli import console, options


def run_dataset(
    folder: Path,
    vary: list[str] | None,
    preset: str,
    file: Path | None,
    assignments: list[str] | None,
    lengths: tuple[int, int | None],
    splits: str,
    seed: int,
    recordings: tuple[list[Path], Path | None],
    size_alone: bool,
) -> None:
    """Say how large a data set is, and write it; what was written before Ctrl-C is kept."""
    from heliograph.datasets.dataset import SHEET, done, write
    from heliograph.datasets.plan import planned

    films, packets = lengths
    over: Any = options.laid_over(file, assignments)
    plan = planned(options.varied(vary), preset, over, films, _shares(splits), packets, seed, *recordings)
    kept = len(done(plan, folder))
    there = f", of which {kept} films are there" if kept else ""
    console.say(f"{folder}: {len(plan.films)} films, {plan.frames} frames, {_size(plan.bytes)}{there}")
    if size_alone:
        return
    written = float(kept)
    try:
        with console.progress("films", len(plan.films)) as advance:

            def note(count: float) -> None:
                nonlocal written
                written = count
                advance(count)

            note(kept)
            write(plan, folder, note)
    except KeyboardInterrupt:
        console.complain(f"interrupted after {int(written)} of {len(plan.films)} films; the same command goes on")
        sys.exit(console.INTERRUPTED)
    console.say(f"{folder / SHEET}: seed {seed}; " + ", ".join(f"{n} {name}" for name, n in _counted(plan).items()))


def _shares(text: str) -> list[int]:
    try:
        return [int(one) for one in text.split(",")]
    except ValueError:
        raise SettingsError(f"--splits takes TRAIN,VALIDATION,TEST in whole shares, not {shown(text)}") from None


def _counted(plan: Any) -> dict[str, int]:
    """Films by split."""
    from heliograph.datasets.plan import SPLITS

    return {name: sum(film.split == name for film in plan.films) for name in SPLITS}


def _size(size: int) -> str:
    return f"{size / 1e9:.1f} GB" if size >= 1e9 else f"{size / 1e6:.1f} MB"
