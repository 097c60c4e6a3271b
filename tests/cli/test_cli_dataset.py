"""The `heliograph dataset` command."""

from pathlib import Path

import pytest
from cli_runs import Call, failed, names, succeeded

SMALL = (
    "--set", "channel.camera.width=64", "--set", "channel.camera.height=48", "--set", "signal.data_pairs=8",
    "--set", "channel.arrays.0.x_m=0", "--set", "channel.arrays.0.y_m=0",
)  # fmt: skip
LARGE = ("--set", "channel.camera.width=4000", "--set", "channel.camera.height=4000")
SPLIT = ("--vary", "channel.distance_m=30,40", "--films", "3", "--splits", "1,1,1")
FILMS = ["test/000002.h5", "test/000005.h5", "train/000000.h5", "train/000003.h5", "validation/000001.h5",
         "validation/000004.h5"]  # fmt: skip


def test_the_size_is_printed_and_existing_films_are_kept(call: Call, tmp_path: Path) -> None:
    said = succeeded(call("dataset", "a", *SMALL, *SPLIT, "--size"))
    assert said.startswith("a: 6 films, 120 frames, ")
    assert not (tmp_path / "a").exists()
    made = succeeded(call("dataset", "a", *SMALL, *SPLIT)).splitlines()
    assert made == [said.strip(), "a/DATASHEET.md: seed 0; 2 train, 2 validation, 2 test"]
    assert names(tmp_path / "a") == ["DATASHEET.md", "dataset.json", "films.csv", *FILMS]
    again = succeeded(call("dataset", "a", *SMALL, *SPLIT)).splitlines()
    assert again[0] == f"{said.strip()}, of which 6 films exist"
    assert "differs in seed" in failed(call("dataset", "a", *SMALL, *SPLIT, "--seed", "1"))


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--splits", "many"), "--splits takes TRAIN,VALIDATION,TEST in whole shares, not 'many'"),
        (("--splits", "1,2"), "such as 80,10,10, not 1,2"),
        (("--films", "2"), "2 films of each kind cannot be split in 3"),
        (("--vary", "channel.distnce_m=3"), "did you mean 'channel.distance_m'?"),
        (("--vary", "channel.distance_m=3", "--vary", "channel.distance_m=4"), "is varied twice"),
        (("--set", "channel.background.kind=footage"), "give it by --background VIDEO"),
        (("--background", "none.mp4"), "there is no file none.mp4"),
        (("--packets", "10000", "--films", "2000", *LARGE), "are free"),
    ],
)
def test_invalid_options_are_one_line(options: tuple[str, ...], says: str, call: Call) -> None:
    run = call("dataset", "a", *SMALL, *options)
    assert says in failed(run)
    assert not Path("a").exists()
