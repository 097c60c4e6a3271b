"""`heliograph measure` and `heliograph dataset`: counts, sizes, and errors for invalid arguments."""

import json
from collections.abc import Callable
from pathlib import Path

import cv2
import pytest
from cli_runs import SMALL, Call, failed, names, succeeded

from heliograph.base.threads import one_thread

Lines = Callable[..., list[str]]


@pytest.fixture
def lines(call: Call) -> Lines:
    """Run a measurement; return the lines that it prints."""
    return lambda *arguments: succeeded(call("measure", *arguments)).splitlines()


@pytest.mark.slow
def test_scenes_are_counted_separately(lines: Lines) -> None:
    said = lines("scenes", "upright", "--at", "30,40", "--packets", "1", "--receiver", "plain", "--workers", "1")
    assert [line.split(": ")[0] for line in said] == ["upright, 30 m", "upright, 40 m"]
    assert all("high 0/1 [" in line and line.endswith("packets of nothing 0") for line in said)


@pytest.mark.slow
def test_acquisition_counts_its_trials(lines: Lines) -> None:
    (said,) = lines("acquisition", "--trials", "1", "--within", "5", "--workers", "1")
    assert said.startswith("1 trials: by the first header 1, by the second 0, missed 0 [0.0e+00, ")


@pytest.mark.slow
def test_repeated_packets_are_counted_by_reception(lines: Lines) -> None:
    said = lines("repeated-packets", "--distance", "40", "--layer", "low", "--receptions", "2", "--films", "1",
                 "--set", "signal.data_pairs=8", "--workers", "1")  # fmt: skip
    assert [line.split(" wrong")[0] for line in said] == [f"40 m, low, reception {k}: 0 of 1" for k in (1, 2)]


@pytest.mark.slow
def test_known_and_estimated_channel_are_compared(lines: Lines) -> None:
    with one_thread():  # on a loaded machine, multithreaded BLAS is ten times slower for small matrices
        said = lines("known-channel", "--distance", "60", "--brightness", "1", "--packets", "1", "--workers", "1")
    expected = [f"60 m, low, brightness 1, {how}: 0 of 1" for how in ("blind", "known")]
    assert [line.split(" wrong")[0] for line in said] == expected


@pytest.mark.slow
def test_tables_are_markdown(lines: Lines) -> None:
    assert [line.count("|") for line in lines("header-separation", "220")] == [7, 7, 7, 0, 3, 3, 3]
    losses = lines("timing-loss")
    assert losses[0].startswith("| rate | exposure | phase |")
    assert len(losses) > 50


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(getattr(cv2, "aruco", None), "ArucoDetector"), reason="OpenCV before 4.7")
def test_ranging_counts_films_by_method(call: Call, lines: Lines) -> None:
    arguments = ("ranging", "--at", "30", "--films", "2", "--first", "4001", "--workers", "1")
    with one_thread():
        head, *rows = lines(*arguments)
        found = json.loads(succeeded(call("measure", *arguments, "--json")))
    assert head.split() == ["distance", "method", "found", "distance", "error", "lateral", "yaw"]
    methods = ["plain", "soft", "POC", "ArUco"]
    assert [row.split()[:4] for row in rows] == [["30", "m", method, "2/2"] for method in methods]
    assert [(one["distance_m"], one["method"], one["found"], one["films"]) for one in found] == [
        (30.0, method, 2, 2) for method in methods
    ]
    for one, row in zip(found, rows, strict=True):
        # 0.75 m, the published error within 100 m
        assert one["low"] <= one["distance_error"] <= one["high"] < 0.75 / 30
        assert f"{one['distance_error']:.2%}" in row
        assert (one["yaw_deg"] is None) == (one["method"] == "POC")


@pytest.mark.parametrize("at", ["5", "25,nan"])
def test_ranging_refuses_distances_beyond_the_scene(call: Call, at: str) -> None:
    assert "distances are 10 to 1000 m, not" in failed(call("measure", "ranging", "--at", at))


@pytest.mark.real_data
@pytest.mark.slow
def test_drives_and_empty_clips(lines: Lines, data: Path) -> None:
    recorded = (data / "driving" / "day-motorway.mp4", "--imu", data / "motion" / "car-imu.csv")
    drive = lines("drives", *recorded, "--margin", "16", "--set", "channel.distance_m=40",
                  "--set", "channel.duration_s=0.05", "--set", "signal.data_pairs=16")  # fmt: skip
    assert (drive[0], drive[-1]) == ("day-motorway.mp4: 50 frames", "  false codewords 0, false packets 0")
    empty = lines("empty", *recorded, "--native", "--frames", "20", "--set", "channel.camera.width=480",
                  "--set", "channel.camera.height=270")  # fmt: skip
    assert empty[0].startswith("day-motorway.mp4: 0/20 (< 1.5e-01) detections")
    assert empty[1].startswith("all clips, per frame: 0/20 ")


@pytest.mark.slow
def test_a_film_encoded_again(call: Call, lines: Lines) -> None:
    film = ("simulate", "film.mp4", "--lossless", *SMALL, "--set", "channel.distance_m=30",
            "--set", "channel.duration_s=0.11")  # fmt: skip
    succeeded(call(*film))
    said = lines("lossy", "film.mp4", "again.mp4")
    assert said[0].startswith("again.mp4: 110 frames, ")
    assert said[-1] == "  false codewords 0, false packets 0"
    assert "is the film itself" in failed(call("measure", "lossy", "film.mp4", "film.mp4"))


def test_help_lists_the_measurements(call: Call) -> None:
    run = call("measure")
    assert run.returncode == 2
    assert "Usage: heliograph measure" in run.stderr
    assert "\n  header-separation " in run.stderr


DATASET = (
    "dataset", "a", *SMALL, "--set", "channel.camera.width=64", "--set", "channel.camera.height=48",
    "--set", "signal.data_pairs=8", "--vary", "channel.distance_m=30,40", "--films", "3", "--splits", "1,1,1",
)  # fmt: skip
FILMS = ["test/000002.h5", "test/000005.h5", "train/000000.h5", "train/000003.h5", "validation/000001.h5",
         "validation/000004.h5"]  # fmt: skip


@pytest.mark.slow
def test_the_size_is_printed_and_existing_films_are_kept(call: Call, tmp_path: Path) -> None:
    said = succeeded(call(*DATASET, "--size"))
    assert said.startswith("a: 6 films, 120 frames, ")
    assert not (tmp_path / "a").exists()
    made = succeeded(call(*DATASET)).splitlines()
    assert made == [said.strip(), "a/DATASHEET.md: seed 0; 2 train, 2 validation, 2 test"]
    assert names(tmp_path / "a") == ["DATASHEET.md", "dataset.json", "films.csv", *FILMS]
    again = succeeded(call(*DATASET)).splitlines()
    assert again[0] == f"{said.strip()}, of which 6 films exist"
    assert "differs in seed" in failed(call(*DATASET, "--seed", "1"))
