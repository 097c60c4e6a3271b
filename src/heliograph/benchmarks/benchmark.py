"""Error counts of receivers on the scenarios, as a Dataset, files and a figure."""

import secrets
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from heliograph.base.errors import MediaError, SettingsError
from heliograph.base.files import read_bounded, write_whole
from heliograph.benchmarks.figure import draw
from heliograph.benchmarks.scenarios import VERSION, choose_scenarios
from heliograph.experiments.plots import figure_svg
from heliograph.measure.statistics import Clustered, range_m
from heliograph.receive.registry import RECEIVERS, is_bound
from heliograph.signal.settings import LAYERS
from heliograph.sweeps.metrics import PROCESSING
from heliograph.sweeps.plan import merge_changes, plan
from heliograph.sweeps.sweep import PointProgress, count, count_with_bar, silent
from heliograph.sweeps.tally import PointTally, StopRule

if TYPE_CHECKING:
    import xarray

RANGE_RATE = 1e-2  # codeword error rate at the range of a receiver


def benchmark(
    receivers: Iterable[str] | None = None,
    scenarios: Iterable[str] = ("small",),
    *,
    codewords: int = 50,
    seed: int | Path | str = 0,
    workers: int | None = 1,
    scheduler: str | None = None,
    output: Path | str | None = None,
    progress: bool | None = None,
) -> "xarray.Dataset":
    """Compare receivers on the scenarios of the benchmark.

    All receivers read the same films. A receiver that refuses the films of a scenario has no counts there.

    Parameters
    ----------
    receivers
        Names of receivers; by default all for arrays, those of `register_receiver` included, without bounds.
    scenarios
        Names of scenarios, or of the sets "small" and "full".
    codewords
        Codewords of each layer that complete a scenario.
    seed
        0 for the public split. Another number, or the file of a seed, gives a hidden split: other messages, positions,
        roads and noise. A missing file is created with a random seed.
    workers, scheduler, output, progress
        As for `sweep`. The folder `output` also gets the figure ``benchmark.svg``.

    Returns
    -------
    Dataset with the dimensions "scenario", "receiver" and "layer", the variables of `sweep`, and the processor times
    of the receiver: ``frame_ms``, ``processing_median_s`` and ``processing_95_s``. With static scenarios, ``range_m``
    is the range at a codeword error rate of 1e-2, with the ends of the interval, see `ranges`. The attributes name the
    split and the version of the benchmark.

    Raises
    ------
    HeliographError
        A scenario or receiver is unknown, the file holds no seed, or xarray is not installed.
    """
    from heliograph.sweeps.dataset import need_xarray, to_dataset

    need_xarray()
    tallies = plan_benchmark(scenarios, receivers, seed, codewords)
    count_with_bar(tallies, output, workers, scheduler, progress, count_benchmark)
    keys = {key: list(dict.fromkeys(tally.point.choice[key] for tally in tallies)) for key in ("scenario", "receiver")}
    data = to_dataset(keys, tallies)
    about = {"frame_ms": ("ms", "processor time of the receiver per frame, median of the films")}
    for name, (units, text, *_) in {**about, **PROCESSING}.items():
        times = np.reshape([tally.machine_times[name] for tally in tallies], data.packets.shape).astype(float)
        data[name] = data.packets.dims, times, {"units": units, "long_name": text}
    if found := ranges(tallies):
        for k, name in enumerate(("range_m", "range_low_m", "range_high_m")):
            values = [[found[receiver, layer][k] for layer in LAYERS] for receiver in keys["receiver"]]
            text = f"range at a codeword error rate of {RANGE_RATE}; 0 or infinite beyond the scenarios"
            data[name] = ("receiver", "layer"), np.array(values), {"units": "m", "long_name": text}
    title = f"Heliograph benchmark {VERSION}, {split(tallies)} split"
    return data.assign_attrs(title=title, benchmark=VERSION, split=split(tallies))


def plan_benchmark(
    scenarios: Iterable[str], receivers: Iterable[str] | None, seed: int | Path | str, codewords: int
) -> list[PointTally]:
    """Return a tally for each scenario and receiver."""
    chosen = choose_scenarios(scenarios)
    competitors = (name for name in RECEIVERS.names() if name != "screen" and not is_bound(name))
    names = competitors if receivers is None else receivers
    if not isinstance(names, str):
        names = [RECEIVERS.check(name) for name in names]
    # a mistake in the names creates no file
    number = read_seed(Path(seed)) if isinstance(seed, Path | str) else seed
    # all receivers read the same films: errors complete no point
    rule = StopRule(min_errors=sys.maxsize, max_codewords=codewords)
    labels = {"benchmark": VERSION, "split": "hidden" if number else "public"}
    return [
        PointTally(replace(point, choice={"scenario": name, **point.choice}), rule, may_refuse=True, labels=labels)
        for name, scenario in chosen.items()
        for point in plan({"receiver": names}, scenario.preset, merge_changes(scenario.changes), number)
    ]


def count_benchmark(
    tallies: Sequence[PointTally],
    output: Path | None = None,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: PointProgress = silent,
) -> None:
    """Count as `sweep` does, and draw the figure, also after an interruption."""
    try:
        count(tallies, output, workers, scheduler, progress)
    finally:
        if output is not None and any(tally.blocks for tally in tallies):
            write_whole(output / "benchmark.svg", figure_svg(draw(tallies)))


def split(tallies: Sequence[PointTally]) -> str:
    """Return the name of the split."""
    return str(tallies[0].labels["split"])


def ranges(tallies: Sequence[PointTally]) -> dict[tuple[str, str], tuple[float, float, float]]:
    """Return range in m and ends of the 95 % interval by receiver and layer; empty without static scenarios.

    The range is the distance at which the codeword error rate exceeds `RANGE_RATE`, see `range_m`. For the ends, rates
    are the ends of the intervals. Zero errors do not exceed the limit; half an error stands for none.
    """
    counted: dict[tuple[str, str], list[tuple[float, Clustered]]] = {}
    for tally in static_points(tallies):
        for layer, counts in tally.total.layers.items():
            key = str(tally.point.choice["receiver"]), layer
            counted.setdefault(key, []).append((tally.point.settings.channel.distance_m, counts.words))

    def reach(points: list[tuple[float, Clustered]], rate: Callable[[Clustered], float]) -> float:
        return range_m([(distance_m, rate(words)) for distance_m, words in points], RANGE_RATE)

    return {
        key: (
            reach(points, _rate_at_least_half),
            reach(points, lambda words: words.interval()[1]),
            reach(points, lambda words: words.interval()[0]),
        )
        for key, points in counted.items()
    }


def static_points(tallies: Sequence[PointTally]) -> list[PointTally]:
    """Return the points of the static scenarios, near first."""
    static = [tally for tally in tallies if str(tally.point.choice["scenario"]).startswith("static-")]
    return sorted(static, key=lambda tally: tally.point.settings.channel.distance_m)


def _rate_at_least_half(words: Clustered) -> float:
    """Return the error rate; half an error stands for none, within the limit."""
    return words.rate if words.errors or not words.trials else min(0.5 / words.trials, RANGE_RATE)


def read_seed(file: Path) -> int:
    """Return the seed in a file; create a missing file with a random seed."""
    try:
        if not file.exists():
            write_whole(file, b"%d\n" % secrets.randbelow(1 << 63))
        return int(read_bounded(file, 100))
    except ValueError:
        raise SettingsError(f"{file} holds no seed; write a whole number into it, or name a new file") from None
    except MediaError:
        raise
    except OSError as error:
        raise MediaError(f"cannot read the seed {file}: {error.strerror or error}") from None
