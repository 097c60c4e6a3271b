"""heliograph sweep."""

import contextlib
import logging
import os
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from heliograph.base.config import merge, parse_assignment
from heliograph.base.errors import HeliographError, SettingsError
from heliograph.cli import console, options

if TYPE_CHECKING:
    from heliograph.measure.statistics import Count
    from heliograph.sweeps.runner import PointProgress
    from heliograph.sweeps.tally import PointTally

SCALE = 1000
"""Parts of a point in the progress bar."""

SPEED_PERIOD_S = 3600.0
"""Time in s over which the speed is averaged that the time left is estimated from."""


def run_sweep(
    vary: list[str] | None,
    preset: str,
    file: Path | None,
    assignments: list[str] | None,
    seed: int,
    output: Path | None,
    limits: dict[str, Any],
    crew: tuple[int | None, str | None],
    recordings: tuple[Path | None, Path | None],
    as_json: bool,
) -> None:
    """Count errors over a grid of settings; whatever ends it, what was counted before is kept and shown."""
    from heliograph.sweeps.executors import THREAD_LIMITS

    os.environ.update(THREAD_LIMITS)  # NumPy is not imported yet
    from heliograph.sweeps.plan import plan
    from heliograph.sweeps.tally import PointTally, StopRule

    points = plan(_varied(vary), preset, _over(file, assignments), seed, *recordings)
    tallies = [PointTally(point, StopRule(**limits)) for point in points]
    logging.disable(logging.CRITICAL)  # what is lost of a cluster is said in one line
    ending = _run(tallies, output, crew)
    if isinstance(ending, Exception) and not any(tally.blocks for tally in tallies):
        raise ending
    console.say_json([tally.report() for tally in tallies]) if as_json else _show(tallies)
    if isinstance(ending, KeyboardInterrupt):
        kept = f"; {output} holds the results so far" if output else ""
        console.complain(f"interrupted with {sum(t.done for t in tallies)} of {len(tallies)} points complete{kept}")
        sys.exit(console.INTERRUPTED)
    if ending is not None:
        raise ending


def _run(
    tallies: "Sequence[PointTally]", output: Path | None, crew: tuple[int | None, str | None]
) -> BaseException | None:
    """Count to the end, or until something ends it: that is returned."""
    from heliograph.sweeps.sweep import count

    try:
        with _progress(len(tallies)) as progress:
            count(tallies, output, *crew, progress)
    except (HeliographError, OSError, MemoryError, KeyboardInterrupt) as error:
        return error
    return None


def _varied(texts: list[str] | None) -> dict[str, list[Any]]:
    from heliograph.sweeps.vary import parse_vary

    vary: dict[str, list[Any]] = {}
    for key, values in map(parse_vary, texts or ()):
        if key in vary:
            raise SettingsError(f"'{key}' is varied twice; write its values in one --vary")
        vary[key] = values
    return vary


def _over(file: Path | None, assignments: list[str] | None) -> Any:
    """File and assignments as one nested mapping."""
    tree: Any = options.read_toml(file) if file else {}
    for change in map(parse_assignment, assignments or ()):
        tree = merge(tree, change)
    return tree


@contextlib.contextmanager
def _progress(points: int) -> "Iterator[PointProgress]":
    """A bar with the time left on a terminal, a line now and then in a log."""
    if not sys.stderr.isatty():
        lines = console.Lines("sweeping, points", points)
        yield lambda tallies: lines(sum(tally.fraction for tally in tallies))
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}"), BarColumn(), TaskProgressColumn(), TimeRemainingColumn())
    # a block may take longer than Rich's half a minute, without which it has no speed
    screen = Console(stderr=True)
    with Progress(*columns, console=screen, transient=True, speed_estimate_period=SPEED_PERIOD_S) as bar:
        task = bar.add_task("sweeping", total=SCALE * points)

        def show(tallies: "Sequence[PointTally]") -> None:
            done = f"{sum(t.done for t in tallies)} of {points} points"
            bar.update(task, description=done, completed=round(SCALE * sum(t.fraction for t in tallies)))

        yield show


def _show(tallies: "Sequence[PointTally]") -> None:
    """A line per point and layer: codewords wrong, error rates with intervals, or bounds where no error was met."""
    rows = [row for tally in tallies for row in _rows(tally)]
    head = [*tallies[0].point.choice, "layer", "wrong", "of", "FER (95 %)", "BER (95 %)", "net bit/s"]
    widths = [max(map(len, column)) for column in zip(head, *rows, strict=True)]
    for cells in [head, *rows]:
        console.say("  ".join(f"{cell:>{width}}" for cell, width in zip(cells, widths, strict=True)))


def _rows(tally: "PointTally") -> "Iterator[list[str]]":
    """The net rate, which is of all layers, stands beside the first."""
    net = tally.net_bits_per_second
    rate = "no data" if net is None else f"{net:.0f}"
    for name, layer in tally.total.layers.items():
        counts = [str(layer.codeword_errors), str(layer.codewords), _text(layer.words), _text(layer.decoded)]
        yield [*map(str, tally.point.choice.values()), name, *counts, rate]
        rate = ""


def _text(count: "Count") -> str:
    if not count.errors:
        return count.text()
    low, high = count.interval()
    return f"{count.text()} ({low:.1e} to {high:.1e})"
