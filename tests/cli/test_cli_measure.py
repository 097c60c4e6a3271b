"""`heliograph measure` and `heliograph dataset`: counts, sizes, and errors for invalid arguments."""

from pathlib import Path

import pytest
from cli_runs import SMALL, Call, failed, names, succeeded

from heliograph.base.threads import one_thread


@pytest.fixture
def measured(call: Call) -> Call:
    return lambda *arguments: call("measure", *arguments)


@pytest.mark.slow
def test_scenes_are_counted_separately(measured: Call) -> None:
    lines = succeeded(
        measured("scenes", "upright", "--at", "30,40", "--packets", "1", "--receiver", "plain", "--workers", "1")
    ).splitlines()
    assert [line.split(": ")[0] for line in lines] == ["upright, 30 m", "upright, 40 m"]
    assert all("high 0/1 [" in line and line.endswith("packets of nothing 0") for line in lines)


@pytest.mark.slow
def test_acquisition_counts_its_trials(measured: Call) -> None:
    out = succeeded(measured("acquisition", "--trials", "1", "--within", "5", "--workers", "1"))
    assert out.startswith("1 trials: by the first header 1, by the second 0, missed 0 [0.0e+00, ")


@pytest.mark.slow
def test_repeated_packets_are_counted_by_reception(measured: Call) -> None:
    lines = succeeded(
        measured("repeated-packets", "--distance", "40", "--layer", "low", "--receptions", "2", "--films", "1",
             "--set", "signal.data_pairs=8", "--workers", "1")
    ).splitlines()  # fmt: skip
    assert [line.split(" wrong")[0] for line in lines] == [f"40 m, low, reception {k}: 0 of 1" for k in (1, 2)]


@pytest.mark.slow
def test_known_and_estimated_channel_are_compared(measured: Call) -> None:
    with one_thread():  # on a loaded machine, multithreaded BLAS is ten times slower for small matrices
        out = succeeded(
            measured("known-channel", "--distance", "60", "--brightness", "1", "--packets", "1", "--workers", "1")
        )
    assert [line.split(" wrong")[0] for line in out.splitlines()] == [
        f"60 m, low, brightness 1, {how}: 0 of 1" for how in ("blind", "known")
    ]


@pytest.mark.slow
def test_tables_are_markdown(measured: Call) -> None:
    headers = succeeded(measured("header-separation", "220")).splitlines()
    assert [line.count("|") for line in headers] == [7, 7, 7, 0, 3, 3, 3]
    losses = succeeded(measured("timing-loss")).splitlines()
    assert losses[0].startswith("| rate | exposure | phase |")
    assert len(losses) > 50


@pytest.mark.real_data
@pytest.mark.slow
def test_drives_and_empty_clips(measured: Call, data: Path) -> None:
    clip, imu = data / "driving" / "day-motorway.mp4", data / "motion" / "car-imu.csv"
    drive = succeeded(
        measured("drives", clip, "--imu", imu, "--margin", "16", "--set", "channel.distance_m=40",
             "--set", "channel.duration_s=0.05", "--set", "signal.data_pairs=16")
    ).splitlines()  # fmt: skip
    assert (drive[0], drive[-1]) == ("day-motorway.mp4: 50 frames", "  false codewords 0, false packets 0")
    empty = succeeded(
        measured("empty", clip, "--imu", imu, "--native", "--frames", "20", "--set", "channel.camera.width=480",
             "--set", "channel.camera.height=270")
    ).splitlines()  # fmt: skip
    assert empty[0].startswith("day-motorway.mp4: 0/20 (< 1.5e-01) detections")
    assert empty[1].startswith("all clips, per frame: 0/20 ")


@pytest.mark.slow
def test_a_film_encoded_again(call: Call, measured: Call) -> None:
    film = ("simulate", "film.mp4", "--lossless", *SMALL, "--set", "channel.distance_m=30",
            "--set", "channel.duration_s=0.11")  # fmt: skip
    succeeded(call(*film))
    lines = succeeded(measured("lossy", "film.mp4", "again.mp4")).splitlines()
    assert lines[0].startswith("again.mp4: 110 frames, ")
    assert lines[-1] == "  false codewords 0, false packets 0"
    assert "is the film itself" in failed(measured("lossy", "film.mp4", "film.mp4"))


def test_help_lists_the_measurements(measured: Call) -> None:
    run = measured()
    assert run.returncode == 2
    assert "Usage: heliograph measure" in run.stderr
    assert "\n  header-separation " in run.stderr


TINY = (
    "--set", "channel.camera.width=64", "--set", "channel.camera.height=48", "--set", "signal.data_pairs=8",
    "--set", "channel.arrays.0.x_m=0", "--set", "channel.arrays.0.y_m=0",
)  # fmt: skip
LARGE = ("--set", "channel.camera.width=4000", "--set", "channel.camera.height=4000")
SPLIT = ("--vary", "channel.distance_m=30,40", "--films", "3", "--splits", "1,1,1")
FILMS = ["test/000002.h5", "test/000005.h5", "train/000000.h5", "train/000003.h5", "validation/000001.h5",
         "validation/000004.h5"]  # fmt: skip


@pytest.mark.slow
def test_the_size_is_printed_and_existing_films_are_kept(call: Call, tmp_path: Path) -> None:
    said = succeeded(call("dataset", "a", *TINY, *SPLIT, "--size"))
    assert said.startswith("a: 6 films, 120 frames, ")
    assert not (tmp_path / "a").exists()
    made = succeeded(call("dataset", "a", *TINY, *SPLIT)).splitlines()
    assert made == [said.strip(), "a/DATASHEET.md: seed 0; 2 train, 2 validation, 2 test"]
    assert names(tmp_path / "a") == ["DATASHEET.md", "dataset.json", "films.csv", *FILMS]
    again = succeeded(call("dataset", "a", *TINY, *SPLIT)).splitlines()
    assert again[0] == f"{said.strip()}, of which 6 films exist"
    assert "differs in seed" in failed(call("dataset", "a", *TINY, *SPLIT, "--seed", "1"))
