"""Sweeps in a single process: varied settings, stop rules, stored results."""

import csv
import itertools
import json
import sqlite3
from collections.abc import Callable, Mapping
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from heliograph.base.config import merge
from heliograph.base.errors import HeliographError, MediaError, SettingsError
from heliograph.measure.counts import BlockCounts, LayerCounts
from heliograph.measure.statistics import clopper_pearson
from heliograph.signal.settings import LAYERS
from heliograph.sweeps import dataset, executors, plot, runner, sweep
from heliograph.sweeps import plan as reach
from heliograph.sweeps import points as points_module
from heliograph.sweeps import runner as bar
from heliograph.sweeps.executors import Result, Work
from heliograph.sweeps.plan import grid, parse_vary, plan, varied
from heliograph.sweeps.plan import merge_changes as laid
from heliograph.sweeps.points import Point, run_job
from heliograph.sweeps.store import NAME, Store
from heliograph.sweeps.tally import PointTally, StopRule

SMALL = {"signal": {"data_pairs": 8}, "channel": {"camera": {"width": 480, "height": 288}}}


def fake_counts(codewords: int, errors: int) -> BlockCounts:
    layers = {name: LayerCounts(codewords=codewords, codeword_errors=errors) for name in LAYERS}
    return BlockCounts(layers, film_s=1.0, frames=1000)


def points(**changes: Any) -> list[Any]:
    return plan({"channel.distance_m": [40, 70]}, "static", {**SMALL, **changes})


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("a=25:40:5", [25, 30, 35, 40]),
        ("a=25:39:5", [25, 30, 35]),
        ("a=0.1:0.3:0.1", [0.1, 0.2, 0.3]),
        ("a=3:1:-1", [3, 2, 1]),
        ("a=1,2.5,true,plain,'q,r'", [1, 2.5, True, "plain", "q,r"]),
        ("a=[1, 2],[3]", [[1, 2], [3]]),
        ("a=1:2:0.5,7", [1.0, 1.5, 2.0, 7]),
    ],
)
def test_values_are_read(text: str, values: list[Any]) -> None:
    assert parse_vary(text) == ("a", values)


@pytest.mark.parametrize("text", ["a", "=1", "a=", "a=1,,2", "a=1:2", "a=1:2:0", "a=1:2:-1", "a=0:1e9:1"])
def test_what_varies_nothing_is_refused(text: str) -> None:
    with pytest.raises(SettingsError) as caught:
        parse_vary(text)
    assert "\n" not in str(caught.value)


def test_a_grid_has_all_combinations_the_last_key_fastest() -> None:
    assert grid({"a": [1, 2], "b": ["x", "y"]}) == [
        {"a": 1, "b": "x"}, {"a": 1, "b": "y"}, {"a": 2, "b": "x"}, {"a": 2, "b": "y"}
    ]  # fmt: skip
    assert grid({}) == [{}]
    with pytest.raises(SettingsError, match="twice"):
        grid({"a": [1, 1]})
    with pytest.raises(SettingsError, match="at most"):
        grid({"a": range(200), "b": range(200)})


@pytest.mark.parametrize(
    "values",
    [",".join(f"{a}:{a + 9998}:1" for a in range(0, 400 * 9999, 9999)), ",".join(map(str, range(25_000)))],
    ids=["ranges", "numbers"],
)
def test_too_many_values_are_refused_before_they_are_made(values: str) -> None:
    with pytest.raises(SettingsError, match=r"'channel\.distance_m' has more than 10000 values; take a larger step"):
        parse_vary(f"channel.distance_m={values}")
    with pytest.raises(SettingsError, match="'a' has more than 10000 values"):
        grid({"a": itertools.count()})


def test_many_values_are_compared_at_once() -> None:
    values = [*range(9_998), [1, 2], {"x": [1]}]
    assert grid({"a": values})[-1] == {"a": {"x": [1]}}
    for doubled in ([1, 1.0], [[1], (1.0,)], [{"x": [1]}, {"x": [1]}], [True, 1]):
        with pytest.raises(SettingsError, match="twice"):
            grid({"a": doubled})
    assert len(grid({"a": ["1", 1, [1], [[1]], {"x": 1}, None]})) == 6


def test_a_long_row_of_digits_is_read_at_once() -> None:
    # a regular expression with backtracking took hours
    with pytest.raises(SettingsError, match="more than 64 bits"):
        parse_vary("a=" + "1" * 1_000_000 + "x")


def test_values_may_be_an_array_of_numbers() -> None:
    found = plan({"signal.data_pairs": np.array([8, 16]), "channel.distance_m": np.linspace(40, 50, 2)})
    assert json.loads(json.dumps([dict(point.choice) for point in found]))[1] == {
        "signal.data_pairs": 8, "channel.distance_m": 50.0
    }  # fmt: skip
    assert plan({"signal.data_pairs": [np.int64(8)]})[0].choice == {"signal.data_pairs": 8}


@pytest.mark.parametrize("values", [5, "5", [], np.array([]), np.array(5), {"a": 1}, [1, np.float64(1)]])
def test_what_is_no_list_of_values_is_refused(values: Any) -> None:
    with pytest.raises(SettingsError, match=r"channel\.distance_m"):
        plan({"channel.distance_m": values})


def test_a_setting_varies_under_one_name() -> None:
    with pytest.raises(SettingsError, match="short for"):
        plan({"receiver": ["plain"], "receive.receiver": ["plain"]})


@pytest.mark.parametrize("seed", [-1, 2**63, "a", 1.5])
def test_a_seed_is_what_the_store_can_hold(seed: Any) -> None:
    with pytest.raises(SettingsError, match="seed"):
        plan({}, seed=seed)


def test_a_seed_of_numpy_is_one() -> None:
    seed: Any = np.int64(3)
    (point,) = plan({}, seed=seed)
    assert json.dumps(point.seed) == "3"


def test_presets_and_receivers_vary() -> None:
    night = varied("paper", {"channel": {"distance_m": 60.0}}, {"preset": "night", "receiver": "plain"})
    assert night.channel.background.level == 0.0
    assert night.channel.distance_m == 60.0
    with pytest.raises(SettingsError, match=r"did you mean 'channel\.distance_m'"):
        plan({"channel.distanc_m": [40]})
    with pytest.raises(SettingsError, match="did you mean 'paper'"):
        plan({"preset": ["papr"]})
    with pytest.raises(SettingsError, match="receiver=plane"):
        plan({"receiver": ["plain", "plane"]})
    with pytest.raises(SettingsError, match="--background"):
        plan({"channel.background.kind": ["footage"]})


def test_all_receivers_get_the_same_films_and_other_scenes_others() -> None:
    one, other = plan({"receive.decode.iterations": [3, 4]}, "static", SMALL)
    assert one.key != other.key
    assert [one.block_seed(k) for k in range(3)] == [other.block_seed(k) for k in range(3)]
    near, far = points()
    assert len({near.block_seed(0), near.block_seed(1), far.block_seed(0)}) == 3
    (reseeded,) = plan({}, "static", SMALL, seed=1)
    assert reseeded.block_seed(0) != plan({}, "static", SMALL)[0].block_seed(0)


def test_a_point_ends_by_errors_codewords_seconds_or_emptiness() -> None:
    (point,) = plan({}, "static", SMALL)
    tally = PointTally(point, StopRule(min_errors=5, max_codewords=100, max_seconds=9))
    tally.add(0, fake_counts(10, 4), 1.0)
    assert tally.ending is None
    assert tally.fraction == pytest.approx(0.8)
    tally.add(1, fake_counts(10, 1), 1.0)
    assert tally.ending == "errors"
    for counts, seconds, ending in (((100, 0), 1, "codewords"), ((9, 0), 9, "seconds"), ((9, 0), 1, None)):
        tally = PointTally(point, StopRule(min_errors=5, max_codewords=100, max_seconds=9))
        tally.add(0, fake_counts(*counts), seconds)
        assert tally.ending == ending
    for block in range(3):
        assert tally.ending is None or tally.blocks == 1
        tally = PointTally(point, StopRule()) if not block else tally
        tally.add(block, fake_counts(0, 0), 1.0)
    assert tally.ending == "empty"


def test_blocks_count_in_their_order_and_surplus_ones_do_not() -> None:
    (point,) = plan({}, "static", SMALL)
    tally = PointTally(point, StopRule(min_errors=5, max_codewords=20))
    tally.add(2, fake_counts(10, 9), 1.0)
    tally.add(1, fake_counts(10, 1), 1.0)
    assert tally.blocks == 0
    assert tally.has(2)
    tally.add(0, fake_counts(10, 0), 1.0)
    assert tally.blocks == 2
    assert tally.total.layers["high"].codeword_errors == 1


def test_the_report_has_counts_rates_and_intervals() -> None:
    (point,) = plan({}, "static", SMALL)
    tally = PointTally(point, StopRule())
    nothing = tally.report()
    assert nothing["net_bits_per_second"] is None
    assert nothing["layers"]["high"]["fer"] is None
    payload = {"high": 700, "middle": 0, "low": 0}
    tally.add(0, replace(fake_counts(100, 0), payload_bits=payload), 1.0)
    layer = json.loads(json.dumps(tally.report()))["layers"]["high"]
    assert layer["fer"] == 0.0
    assert layer["fer_ci"] == pytest.approx([0, clopper_pearson(0, 100)[1]])
    assert layer["fer_ci"][1] == pytest.approx(3 / 100, rel=0.02)
    assert tally.report()["net_bits_per_second"] == 700.0


def test_the_report_tells_bounds_and_bits_that_fail_together() -> None:
    (point,) = plan({}, "static", SMALL)
    tally = PointTally(point, StopRule())
    nothing = tally.report()["layers"]["high"]
    assert (nothing["ber_is_bound"], nothing["fer_is_bound"]) == (False, False)
    good = LayerCounts(bits=200 * 512, codewords=200, packets=200)
    bad = replace(good, bit_errors=10 * 50, bit_squares=10 * 50**2, codeword_errors=10)
    layers = {"high": good, "middle": good, "low": bad}
    tally.add(0, BlockCounts(layers, false_packets=2, duplicates=5, film_s=1.0, frames=1000), 1.0)
    report = json.loads(json.dumps(tally.report()))
    assert (report["false_packets"], report["duplicates"]) == (2, 5)
    high, low = report["layers"]["high"], report["layers"]["low"]
    assert (high["ber_is_bound"], high["fer_is_bound"]) == (True, True)
    assert high["ber_ci"] == pytest.approx([0, clopper_pearson(0, 200)[1]])
    assert (low["ber_is_bound"], low["fer_is_bound"]) == (False, False)
    # with ten bad packets in 200, the relative uncertainty is that of the packet count
    assert low["ber_ci"][0] < 0.6 * low["ber"] < 1.6 * low["ber"] < low["ber_ci"][1]


@pytest.mark.parametrize("bad", [{"min_errors": 0}, {"max_codewords": 0}, {"max_seconds": 0.0}])
def test_stop_rules_are_checked(bad: Mapping[str, Any]) -> None:
    with pytest.raises(SettingsError, match=next(iter(bad))):
        StopRule(**bad)


def count(output: Path | None, rule: StopRule | None = None, seed: int = 0) -> list[dict[str, Any]]:
    chosen = plan({"channel.distance_m": [40, 70]}, "static", SMALL, seed)
    tallies = [PointTally(point, rule or StopRule(min_errors=5, max_codewords=20)) for point in chosen]
    sweep.count(tallies, output, workers=1)
    return [tally.report() for tally in tallies]


def rows(folder: Path) -> list[tuple[int, int]]:
    with sqlite3.connect(folder / NAME) as db:
        found = db.execute("SELECT block, computed FROM blocks").fetchall()
    db.close()
    return found


@pytest.mark.slow
def test_a_store_is_resumed_and_extended(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    first = count(tmp_path)
    assert [p["stopped_by"] for p in first] == ["codewords", "codewords"]
    assert json.loads((tmp_path / "points.json").read_text()) == first
    assert len((tmp_path / "points.csv").read_text().splitlines()) == 1 + 2 * 3
    before = rows(tmp_path)

    def never(work: Any) -> Any:
        raise AssertionError("computed again")

    with monkeypatch.context() as patch:
        patch.setattr(runner, "run_job", never)
        assert count(tmp_path) == first
    assert rows(tmp_path) == before
    longer = count(tmp_path, StopRule(min_errors=50, max_codewords=24))
    assert longer[0]["layers"]["high"]["codewords"] == 24
    assert all(computed == 1 for _, computed in rows(tmp_path))
    assert longer == count(None, StopRule(min_errors=50, max_codewords=24))


def test_seed_settings_and_version_are_new_keys(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (point,) = plan({}, "static", SMALL)
    (reseeded,) = plan({}, "static", SMALL, seed=1)
    (moved,) = plan({"channel.distance_m": [51]}, "static", SMALL)
    keys = {point.key, reseeded.key, moved.key}
    monkeypatch.setattr("heliograph.sweeps.points.__version__", "0.0.0")
    assert len(keys | {point.key}) == 4
    with Store(tmp_path) as store:
        store.note(point)
    with sqlite3.connect(tmp_path / NAME) as db:
        version, seed, settings = db.execute("SELECT version, seed, settings FROM points").fetchone()
    db.close()
    assert version == points_module.build()
    assert seed == 0
    assert json.loads(settings)["signal"]["data_pairs"] == 8


def test_results_are_kept_under_the_code_of_the_whole_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    room = tmp_path / "receive"
    room.mkdir()
    (tmp_path / "__init__.py").write_text("")
    (room / "kernels.py").write_text("REACH = 1\n")
    monkeypatch.setattr("heliograph.__file__", str(tmp_path / "__init__.py"))
    builds = []
    for code in ("REACH = 1\n", "REACH = 1\n", "REACH = 2\n"):
        (room / "kernels.py").write_text(code)
        points_module._code_digest.cache_clear()
        builds.append(points_module.build())
    points_module._code_digest.cache_clear()
    assert builds[0] == builds[1] != builds[2]


def test_two_sweeps_may_share_a_store(tmp_path: Path) -> None:
    (point,) = plan({}, "static", SMALL)
    with Store(tmp_path) as one, Store(tmp_path) as other:
        one.add(point, 0, fake_counts(1, 0), 1.0)
        other.add(point, 0, fake_counts(1, 0), 2.0)
        other.add(point, 1, fake_counts(1, 1), 1.0)
        assert one.blocks(point)[0][1] == 1.0
        assert one.blocks(point, 1).keys() == {1}


@pytest.mark.parametrize("content", [b"no database at all, but some text", b""])
def test_a_foreign_file_is_reported(content: bytes, tmp_path: Path) -> None:
    (tmp_path / NAME).write_bytes(content)
    if not content:
        Store(tmp_path).close()  # an empty file counts as a new store
        return
    with pytest.raises(MediaError, match="choose another folder"):
        Store(tmp_path)


def test_another_programs_database_is_left_alone(tmp_path: Path) -> None:
    with sqlite3.connect(tmp_path / NAME) as db:
        db.execute("CREATE TABLE mine (x)")
    db.close()
    with pytest.raises(MediaError, match="holds no results"):
        Store(tmp_path)


class Fragile(executors.Workers):
    """Workers that die with the first submitted blocks."""

    slots = 2

    def __init__(self, losses: int):
        self.losses, self.restarts = losses, 0

    def submit(self, job: Callable[[Work], Result], work: Work) -> "Future[Result]":
        future: Future[Result] = Future()
        if self.restarts < self.losses:
            future.set_exception(BrokenProcessPool("a process died"))
        else:
            future.set_result(job(work))
        return future

    def restart(self) -> None:
        self.restarts += 1

    def close(self) -> None: ...


@pytest.mark.slow
def test_lost_workers_are_replaced_and_at_last_given_up() -> None:
    tallies = [PointTally(point, StopRule(max_codewords=10)) for point in points()]
    with Store() as store:
        runner.run(tallies, store, Fragile(2))
    assert all(tally.done for tally in tallies)
    again = [PointTally(point, StopRule(max_codewords=10)) for point in points()]
    with Store() as store, pytest.raises(HeliographError, match="died"):
        runner.run(again, store, Fragile(100))


def test_an_error_of_a_block_names_its_point() -> None:
    chosen = plan({"channel.camera.fps": [500.0]}, "static", SMALL)
    with pytest.raises(HeliographError, match=r"channel\.camera\.fps=500\.0: the plain receiver"):
        sweep.count([PointTally(point, StopRule()) for point in chosen], workers=1)


def test_a_failure_of_a_worker_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(work: Any) -> Any:
        raise MemoryError("no\nroom")

    monkeypatch.setattr(runner, "run_job", fail)
    with pytest.raises(HeliographError, match="MemoryError: no room"):
        sweep.count([PointTally(points()[0], StopRule())], workers=1)


def test_a_worker_of_another_version_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(runner, "run_job", lambda work: {**run_job(work), "version": "0.0.0"})
    with pytest.raises(HeliographError, match="install the same"):
        sweep.count([PointTally(points()[0], StopRule())], workers=1)


def imu_point(path: Path, rate: float) -> Point:
    rows = [f"{t / 100},{rate},0,0,10" for t in range(200)]
    path.write_text("\n".join(["t_s,gyro_fwd_rad_s,gyro_right,gyro_down,speed_m_s", *rows]), encoding="utf-8")
    (point,) = plan({}, "paper", merge(SMALL, {"channel": {"duration_s": 0.1}}), imu=path)
    return point


def test_a_recording_that_is_not_the_one_planned_with_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "car.csv"
    work = json.loads(json.dumps(imu_point(path, 0.0).job(0)))
    assert run_job(work)["counts"]["frames"] == 100
    other = imu_point(path, 0.1)
    assert run_job(other.job(0))["counts"]["frames"] == 100, "same path, other content: not taken from the cache"
    points_module.load_recording.cache_clear()  # another worker
    with pytest.raises(MediaError, match="has changed since planning") as caught:
        run_job(work)
    assert "\n" not in str(caught.value)
    path.unlink()
    with pytest.raises(MediaError, match="cannot read the recording"):
        run_job(work)


@pytest.mark.slow
def test_workers_are_checked() -> None:
    with pytest.raises(HeliographError, match="at least 1 worker"):
        executors.open_workers(0)
    with pytest.raises(HeliographError, match="not both"):
        executors.open_workers(2, "tcp://127.0.0.1:1")
    with pytest.raises(HeliographError, match="no address"):
        executors.open_workers(None, "localhost")


@pytest.mark.slow
def test_a_dataset_has_dimensions_units_and_provenance(tmp_path: Path) -> None:
    found = sweep.sweep(
        {"channel.distance_m": np.array([40, 70]), "receiver": ["plain"]},
        set={"signal.data_pairs": 8, "channel.camera": {"width": 480, "height": 288}},
        min_errors=5, max_codewords=20, seed=0, output=tmp_path,
    )  # fmt: skip
    assert found.ber.dims == ("channel.distance_m", "receiver", "layer")
    assert found["channel.distance_m"].attrs["units"] == "m"
    assert found["net_bits_per_second"].attrs["units"] == "bit/s"
    assert found.attrs["seed"] == 0
    shared = json.loads(found.attrs["settings"])
    assert shared["signal"]["data_pairs"] == 8
    assert "distance_m" not in shared["channel"]
    reports = json.loads((tmp_path / "points.json").read_text())
    for at, report in zip((40, 70), reports, strict=True):
        layer = found.sel({"channel.distance_m": at, "receiver": "plain", "layer": "low"})
        assert int(layer.codewords) == report["layers"]["low"]["codewords"]
        assert float(layer.fer_high) == report["layers"]["low"]["fer_ci"][1]
        assert bool(layer.fer_is_bound) == report["layers"]["low"]["fer_is_bound"] == (at == 40)
        assert int(found.duplicates.sel({"channel.distance_m": at, "receiver": "plain"})) == report["duplicates"]
    assert np.all(found.ber_low.values <= found.ber_high.values)
    found.to_netcdf(tmp_path / "sweep.nc", engine="h5netcdf")


@pytest.mark.parametrize(
    ("key", "unit"),
    [("channel.distance_m", "m"), ("channel.speed_m_s", "m/s"), ("channel.camera.blur_px", "px"),
     ("channel.camera.exposure_s", "s"), ("channel.camera.fps", "Hz"), ("channel.sensor.full_well_e", "electron"),
     ("receiver", "1"), ("channel.arrays.0.clock_ppm", "1e-6"), ("receive.track.acceleration_px_s2", "px/s2")],
)  # fmt: skip
def test_units_follow_from_names(key: str, unit: str) -> None:
    assert dataset.unit(key) == unit


def test_a_lacking_extra_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "xarray", None)
    with pytest.raises(HeliographError, match="needs xarray: pip install xarray pandas h5netcdf"):
        sweep.sweep({})
    monkeypatch.setitem(__import__("sys").modules, "distributed", None)
    with pytest.raises(HeliographError, match=r"pip install 'dask\[distributed\]'"):
        executors.open_workers(None, "tcp://127.0.0.1:8786")


def altered(folder: Path, statement: str, *values: Any) -> None:
    """Create a store, and modify a block of the first point."""
    with Store(folder) as store:
        store.note(points()[0])
        store.add(points()[0], 0, fake_counts(4, 2), 1.0)
    with sqlite3.connect(folder / NAME) as db:
        db.execute(statement, values)
    db.close()


def counted(change: Callable[[Any], Any]) -> str:
    plain = fake_counts(4, 2).to_plain()
    return json.dumps(change(plain) or plain)


def deep(count: int) -> str:
    return "[" * count + "]" * count


CHANGED: dict[str, Callable[[Any], Any]] = {
    "a list": lambda plain: [1],
    "a text": lambda plain: "counts",
    "a lacking name": lambda plain: plain.pop("frames") and None,
    "one name more": lambda plain: plain.update(extra=1),
    "a lacking layer": lambda plain: plain["layers"].pop("low") and None,
    "layers in a list": lambda plain: plain.update(layers=[1]),
    "a layer of another name": lambda plain: plain["layers"].update(lowest=plain["layers"].pop("low")),
    "a lacking count": lambda plain: plain["layers"]["low"].pop("bits") and None,
    "a text for a count": lambda plain: plain["layers"]["low"].update(codewords="4"),
    "a broken count": lambda plain: plain["layers"]["low"].update(codewords=4.5),
    "a yes for a count": lambda plain: plain["layers"]["low"].update(codewords=True),
    "less than none": lambda plain: plain["layers"]["low"].update(codewords=-4, codeword_errors=-4),
    "more wrong than sent": lambda plain: plain["layers"]["low"].update(codeword_errors=5),
    "more bits wrong than read": lambda plain: plain["layers"]["low"].update(bit_errors=1),
    "more missed than wrong": lambda plain: plain["layers"]["low"].update(missed=3),
    "squares without errors": lambda plain: plain["layers"]["low"].update(bit_squares=3),
    "an immense count": lambda plain: plain["layers"]["low"].update(codewords=10**400),
    "bins in a mapping": lambda plain: plain.update(bins={"a": 1}),
    "a bin of one": lambda plain: plain.update(bins=[[1]]),
    "a bin at a text": lambda plain: plain.update(bins=[["near", plain["layers"]]]),
    "payload of one": lambda plain: plain.update(payload_bits=7),
    "a film without end": lambda plain: plain.update(film_s=float("inf")),
    "a film that is no number": lambda plain: plain.update(film_s=float("nan")),
    "no film": lambda plain: plain.update(film_s=None),
    "more found than sent": lambda plain: plain.update(detected=1),
}


@pytest.mark.parametrize(
    ("statement", "values"),
    [
        *(("UPDATE blocks SET counts = ?", (counted(change),)) for change in CHANGED.values()),
        *(("UPDATE blocks SET counts = ?", (text,)) for text in ("", "{", "null", "7", deep(50_000), b"\xff\x00")),
        *(("UPDATE blocks SET seconds = ?", (value,)) for value in ("soon", -1.0, float("inf"), b"1")),
        ("UPDATE blocks SET block = ?", ("first",)),
        ("UPDATE blocks SET counts = CAST(x'ff' AS TEXT)", ()),
        ("ALTER TABLE blocks DROP COLUMN seconds", ()),
        ("ALTER TABLE points DROP COLUMN settings", ()),
        ("PRAGMA user_version = 7", ()),
    ],
    ids=lambda value: str(value)[:40],
)
def test_an_altered_store_is_refused_in_one_line(statement: str, values: Any, tmp_path: Path) -> None:
    altered(tmp_path, statement, *values)
    (tmp_path / "points.json").write_text("earlier")
    tally = PointTally(points()[0], StopRule(max_codewords=1))
    with pytest.raises(MediaError, match="choose another folder") as caught:
        sweep.count([tally], tmp_path, workers=1)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400
    assert (tmp_path / "points.json").read_text() == "earlier"
    assert tally.blocks == 0


def test_workers_that_are_not_there_leave_no_folder(tmp_path: Path) -> None:
    with pytest.raises(HeliographError, match="no address"):
        sweep.count([PointTally(points()[0], StopRule())], tmp_path / "out", None, "nowhere")
    assert list(tmp_path.iterdir()) == []


def test_arrays_that_nobody_looks_for_are_named() -> None:
    grid_of = {"signal.side": [8, 16, 32], "channel.distance_m": [70, 2]}
    text = reach.not_looked_for(plan(grid_of))
    assert text.startswith(
        "2 of 6 points have an array outside the detection range (signal.side=8, channel.distance_m=70: "
    )
    assert "signal.side=32, channel.distance_m=2: 933 px a side, the receiver detects 8 to 512 px" in text
    assert reach.not_looked_for(plan({"receiver": ["soft"]}, "static", laid(["signal.side=8"]))) == ""
    drive = plan({"channel.stop_m": [30, 65]}, "paper", laid(["signal.side=8", "channel.distance_m=70"]))
    assert [bool(reach.not_looked_for([point])) for point in drive] == [False, True]


def test_more_workers_than_the_cores_can_feed_are_not_started(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(executors, "cores", lambda: 2)
    assert [executors.enough_workers(n) for n in (1, 2, 4, 5, 64)] == [1, 2, 4, 4, 4]
    assert "64 workers are more than 2 cores can feed: 4 are started" in executors.fewer_workers(64)
    assert executors.fewer_workers(4) == executors.fewer_workers(None) == ""
    with closing(executors.open_workers(64)) as crew:
        assert crew.slots == 4
    monkeypatch.setattr(sweep, "count", interrupt)
    with pytest.warns(UserWarning, match="4 are started"):
        sweep_interrupted()


def sweep_interrupted() -> None:
    with pytest.raises(KeyboardInterrupt):
        sweep.sweep({}, workers=64)


def interrupt(*_: Any) -> None:
    raise KeyboardInterrupt


def drawn(axes: Any, path: Path) -> None:
    axes.figure.savefig(path)
    assert path.stat().st_size > 1000


@pytest.mark.slow
def test_an_array_that_was_not_found_is_told_from_one_that_was_not_read(tmp_path: Path) -> None:
    with pytest.warns(UserWarning, match="channel.distance_m=70: 6.67 px a side"):
        data = sweep.sweep(
            {"channel.distance_m": [40, 70, 71]}, set={**laid(["signal.side=8"])}, max_codewords=2, output=tmp_path
        )
    assert data.packets.values.tolist() == [2, 2, 2]
    assert data.detected.values.tolist() == [2, 0, 0]
    reports = json.loads((tmp_path / "points.json").read_text())
    assert [(r["packets"], r["detected"]) for r in reports] == [(2, 2), (2, 0), (2, 0)]
    table = list(csv.DictReader((tmp_path / "points.csv").read_text().splitlines()))
    assert [row["detected"] for row in table] == ["2"] * 3 + ["0"] * 6
    raw = data.sel({"channel.distance_m": 40})
    assert (raw.raw_bits > 0).all()
    assert (raw.raw_ber == raw.raw_errors / raw.raw_bits).all()
    assert (raw.raw_ber_low <= raw.raw_ber).all()
    assert (raw.raw_ber <= raw.raw_ber_high).all()
    assert float(table[0]["raw_ber_high"]) == float(raw.raw_ber_high.sel(layer="high"))
    axes = plot.plot_rates(data, "raw_ber")
    assert axes.get_xlabel() == "channel.distance_m (m)"
    assert plot.MISSED in plot.legend_entries(axes)[1]
    crosses = [np.asarray(line.get_xdata()).tolist() for line in axes.lines if line.get_marker() == "x"]
    assert crosses == [[70, 71]] * 3
    drawn(axes, tmp_path / "plot.png")


@pytest.mark.slow
def test_the_raw_error_rate_of_the_soft_receiver_grows_with_the_distance() -> None:
    """The first equalisation's rate rises per layer; the last equalisation depends on the decoded codewords."""
    distances = [60, 80, 100, 120]
    arrays = {"channel.arrays.0.x_m": 0, "channel.arrays.0.y_m": 0, "channel.camera.width": 160}
    small = {**arrays, "channel.camera.height": 120, "channel.duration_s": 0.2, "receive.receiver": "soft"}
    data = sweep.sweep({"channel.distance_m": distances}, set=small, max_codewords=2)
    assert (data.raw_bits > 0).all()
    assert (np.diff(data.raw_ber.values, axis=0) > 0).all()
    low = data.final_raw_ber.sel(layer="low").values
    assert low[1] < low[0]
    assert (data.final_raw_ber.sel(layer="low") < data.raw_ber.sel(layer="low"))[1:].all()


def test_a_plot_has_a_line_for_each_choice_and_names_what_is_wrong(tmp_path: Path) -> None:
    vary: dict[str, list[Any]] = {"receiver": ["plain", "soft"], "channel.distance_m": [40, 70]}
    tallies = [PointTally(point, StopRule()) for point in plan(vary, "static", SMALL)]
    for number, tally in enumerate(tallies):
        tally.add(0, replace(fake_counts(10, number), packets=1, detected=1), 1.0)
    data = dataset.to_dataset(vary, tallies)
    axes = plot.plot_rates(data)
    labels = [f"{r}, {layer}" for r in vary["receiver"] for layer in LAYERS]
    assert axes.get_legend_handles_labels()[1] == labels
    lines = {str(line.get_label()): np.asarray(line.get_ydata()).tolist() for line in axes.lines}
    assert lines["plain, high"] == pytest.approx([0.1])
    assert lines["soft, low"] == pytest.approx([0.2, 0.3])
    bounds = [line for line in axes.lines if line.get_gid() == plot.BOUND]
    assert [line.get_linestyle() for line in bounds] == ["None"] * 3
    assert np.concatenate([line.get_ydata() for line in bounds]) == pytest.approx([clopper_pearson(0, 10)[1]] * 3)
    legend = axes.get_legend()
    assert legend is not None
    assert [text.get_text() for text in legend.get_texts()] == [*labels, plot.BOUND]
    one = plot.plot_rates(data.sel(layer="low", receiver="soft"))
    assert one.get_legend_handles_labels()[1] == ["low"]
    drawn(plot.plot_rates(data, along="receiver"), tmp_path / "plot.png")
    with pytest.raises(HeliographError, match="there are ber, raw_ber, fer"):
        plot.plot_rates(data, "per")
    with pytest.raises(
        HeliographError, match=r"nothing varies by 'channel\.x'; there are receiver, channel\.distance_m"
    ):
        plot.plot_rates(data, along="channel.x")
    with pytest.raises(HeliographError, match="nothing varies in this Dataset"):
        plot.plot_rates(data.isel({"receiver": 0, "channel.distance_m": 0}))


def test_progress_is_shown_on_a_terminal_or_when_asked_for(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    tallies = [PointTally(points()[0], StopRule())]
    said = "0 of 1 points"
    for shown, terminal, text in ((None, False, ""), (None, True, said), (False, True, ""), (True, False, said)):
        monkeypatch.setattr(bar, "on_a_terminal", lambda terminal=terminal: terminal)
        with bar.bar(1, shown) as advance:
            advance(tallies)
        assert text in (err := capsys.readouterr().err)
        assert bool(err) == bool(text)
