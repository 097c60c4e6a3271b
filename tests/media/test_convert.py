"""Film conversion keeps levels, times and metadata."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from made_recordings import Levels, noise, write_cine, write_mraw, write_pictures, write_tiff

from heliograph.base.errors import MediaError
from heliograph.base.frames import Frame
from heliograph.media import convert_film, create_film, open_film

KINDS = (".h5", ".mkv", ".nut", ".mp4")
PLACES = (0, 1, 2, 5, 6, 9)
"""Frame positions on the time grid, with gaps."""


def frames(bits: int, rate_hz: float) -> list[Frame]:
    rng = np.random.default_rng(4)
    pictures = [rng.integers(0, 1 << bits, (32, 48)) for _ in PLACES]
    levels = [p.astype(np.uint8) if bits == 8 else p.astype(np.uint16) for p in pictures]
    return [Frame(k, 0.25 + k / rate_hz, level, bits) for k, level in zip(PLACES, levels, strict=True)]


def film(path: Path, bits: int = 8, rate_hz: float = 1000.0) -> Path:
    with create_film(path, width=48, height=32, rate_hz=rate_hz, bits=bits, metadata={"note": "mine"},
                     lossless=path.suffix == ".mp4") as written:  # fmt: skip
        for frame in frames(bits, rate_hz):
            written.write(frame)
    return path


def converted(source: Path, target: Path, rate_hz: float | None = None) -> int:
    with open_film(source, rate_hz=rate_hz) as opened:
        return convert_film(opened, target)


@pytest.mark.parametrize("bits", [8, 10])
@pytest.mark.parametrize("target", KINDS)
@pytest.mark.parametrize("source", KINDS)
def test_levels_times_and_notes_stay(tmp_path: Path, source: str, target: str, bits: int) -> None:
    path = film(tmp_path / f"a{source}", bits)
    assert converted(path, tmp_path / f"b{target}") == len(PLACES)
    with open_film(tmp_path / f"b{target}") as read:
        got = list(read)
        assert (read.rate_hz, read.bits, read.metadata["note"]) == (1000.0, bits, "mine")
    for one, sent in zip(got, frames(bits, 1000.0), strict=True):
        assert np.array_equal(one.pixels, sent.pixels)
        assert one.time_s == pytest.approx(sent.time_s, abs=1e-9)


@pytest.mark.parametrize("bits", [8, 12, 16])
@pytest.mark.parametrize("target", [".h5", ".mkv", ".nut"])
@pytest.mark.parametrize("source", [".h5", ".mkv", ".nut"])
def test_more_bits_and_any_times(tmp_path: Path, source: str, target: str, bits: int) -> None:
    """Irregular times, to the precision of the coarser format."""
    late = [Frame(0, 0.1 + k / 100 + 1e-4 * (k % 3), one.pixels, bits) for k, one in enumerate(frames(bits, 100.0))]
    with create_film(tmp_path / f"a{source}", width=48, height=32, rate_hz=100.0, bits=bits) as written:
        for frame in late:
            written.write(frame)
    converted(tmp_path / f"a{source}", tmp_path / f"b{target}")
    with open_film(tmp_path / f"b{target}") as read:
        got = list(read)
        assert read.bits == bits
    coarsest_s = 1.001e-3 if ".mkv" in (source, target) else 2e-6 if ".nut" in (source, target) else 1e-12
    for one, sent in zip(got, late, strict=True):
        assert np.array_equal(one.pixels, sent.pixels)
        assert one.time_s == pytest.approx(sent.time_s, abs=coarsest_s)


CAMERAS = ("folder", "pattern", "tiff", "npy", "mraw", "cine")


@pytest.mark.parametrize("bits", [8, 12, 16])
@pytest.mark.parametrize("target", KINDS)
@pytest.mark.parametrize("source", CAMERAS)
def test_what_cameras_and_programs_write(tmp_path: Path, source: str, target: str, bits: int) -> None:
    """Formats with 16-bit words store 12-bit levels as 16-bit levels."""
    levels = noise(5, 32, 48, bits)
    times_s = np.arange(5) / 500
    word = 8 if bits == 8 else 16
    kinds: dict[str, Callable[[], Path]] = {
        "folder": lambda: write_pictures(tmp_path / "p", levels),
        "pattern": lambda: write_pictures(tmp_path / "p", levels) / "img%04d.png",
        "tiff": lambda: write_tiff(tmp_path / "a.tif", levels),
        "npy": lambda: saved(tmp_path / "a.npy", levels),
        "mraw": lambda: write_mraw(tmp_path / "a.mraw", levels, word, bits, rate=500.0),
        "cine": lambda: write_cine(tmp_path / "a.cine", list(levels), word, bits, list(times_s), 500),
    }
    path, goal = kinds[source](), tmp_path / f"b{target}"
    held = bits if source in ("mraw", "cine") else word
    rate_hz = None if source in ("mraw", "cine") else 500.0
    if target == ".mp4" and held > 10:
        with pytest.raises(MediaError, match="holds at most 10 bits"):
            converted(path, goal, rate_hz)
        return
    with open_film(path, rate_hz=rate_hz) as opened:
        assert not any(frame.pixels.flags.writeable for frame in opened), "receivers would copy them"
    converted(path, goal, rate_hz)
    with open_film(goal) as read:
        got = list(read)
        assert (read.bits, read.rate_hz) == (held, 500.0)
    for one, sent, time_s in zip(got, levels, times_s, strict=True):
        assert np.array_equal(one.pixels, sent)
        assert one.time_s == pytest.approx(time_s, abs=2e-9)


def saved(path: Path, levels: Levels) -> Path:
    np.save(path, levels)
    return path


def test_the_camera_s_own_rate_is_written(tmp_path: Path) -> None:
    converted(film(tmp_path / "slow.mkv", rate_hz=25), tmp_path / "b.h5", 1000.0)
    with open_film(tmp_path / "b.h5") as read:
        assert read.rate_hz == 1000.0
        assert np.diff([frame.time_s for frame in read]) == pytest.approx(np.diff(PLACES) / 1000)


def test_what_a_kind_does_not_hold_is_an_error_and_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(MediaError, match="12"):
        converted(film(tmp_path / "a.h5", 12), tmp_path / "b.mp4")
    with pytest.raises(MediaError, match="unknown kind"):
        converted(tmp_path / "a.h5", tmp_path / "b.gif")
    assert [path.name for path in tmp_path.iterdir()] == ["a.h5"]


def test_whole_frames_of_a_damaged_film_are_kept(tmp_path: Path) -> None:
    path = film(tmp_path / "a.mkv")
    data = path.read_bytes()
    path.write_bytes(data[: len(data) * 2 // 3])
    with pytest.raises(MediaError, match=r"a\.mkv"):
        converted(path, tmp_path / "b.h5")
    with open_film(tmp_path / "b.h5") as read:
        assert 0 < len(list(read)) < len(PLACES)


def test_a_film_is_not_written_over_itself(tmp_path: Path) -> None:
    path = film(tmp_path / "a.h5")
    held = path.read_bytes()
    with open_film(path, crop=(0, 0, 2, 2)) as opened, pytest.raises(MediaError, match="is read and would be written"):
        convert_film(opened, tmp_path / "." / "a.h5")
    assert path.read_bytes() == held


def test_what_is_no_film_is_refused(tmp_path: Path) -> None:
    nothing: Any = "a.h5"
    with pytest.raises(MediaError, match="takes a film as open_film gives it, not str"):
        convert_film(nothing, tmp_path / "b.h5")
    with open_film(film(tmp_path / "a.h5")) as opened, pytest.raises(MediaError, match="path is text or a pathlib"):
        convert_film(opened, cast(Any, 5))


def test_ctrl_c_keeps_the_frames_so_far(tmp_path: Path) -> None:
    def stop(done: int) -> None:
        if done == 3:
            raise KeyboardInterrupt

    with open_film(film(tmp_path / "a.h5")) as opened, pytest.raises(KeyboardInterrupt):
        convert_film(opened, tmp_path / "b.mkv", stop)
    with open_film(tmp_path / "b.mkv") as read:
        assert len(list(read)) == 3
