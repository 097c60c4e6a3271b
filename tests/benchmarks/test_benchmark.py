"""The benchmark: scenarios, counts of receivers, splits, files and the command."""

import csv
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_runs import Call, called, failed, succeeded

import heliograph
from heliograph.base.errors import HeliographError
from heliograph.benchmarks import benchmark as module
from heliograph.benchmarks import scenarios
from heliograph.benchmarks.benchmark import plan_benchmark, read_seed
from heliograph.benchmarks.scenarios import Scenario, choose_scenarios
from heliograph.measure.counts import BlockCounts, LayerCounts
from heliograph.signal.settings import LAYERS
from heliograph.sweeps import sweep
from heliograph.sweeps.metrics import PROCESSING

TINY = {"signal.data_pairs": 8, "channel.camera.width": 480, "channel.camera.height": 288}
FAST = {"channel.camera.fps": 2000, "channel.camera.exposure_s": 0.4e-3}
ALL = scenarios.SCENARIOS
FEW = {
    "near": Scenario("near", {**TINY, "channel.distance_m": 40}, is_small=True),
    "far": Scenario("far", {**TINY, "channel.distance_m": 70}, is_small=True),
    "fast": Scenario("fast", {**TINY, **FAST, "channel.distance_m": 40}),
}
BLIND = """
import heliograph

class Blind(heliograph.LuminanceReceiver):
    def luminances(self, pattern, inverse, leds):
        return leds[0, ..., 0] * 0

heliograph.register_receiver("blind", Blind)
"""


@pytest.fixture(autouse=True)
def few_scenarios(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scenarios, "SCENARIOS", FEW)


@pytest.fixture
def call(tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Call:
    monkeypatch.chdir(tmp_path)
    return lambda *arguments: called(*arguments, capfd=capfd, monkeypatch=monkeypatch)


def test_all_scenarios_are_valid_and_the_small_set_is_a_part(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scenarios, "SCENARIOS", ALL)
    full, small = choose_scenarios(["full"]), choose_scenarios(["small"])
    assert set(small) < set(full) == set(scenarios.SCENARIOS)
    assert list(choose_scenarios([*small, "small", "static-25"])) == [*small, "static-25"]
    points = [tally.point for tally in plan_benchmark(["full"], ["plain", "soft"], 0, 1)]
    assert [point.choice["scenario"] for point in points] == [name for name in full for _ in "12"]
    for one, other in zip(points[::2], points[1::2], strict=True):
        assert one.block_seed(0) == other.block_seed(0), "receivers read the same films"
    assert len({point.key for point in points}) == len(points)
    assert all(re.fullmatch(r"[a-z0-9.-]+", name) and "\n" not in full[name].summary for name in full)


@pytest.mark.slow
def test_counts_are_equal_for_one_and_two_workers() -> None:
    one, two = (heliograph.benchmark(["plain", "soft"], ["near", "far"], codewords=2, workers=n) for n in (1, 2))
    machine = ["frame_ms", *PROCESSING]
    assert one.drop_vars(machine).equals(two.drop_vars(machine))
    assert all((one[name] > 0).all() for name in machine)
    assert (one.distance_error < 0.05).all()
    assert dict(one.sizes) == {"scenario": 2, "receiver": 2, "layer": 3}
    assert one.codewords.sel(layer="high").values.tolist() == [[2, 2], [2, 2]]
    assert one.detected.values.tolist() == one.packets.values.tolist() == [[2, 2], [2, 2]]
    assert (one.arrays == 2).all()
    assert (one.acquired == 2).all()
    assert (one.mota == 1).all()
    assert (one.motp_px < 0.1).all()
    assert (one.goodput_bits_per_second == one.net_bits_per_second).all()
    assert one.latency_median_s.values == pytest.approx(0.02, abs=2e-3)  # the film ends with the packet
    errors = one.codeword_errors
    assert errors.sel(scenario="near").values.tolist() == [[0, 0, 0], [0, 0, 0]]
    assert (errors.sel(receiver="plain", layer="low") == [0, 2]).all()
    assert ((one.fer_low <= one.fer) & (one.fer <= one.fer_high)).all()
    assert (one.attrs["split"], one.attrs["seed"], one.attrs["benchmark"]) == ("public", 0, scenarios.VERSION)


@pytest.mark.slow
def test_a_stored_run_is_not_repeated(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = heliograph.benchmark(["plain"], codewords=1, output=tmp_path)

    def never(work: Any) -> Any:
        raise AssertionError(work)

    monkeypatch.setattr(sweep, "run_job", never)
    assert heliograph.benchmark(["plain"], codewords=1, output=tmp_path).identical(first)


@pytest.mark.slow
def test_the_figure_shows_an_interrupted_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupt(tallies: Any, *_: Any) -> None:
        sweep.count(tallies[:1], tmp_path, workers=1)
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "count", interrupt)
    with pytest.raises(KeyboardInterrupt):
        heliograph.benchmark(["plain"], ["near", "far"], codewords=1, output=tmp_path)
    assert "near" in (tmp_path / "benchmark.svg").read_text()


@pytest.mark.slow
def test_loaded_receiver_and_hidden_split_are_in_table_and_files(tmp_path: Path, call: Call) -> None:
    (tmp_path / "blind.py").write_text(BLIND)
    options = ("--codewords", "1", "--workers", "1", "--output", "out", "--seed-file", "seed.txt")
    receivers = (part for name in ("plain", "soft", "blind") for part in ("--receiver", name))
    lines = succeeded(call("--load", "blind.py", "benchmark", *receivers, *options)).splitlines()
    rows = [line.split() for line in lines]
    assert rows[0][:5] == ["scenario", "receiver", *LAYERS]
    pairs = [(scenario, receiver) for scenario in ("near", "far") for receiver in ("plain", "soft", "blind")]
    assert [tuple(row[:2]) for row in rows[1:7]] == pairs
    assert "0/1 (0 to 95 %)" in lines[1]
    assert "1/1 (5 to 100 %)" in lines[3]
    assert "hidden split" in lines[-1]
    assert {"benchmark.svg", "points.csv", "points.json", "results.sqlite"} <= {p.name for p in Path("out").iterdir()}
    points = [*csv.DictReader(Path("out/points.csv").read_text().splitlines())]
    assert {(row["benchmark"], row["split"]) for row in points} == {(str(scenarios.VERSION), "hidden")}
    figure = Path("out/benchmark.svg").read_text()
    assert "<svg" in figure


@pytest.mark.slow
def test_receiver_that_refuses_a_scenario_has_no_counts(call: Call) -> None:
    table = succeeded(call("benchmark", "fast", "near", "--receiver", "plain", "--codewords", "1", "--workers", "1"))
    assert re.search(r"fast +plain( +-){7}\n", table)
    assert "-: plain refuses: the plain receiver needs one frame per pattern" in table
    assert re.search(r"near +plain +0/1", table)
    data = heliograph.benchmark(["plain"], ["fast"], codewords=1)
    assert (data.codewords == 0).all()
    assert np.isnan(data.fer).all()


@pytest.mark.slow
def test_metrics_are_further_tables_of_120_columns(call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(scenarios, "SCENARIOS", {"static-40": FEW["near"], "static-70": FEW["far"]})
    options = ("static-40", "static-70", "--receiver", "soft", "--codewords", "2", "--workers", "1", "--metrics")
    lines = succeeded(call("benchmark", *options)).splitlines()
    assert max(map(len, lines)) <= 120
    columns = ["scenario", "receiver", "goodput bit/s", "acquired", "in s", "false/min", "MOTA", "MOTP px", "latency s"]
    assert re.split("  +", lines[4].strip()) == [*columns, "processing s"]
    # no false alarm in two films of 0.02 s: at most 3 in 0.04 s
    assert re.fullmatch(r" *static-40 +soft +\d+ +2/2 +0.020 +0 \(0 to 4.\d\de\+03\) +1.000 +0.0\d+ +0.020.*", lines[5])
    assert re.fullmatch(r" +soft +>70 m \(<40 to >70\) +>70 m \(<40 to >70\) +.*", lines[9])


def test_range_is_where_the_codeword_error_rate_exceeds_one_percent(monkeypatch: pytest.MonkeyPatch) -> None:
    """Wrong of 400 codewords: 0, 1 and 40 of the high layer, none of the middle layer; no low layer is sent."""
    distances_m = {"static-25": 25, "static-60": 60, "static-80": 80, "drive": 70}
    known = {name: Scenario(name, {**TINY, "channel.distance_m": z}) for name, z in distances_m.items()}
    monkeypatch.setattr(scenarios, "SCENARIOS", known)
    tallies = plan_benchmark(known, ["plain"], 0, 1)
    none = LayerCounts(codewords=400, sent_packets=400)
    for tally, errors in zip(tallies, (0, 1, 40, 400), strict=True):
        high = replace(none, codeword_errors=errors, word_squares=errors)
        tally.total = BlockCounts({"high": high, "middle": none, "low": LayerCounts()})
    found = module.ranges(tallies[::-1])
    middle, low, high_m = found["plain", "high"]
    assert middle == pytest.approx(60 + 20 * math.log(4) / math.log(40))
    assert 25 < low < middle < high_m < 80
    assert found["plain", "middle"] == (math.inf, math.inf, math.inf)
    assert math.isnan(found["plain", "low"][0])
    assert found["plain", "low"][1:] == (0, math.inf)
    assert module.ranges(tallies[3:]) == {}


def test_hidden_split_repeats_with_the_same_file(tmp_path: Path) -> None:
    seed = read_seed(tmp_path / "seed")
    assert (tmp_path / "seed").read_text() == f"{seed}\n"
    assert read_seed(tmp_path / "seed") == seed != read_seed(tmp_path / "other")
    public, hidden = (plan_benchmark(["near"], ["plain"], number, 1)[0] for number in (0, seed))
    assert public.point.block_seed(0) != hidden.point.block_seed(0)
    assert (module.split([public]), module.split([hidden])) == ("public", "hidden")


def test_the_list_names_each_scenario(call: Call) -> None:
    lines = succeeded(call("benchmark", "--list")).splitlines()
    assert [line.split() for line in lines] == [["near", "small", "near"], ["far", "small", "far"], ["fast", "fast"]]


def test_an_error_of_a_loaded_receiver_has_its_file_and_line(tmp_path: Path, call: Call) -> None:
    (tmp_path / "blind.py").write_text(BLIND.replace("leds[0, ..., 0] * 0", "pattern[5000]"))
    message = failed(call("--load", "blind.py", "benchmark", "near", "--receiver", "blind", "--workers", "1"))
    assert "a worker failed with IndexError in blind.py, line 6: index 5000 is out of bounds" in message


@pytest.mark.parametrize(("options", "says"), [
    (["nowhere"], "unknown scenario 'nowhere'; there are small, full, near, far, fast"),
    (["neer"], "unknown scenario 'neer'; did you mean 'near'?"),
    (["near", "--receiver", "plane"], "unknown receiver 'plane'; did you mean 'plain'?"),
    (["near", "--receiver", "plain", "--receiver", "plain"], "'receiver' has the value 'plain' twice"),
    (["--seed-file", "words.txt"], "words.txt holds no seed; write a whole number into it, or name a new file"),
    (["--seed-file", "."], "cannot read the seed .: "),
])  # fmt: skip
def test_unknown_names_and_seeds_are_one_line(options: list[str], says: str, call: Call) -> None:
    Path("words.txt").write_text("secret")
    assert says in failed(call("benchmark", *options))


@pytest.mark.parametrize(("options", "says"), [
    ({"scenarios": "near"}, 'scenarios are a list of names, such as ["small"], not \'near\''),
    ({"scenarios": []}, "needs a scenario"), ({"receivers": "soft"}, "varies over a list of values"),
    ({"seed": 1.5}, "the seed is a whole number"), ({"workers": "2"}, "workers are a whole number"),
    ({"codewords": 0}, "'max_codewords'"), ({"output": 3}, "paths, not 3"),
])  # fmt: skip
def test_wrong_arguments_are_refused_at_once(options: dict[str, Any], says: str) -> None:
    with pytest.raises(HeliographError, match=re.escape(says)):
        heliograph.benchmark(**{"receivers": ["plain"], "scenarios": ["near"], **options})
