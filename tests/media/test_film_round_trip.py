"""Pixels, times and metadata survive a round trip."""

import threading
from itertools import product
from pathlib import Path
from typing import Any

import made_recordings
import numpy as np
import pytest
from film_checks import form, holds, read, uniform, write_levels

from heliograph.base.frames import Frame, Pixels
from heliograph.media import create_film, open_film

W, H = 70, 34  # 70-byte lines are padded in codec buffers
FINE = [".nut", ".mp4", ".h5"]


def noise(count: int, bits: int = 8, shape: tuple[int, int] = (H, W)) -> list[Pixels]:
    levels = made_recordings.noise(count, *shape, bits)
    levels[0].flat[:2] = 0, (1 << bits) - 1
    return list(levels)


def write(path: Path, pixels: list[Pixels], times: list[float], rate: float = 1000.0, **options: Any) -> None:
    bits = int(options.get("bits", 8))
    rows, columns = pixels[0].shape
    with create_film(path, width=columns, height=rows, rate_hz=rate, **options) as film:
        for index, (picture, time_s) in enumerate(zip(pixels, times, strict=True)):
            film.write(Frame(index, time_s, picture, bits))


LOSSLESS = {"codec": "h264", "lossless": True}


@pytest.mark.parametrize(("suffix", "bits", "options"), [
    *product([".mkv"], range(8, 17), [{}]), *product([".nut", ".h5"], (8, 9, 12, 16), [{}]),
    *product([".mp4"], (8, 9, 10), [LOSSLESS]), (".mkv", 8, LOSSLESS), (".nut", 10, LOSSLESS),
])  # fmt: skip
def test_gray_levels_are_exact(tmp_path: Path, suffix: str, bits: int, options: dict[str, Any]) -> None:
    path, (rows, columns) = tmp_path / f"film{suffix}", (33, 71) if options else (H, W)
    pixels = noise(4, bits, (rows, columns))
    write(path, pixels, [0.0, 0.001, 0.002, 0.003], bits=bits, **options)
    assert form(path)[:4] == (columns, rows, bits, 1000.0)
    assert options or form(path)[4] == 4
    assert holds(path, pixels)
    assert {(frame.pixels.dtype, frame.bits) for frame in read(path)} == {(pixels[0].dtype, bits)}


@pytest.mark.parametrize(("name", "options"), [
    ("a.mp4", {}), ("a.mp4", {"crf": 1.0}), ("a.avi", {}), ("a.mkv", {"codec": "mjpeg"}), ("a.nut", {"codec": "h264"}),
    ("odd.mp4", {}), ("odd.avi", {}),
])  # fmt: skip
def test_lossy_codecs_do_not_shift_levels(tmp_path: Path, name: str, options: dict[str, Any]) -> None:
    rows, columns = (63, 255) if name.startswith("odd") else (64, 256)
    # noise, since a smooth ramp repeats the same rounding error
    noisy = np.arange(columns) + np.random.default_rng(1).normal(0, 2, (rows, columns))
    ramp = np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
    write(tmp_path / name, [ramp] * 3, [0.0, 0.001, 0.002], **options)
    for expand in (False, True):  # Heliograph's films are tagged as full range
        for frame in read(tmp_path / name, expand_range=expand):
            error = frame.pixels.astype(int) - ramp
            assert abs(error.mean()) < 0.3
            assert np.abs(error).max() <= 8


@pytest.mark.parametrize(("suffix", "times"), [
    *product(FINE, [[0.0, 0.001000, 0.002001, 0.003499, 0.100007, 20.5]]),
    *product([*FINE, ".mkv", ".avi"], [[start + n / 1000 for n in range(5)] for start in (-1.25, 3600.000001)]),
])  # fmt: skip
def test_times_are_exact_to_a_microsecond_and_start_anywhere(tmp_path: Path, suffix: str, times: list[float]) -> None:
    write(tmp_path / f"a{suffix}", noise(len(times)), times)
    back = [f.time_s for f in open_film(tmp_path / f"a{suffix}")]
    assert np.abs(np.subtract(back, times)).max() < 1e-9


SLOW = [7.5, 30000 / 1001, 960.0]
FAST = [2000.0, 123456.7]  # .mkv and .avi reject these, see test_film_errors


@pytest.mark.parametrize(
    ("suffix", "rate"),
    [*product([".nut", ".mp4", ".h5", ".mkv", ".avi"], SLOW), *product([".nut", ".mp4", ".h5"], FAST)],
)
def test_grid_times_return_bit_for_bit_and_gaps_stay(tmp_path: Path, suffix: str, rate: float) -> None:
    numbers = [3, 4, 5, 9, 10, 40]
    write(tmp_path / f"a{suffix}", noise(6), [n / rate for n in numbers], rate)
    with open_film(tmp_path / f"a{suffix}") as film:
        assert (film.rate_hz, [(f.index, f.time_s) for f in film]) == (rate, [(n, n / rate) for n in numbers])


@pytest.mark.parametrize("suffix", [".nut", ".mkv", ".mp4", ".avi", ".h5"])
def test_metadata_and_frame_count(tmp_path: Path, suffix: str) -> None:
    notes = {"truth": '{"a": [1, 2]}', "Ort": "Zürich; = \\ \n 東京", "empty": "", "long": "xé" * 50_000}
    write(tmp_path / f"a{suffix}", noise(5), [n / 500 for n in range(5)], 500.0, metadata=notes)
    with open_film(tmp_path / f"a{suffix}") as film:
        assert (film.metadata.items(), film.frame_count) == (notes.items(), 5)


def test_the_writer_copies_the_pixels(tmp_path: Path) -> None:
    buffer = np.zeros((H, W), np.uint8)
    with create_film(tmp_path / "a.mkv", width=W, height=H, rate_hz=1000) as film:
        for index in range(30):
            buffer[:] = index
            film.write(Frame(index, index / 1000, buffer))
    assert holds(tmp_path / "a.mkv", uniform(range(30), H, W))
    assert not [t for t in threading.enumerate() if t.name.startswith("film-encoder")]


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (9, 1), (2, 5), (3, 2)])
@pytest.mark.parametrize("suffix", [".mkv", ".h5"])
def test_tiny_films(tmp_path: Path, suffix: str, size: tuple[int, int]) -> None:
    """Fewer pixels than slices in an FFV1 picture, as after a crop."""
    levels = made_recordings.noise(3, *size, 8)
    assert holds(write_levels(tmp_path / f"a{suffix}", levels), levels)
