"""Sweeps in a single process: varied settings, stop rules, stored results, Datasets and plots."""

import csv
import itertools
import json
import shutil
import sqlite3
import sys
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from dataclasses import replace
from decimal import Decimal
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from properties import examples

from heliograph.base.config import merge
from heliograph.base.errors import HeliographError, MediaError, SettingsError
from heliograph.base.toml_text import to_toml
from heliograph.measure.counts import BlockCounts, LayerCounts
from heliograph.measure.statistics import clopper_pearson
from heliograph.signal.settings import LAYERS
from heliograph.sweeps import dataset, executors, metrics, plot, sweep
from heliograph.sweeps import points as points_module
from heliograph.sweeps.executors import Result, Work
from heliograph.sweeps.plan import grid, merge_changes, nested, parse_vary, plan, size_warning, varied
from heliograph.sweeps.points import Point, run_job
from heliograph.sweeps.store import NAME, Store
from heliograph.sweeps.tally import PointTally, StopRule

SMALL = {"signal": {"data_pairs": 8}, "channel": {"camera": {"width": 480, "height": 288}}}
FEW = StopRule(max_codewords=3)


def fake_counts(codewords: int, errors: int) -> BlockCounts:
    one = LayerCounts(codewords=codewords, codeword_errors=errors, sent_packets=codewords, word_squares=errors)
    layers = dict.fromkeys(LAYERS, one)
    return BlockCounts(layers, film_s=1.0, frames=1000)


def points() -> list[Point]:
    return plan({"channel.distance_m": [40, 70]}, "static", SMALL)


def tally_of(rule: StopRule | None = None) -> PointTally:
    return PointTally(plan({}, "static", SMALL)[0], rule or StopRule())


@pytest.mark.parametrize(("text", "values"), [
    ('a=1,2.5,true,plain,\'q,r\',"s\\",t"', [1, 2.5, True, "plain", "q,r", 's",t']),
    ("a=[1, 2],[3],{b = ['c,]', 4]}", [[1, 2], [3], {"b": ["c,]", 4]}]), ("a=1:2:0.5,7", [1.0, 1.5, 2.0, 7]),
])  # fmt: skip
def test_values_are_parsed(text: str, values: list[Any]) -> None:
    assert parse_vary(text) == ("a", values)


@pytest.mark.parametrize("text", [
    "a", "=1", "a=", "a=1,,2", "a=1:2", "a=1:2:0", "a=1:2:-1", "a=0:1e9:1", "a=1e999999999:2:1", "a=0:1e400:1e399",
    "a=1:2:1e-999999", "a=" + "9" * 5000, "a=" + "[" * 50_000, "a=" + "1" * 100_000 + "x",
], ids=lambda text: text[:16])  # fmt: skip
def test_invalid_values_are_refused_in_one_line(text: str) -> None:
    """A regular expression with backtracking took hours for long numbers."""
    with pytest.raises(SettingsError) as refused:
        parse_vary(text)
    assert len(str(refused.value)) < 400


@pytest.mark.parametrize("values", [
    ",".join(f"{a}:{a + 9998}:1" for a in range(0, 400 * 9999, 9999)), ",".join(map(str, range(25_000))),
], ids=["ranges", "numbers"])  # fmt: skip
def test_too_many_values_are_refused_before_they_are_created(values: str) -> None:
    for call, says in (
        (lambda: parse_vary(f"a.b={values}"), r"'a\.b' has more than 10000 values; take a larger step"),
        (lambda: grid({"a": itertools.count()}), "'a' has more than 10000 values"),
        (lambda: grid({"a": range(200), "b": range(200)}), "at most"),
    ):
        with pytest.raises(SettingsError, match=says):
            call()
    assert len(parse_vary("a=9999:0:-1")[1]) == 10_000


def test_repeated_values_are_refused() -> None:
    values = [*range(9_998), [1, 2], {"x": [1]}]
    assert grid({"a": values})[-1] == {"a": {"x": [1]}}
    for doubled in ([1, 1], [1, 1.0], [[1], (1.0,)], [{"x": [1]}, {"x": [1]}], [True, 1], [1, np.float64(1)]):
        with pytest.raises(SettingsError, match="twice"):
            grid({"a": doubled})
    assert len(grid({"a": ["1", 1, [1], [[1]], {"x": 1}, None]})) == 6


def test_values_and_seed_may_be_numbers_of_numpy() -> None:
    vary = {"signal.data_pairs": np.array([8, 16]), "channel.distance_m": np.linspace(40, 50, 2)}
    found = plan(vary, seed=cast("Any", np.int64(3)))
    assert json.dumps([found[1].choice, found[0].seed]) == '[{"signal.data_pairs": 8, "channel.distance_m": 50.0}, 3]'
    assert plan({"signal.data_pairs": [np.int64(8)]})[0].choice == {"signal.data_pairs": 8}


NO_LISTS: list[Any] = [5, "5", [], np.array([]), np.array(5), {"a": 1}]


@pytest.mark.parametrize(
    ("vary", "seed", "message"),
    [
        *(({"channel.distance_m": values}, 0, r"channel\.distance_m") for values in NO_LISTS),
        *(({}, seed, "seed") for seed in (-1, 2**63, "a", 1.5)),
        ({"channel.distanc_m": [40]}, 0, r"did you mean 'channel\.distance_m'"),
        ({"preset": ["papr"]}, 0, "did you mean 'paper'"),
        ({"receiver": ["plain", "plane"]}, 0, "receiver=plane"),
        ({"receiver": ["plain"], "receive.receiver": ["plain"]}, 0, "short for"),
        ({"channel.background.kind": ["footage"]}, 0, "--background"),
        ({"channel.shake": ["imu"]}, 0, "--imu"),
    ],
)
def test_plan_names_invalid_values_seeds_and_points(vary: dict[str, Any], seed: Any, message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        plan(vary, seed=seed)


def test_presets_and_receivers_vary() -> None:
    night = varied("paper", {"channel": {"distance_m": 60.0}}, {"preset": "night", "receiver": "soft"})
    assert (night.channel.background.level, night.channel.distance_m, night.receive.receiver) == (0.0, 60.0, "soft")


def test_receivers_share_films_and_scenes_and_seeds_do_not() -> None:
    one, other = plan({"receive.decode.iterations": [3, 4]}, "static", SMALL)
    assert one.key != other.key
    assert [one.block_seed(k) for k in range(3)] == [other.block_seed(k) for k in range(3)]
    near, far = points()
    (reseeded,) = plan({}, "static", SMALL, seed=1)
    assert len({near.block_seed(0), near.block_seed(1), far.block_seed(0)}) == 3
    assert reseeded.block_seed(0) != tally_of().point.block_seed(0)


def test_seed_settings_and_version_are_in_the_key(monkeypatch: pytest.MonkeyPatch) -> None:
    point, (reseeded,) = tally_of().point, plan({}, "static", SMALL, seed=1)
    keys = {point.key, reseeded.key, points()[0].key}
    monkeypatch.setattr("heliograph.sweeps.points.__version__", "0.0.0")
    assert len(keys | {point.key}) == 4


@pytest.mark.parametrize(("blocks", "ending"), [
    ([(10, 4, 1)], None), ([(10, 4, 1), (10, 1, 1)], "errors"), ([(100, 0, 1)], "codewords"), ([(9, 0, 9)], "seconds"),
    ([(9, 0, 1)], None), ([(0, 0, 1)] * 2, None), ([(0, 0, 1)] * 3, "empty"),
])  # fmt: skip
def test_point_ends_by_errors_codewords_seconds_or_emptiness(blocks: Any, ending: str | None) -> None:
    tally = tally_of(StopRule(min_errors=5, max_codewords=100, max_seconds=9))
    for block, (codewords, errors, seconds) in enumerate(blocks):
        assert tally.ending is None
        tally.add(block, fake_counts(codewords, errors), seconds)
    assert tally.ending == ending
    assert tally.fraction == (1 if ending else pytest.approx(0.8 if blocks[0][1] else len(blocks) / 9))


def test_blocks_count_in_order_without_surplus() -> None:
    tally = tally_of(StopRule(min_errors=5, max_codewords=20))
    tally.add(2, fake_counts(10, 9), 1.0)
    tally.add(1, fake_counts(10, 1), 1.0)
    assert (tally.blocks, tally.has(2)) == (0, True)
    tally.add(0, fake_counts(10, 0), 1.0)
    assert (tally.blocks, tally.total.layers["high"].codeword_errors) == (2, 1)


def test_report_has_counts_rates_intervals_and_bounds() -> None:
    tally = tally_of()
    empty = tally.report()
    layer = empty["layers"]["high"]
    assert (layer["fer"], layer["ber_is_bound"], layer["fer_is_bound"]) == (None, False, False)
    good = LayerCounts(bits=200 * 512, codewords=200, packets=200, sent_packets=200)
    bad = replace(good, bit_errors=10 * 50, bit_squares=10 * 50**2, codeword_errors=10, word_squares=10)
    layers, payload = {"high": good, "middle": good, "low": bad}, {"high": 700, "middle": 0, "low": 0}
    tally.add(0, BlockCounts(layers, payload_bits=payload, false_packets=2, duplicates=5, film_s=1.0, frames=1000), 1.0)
    report = json.loads(json.dumps(tally.report()))
    assert (report["false_packets"], report["duplicates"]) == (2, 5)
    assert (empty["net_bits_per_second"], report["net_bits_per_second"]) == (None, 700.0)
    high, low = report["layers"]["high"], report["layers"]["low"]
    assert (high["fer"], high["ber_is_bound"], high["fer_is_bound"]) == (0.0, True, True)
    assert high["ber_ci"] == high["fer_ci"] == pytest.approx([0, clopper_pearson(0, 200)[1]])
    assert high["fer_ci"][1] == pytest.approx(3 / 200, rel=0.02)
    assert (low["ber_is_bound"], low["fer_is_bound"]) == (False, False)
    # with ten bad packets in 200, the relative uncertainty is that of the packet count
    assert low["ber_ci"][0] < 0.6 * low["ber"] < 1.6 * low["ber"] < low["ber_ci"][1]


def test_metrics_have_known_values() -> None:
    """100 packets in 30 s: 90 located, 2 misplaced, 8 missed; false: 3 packets, 1 duplicate, 2 misplaced packets."""
    counts = BlockCounts(
        payload_bits={"high": 3000, "middle": 0, "low": 0}, packets=100, false_packets=1, uncertain_packets=2,
        duplicates=1, film_s=30.0, timely_bits=1500, located=90, misplaced=2, position_px=9.0, distances=4,
        distance_squares=0.16, arrays=3, acquisition={"2000": 1, "1000": 1}, latency={"1000": 19, "1500": 1},
        processing={"30": 1},
    )  # fmt: skip
    found = metrics.values(counts)
    expected = {
        "net_bits_per_second": 100, "goodput_bits_per_second": 50, "mota": 1 - (10 + 6) / 100, "motp_px": 0.1,
        "distance_error": 0.2, "false_alarms_per_minute": 6, "acquired": 2, "acquisition_median_s": 0.2,
        "acquisition_95_s": None, "latency_median_s": 0.1, "latency_95_s": 0.1,
    }  # fmt: skip
    assert {name: found[name] for name in expected} == pytest.approx(expected)
    low, high = (found[f"false_alarms_per_minute_{end}"] for end in ("low", "high"))
    assert (low, high) == pytest.approx((2 * 0.6187, 2 * 8.7673), rel=1e-4)  # of 3 events
    assert metrics.values(counts, metrics.PROCESSING) == pytest.approx(dict.fromkeys(metrics.PROCESSING, 0.003))


def test_metrics_without_data_are_unknown() -> None:
    found = metrics.values(BlockCounts())
    assert {name for name, value in found.items() if value == 0} >= {"packets", "false_packets", "acquired"}
    assert all(found[name] is None for name in ("mota", "motp_px", "latency_median_s", "false_alarms_per_minute_high"))


@pytest.mark.parametrize("bad", [{"min_errors": 0}, {"max_codewords": 0}, {"max_seconds": 0.0}])
def test_stop_rules_are_checked(bad: Mapping[str, Any]) -> None:
    with pytest.raises(SettingsError, match=next(iter(bad))):
        StopRule(**bad)


def count(output: Path | None, rule: StopRule = FEW) -> list[dict[str, Any]]:
    tallies = [PointTally(point, rule) for point in points()]
    sweep.count(tallies, output, workers=1)
    return [tally.report() for tally in tallies]


def computed(folder: Path) -> list[int]:
    """Return the number of computations of each stored block."""
    with closing(sqlite3.connect(folder / NAME)) as db:
        return [row[0] for row in db.execute("SELECT computed FROM blocks")]


@pytest.fixture(scope="module")
def swept(tmp_path_factory: pytest.TempPathFactory) -> tuple[Any, Path]:
    """Return the Dataset of a sweep and the folder of the results."""
    folder = tmp_path_factory.mktemp("sweep")
    data = sweep.sweep(
        {"channel.distance_m": np.array([40, 70])},
        set={"signal.data_pairs": 8, "channel.camera": {"width": 480, "height": 288}},
        max_codewords=3, output=folder,
    )  # fmt: skip
    return data, folder


@pytest.mark.slow
def test_store_is_resumed_and_grows(swept: tuple[Any, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    shutil.copytree(swept[1], tmp_path, dirs_exist_ok=True)
    first = json.loads((tmp_path / "points.json").read_text())
    assert [point["stopped_by"] for point in first] == ["codewords", "codewords"]
    rows = [*csv.DictReader((tmp_path / "points.csv").read_text().splitlines())]
    assert len(rows) == 2 * 3
    assert {row["false_codewords"] for row in rows} == {"0"}
    assert all(float(row["frame_ms"]) > 0 and row["version"] and row["seed"] == "0" for row in rows)

    def never(work: Any) -> Any:
        raise AssertionError("computed again")

    with monkeypatch.context() as patch:
        patch.setattr(sweep, "run_job", never)
        assert count(tmp_path) == first
    assert computed(tmp_path) == [1] * 6
    longer = count(tmp_path, StopRule(max_codewords=4))
    assert (longer[0]["layers"]["high"]["codewords"], computed(tmp_path)) == (4, [1] * 8)
    assert longer == count(None, StopRule(max_codewords=4))


def test_code_of_the_package_is_in_the_key(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "receive").mkdir()
    (tmp_path / "__init__.py").write_text("")
    monkeypatch.setattr("heliograph.__file__", str(tmp_path / "__init__.py"))
    builds = []
    for code in ("REACH = 1\n", "REACH = 1\n", "REACH = 2\n"):
        (tmp_path / "receive/kernels.py").write_text(code)
        points_module._code_digest.cache_clear()
        builds.append(points_module.build())
    points_module._code_digest.cache_clear()
    assert builds[0] == builds[1] != builds[2]


def test_two_sweeps_may_share_a_store(tmp_path: Path) -> None:
    point = points()[0]
    with closing(Store(tmp_path)) as one, closing(Store(tmp_path)) as other:
        one.add(point, 0, fake_counts(1, 0), 1.0)
        other.add(point, 0, fake_counts(1, 0), 2.0)
        other.add(point, 1, fake_counts(1, 1), 1.0)
        assert (one.blocks(point)[0][1], [*one.blocks(point, 1)]) == (1.0, [1])


def test_foreign_files_are_refused_and_an_empty_file_is_a_new_store(tmp_path: Path) -> None:
    file = tmp_path / NAME
    file.write_bytes(b"no database at all, but some text")
    with pytest.raises(MediaError, match="choose another folder"):
        Store(tmp_path)
    file.write_bytes(b"")
    Store(tmp_path).close()
    file.unlink()
    with closing(sqlite3.connect(file)) as db:
        db.execute("CREATE TABLE mine (x)")
    with pytest.raises(MediaError, match="holds no results"):
        Store(tmp_path)


class FragileWorkers(executors.Workers):
    """Workers that die with the first submitted blocks."""

    slots = 2

    def __init__(self, losses: int):
        self.losses, self.restarts = losses, 0

    def submit(self, job: Callable[[Work], Result], work: Work) -> "Future[Result]":
        if self.restarts >= self.losses:
            return super().submit(job, work)
        future: Future[Result] = Future()
        future.set_exception(BrokenProcessPool("a process died"))
        return future

    def restart(self) -> None:
        self.restarts += 1


@pytest.mark.slow
def test_lost_workers_are_replaced_up_to_a_limit() -> None:
    tallies = [PointTally(point, StopRule(max_codewords=1)) for point in points()]
    with closing(Store()) as store:
        sweep.run(tallies, store, FragileWorkers(2))
    assert all(tally.done for tally in tallies)
    with closing(Store()) as store, pytest.raises(HeliographError, match="died"):
        sweep.run([tally_of()], store, FragileWorkers(100))


def test_error_of_a_block_names_the_point() -> None:
    (point,) = plan({"channel.camera.fps": [500.0]}, "static", SMALL)
    with pytest.raises(HeliographError, match=r"channel\.camera\.fps=500\.0: the plain receiver"):
        sweep.count([PointTally(point, StopRule())], workers=1)


def fail(work: Any) -> Any:
    raise MemoryError("no\nroom")


@pytest.mark.parametrize(("job", "message"), [
    (fail, "MemoryError: no room"), (lambda work: {**run_job(work), "version": "0.0.0"}, "install the same"),
])  # fmt: skip
def test_failure_and_other_version_are_one_line(job: Any, message: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sweep, "run_job", job)
    with pytest.raises(HeliographError, match=message):
        sweep.count([tally_of()], workers=1)


def test_a_refusal_of_a_receiver_is_an_error_unless_the_point_may_have_one() -> None:
    (point,) = plan(
        {"channel.camera.fps": [2000]}, "static", merge(SMALL, {"channel": {"camera": {"exposure_s": 4e-4}}})
    )
    with pytest.raises(
        HeliographError, match=r"channel.camera.fps=2000: the plain receiver needs one frame per pattern"
    ):
        sweep.count([PointTally(point, FEW)], workers=1)
    tally = PointTally(point, FEW, may_refuse=True)
    sweep.count([tally], workers=1)
    assert (tally.ending, tally.fraction, tally.total) == ("refused", 1.0, BlockCounts())
    assert tally.refusal.startswith("the plain receiver needs")


def imu_point(path: Path, rate: float) -> Point:
    rows = [f"{t / 100},{rate},0,0,10" for t in range(200)]
    path.write_text("\n".join(["t_s,gyro_fwd_rad_s,gyro_right,gyro_down,speed_m_s", *rows]), encoding="utf-8")
    (point,) = plan({}, "paper", merge(SMALL, {"channel": {"duration_s": 0.1}}), imu=path)
    return point


@pytest.mark.slow
def test_recording_changed_since_planning_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "car.csv"
    work = json.loads(json.dumps(imu_point(path, 0.0).job(0)))
    assert run_job(work)["counts"]["frames"] == 100
    other = imu_point(path, 0.1)
    assert run_job(other.job(0))["counts"]["frames"] == 100, "same path, other content: not taken from the cache"
    points_module.load_recording.cache_clear()  # another worker
    with pytest.raises(MediaError, match="has changed since planning"):
        run_job(work)
    path.unlink()
    with pytest.raises(MediaError, match="cannot read the recording"):
        run_job(work)


@pytest.mark.parametrize(("arguments", "message"), [
    ((0,), "at least 1 worker"), ((2, "tcp://127.0.0.1:1"), "not both"),
    pytest.param((None, "localhost"), "no address", marks=pytest.mark.slow),  # imports Dask
])  # fmt: skip
def test_workers_are_checked_before_a_folder_is_created(arguments: Any, message: str, tmp_path: Path) -> None:
    if "address" in message:
        pytest.importorskip("distributed")
    with pytest.raises(HeliographError, match=message):
        sweep.count([tally_of()], tmp_path / "out", *arguments)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_dataset_has_dimensions_units_and_provenance(swept: tuple[Any, Path], tmp_path: Path) -> None:
    found, folder = swept
    assert (found.ber.dims, found["channel.distance_m"].attrs["units"]) == (("channel.distance_m", "layer"), "m")
    assert (found["net_bits_per_second"].attrs["units"], found.attrs["seed"]) == ("bit/s", 0)
    shared = json.loads(found.attrs["settings"])
    assert shared["signal"]["data_pairs"] == 8
    assert "distance_m" not in shared["channel"]
    reports = json.loads((folder / "points.json").read_text())
    for at, report in zip((40, 70), reports, strict=True):
        layer = found.sel({"channel.distance_m": at, "layer": "low"})
        assert int(layer.codewords) == report["layers"]["low"]["codewords"]
        assert float(layer.fer_high) == report["layers"]["low"]["fer_ci"][1]
        assert bool(layer.fer_is_bound) == report["layers"]["low"]["fer_is_bound"] == (at == 40)
        assert int(found.duplicates.sel({"channel.distance_m": at})) == report["duplicates"]
    assert np.all(found.ber_low.values <= found.ber_high.values)
    found.to_netcdf(tmp_path / "sweep.nc", engine="h5netcdf")


@pytest.mark.parametrize(("key", "unit"), [
    ("channel.distance_m", "m"), ("channel.speed_m_s", "m/s"), ("channel.camera.blur_px", "px"),
    ("channel.camera.exposure_s", "s"), ("channel.camera.fps", "Hz"), ("channel.sensor.full_well_e", "electron"),
    ("receiver", "1"), ("channel.arrays.0.clock_ppm", "1e-6"), ("receive.track.acceleration_px_s2", "px/s2"),
])  # fmt: skip
def test_units_follow_from_names(key: str, unit: str) -> None:
    assert dataset.unit(key) == unit


def test_missing_library_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(HeliographError, match=r"pip install 'heliograph\[cluster\]'"):
        executors.open_workers(None, "tcp://127.0.0.1:8786")


def altered(name: str, layer: str = "", **values: Any) -> str:
    """Return the counts of a block without a name, or with other values."""
    plain = fake_counts(4, 2).to_plain()
    part: Any = plain["layers"][layer] if layer else plain
    part.update(values)
    part.pop(name, None)
    return json.dumps(plain)


PLAIN: Any = fake_counts(4, 2).to_plain()["layers"]
COUNTS = [
    "[1]", altered("frames"), altered("", extra=1), altered("", layers=dict(list(PLAIN.items())[:2])),
    altered("", layers=dict(zip(("high", "middle", "lowest"), PLAIN.values(), strict=True))),
    altered("bits", "low"), altered("", "low", codewords=4.5), altered("", "low", codewords=True),
    altered("", "low", codewords=-4, codeword_errors=-4), altered("", "low", codeword_errors=5),
    altered("", "low", bit_errors=1), altered("", "low", missed=3), altered("", "low", bit_squares=3),
    altered("", "low", codewords=10**400), altered("", bins={"a": 1}), altered("", bins=[["near", PLAIN]]),
    altered("", payload_bits=7), altered("", film_s=float("inf")), altered("", film_s=float("nan")),
    altered("", detected=1), "{", "null", "[" * 50_000 + "]" * 50_000, b"\xff\x00",
]  # fmt: skip


@pytest.mark.parametrize(("statement", "values"), [
    *(("UPDATE blocks SET counts = ?", (text,)) for text in COUNTS),
    *(("UPDATE blocks SET seconds = ?", (value,)) for value in ("soon", -1.0, float("inf"), b"1")),
    ("UPDATE blocks SET block = ?", ("first",)), ("UPDATE blocks SET counts = CAST(x'ff' AS TEXT)", ()),
    ("ALTER TABLE blocks DROP COLUMN seconds", ()), ("PRAGMA user_version = 7", ()),
], ids=lambda value: str(value)[:40])  # fmt: skip
def test_altered_store_is_refused_in_one_line(statement: str, values: Any, tmp_path: Path) -> None:
    with closing(Store(tmp_path)) as store:
        store.add(points()[0], 0, fake_counts(4, 2), 1.0)
    with closing(sqlite3.connect(tmp_path / NAME)) as db, db:
        db.execute(statement, values)
    (tmp_path / "points.json").write_text("earlier")
    tally = PointTally(points()[0], StopRule(max_codewords=1))
    with pytest.raises(MediaError, match=r"^(?=.{,399}$).*choose another folder"):
        sweep.count([tally], tmp_path, workers=1)
    assert ((tmp_path / "points.json").read_text(), tally.blocks) == ("earlier", 0)


def test_arrays_outside_the_detection_range_are_named() -> None:
    text = size_warning(plan({"signal.side": [8, 16, 32], "channel.distance_m": [70, 2]}))
    assert text.startswith(
        "2 of 6 points have an array outside the detection range (signal.side=8, channel.distance_m=70: "
    )
    assert "signal.side=32, channel.distance_m=2: 933 px a side, the receiver detects 8 to 512 px" in text
    assert size_warning(plan({"receiver": ["soft"]}, "static", merge_changes(["signal.side=8"]))) == ""
    drive = plan({"channel.stop_m": [30, 65]}, "paper", merge_changes(["signal.side=8", "channel.distance_m=70"]))
    assert [bool(size_warning([point])) for point in drive] == [False, True]


def test_number_of_workers_is_limited_by_the_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(executors, "cores", lambda: 2)
    assert [executors.enough_workers(n) for n in (1, 2, 4, 5, 64)] == [1, 2, 4, 4, 4]
    assert executors.fewer_workers(4) == executors.fewer_workers(None) == ""
    with closing(executors.open_workers(64)) as crew:
        assert crew.slots == 4

    def interrupt(*_: Any) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(sweep, "count", interrupt)
    with (
        pytest.raises(KeyboardInterrupt),
        pytest.warns(UserWarning, match="64 workers are more than 2 cores can feed: 4 are started"),
    ):
        sweep.sweep({}, workers=64)


def save(axes: Any, path: Path) -> None:
    axes.figure.savefig(path)
    assert path.stat().st_size > 1000


@pytest.mark.slow
def test_undetected_array_differs_from_an_unreadable_one(tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match="channel.distance_m=70: 6.67 px a side"):
        data = sweep.sweep({"channel.distance_m": [40, 70]}, set={"signal.side": 8}, max_codewords=1, output=tmp_path)
    assert (data.packets.values.tolist(), data.detected.values.tolist()) == ([1, 1], [1, 0])
    reports = json.loads((tmp_path / "points.json").read_text())
    assert [(report["packets"], report["detected"]) for report in reports] == [(1, 1), (1, 0)]
    table = list(csv.DictReader((tmp_path / "points.csv").read_text().splitlines()))
    assert [row["detected"] for row in table] == ["1"] * 3 + ["0"] * 3
    near = data.sel({"channel.distance_m": 40})
    assert ((near.raw_bits > 0) & (near.raw_ber == near.raw_errors / near.raw_bits)).all()
    assert ((near.raw_ber_low <= near.raw_ber) & (near.raw_ber <= near.raw_ber_high)).all()
    assert float(table[0]["raw_ber_high"]) == float(near.raw_ber_high.sel(layer="high"))
    axes = plot.plot_rates(data, "raw_ber")
    assert axes.get_xlabel() == "channel.distance_m (m)"
    assert plot.MISSED in plot.legend_entries(axes)[1]
    crosses = [np.asarray(line.get_xdata()).tolist() for line in axes.lines if line.get_marker() == "x"]
    assert crosses == [[70]] * 3
    save(axes, tmp_path / "plot.png")


@pytest.mark.slow
def test_raw_error_rate_of_the_soft_receiver_grows_with_the_distance() -> None:
    """The first equalisation's rate rises per layer; the last equalisation depends on the decoded codewords."""
    data = sweep.sweep({"channel.distance_m": [60, 80, 120]}, set={"receive.receiver": "soft"}, max_codewords=1)
    assert (data.raw_bits > 0).all()
    assert (np.diff(data.raw_ber.values, axis=0) > 0).all()
    low = data.final_raw_ber.sel(layer="low").values
    assert low[1] < low[0]
    assert (data.final_raw_ber.sel(layer="low") < data.raw_ber.sel(layer="low"))[1:].all()


def test_plot_has_a_line_for_each_choice_and_names_invalid_arguments(tmp_path: Path) -> None:
    vary: dict[str, list[Any]] = {"receiver": ["plain", "soft"], "channel.distance_m": [40, 70]}
    tallies = [PointTally(point, StopRule()) for point in plan(vary, "static", SMALL)]
    for number, tally in enumerate(tallies):
        tally.add(0, replace(fake_counts(10, number), packets=1, detected=1), 1.0)
    data = dataset.to_dataset(vary, tallies)
    axes = plot.plot_rates(data)
    labels = [f"{r}, {layer}" for r in vary["receiver"] for layer in LAYERS]
    assert axes.get_legend_handles_labels()[1] == labels
    lines = {str(line.get_label()): np.asarray(line.get_ydata()).tolist() for line in axes.lines}
    assert (lines["plain, high"], lines["soft, low"]) == (pytest.approx([0.1]), pytest.approx([0.2, 0.3]))
    bounds = [line for line in axes.lines if line.get_gid() == plot.BOUND]
    assert [line.get_linestyle() for line in bounds] == ["None"] * 3
    assert np.concatenate([line.get_ydata() for line in bounds]) == pytest.approx([clopper_pearson(0, 10)[1]] * 3)
    legend: Any = axes.get_legend()
    assert [text.get_text() for text in legend.get_texts()] == [*labels, plot.BOUND]
    assert plot.plot_rates(data.sel(layer="low", receiver="soft")).get_legend_handles_labels()[1] == ["low"]
    save(plot.plot_rates(data, along="receiver"), tmp_path / "plot.png")
    single = data.isel({"receiver": 0, "channel.distance_m": 0})
    for arguments, message in (
        ((data, "per"), "there are ber, raw_ber, final_raw_ber, fer"),
        ((data, "fer", "channel.x"), r"nothing varies by 'channel\.x'; there are receiver, channel\.distance_m"),
        ((single,), "nothing varies in this Dataset"),
    ):
        with pytest.raises(HeliographError, match=message):
            plot.plot_rates(*arguments)


@pytest.mark.parametrize(("shown", "is_terminal", "is_visible"), [
    (None, False, False), (None, True, True), (False, True, False), (True, False, True),
])  # fmt: skip
def test_progress_is_visible_on_a_terminal_or_on_request(
    shown: bool | None, is_terminal: bool, is_visible: bool,
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.setattr(sys.stderr, "isatty", lambda: is_terminal)
    with sweep.bar(1, shown) as advance:
        advance([tally_of()])
    err = capsys.readouterr().err
    assert bool(err) == ("0 of 1 points" in err) == is_visible


def test_bar_estimates_the_remaining_time_after_the_first_point(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    now = 0.0
    monkeypatch.setattr("time.monotonic", lambda: now)
    tallies = [tally_of(StopRule(max_codewords=4)) for _ in range(4)]
    # an earlier run stored half of the first point
    tallies[0].add(0, fake_counts(2, 0), 1.0)
    with sweep.bar(4, shown=True) as advance:
        for tally in tallies[:2]:
            advance(tallies)
            now += 20.0
            tally.add(tally.blocks, fake_counts(4, 0), 1.0)
        advance(tallies)
    err = capsys.readouterr().err
    assert err.count("estimate") == 1
    assert "1 of 4 points complete; estimate for the others: 2 min" in err


DECIMALS = st.decimals(-1000, 1000, places=3)
STEPS = st.decimals("0.001", 100, places=3)
TEXTS = st.text(st.characters(exclude_categories=["Cs", "Cc"]), min_size=1, max_size=10)
VALUES = (
    st.booleans() | st.integers(-(10**9), 10**9) | st.floats(-1e9, 1e9) | TEXTS
    | st.lists(st.integers(-(2**63), 2**63 - 1), max_size=3)
)  # fmt: skip


def written(value: Any) -> str:
    """Format a value as TOML."""
    return to_toml({"v": value}).removeprefix("v = ").rstrip("\n")


@examples(100)
@given(first=DECIMALS, count=st.integers(0, 60), step=STEPS, down=st.booleans())
@pytest.mark.slow
def test_a_range_has_its_ends_and_even_steps(first: Decimal, count: int, step: Decimal, down: bool) -> None:
    step = -step if down else step
    last = first + count * step
    key, values = parse_vary(f"channel.distance_m={first}:{last}:{step}")
    assert (key, values) == ("channel.distance_m", [float(first + k * step) for k in range(count + 1)])
    # integers stay integers
    whole = first == first.to_integral_value() and step == step.to_integral_value()
    assert {type(value) for value in values} == {int if whole else float}
    # an end between two steps is excluded
    assert parse_vary(f"a={first}:{last + step / 2}:{step}")[1] == values


@examples(100)
@given(values=st.lists(VALUES, min_size=1, max_size=6))
def test_a_list_holds_its_values_as_they_are(values: list[Any]) -> None:
    found = parse_vary(f" a.b = {','.join(map(written, values))}")
    assert (found, list(map(type, found[1]))) == (("a.b", values), list(map(type, values)))


KEYS = st.sampled_from(["a", "b.c", "d", "e"])


@examples(100)
@given(vary=st.dictionaries(KEYS, st.lists(st.integers(), min_size=1, max_size=5, unique=True), max_size=4))
def test_a_grid_has_each_combination_once_the_last_key_fastest(vary: dict[str, list[int]]) -> None:
    points = grid(vary)
    assert [list(point) for point in points] == [list(vary)] * len(points)
    assert [tuple(point.values()) for point in points] == list(itertools.product(*vary.values()))


@examples(100)
@given(path=st.lists(st.text("abc_", min_size=1, max_size=3), min_size=1, max_size=4), value=VALUES)
def test_a_dotted_key_becomes_nested_mappings(path: list[str], value: Any) -> None:
    tree = nested(".".join(path), value)
    for key in path:
        assert list(tree) == [key]
        tree = tree[key]
    assert tree == value
