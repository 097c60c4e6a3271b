"""Film conversion keeps levels, times and metadata."""

from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from film_checks import form, holds, read, same
from made_recordings import noise, write_kinds

from heliograph.base.errors import MediaError
from heliograph.base.frames import Frame
from heliograph.media import convert_film, create_film, open_film
from heliograph.receive.sync.frame_clock import owned

PLACES = (0, 1, 2, 5, 6, 9)
"""Frame positions on the time grid, with gaps."""


def film(path: Path, bits: int = 8, rate_hz: float = 1000.0, jitter_s: float = 0.0) -> list[Frame]:
    """Write a film, and return the frames."""
    levels = noise(len(PLACES), 32, 48, bits)
    frames = [
        Frame(k, 0.25 + k / rate_hz + jitter_s * (k % 3), level, bits) for k, level in zip(PLACES, levels, strict=True)
    ]
    with create_film(path, width=48, height=32, rate_hz=rate_hz, bits=bits, metadata={"note": "mine"},
                     lossless=path.suffix == ".mp4") as written:  # fmt: skip
        for frame in frames:
            written.write(frame)
    return frames


def converted(source: Path, target: Path, rate_hz: float | None = None) -> int:
    with open_film(source, rate_hz=rate_hz) as opened:
        return convert_film(opened, target)


@pytest.mark.parametrize(("source", "target", "bits"), [
    (".h5", ".mkv", 8), (".mkv", ".nut", 10), (".nut", ".mp4", 10), (".mp4", ".h5", 8), (".mp4", ".mp4", 10),
    (".h5", ".nut", 12), (".nut", ".mkv", 16), (".mkv", ".h5", 16),
])  # fmt: skip
def test_levels_times_and_metadata_are_kept(tmp_path: Path, source: str, target: str, bits: int) -> None:
    sent = film(tmp_path / f"a{source}", bits)
    assert converted(tmp_path / f"a{source}", tmp_path / f"b{target}") == len(PLACES)
    with open_film(tmp_path / f"b{target}") as opened:
        got = list(opened)
        assert (opened.rate_hz, opened.bits, opened.metadata["note"]) == (1000.0, bits, "mine")
    assert same(got, [frame.pixels for frame in sent])
    assert [frame.time_s for frame in got] == pytest.approx([frame.time_s for frame in sent], abs=1e-9)


@pytest.mark.parametrize(("source", "target", "error_s"), [
    (".h5", ".h5", 1e-12), (".h5", ".nut", 2e-6), (".nut", ".h5", 2e-6), (".nut", ".mkv", 1.001e-3),
    (".mkv", ".h5", 1.001e-3),
])  # fmt: skip
def test_irregular_times_are_kept_as_far_as_possible(tmp_path: Path, source: str, target: str, error_s: float) -> None:
    sent = film(tmp_path / f"a{source}", rate_hz=100.0, jitter_s=1e-4)
    converted(tmp_path / f"a{source}", tmp_path / f"b{target}")
    got = read(tmp_path / f"b{target}")
    assert [frame.time_s for frame in got] == pytest.approx([frame.time_s for frame in sent], abs=error_s)


def test_recordings_of_cameras_are_converted(tmp_path: Path) -> None:
    levels = noise(5, 32, 48, 8)
    suffixes = (".h5", ".mkv", ".nut", ".mp4", ".mp4", ".mp4")
    for (path, needs_rate), suffix in zip(write_kinds(tmp_path, levels, 500).values(), suffixes, strict=True):
        rate_hz, target = 500.0 if needs_rate else None, tmp_path / f"c{suffix}"
        assert not any(frame.pixels.flags.writeable for frame in read(path, rate_hz=rate_hz)), "receivers would copy"
        converted(path, target, rate_hz)
        assert form(target)[2:4] == (8, 500.0)
        assert holds(target, levels, np.arange(5) / 500)
        assert all(owned(frame) is frame for frame in read(target)), "receivers would copy them"


def test_the_given_rate_is_written(tmp_path: Path) -> None:
    film(tmp_path / "slow.mkv", rate_hz=25)
    converted(tmp_path / "slow.mkv", tmp_path / "b.h5", 1000.0)
    with open_film(tmp_path / "b.h5") as opened:
        assert opened.rate_hz == 1000.0
        assert np.diff([frame.time_s for frame in opened]) == pytest.approx(np.diff(PLACES) / 1000)


def test_unsupported_targets_leave_no_file(tmp_path: Path) -> None:
    film(tmp_path / "a.h5", 12)
    for name, says in (("b.mp4", "holds at most 10 bits"), ("b.gif", "unknown kind")):
        with pytest.raises(MediaError, match=says):
            converted(tmp_path / "a.h5", tmp_path / name)
    assert [path.name for path in tmp_path.iterdir()] == ["a.h5"]


def test_complete_frames_of_a_damaged_film_are_kept(tmp_path: Path) -> None:
    path = tmp_path / "a.mkv"
    film(path)
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * 2 // 3])
    with pytest.raises(MediaError, match=r"a\.mkv"):
        converted(path, tmp_path / "b.h5")
    assert 0 < len(read(tmp_path / "b.h5")) < len(PLACES)


def test_a_film_is_not_written_over_itself(tmp_path: Path) -> None:
    path = tmp_path / "a.h5"
    film(path)
    held = path.read_bytes()
    with open_film(path, crop=(0, 0, 2, 2)) as opened, pytest.raises(MediaError, match="is read and would be written"):
        convert_film(opened, tmp_path / "." / "a.h5")
    assert path.read_bytes() == held


def test_other_values_than_films_and_paths_are_refused(tmp_path: Path) -> None:
    film(tmp_path / "a.h5")
    with pytest.raises(MediaError, match="takes a film as open_film gives it, not str"):
        convert_film(cast(Any, "a.h5"), tmp_path / "b.h5")
    with open_film(tmp_path / "a.h5") as opened, pytest.raises(MediaError, match="path is text or a pathlib"):
        convert_film(opened, cast(Any, 5))


def test_ctrl_c_keeps_the_frames_so_far(tmp_path: Path) -> None:
    def stop(done: int) -> None:
        if done == 3:
            raise KeyboardInterrupt

    film(tmp_path / "a.h5")
    with open_film(tmp_path / "a.h5") as opened, pytest.raises(KeyboardInterrupt):
        convert_film(opened, tmp_path / "b.mkv", stop)
    assert len(read(tmp_path / "b.mkv")) == 3
