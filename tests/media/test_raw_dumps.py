"""Raw dumps: levels without a header."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from film_checks import holds, refused
from made_recordings import noise, write_y4m

from heliograph.media import open_film


@pytest.mark.parametrize(("suffix", "content"), [
    (".raw", "noise"), (".raw", "black"), (".RAW", "words"), (".bin", "noise"), (".bin", "black"), (".dat", "words"),
    (".gray", "black"), (".y", "noise"), (".img", "words"), (".rgb", "noise"), (".yuv", "black"), (".nv12", "noise"),
])  # fmt: skip
def test_a_raw_dump_is_named_with_the_way_to_npy(tmp_path: Path, suffix: str, content: str) -> None:
    levels = {"noise": noise(40, 48, 48, 8), "black": np.zeros((40, 48, 48), np.uint8), "words": noise(40, 48, 48, 12)}
    path = tmp_path / f"dump{suffix}"
    levels[content].tofile(path)
    says = refused(path, rate_hz=1000)[1]
    assert f"({path.stat().st_size} bytes) has no known header with the size of its frames: save it as .npy by" in says
    assert "n.save('dump.npy', n.fromfile(" in says
    assert "damaged" not in says


@pytest.mark.parametrize("suffix", [".raw", ".bin", ".dat", ".yuv"])
def test_a_film_under_the_name_of_a_dump_is_read(tmp_path: Path, suffix: str) -> None:
    shutil.move(write_y4m(tmp_path / "a.y4m", "mono"), tmp_path / f"a{suffix}")
    with open_film(tmp_path / f"a{suffix}") as film:
        assert len(list(film)) == 5


def test_the_advised_command_reads_the_frames(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    levels = noise(6, 8, 12, 8)
    levels.tofile("gray.raw")
    np.concatenate([levels, np.full((6, 4, 12), 128, np.uint8)], axis=1).tofile("colour.yuv")
    for path in (Path("gray.raw"), Path("colour.yuv")):
        command = refused(path, rate_hz=10)[1].split('python -c "')[1].split('"')[0]
        exec(command.replace("ROWS", "8").replace("COLUMNS", "12"), {})
        assert holds(path.with_suffix(".npy"), levels, rate_hz=10)
