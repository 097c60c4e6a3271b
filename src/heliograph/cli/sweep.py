"""heliograph sweep."""

import logging
import os
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from heliograph.base.errors import HeliographError
from heliograph.cli import console, options

if TYPE_CHECKING:
    from heliograph.measure.statistics import Count
    from heliograph.sweeps.tally import PointTally


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
    from heliograph.base.workers import THREAD_LIMITS
    from heliograph.sweeps.executors import fewer_workers

    os.environ.update(THREAD_LIMITS)  # NumPy is not imported yet
    from heliograph.sweeps.plan import not_looked_for, plan
    from heliograph.sweeps.tally import PointTally, StopRule

    points = plan(options.varied(vary), preset, options.laid_over(file, assignments), seed, *recordings)
    tallies = [PointTally(point, StopRule(**limits)) for point in points]
    for text in filter(None, (not_looked_for(points), fewer_workers(crew[0]))):
        console.complain(text)
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
    from heliograph.sweeps.runner import bar
    from heliograph.sweeps.sweep import count

    try:
        with bar(len(tallies)) as progress:
            count(tallies, output, *crew, progress)
    except (HeliographError, OSError, MemoryError, KeyboardInterrupt) as error:
        return error
    return None


def _show(tallies: "Sequence[PointTally]") -> None:
    """A line per point and layer: codewords wrong, error rates with intervals or bounds, packets found."""
    rows = [row for tally in tallies for row in _rows(tally)]
    head = [*tallies[0].point.choice, "layer", "wrong", "of", "FER (95 %)", "BER (95 %)", "found", "net bit/s"]
    console.say_table(head, rows)


def _rows(tally: "PointTally") -> "Iterator[list[str]]":
    """Packets found and net rate, which are of all layers, stand beside the first."""
    net = tally.net_bits_per_second
    rate = "no data" if net is None else f"{net:.0f}"
    found = f"{tally.total.detected}/{tally.total.packets}"
    for name, layer in tally.total.layers.items():
        counts = [str(layer.codeword_errors), str(layer.codewords), _text(layer.words), _text(layer.decoded)]
        yield [*map(str, tally.point.choice.values()), name, *counts, found, rate]
        found = rate = ""


def _text(count: "Count") -> str:
    if not count.errors:
        return count.text()
    low, high = count.interval()
    return f"{count.text()} ({low:.1e} to {high:.1e})"
