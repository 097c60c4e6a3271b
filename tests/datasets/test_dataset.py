"""Dataset plan, files and resumption."""

import csv
import json
import re
from collections import Counter
from itertools import islice
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
from film_checks import write_levels
from hypothesis import given
from hypothesis import strategies as st
from properties import examples

import heliograph
from heliograph.base.errors import HeliographError, MediaError, SettingsError
from heliograph.datasets.dataset import done, write, write_dataset
from heliograph.datasets.film import corners, cut_out
from heliograph.datasets.plan import SEEDS, DatasetPlan, planned
from heliograph.link.simulate import simulate, transmitters
from heliograph.measure.bench import dithered, random_messages

SMALL: dict[str, Any] = {
    "channel": {"distance_m": 30.0, "camera": {"width": 64, "height": 48}, "arrays": [{"x_m": 0.0, "y_m": 0.0}]},
    "signal": {"data_pairs": 8},
}
VARY = {"channel.distance_m": [30.0, 40.0]}


def plan_of(films: int = 3, splits: Any = (1, 1, 1), seed: int = 0, vary: Any = VARY, **others: Any) -> DatasetPlan:
    return planned(vary, "static", SMALL, films, splits, None, seed, **others)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, DatasetPlan]:
    folder = tmp_path_factory.mktemp("made") / "set"
    plan = plan_of()
    write(plan, folder)
    return folder, plan


@examples(15)
@given(st.integers(3, 40), st.tuples(*[st.integers(0, 100)] * 3).filter(any))
@pytest.mark.slow
def test_splits_have_their_shares_and_every_film_its_own_seed(films: int, splits: tuple[int, int, int]) -> None:
    plan = plan_of(films, splits, seed=2)
    counts = Counter((film.split, film.point.text) for film in plan.films)
    for name, share in zip(("train", "validation", "test"), splits, strict=True):
        each = {counts[name, point.text] for point in plan.points}
        assert len(each) == 1
        count = each.pop()
        assert (count > 0) == (share > 0)
        assert abs(count - films * share / sum(splits)) < 2
    assert len(plan.films) == 2 * films
    assert sorted(film.seed for film in plan.films) == [2 * SEEDS + k for k in range(2 * films)]


@pytest.mark.slow
def test_a_file_is_the_film_its_truth_and_its_cut_outs(made: tuple[Path, DatasetPlan]) -> None:
    folder, plan = made
    known = plan.films[4]
    settings = dithered(known.settings, known.seed)
    messages = random_messages(settings, known.seed)
    simulated = list(simulate(settings, messages, known.seed))
    with heliograph.open_film(folder / known.name) as opened:
        for frame, (sent, _) in zip(opened, simulated, strict=True):
            np.testing.assert_array_equal(frame.pixels, sent.pixels)
            assert frame.time_s == sent.time_s
    with h5py.File(folder / known.name) as file:
        assert (file.attrs["seed"], file.attrs["split"]) == (known.seed, "validation")
        assert json.loads(file.attrs["varied"]) == {"channel.distance_m": 40.0}
        assert file["truth/index"][:].tolist() == [truth.index for _, truth in simulated]
        assert file["truth/patterns"][:, 0].tolist() == [
            [truth.arrays[0].patterns[0], truth.arrays[0].patterns[-1]] for _, truth in simulated
        ]
        begin, levels = file["sent/0"].attrs["first_pattern"], file["sent/0/levels"][:]
        last = file["truth/patterns"][:].max()
        light = transmitters(settings, messages)[0].levels()
        np.testing.assert_array_equal(levels, list(islice(light, int(begin), int(last) + 1)))
        assert bytes(file["sent/0/messages/high"][:]) == messages[0]["high"][0]
        for k in (0, 7):
            (x, y), cut = file["cutouts/origin"][k, 0], file["cutouts/pixels"][k, 0]
            size = len(cut)
            np.testing.assert_array_equal(cut, file["frames"][k, y : y + size, x : x + size])
            middle = file["truth/corners"][k, 0].mean(axis=0) - [x, y]
            np.testing.assert_allclose(middle, (size - 1) / 2, atol=0.51)
            assert size > 1.4 * np.ptp(file["truth/corners"][k, 0][:, 0])


@pytest.mark.slow
def test_truth_and_cut_outs_are_where_the_array_shines(made: tuple[Path, DatasetPlan]) -> None:
    folder, plan = made
    with h5py.File(folder / plan.films[0].name) as file:
        change = np.ptp(file["frames"][:].astype(float), axis=0)
        shining = np.argwhere(change > 0.5 * change.max())[:, ::-1]
        box = file["truth/corners"][0, 0]
        # LED centres lie half a pitch inside the corners
        assert (abs(shining.min(axis=0) - box.min(axis=0)) < 2.5).all()
        assert (abs(shining.max(axis=0) - box.max(axis=0)) < 2.5).all()


@pytest.mark.slow
def test_the_table_and_the_datasheet_name_every_film(made: tuple[Path, DatasetPlan]) -> None:
    folder, plan = made
    rows = list(csv.DictReader((folder / "films.csv").read_text().splitlines()))
    assert [row["file"] for row in rows] == [film.name for film in plan.films]
    assert {path.relative_to(folder).as_posix() for path in folder.rglob("*.h5")} == {row["file"] for row in rows}
    text = (folder / "DATASHEET.md").read_text()
    assert "channel.distance_m=40.0" in text
    assert f"{len(plan.films)} films" in text
    pixels = sum((folder / film.name).stat().st_size for film in plan.films)
    assert plan.bytes < pixels < plan.bytes + 200_000 * len(plan.films)


@pytest.mark.slow
def test_the_datasheets_code_reads_it(made: tuple[Path, DatasetPlan], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(made[0])
    code = Path("DATASHEET.md").read_text().split("```python\n")[1].split("```")[0]
    assert len(code.strip().splitlines()) <= 10
    names: dict[str, Any] = {}
    exec(code, names)
    assert (names["corners"].shape, names["sent"].shape, names["cutout"].ndim) == ((1, 4, 2), (16, 16), 2)


@pytest.mark.slow
def test_an_interrupted_run_resumes_and_keeps_finished_films(tmp_path: Path) -> None:
    def stop(films: float) -> None:
        if films > 2:  # within the third film
            raise KeyboardInterrupt

    plan, folder = plan_of(vary={}), tmp_path / "set"
    with pytest.raises(KeyboardInterrupt):
        write(plan, folder, stop)
    assert done(plan, folder) == [0, 1]
    assert not [path.name for path in folder.rglob(".*")]
    assert not (folder / "DATASHEET.md").exists()
    before, seen = (folder / plan.films[0].name).stat().st_mtime_ns, list[float]()
    write(plan, folder, seen.append)
    assert (seen, 2 < seen[0] < 3, seen[-1]) == (sorted(seen), True, 3)
    assert (folder / plan.films[0].name).stat().st_mtime_ns == before
    for other in (plan_of(seed=1), plan_of(films=4), plan_of()):
        with pytest.raises(MediaError, match="holds another data set"):
            done(other, folder)


@pytest.mark.slow
def test_the_same_seed_makes_the_same_films(made: tuple[Path, DatasetPlan], tmp_path: Path) -> None:
    folder, plan = made
    write_dataset(tmp_path / "again", {"channel.distance_m": [30.0]}, films=1, splits=(1, 0, 0), set=[
        "channel.camera.width=64", "channel.camera.height=48", "channel.arrays.0.x_m=0", "channel.arrays.0.y_m=0",
        "signal.data_pairs=8"])  # fmt: skip
    with h5py.File(folder / plan.films[0].name) as one, h5py.File(tmp_path / "again" / plan.films[0].name) as other:
        for name in ("frames", "truth/corners", "cutouts/pixels", "sent/0/levels"):
            np.testing.assert_array_equal(one[name], other[name])


@pytest.mark.slow
def test_no_footage_is_in_two_splits(tmp_path: Path) -> None:
    clips = [tmp_path / f"{k}.h5" for k in range(4)]
    for k, path in enumerate(clips):
        write_levels(path, np.full((2, 48, 64), 40 * k, np.uint8), 30)
    plan = plan_of(films=6, splits=(2, 1, 1), backgrounds=clips)
    used = {name: {f.point.recordings["footage"].path for f in plan.films if f.split == name}
            for name in ("train", "validation", "test")}  # fmt: skip
    assert ([len(by) for by in used.values()], len(set.union(*used.values()))) == ([2, 1, 1], 4)
    write(plan_of(vary={}, backgrounds=clips), tmp_path / "set")
    assert "is in a single split" in (tmp_path / "set" / "DATASHEET.md").read_text()
    with pytest.raises(SettingsError, match="3 splits need a footage each, not 2"):
        plan_of(backgrounds=clips[:2])
    with pytest.raises(SettingsError, match="the same footage twice"):
        plan_of(backgrounds=[clips[0], clips[0], clips[1]])


@pytest.mark.parametrize(("x", "y"), [(10.2, 5.1), (-40.0, 3.0), (1e12, 3.0), (np.nan, 3.0), (0.0, 0.0), (19.0, 15.0)])
def test_cut_outs_beyond_the_frame_are_dark(x: float, y: float) -> None:
    pixels = np.arange(1, 16 * 20 + 1, dtype=np.uint16).reshape(16, 20)
    out, (left, top) = cut_out(pixels, x, y, 9)
    for i, j in np.ndindex(9, 9):
        inside = 0 <= top + i < 16 and 0 <= left + j < 20
        assert out[i, j] == (pixels[top + i, left + j] if inside else 0)


def test_corners_behind_the_camera_are_no_numbers() -> None:
    ahead = np.array([[1000.0, 0, 0], [0, 1000.0, 0], [0, 0, 10.0]])
    np.testing.assert_allclose(corners(ahead, 0.2)[2], [10.0, 10.0])
    assert np.isnan(corners(-ahead, 0.2)).all()


@pytest.mark.parametrize(("changes", "says"), [
    ({"films": 2}, "2 films of each kind cannot be split in 3"),
    ({"films": 0}, "the number of films is a whole number from 1"),
    ({"films": 10**9}, "the number of films is a whole number from 1"),
    ({"films": 600_000}, "at most 1000000 films, not 1200000"), ({"splits": (0, 0, 0)}, "not 0,0,0"),
    ({"splits": (1, 1)}, "such as 80,10,10, not 1,1"), ({"splits": (1, 1, -1)}, "such as 80,10,10, not 1,1,-1"),
    ({"splits": 5}, "such as 80,10,10, not 5"), ({"seed": -1}, "the seed is a whole number from 0"),
    ({"seed": 1 << 50}, "the seed is a whole number from 0"),
])  # fmt: skip
def test_wrong_plans_are_one_line(changes: dict[str, Any], says: str) -> None:
    with pytest.raises(HeliographError, match=re.escape(says)):
        plan_of(**changes)


def test_a_folder_of_other_files_is_not_changed(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    for folder in (tmp_path, tmp_path / "mine.txt"):
        with pytest.raises(MediaError, match="holds no data set"):
            write(plan_of(), folder)
    (tmp_path / "dataset.json").write_text("no JSON")
    with pytest.raises(MediaError, match="holds another data set"):
        write(plan_of(), tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["dataset.json", "mine.txt"]


def test_cut_outs_of_a_near_array_are_no_larger_than_the_frame() -> None:
    near = planned({}, "static", {**SMALL, "channel": {**SMALL["channel"], "distance_m": 1.0}}, 3, (1, 0, 0), None, 0)
    assert {film.cutout_px for film in near.films} == {64}
