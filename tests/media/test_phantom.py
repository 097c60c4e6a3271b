"""Phantom .cine recordings."""

import struct
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from film_checks import ends, form, holds, read, refused, same
from made_recordings import Levels, noise, write_cine

from heliograph.media.phantom import linear

WORDS = [(8, 8), (16, 12), (16, 16), (12, 12)]
"""Bits per pixel in the file, and used bits."""


def by_ffmpeg(path: Path) -> Levels:
    if int(av.__version__.split(".")[0]) < 18:
        pytest.skip("this FFmpeg decodes the first line alone of frames that small")
    with av.open(str(path)) as container:
        return np.stack([picture.to_ndarray() for picture in container.decode(video=0)])


@pytest.mark.parametrize(("word", "depth"), WORDS)
@pytest.mark.parametrize("upwards", [True, False])
def test_levels_rate_and_stamps(tmp_path: Path, word: int, depth: int, upwards: bool) -> None:
    levels, times = noise(4, 6, 8, depth), [0.25, 0.252, 0.26, 0.262]
    path = write_cine(tmp_path / "a.cine", list(levels), word, depth, times, rate=500, upwards=upwards)
    assert form(path) == (8, 6, depth, 500.0, 4)
    assert holds(path, levels, [0, 0.002, 0.01, 0.012], [0, 1, 5, 6])


@pytest.mark.parametrize(("word", "depth"), [(8, 8), (16, 16), (24, 8), (48, 16)])
def test_ffmpeg_reads_the_same_pixels_of_a_made_recording(tmp_path: Path, word: int, depth: int) -> None:
    frames = noise(3, 6, 8 * (3 if word in (24, 48) else 1), depth)
    colours = frames.reshape(3, 6, 8, -1) if word in (24, 48) else frames
    path = write_cine(tmp_path / "a.cine", list(colours), word, depth)
    theirs = by_ffmpeg(path)
    for channel, place in {"red": 2, "green": 1, "blue": 0}.items():
        assert same(read(path, channel=channel), colours[..., place] if word in (24, 48) else colours)
    # reference data are bgr24 and bgr48
    assert np.array_equal(theirs.reshape(colours.shape), colours)


def test_codes_of_ten_bits_are_on_a_curve() -> None:
    codes = np.array([64, 512, 1008, 1014, 1015, 1023], np.uint16)
    assert linear(codes).tolist()[0] == 64
    # levels from the vendor's table
    assert np.abs(linear(codes).astype(int) - [64, 998, 4014, 4064, 4095, 4095]).max() <= 3
    assert (np.diff(linear(np.arange(1024, dtype=np.uint16)).astype(int)) >= 0).all()


@pytest.mark.parametrize(("times", "expected"), [
    *[([0.25, 0.252, wrong, 0.26], [0, 0.002, 0.004, 0.01]) for wrong in (-5.0, 0.25, 4e6)],
    (None, [0, 0.002, 0.004, 0.006]),
])  # fmt: skip
def test_the_rate_replaces_missing_and_impossible_stamps(tmp_path: Path, times: Any, expected: list[float]) -> None:
    levels = noise(4, 4, 4, 8)
    assert holds(write_cine(tmp_path / "a.cine", list(levels), 8, 8, times, rate=500), levels, expected)


@pytest.mark.real_data
def test_a_recording_of_a_real_camera(data: Path) -> None:
    """Ten-bit packed levels equal FFmpeg's, which expands to 16 bits by repetition, without a tone curve."""
    path = data / "phantom" / "data_small_cine.cine"
    assert form(path) == (256, 32, 12, 100.0, 235)
    assert holds(path, [linear(picture >> 6) for picture in by_ffmpeg(path)], indices=range(235))
    # the camera clock has 1 us steps
    assert np.allclose([frame.time_s for frame in read(path)], np.arange(235) / 100, atol=2e-6)


@pytest.mark.parametrize("stamped", [True, False])
def test_truncated_file_gives_its_complete_frames(tmp_path: Path, stamped: bool) -> None:
    levels = noise(5, 6, 8, 12)
    path = write_cine(tmp_path / "a.cine", list(levels), 16, 12, [0, 1, 2, 3, 4] if stamped else None)
    whole = path.read_bytes()
    for lost, left in ((1, 4), (96 + 11, 4), (96 + 13, 3), (3 * 108 + 5, 1)):
        path.write_bytes(whole[:-lost])
        assert ends(path, levels[:left], f"a.cine ends in the middle, after {left} whole frames")
    for size in (3, 20, 44, 83, 200, 900, 6083):
        path.write_bytes(whole[:size])
        assert ends(path, [], "ends in the middle of its headers")


@pytest.mark.parametrize(("place", "form", "value", "says"), [
    (0, "<2s", b"XX", "is no Phantom recording"), (4, "<H", 1, "is compressed"), (20, "<I", 0, "holds no frames"),
    (20, "<I", 1 << 31, "claims 2147483648 frames"), (48, "<i", 0, "frames of 0x6 pixels"),
    (48, "<i", -8, "frames of -8x6 pixels"), (52, "<i", 1 << 30, "frames of 8x1073741824 pixels"),
    (58, "<H", 14, "pixels of 14 bits"), (60, "<I", 512, "is compressed"),
    (28, "<I", 90, "has no camera settings where its header points"), (84 + 768, "<I", 0, "--fps"),
    (32, "<I", 0xFFFFFFF0, "ends in the middle, after 0 whole frames"),
])  # fmt: skip
def test_wrong_headers_are_named(tmp_path: Path, place: int, form: str, value: object, says: str) -> None:
    path = write_cine(tmp_path / "a.cine", list(noise(5, 6, 8, 8)), 8, 8)
    data = bytearray(path.read_bytes())
    struct.pack_into(form, data, place, value)
    path.write_bytes(data)
    assert says in refused(path)[1]
