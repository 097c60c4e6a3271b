"""Comparison of receivers on named scenarios."""

import math
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from heliograph import __version__
from heliograph.base.workers import limit_threads
from heliograph.benchmarks.benchmark import count_benchmark, plan_benchmark, ranges, split, static_points
from heliograph.benchmarks.figure import label_of
from heliograph.benchmarks.scenarios import VERSION, choose_scenarios
from heliograph.cli import console, options
from heliograph.cli.options import option
from heliograph.cli.sweep import count_and_show
from heliograph.measure.statistics import Count
from heliograph.signal.settings import LAYERS
from heliograph.sweeps.executors import fewer_workers
from heliograph.sweeps.metrics import values
from heliograph.sweeps.tally import PointTally


def complete_scenario(start: str) -> list[tuple[str, str]]:
    """Return scenarios and summaries for shell completion."""
    return [(name, kind.summary) for name, kind in choose_scenarios(["full"]).items() if name.startswith(start)]


@options.command
def benchmark(
    *,
    scenarios: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[SCENARIO ...]",
            help="Scenarios, or the sets small and full; default: small. See --list.",
            autocompletion=complete_scenario,
        ),
    ] = None,
    receiver: list[str] | None = option(
        "Receiver to compare; may be repeated. Default: all for arrays, with those of --load, without bounds.",
        "NAME",
        autocompletion=options.complete_receiver,
    ),
    metrics: bool = option(
        "Print further metrics: goodput, acquisition, tracking, latency, range.", None, default=False
    ),
    list_only: bool = option("List the scenarios and exit.", None, "--list", default=False),
    codewords: int = option("Codewords of each layer that complete a scenario.", default=50, min=1),
    seed_file: Path | None = option(
        "File of the seed of a hidden split; a missing file is created with a random seed. Default: the public split.",
        "FILE",
    ),
    crew: options.WorkerOptions,
    output: Path | None = option("Folder for results and figure. A stopped run continues from this folder.", "DIR"),
    as_json: options.JsonList = False,
) -> None:
    """Compare receivers on named scenarios.

    Prints wrong and sent codewords of each layer with the 95 % interval of the error rate.
    """
    if list_only:
        for name, scenario in choose_scenarios(["full"]).items():
            console.say(f"{name:16}  {'small' if scenario.is_small else '':5}  {scenario.summary}")
        return
    limit_threads()
    tallies = plan_benchmark(scenarios or ["small"], receiver or None, seed_file or 0, codewords)
    if fewer := fewer_workers(crew.workers):
        console.complain(fewer)
    count_and_show(tallies, output, crew, as_json, partial(_show, metrics), count_benchmark)


def _show(metrics: bool, tallies: Sequence[PointTally]) -> None:
    """Print a row for each scenario and receiver, and the first refusal of each receiver."""
    head = ["scenario", "receiver", *LAYERS, "found", "net bit/s", "distance", "ms/frame"]
    console.say_table(head, [[*_row(tally)] for tally in tallies])
    if metrics:
        console.say("")
        columns = ["goodput bit/s", "acquired", "in s", "false/min", "MOTA", "MOTP px", "latency s", "processing s"]
        console.say_table(["scenario", "receiver", *columns], [[*_metrics_row(tally)] for tally in tallies])
        if static := static_points(tallies):
            console.say("")
            console.say_table(["range at 1e-2", *LAYERS], [*_range_rows(static)])
    refusals = {str(tally.point.choice["receiver"]): tally.refusal for tally in reversed(tallies) if tally.refusal}
    for name, refusal in refusals.items():
        console.say_prose(f"-: {name} refuses: {refusal}")
    console.say(f"benchmark {VERSION}, {split(tallies)} split, heliograph {__version__}")


def _names(tally: PointTally) -> Iterator[str]:
    yield str(tally.point.choice["scenario"])
    yield label_of(str(tally.point.choice["receiver"]))


def _row(tally: PointTally) -> Iterator[str]:
    yield from _names(tally)
    yield from ("-" if tally.refusal else _count_text(layer.words) for layer in tally.total.layers.values())
    yield "-" if tally.refusal else f"{tally.total.detected}/{tally.total.packets}"
    found = values(tally.total) | tally.machine_times
    yield _text(found["net_bits_per_second"], ".0f")
    yield "-" if found["distance_error"] is None else f"{100 * found['distance_error']:.2g} %"
    yield _text(found["frame_ms"], ".2g")


def _metrics_row(tally: PointTally) -> Iterator[str]:
    found = values(tally.total) | tally.machine_times
    yield from _names(tally)
    yield _text(found["goodput_bits_per_second"], ".0f")
    yield f"{found['acquired']}/{found['arrays']}" if found["arrays"] else "-"
    yield _text(found["acquisition_median_s"], ".3f")
    low, high = (_text(found[f"false_alarms_per_minute_{end}"], ".3g") for end in ("low", "high"))
    yield f"{_text(found['false_alarms_per_minute'], '.3g')} ({low} to {high})" if found["film_seconds"] else "-"
    yield _text(found["mota"], ".3f")
    yield _text(found["motp_px"], ".3f")
    for name in ("latency", "processing"):
        yield " / ".join(_text(found[f"{name}_{kind}_s"], ".3f") for kind in ("median", "95"))


def _range_rows(static: Sequence[PointTally]) -> Iterator[list[str]]:
    """Yield the ranges of each receiver with the ends of the intervals."""
    nearest, farthest = (static[k].point.settings.channel.distance_m for k in (0, -1))
    found = {key: [_metres(end, nearest, farthest) for end in ends] for key, ends in ranges(static).items()}
    for receiver in dict.fromkeys(receiver for receiver, _ in found):
        ends = [found[receiver, layer] for layer in LAYERS]
        yield [label_of(receiver), *("-" if at == "-" else f"{at} m ({low} to {high})" for at, low, high in ends)]


def _metres(value: float, nearest: float, farthest: float) -> str:
    if math.isnan(value):
        return "-"
    return f"<{nearest:.0f}" if value == 0 else f">{farthest:.0f}" if math.isinf(value) else f"{value:.0f}"


def _text(value: float | None, form: str) -> str:
    return "-" if value is None else f"{value:{form}}"


def _count_text(words: Count) -> str:
    low, high = words.interval()
    return f"{words.errors}/{words.trials} ({100 * low:.3g} to {100 * high:.3g} %)" if words.trials else "no data"
