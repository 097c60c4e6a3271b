"""Error rates over a grid of settings."""

import logging
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

from heliograph.base.errors import HeliographError
from heliograph.base.workers import limit_threads
from heliograph.cli import console, options
from heliograph.cli.options import option
from heliograph.measure.statistics import Count
from heliograph.sweeps.executors import fewer_workers
from heliograph.sweeps.metrics import values
from heliograph.sweeps.plan import parse_vary_options, plan, size_warning
from heliograph.sweeps.sweep import bar, count
from heliograph.sweeps.tally import PointTally, StopRule


@options.command
def sweep(
    *,
    vary: list[str] | None = options.vary_option("Repeat it for a grid. 'receiver' and 'preset' are keys as well."),
    settings: options.SettingsOptions = options.STATIC,
    output: Path | None = option("Folder for the results. A stopped sweep continues from this folder.", "DIR"),
    min_errors: int = option("Wrong codewords of each layer that complete a point.", default=50, min=1),
    max_codewords: int = option("Maximum number of codewords of a layer at a point.", default=1000, min=1),
    max_seconds: float | None = option("Maximum computing time of a point in s, summed over the workers."),
    crew: options.WorkerOptions,
    scene: options.SceneOptions,
    as_json: options.JsonList = False,
) -> None:
    """Count errors over a grid of settings, without films."""
    limit_threads()
    overlay = settings.overlay()
    points = plan(parse_vary_options(vary), settings.preset, overlay, scene.seed, scene.background, scene.imu)
    stop_rule = StopRule(min_errors=min_errors, max_codewords=max_codewords, max_seconds=max_seconds)
    tallies = [PointTally(point, stop_rule) for point in points]
    for text in filter(None, (size_warning(points), fewer_workers(crew.workers))):
        console.complain(text)
    count_and_show(tallies, output, crew, as_json, _show)


def count_and_show(
    tallies: Sequence[PointTally],
    output: Path | None,
    crew: options.WorkerOptions,
    as_json: bool,
    show_table: Callable[[Sequence[PointTally]], None],
    count: Callable[..., None] = count,
) -> None:
    """Count errors and print the results, also after an interruption or an error."""
    logging.disable(logging.CRITICAL)  # hides the messages of lost clusters; an error follows

    def show() -> None:
        console.say_json([tally.report() for tally in tallies]) if as_json else show_table(tallies)

    try:
        with bar(len(tallies)) as progress:
            count(tallies, output, crew.workers, crew.scheduler, progress)
    except KeyboardInterrupt:
        kept = ""
        if any(tally.blocks for tally in tallies):
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
    net = values(tally.total)["net_bits_per_second"]
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
