"""Manual corners on the command line for arrays missed by detection."""

import json
from pathlib import Path

import numpy as np
import pytest
from cli_runs import Call, lasting, succeeded, within

CORNERS = "78,43,96,58,81,76,63,61"
TURNED = (*lasting(0.15), "--set", "channel.distance_m=40", "--set", "channel.arrays.0.roll_deg=40")


@pytest.fixture(scope="module")
def turned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("turned")
    succeeded(within(folder, "simulate", "a.h5", *TURNED, "--high", "text:mind the gap"))
    return folder / "a.h5"


@pytest.mark.slow
def test_skipped_blocks_of_a_busy_scene_are_reported(call: Call) -> None:
    levels = np.random.default_rng(0).integers(0, 256, (130, 8, 10), np.uint8)
    np.save("busy.npy", np.kron(levels, np.ones((1, 8, 8), np.uint8)))
    read = ("receive", "busy.npy", "--fps", "1000", "--preset", "static", "--set", "receive.detect.cpu_share=0.01")
    report, said = json.loads(call(*read, "--json").stdout), call(*read).stdout
    assert report["dropped_blocks"] > 0
    assert f"skipped {report['dropped_candidates']} candidates and {report['dropped_blocks']} blocks" in said
    np.save("busy.npy", np.full((130, 120, 160), 40, np.uint8))
    assert "skipped" not in call(*read).stdout


@pytest.mark.slow
def test_corners_refer_to_the_crop_and_apply_to_several_films(turned: Path, call: Call) -> None:
    """`tests/receive/test_corners_and_region.py` reads the same film with both receivers."""
    moved = ",".join(str(int(n) - (10, 5)[k % 2]) for k, n in enumerate(CORNERS.split(",")))
    said = succeeded(call("receive", turned, "--workers", "1", "--preset", "static", "--output", "out",
                          "--crop", "10,5,140,110", "--corners", moved))  # fmt: skip
    assert [array["id"] for array in json.loads(said)["arrays"]] == [0]
    assert Path("out", "a.h5", "array-0-high-0.bin").read_bytes() == b"mind the gap"
