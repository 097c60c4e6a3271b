"""`heliograph measure`: counts, and errors for invalid arguments."""

from collections.abc import Callable
from pathlib import Path

import pytest
from cli_runs import SMALL, Run, called, failed, succeeded

from heliograph.base.threads import one_thread

Call = Callable[..., Run]


@pytest.fixture
def call(tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> Call:
    monkeypatch.chdir(tmp_path)
    return lambda *arguments: called("measure", *arguments, capfd=capfd, monkeypatch=monkeypatch)


@pytest.mark.slow
def test_scenes_are_counted_one_by_one(call: Call) -> None:
    lines = succeeded(
        call("scenes", "upright", "--at", "30,40", "--packets", "1", "--receiver", "plain", "--workers", "1")
    ).splitlines()
    assert [line.split(": ")[0] for line in lines] == ["upright, 30 m", "upright, 40 m"]
    assert all("high 0/1 [" in line and line.endswith("packets of nothing 0") for line in lines)


def test_acquisition_counts_its_trials(call: Call) -> None:
    out = succeeded(call("acquisition", "--trials", "1", "--within", "5", "--workers", "1"))
    assert out.startswith("1 trials: by the first header 1, by the second 0, missed 0 [0.0e+00, ")


@pytest.mark.slow
def test_repeated_packets_are_counted_by_reception(call: Call) -> None:
    lines = succeeded(
        call("repeated-packets", "--distance", "40", "--layer", "low", "--receptions", "2", "--films", "1",
             "--set", "signal.data_pairs=8", "--workers", "1")
    ).splitlines()  # fmt: skip
    assert [line.split(" wrong")[0] for line in lines] == [f"40 m, low, reception {k}: 0 of 1" for k in (1, 2)]


@pytest.mark.slow
def test_the_known_channel_stands_beside_the_estimated_one(call: Call) -> None:
    with one_thread():  # on a loaded machine, multithreaded BLAS is ten times slower for small matrices
        out = succeeded(
            call("known-channel", "--distance", "60", "--brightness", "1", "--packets", "1", "--workers", "1")
        )
    assert [line.split(" wrong")[0] for line in out.splitlines()] == [
        f"60 m, low, brightness 1, {how}: 0 of 1" for how in ("blind", "known")
    ]


@pytest.mark.slow
def test_tables_are_markdown(call: Call) -> None:
    headers = succeeded(call("header-separation", "220")).splitlines()
    assert [line.count("|") for line in headers] == [7, 7, 7, 0, 3, 3, 3]
    losses = succeeded(call("timing-loss")).splitlines()
    assert losses[0].startswith("| rate | exposure | phase |")
    assert len(losses) > 50


@pytest.mark.real_data
@pytest.mark.slow
def test_drives_and_empty_clips(call: Call, data: Path) -> None:
    clip, imu = data / "driving" / "day-motorway.mp4", data / "motion" / "car-imu.csv"
    drive = succeeded(
        call("drives", clip, "--imu", imu, "--margin", "16", "--set", "channel.distance_m=40",
             "--set", "channel.duration_s=0.05", "--set", "signal.data_pairs=16")
    ).splitlines()  # fmt: skip
    assert drive[0] == "day-motorway.mp4: 50 frames"
    assert drive[-1] == "  false codewords 0, false packets 0"
    empty = succeeded(
        call("empty", clip, "--imu", imu, "--native", "--frames", "20", "--set", "channel.camera.width=480",
             "--set", "channel.camera.height=270")
    ).splitlines()  # fmt: skip
    assert empty[0].startswith("day-motorway.mp4: 0/20 (< 1.5e-01) detections")
    assert empty[1].startswith("all clips, per frame: 0/20 ")


def test_a_film_encoded_again(call: Call, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    film = ("simulate", "film.mp4", "--lossless", *SMALL, "--set", "channel.distance_m=30",
            "--set", "channel.duration_s=0.11")  # fmt: skip
    succeeded(called(*film, capfd=capfd, monkeypatch=monkeypatch))
    lines = succeeded(call("lossy", "film.mp4", "again.mp4")).splitlines()
    assert lines[0].startswith("again.mp4: 110 frames, ")
    assert lines[-1] == "  false codewords 0, false packets 0"
    assert "is the film itself" in failed(call("lossy", "film.mp4", "film.mp4"))


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("scenes nowhere", "there is no scene nowhere; there are upright"),
        ("scenes upright --at near", "'near' is no list of numbers; separate numbers by commas"),
        ("scenes upright --receiver sift --at 50", "receive.receiver"),
        ("repeated-packets --layer top", "unknown layer 'top'; choose from high, middle, low"),
        ("known-channel --brightness 1,,2", "'1,,2' is no list of numbers"),
        ("drives none.mp4 --imu none.csv", "none.mp4"),
        ("lossy none.mp4 out.mp4", "there is no truth file none.mp4.truth.npz"),
    ],
)
@pytest.mark.slow
def test_wrong_arguments_are_one_line(call: Call, arguments: str, message: str) -> None:
    assert message in failed(call(*arguments.split()))


def test_an_unknown_measurement_is_a_usage_error(call: Call) -> None:
    assert "heliograph measure --help" in failed(call("nothing"), 2)


def test_without_a_measurement_the_help_says_which_there_are(call: Call) -> None:
    run = call()
    assert run.returncode == 2
    assert "Usage: heliograph measure" in run.stderr
    assert "\n  header-separation " in run.stderr
