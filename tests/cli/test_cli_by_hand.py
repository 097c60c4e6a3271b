"""Manual corners on the command line for arrays missed by detection."""

import json
from pathlib import Path

import numpy as np
import pytest
from cli_runs import Call, Run, failed, lasting, succeeded, within

CORNERS = "78,43,96,58,81,76,63,61"
TURNED = (*lasting(0.15), "--set", "channel.distance_m=40", "--set", "channel.arrays.0.roll_deg=40")


@pytest.fixture(scope="module")
def dark(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Create a film with a valid format and no content."""
    path = tmp_path_factory.mktemp("dark") / "a.npy"
    np.save(path, np.zeros((3, 120, 160), np.uint8))
    return path


def arrays(run: Run) -> list[int]:
    found = [array["id"] for array in json.loads(run.stdout)["arrays"]]
    assert (run.returncode, run.stderr) == (0 if found else 3, "")
    return found


@pytest.fixture(scope="module")
def turned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("turned")
    succeeded(within(folder, "simulate", "a.h5", *TURNED, "--high", "text:mind the gap"))
    return folder / "a.h5"


@pytest.mark.slow
def test_a_turned_array_is_read_by_its_corners(turned: Path, call: Call) -> None:
    """`tests/receive/test_corners_and_region.py` reads the same film with both receivers."""
    read = ("receive", turned, "--preset", "static", "--json", "--output", "out")
    assert arrays(call(*read, "--corners", CORNERS)) == [0]
    assert Path("out", "array-0-high-0.bin").read_bytes() == b"mind the gap"


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
    moved = ",".join(str(int(n) - (10, 5)[k % 2]) for k, n in enumerate(CORNERS.split(",")))
    said = succeeded(call("receive", turned, "--workers", "1", "--preset", "static",
                          "--crop", "10,5,140,110", "--corners", moved))  # fmt: skip
    assert [array["id"] for array in json.loads(said)["arrays"]] == [0]


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (("--corners", "1,2,3"), "--corners takes X,Y,X,Y,X,Y,X,Y in pixels, not '1,2,3'"),
        (("--corners", "a,b,c,d,e,f,g,h"), "--corners takes"),
        (("--corners", "nan,0,9,0,9,9,0,9"), "--corners takes"),
        (("--corners", "0,0,90,90,90,0,0,90"), "four corners one after the other around an area"),
        (("--corners", "0,0,5,0,5,5,0,5"), "set receive.detect.min_side_px"),
        (("--region", "1,2,30"), "--region takes X,Y,WIDTH,HEIGHT in whole pixels, not '1,2,30'"),
        (("--region", "1,2,30,4.5"), "--region takes"),
        (("--region", "1,2,3,3"), "receive.detect.region"),
        (("--region", ""), "--region takes"),
        (("--region", "1,2,1" + "0" * 5000 + ",9"), "--region takes"),
        (("--region", "1,2,1" + "0" * 400 + ",9"), "--region takes"),
    ],
)
def test_an_invalid_place_is_one_line(options: tuple[str, str], says: str, dark: Path, call: Call) -> None:
    assert says in failed(call("receive", dark, "--fps", "1000", "--preset", "static", *options))


def test_a_region_beyond_the_film_is_one_line(dark: Path, call: Call) -> None:
    run = call("receive", dark, "--fps", "1000", "--preset", "static", "--region", "500,0,40,40")
    assert run.returncode == 1
    assert run.stderr == "heliograph: the region 500,0,40,40 that was given lies beyond the frames, which are 160x120\n"
