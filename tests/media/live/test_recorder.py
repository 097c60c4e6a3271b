"""Record the last seconds before a failure."""

from pathlib import Path

import numpy as np
import pytest
from film_checks import write_levels

from heliograph.base.errors import MediaError
from heliograph.base.frames import Frame
from heliograph.media import FilmReader, open_film
from heliograph.media.live.recorder import Recorder


@pytest.fixture
def source(tmp_path: Path) -> FilmReader:
    """Return a film reader; only the frame size and format matter."""
    return open_film(write_levels(tmp_path / "source.h5", np.zeros((1, 4, 8), np.uint16), 100, 12))


def frame(number: int) -> Frame:
    return Frame(number, number / 100, np.full((4, 8), number, np.uint16), 12)


def kept(path: Path) -> list[int]:
    with open_film(path) as film:
        assert (film.rate_hz, film.bits, film.metadata) == (100, 12, {"note": "x"})
        got = list(film)
    assert all(one.pixels[0, 0] == one.index for one in got)
    return [one.index for one in got]


@pytest.mark.parametrize(("failures", "last"), [((), None), ((50,), 51), ((99,), 99), ((50, 53, 60), 71)])
def test_the_last_seconds_before_a_failure_are_kept(
    tmp_path: Path, source: FilmReader, failures: tuple[int, ...], last: int | None
) -> None:
    """Another frame may arrive before the recording starts; later failures are in the next film."""
    recorder = Recorder(tmp_path / "kept.h5", 0.2, source, {"note": "x"})
    for number in range(100):
        recorder.saw(frame(number))
        if number in failures:
            recorder.failed()
    recorder.close()
    assert recorder.written == (21 if last else 0)
    if last is None:
        assert [path.name for path in tmp_path.iterdir()] == ["source.h5"]
    else:
        assert kept(tmp_path / "kept.h5") == list(range(last - 20, last + 1))


def test_memory_is_bounded(tmp_path: Path, source: FilmReader) -> None:
    recorder = Recorder(tmp_path / "kept.h5", 10, source, {"note": "x"}, max_bytes=30 * 64)
    assert recorder.seconds == pytest.approx(0.3)
    for number in range(200):
        recorder.saw(frame(number))
    recorder.failed()
    recorder.close()
    assert len(kept(tmp_path / "kept.h5")) == 30


@pytest.mark.parametrize(("name", "says"), [
    ("kept.mkv", "is recorded as HDF5, so its name ends in one of .h5, .hdf5"),
    ("nowhere/kept.h5", "name a file in a folder that exists"),
])  # fmt: skip
def test_wrong_targets_are_named(tmp_path: Path, source: FilmReader, name: str, says: str) -> None:
    with pytest.raises(MediaError, match=says):
        Recorder(tmp_path / name, 1, source, {})


def test_a_failed_write_is_reported_and_leaves_no_file(tmp_path: Path, source: FilmReader) -> None:
    (tmp_path / "gone").mkdir()
    recorder = Recorder(tmp_path / "gone" / "kept.h5", 1, source, {})
    recorder.saw(frame(0))
    recorder.failed()
    (tmp_path / "gone").rmdir()
    with pytest.raises(MediaError, match="does not exist"):
        recorder.close()
    assert recorder.written == 0
