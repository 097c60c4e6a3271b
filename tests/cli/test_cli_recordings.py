"""Recordings of cameras and screens, and arrays at given corners, on the command line."""

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from cli_runs import Call, failed, lasting, succeeded, within
from film_checks import write_levels
from made_recordings import write_kinds
from screen_films import Phone, phone_frames, write_phone_film
from screen_light import shown

from heliograph.media import open_film
from heliograph.web.sending import sending_of

pytestmark = pytest.mark.slow

HIGH = b"brake\x00\xff"
Reading = tuple[list[dict[str, Any]], dict[str, bytes]]
"""Packets, and messages by name."""


Paths = dict[str, tuple[Path, bool]]
"""Path of a film in each format, and True if the format lacks a frame rate."""


@pytest.fixture(scope="module")
def shots(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Create a folder with a film."""
    folder = tmp_path_factory.mktemp("shots")
    (folder / "high").write_bytes(HIGH)
    succeeded(within(folder, "simulate", "a.h5", *lasting(0.22), "--seed", "4", "--high", "high"))
    return folder


@pytest.fixture(scope="module")
def paths(shots: Path) -> Paths:
    """Write the film in each format."""
    with open_film(shots / "a.h5") as film:
        return write_kinds(shots, np.stack([frame.pixels for frame in film]), round(film.rate_hz))


@pytest.fixture(scope="module")
def known(shots: Path) -> Reading:
    """Receive the film."""
    return read(lambda *arguments: within(shots, *arguments), shots / "a.h5", shots / "known")


def read(call: Call, film: Path, output: Path, *options: str) -> Reading:
    succeeded(call("receive", film, "--preset", "static", "--output", output, *options))
    packets = [json.loads(line) for line in (output / "packets.jsonl").read_text().splitlines()]
    return packets, {path.name: path.read_bytes() for path in output.glob("*.bin")}


@pytest.mark.parametrize("kind", ["folder", "mraw"])
def test_formats_of_cameras_are_received(kind: str, known: Reading, paths: Paths, tmp_path: Path, call: Call) -> None:
    path, clockless = paths[kind]
    got = read(call, path, tmp_path / "got", *(("--fps", "1000") if clockless else ()))
    assert (got, len(got[0]) >= 2, got[1]) == (known, True, {"array-0-high-0.bin": HIGH})


def test_a_cropped_and_rotated_film_is_read(shots: Path, known: Reading, tmp_path: Path, call: Call) -> None:
    packets, got = read(call, shots / "a.h5", tmp_path / "got", "--crop", "40,20,80,80", "--rotate", "90")
    assert got == known[1] == {"array-0-high-0.bin": HIGH}
    assert [packet["status"] for packet in packets] == [packet["status"] for packet in known[0]]
    assert {row["orientation"] for row in packets} != {row["orientation"] for row in known[0]}


@pytest.mark.parametrize("kind", ["npy", "mraw"])
def test_convert_keeps_the_complete_frames_of_a_truncated_recording(
    kind: str, paths: Paths, tmp_path: Path, call: Call
) -> None:
    whole, clockless = paths[kind]
    path = tmp_path / whole.name
    path.write_bytes(whole.read_bytes())
    if kind == "mraw":
        path.with_suffix(".cih").write_bytes(whole.with_suffix(".cih").read_bytes())
    line = ("convert", path, "c.h5", *(("--fps", "1000") if clockless else ()))
    os.truncate(path, path.stat().st_size * 2 // 3)
    said = failed(call(*line))
    with open_film(tmp_path / "c.h5") as kept:
        count = len(list(kept))
    assert 110 < count < 190
    assert f"in the middle, after {count} whole frames: copy it again; c.h5 holds the {count} frames so far" in said
    # a complete film is not replaced by a truncated film
    before = (tmp_path / "c.h5").read_bytes()
    os.truncate(path, path.stat().st_size * 2 // 3)
    assert failed(call(*line)).endswith("; c.h5 is unchanged")
    assert (tmp_path / "c.h5").read_bytes() == before


def test_results_replace_those_of_an_earlier_film(shots: Path, tmp_path: Path, call: Call) -> None:
    out = tmp_path / "got"
    read(call, shots / "a.h5", out)
    (out / "array-3-low-1.bin").write_bytes(b"another film's")
    (out / "array-of-mine.bin").write_bytes(b"not ours")
    _, got = read(call, shots / "a.h5", out)
    report = json.loads((out / "summary.json").read_text())
    assert got == {"array-0-high-0.bin": HIGH, "array-of-mine.bin": b"not ours"}
    assert report["film"] == str(shots / "a.h5")
    assert "error" not in report


def test_current_folder_is_a_film(paths: Paths, tmp_path: Path, call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(paths["folder"][0])
    _, got = read(call, Path(), tmp_path / "got", "--fps", "1000")
    assert got == {"array-0-high-0.bin": HIGH}


CORNERS = "78,43,96,58,81,76,63,61"


@pytest.fixture(scope="module")
def turned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("turned")
    changes = (
        "--set",
        "channel.distance_m=40",
        "--set",
        "channel.arrays.0.roll_deg=40",
        "--set",
        "signal.data_pairs=16",
    )
    succeeded(within(folder, "simulate", "a.h5", *lasting(0.05), *changes, "--high", "text:mind the gap"))
    return folder / "a.h5"


def test_skipped_blocks_of_a_busy_scene_are_reported(call: Call) -> None:
    levels = np.random.default_rng(0).integers(0, 256, (130, 8, 10), np.uint8)
    np.save("busy.npy", np.kron(levels, np.ones((1, 8, 8), np.uint8)))
    read = ("receive", "busy.npy", "--fps", "1000", "--preset", "static", "--set", "receive.detect.cpu_share=0.01")
    report, said = json.loads(call(*read, "--json").stdout), call(*read).stdout
    assert report["dropped_blocks"] > 0
    assert f"skipped {report['dropped_candidates']} candidates and {report['dropped_blocks']} blocks" in said
    np.save("busy.npy", np.full((130, 120, 160), 40, np.uint8))
    assert "skipped" not in call(*read).stdout


def test_corners_refer_to_the_crop_and_apply_to_several_films(turned: Path, call: Call) -> None:
    """`tests/receive/test_corners_and_region.py` reads the same film with both receivers."""
    moved = ",".join(str(int(n) - (10, 5)[k % 2]) for k, n in enumerate(CORNERS.split(",")))
    said = succeeded(call("receive", turned, "--workers", "1", "--preset", "static", "--output", "out",
                          "--crop", "10,5,140,110", "--corners", moved))  # fmt: skip
    assert [array["id"] for array in json.loads(said)["arrays"]] == [0]
    assert Path("out", "a.h5", "array-0-high-0.bin").read_bytes() == b"mind the gap"


PHONE = Phone(width=320, height=240, side_px=160.0, blur_px=0.8, seed=5)


def test_a_phone_film_is_recognised_and_another_receiver_refuses_it(tmp_path: Path) -> None:
    grabs = shown(sending_of(b"Hello from a laptop", None, 16, 15.0), 4.4, cell_px=8)
    write_phone_film(tmp_path / "phone.mp4", phone_frames(grabs, PHONE), PHONE)
    lines = succeeded(within(tmp_path, "receive", "phone.mp4")).splitlines()
    assert lines[0].startswith("receiver screen: the film shows a screen: 16 x 16 cells")
    assert "array 0, high, message 0: 19 bytes, 'Hello from a laptop'" in lines
    run = within(tmp_path, "receive", "phone.mp4", "--receiver", "plain")
    advice = [line for line in run.stdout.splitlines() if line.startswith("  - ")]
    assert advice == ["  - read it by --preset phone-15, which chooses --receiver screen"]
    assert "phone.mp4 shows a screen: read it by --preset phone-15" in failed(run)


def test_receive_reports_a_missing_screen_early_and_at_the_end(tmp_path: Path) -> None:
    write_levels(tmp_path / "empty.h5", np.random.default_rng(1).integers(90, 110, (170, 48, 64), np.uint8), 30)
    run = within(tmp_path, "receive", "empty.h5", "--preset", "phone")
    assert "no readable screen is visible, in the first 5.0 s" in failed(run, 3)
    assert "no array found: no readable screen is visible" in run.stdout
