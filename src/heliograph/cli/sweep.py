"""Error rates over a grid of settings."""

import logging
from collections.abc import Iterator, Sequence
from pathlib import Path

from heliograph.base.errors import HeliographError
from heliograph.cli import console
from heliograph.cli.options import WorkerOptions
from heliograph.measure.statistics import Count
from heliograph.sweeps.executors import fewer_workers
from heliograph.sweeps.plan import size_warning
from heliograph.sweeps.points import Point
from heliograph.sweeps.runner import bar
from heliograph.sweeps.sweep import count
from heliograph.sweeps.tally import PointTally, StopRule


def run_sweep(
    points: list[Point], stop_rule: StopRule, output: Path | None, crew: WorkerOptions, *, as_json: bool
) -> None:
    """Count errors at each point; show the counts so far after an early end."""
    tallies = [PointTally(point, stop_rule) for point in points]
    for text in filter(None, (size_warning(points), fewer_workers(crew.workers))):
        console.complain(text)
    logging.disable(logging.CRITICAL)  # hides the messages of lost clusters; an error follows

    def show() -> None:
        console.say_json([tally.report() for tally in tallies]) if as_json else _show(tallies)

    try:
        with bar(len(tallies)) as progress:
            count(tallies, output, crew.workers, crew.scheduler, progress)
    except KeyboardInterrupt:
        show()
        kept = f"; {output} holds the results so far" if output else ""
        complete = sum(tally.done for tally in tallies)
        console.exit_interrupted(f"interrupted with {complete} of {len(tallies)} points complete{kept}")
    except (HeliographError, OSError, MemoryError):
        if any(tally.blocks for tally in tallies):
            show()
        raise
    show()


def _show(tallies: Sequence[PointTally]) -> None:
    """Print a row for each point and layer: wrong codewords, error rates with intervals or bounds, found packets."""
    rows = [row for tally in tallies for row in _rows(tally)]
    head = [*tallies[0].point.choice, "layer", "wrong", "of", "FER (95 %)", "BER (95 %)", "found", "net bit/s"]
    console.say_table(head, rows)


def _rows(tally: PointTally) -> Iterator[list[str]]:
    """Yield a row for each layer; the first row also has the packets and the net rate of all layers."""
    net = tally.net_bits_per_second
    rate = "no data" if net is None else f"{net:.0f}"
    found = f"{tally.total.detected}/{tally.total.packets}"
    for name, layer in tally.total.layers.items():
        counts = [str(layer.codeword_errors), str(layer.codewords), _rate_text(layer.words), _rate_text(layer.decoded)]
        yield [*map(str, tally.point.choice.values()), name, *counts, found, rate]
        found = rate = ""


def _rate_text(errors: Count) -> str:
    if not errors.errors:
        return errors.text()
    low, high = errors.interval()
    return f"{errors.text()} ({low:.1e} to {high:.1e})"
