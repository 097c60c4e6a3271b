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


@pytest.mark.slow
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
