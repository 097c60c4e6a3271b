"""Write docs/benchmark-results.md with figure and CSV from a complete folder of `heliograph benchmark full`.

python scripts/make_benchmark.py FOLDER CODEWORDS "1.5 h on two cores"
"""

import math
import shutil
import statistics
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

from heliograph import __version__
from heliograph.benchmarks.benchmark import count_benchmark, plan_benchmark, ranges
from heliograph.benchmarks.figure import label_of
from heliograph.benchmarks.scenarios import SCENARIOS, VERSION
from heliograph.measure.statistics import Clustered
from heliograph.signal.settings import LAYERS
from heliograph.sweeps.tally import PointTally

DOCS = Path(__file__).parents[1] / "docs"
BOUNDS = ("genie-zero-forcing", "genie-mmse")

HEAD = """# Benchmark results

All receivers read the same films: public split of benchmark {benchmark}, heliograph {version}.
[Receivers](receivers.md) names the sources, `heliograph benchmark --list` describes the scenarios, and
[benchmark.csv](benchmark.csv) has all [metrics](benchmark.md#metrics).

<!-- skip: next "not run: takes half an hour" -->

```sh
heliograph benchmark full --codewords {codewords} --output results
```

Duration: {duration}. {frames:,} frames, {words:,} codewords; {false} undetected errors.

## Range

Distance at which the codeword error rate exceeds 1e-2, with 95 % interval; median time of the receiver for a frame.
"""

TABLES = """## Wrong codewords

Wrong of sent codewords; `-` where a receiver refuses the films, or a bound was not computed. None wrong of
{codewords} is a rate of at most {bound:.1f} %.
"""

FIGURE = """## Intervals

![Codeword error rate of each layer with 95 % interval, by scenario and receiver](pictures/benchmark.svg)
"""


def table(head: Sequence[str], rows: Iterator[Sequence[str]]) -> str:
    """Return a table in Markdown."""
    return "\n".join(f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *rows)) + "\n"


def range_rows(tallies: Sequence[PointTally]) -> Iterator[Sequence[str]]:
    """Yield a row for each receiver that reads static films."""

    def metres(value: float) -> str:
        return "-" if math.isnan(value) else "< 25" if value == 0 else "> 220" if math.isinf(value) else f"{value:.0f}"

    found = ranges(tallies)
    for receiver in dict.fromkeys(receiver for receiver, _ in found):
        ends = [tuple(map(metres, found[receiver, layer])) for layer in LAYERS]
        measured = [tally.machine_times["frame_ms"] for tally in tallies if tally.point.choice["receiver"] == receiver]
        times = [value for value in measured if value is not None]
        if times:
            texts = ["-" if at == "-" else f"{at} ({low} to {high})" for at, low, high in ends]
            yield [f"`{label_of(receiver)}`", *texts, f"{statistics.median(times):.2g}"]


def error_rows(tallies: Sequence[PointTally], layer: str) -> Iterator[Sequence[str]]:
    """Yield a row for each scenario with a cell for each receiver."""
    words = {tuple(tally.point.choice.values()): tally.total.layers[layer].words for tally in tallies}
    scenarios, receivers = (list(dict.fromkeys(key[k] for key in words)) for k in (0, 1))
    for scenario in scenarios:
        counts = [words.get((scenario, receiver), Clustered()) for receiver in receivers]
        yield [scenario, *(f"{count.errors}/{count.trials}" if count.trials else "-" for count in counts)]


def page(tallies: Sequence[PointTally], codewords: int, duration: str) -> str:
    """Return the text of the page."""
    sums = {
        "frames": sum(tally.total.frames for tally in tallies),
        "words": sum(tally.total.codewords for tally in tallies),
        "false": sum(tally.total.false_codewords for tally in tallies),
    }
    head = HEAD.format(benchmark=VERSION, version=__version__, codewords=codewords, duration=duration, **sums)
    names = list(dict.fromkeys(str(tally.point.choice["receiver"]) for tally in tallies))
    parts = [
        head,
        table(["receiver", *(f"{layer}, m" for layer in LAYERS), "ms/frame"], range_rows(tallies)),
        TABLES.format(codewords=codewords, bound=100 * (1 - 0.05 ** (1 / codewords))),
    ]
    for layer in LAYERS:
        parts += [f"### {layer.capitalize()} layer\n", table(["scenario", *names], error_rows(tallies, layer))]
    return "\n".join([*parts, FIGURE])


if __name__ == "__main__":
    folder, number = Path(sys.argv[1]), int(sys.argv[2])
    static = [name for name in SCENARIOS if name.startswith("static-")]
    counted = plan_benchmark(["full"], None, 0, number) + plan_benchmark(static, BOUNDS, 0, number)
    # reads the stored counts, and completes them
    count_benchmark(counted, folder, workers=1)
    (DOCS / "benchmark-results.md").write_text(page(counted, number, sys.argv[3]))
    shutil.copy(folder / "benchmark.svg", DOCS / "pictures" / "benchmark.svg")
    shutil.copy(folder / "points.csv", DOCS / "benchmark.csv")
