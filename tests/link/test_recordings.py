"""Recorded footage and motion, including invalid files."""

from pathlib import Path

import numpy as np
import pytest
from film_checks import uniform, write_levels

from heliograph.base.errors import MediaError
from heliograph.link.simulate import IMU_COLUMNS, load_footage, load_imu

HEAD = ",".join(IMU_COLUMNS)


def rows(count: int = 40) -> list[str]:
    return [f"{k * 0.01:.2f},0.01,{0.001 * k:.4f},-0.02,8.3" for k in range(count)]


def motion(path: Path, lines: list[str]) -> Path:
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def test_motion_is_read_by_the_names_of_its_columns(tmp_path: Path) -> None:
    trace = load_imu(motion(tmp_path / "a.csv", [f"note,{HEAD}", *(f"7,{row}" for row in rows())]))
    assert trace.t_s[:3].tolist() == pytest.approx([0, 0.01, 0.02])
    assert (trace.gyro_rad_s[10].tolist(), set(trace.speed_m_s.tolist())) == (pytest.approx([0.01, 0.01, -0.02]), {8.3})


@pytest.mark.parametrize(("lines", "said"), [
    ([], "is empty"), (["q#"], "is empty"), (["#", " ", "# "], "is empty"), ([HEAD], "at least 32"),
    ([HEAD, *rows(5)], "at least 32"),
    ([HEAD.replace("gyro_down", "gyro_up"), *rows()], "lacks the column 'gyro_down'"),
    ([HEAD, *rows(39), "0.39,x,0,0,8"], "finite"), ([HEAD, *rows(39), "0.39,,0,0,8"], "finite"),
    ([HEAD, *rows(39), "0.01,0,0,0,8"], "rising"),
    ([HEAD, *rows(39), "0.39,0,0"], "Line #41 .got 3 columns instead of 5"),
])  # fmt: skip
def test_wrong_motion_is_reported(tmp_path: Path, lines: list[str], said: str) -> None:
    path = motion(tmp_path / "a.csv", lines)
    with pytest.raises(MediaError, match=said) as caught:
        load_imu(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(("name", "said"), [
    ("none.csv", "No such file"), (".", "directory"), ("binary.csv", "no text"),
])  # fmt: skip
def test_motion_that_cannot_be_read_is_reported(tmp_path: Path, name: str, said: str) -> None:
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(MediaError, match=said):
        load_imu(tmp_path / name)


def test_footage_can_be_read_again_and_again(tmp_path: Path) -> None:
    write_levels(tmp_path / "a.mkv", uniform([300, 400, 500], 16, 32, np.uint16), 25, 10)
    footage = load_footage(tmp_path / "a.mkv")
    assert footage.rate_hz == 25
    for _ in range(2):
        frames = list(footage.frames())
        assert [int(f[0, 0]) for f in frames] == [75, 100, 125]
        assert all(f.dtype == np.uint8 and f.shape == (16, 32) for f in frames)


def test_footage_that_is_none_is_reported(tmp_path: Path) -> None:
    (tmp_path / "a.mkv").write_text("no film")
    with pytest.raises(MediaError, match="not a video"):
        load_footage(tmp_path / "a.mkv")
