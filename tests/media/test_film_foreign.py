"""Films from other sources: real recordings, limited range, RGB and packed formats."""

from fractions import Fraction
from itertools import islice
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest
from made_videos import write_video
from numpy.typing import NDArray

from heliograph.base.errors import MediaError
from heliograph.media import open_film, planes


@pytest.mark.real_data
@pytest.mark.parametrize(("name", "size", "rate", "count"), [
    ("day-motorway", (960, 540), 25.0, 221), ("day-shade", (1280, 720), 25.0, 100),
    ("night-road", (1920, 1080), 29.98, 157),
])  # fmt: skip
@pytest.mark.slow
def test_dashcam_footage(data: Path, name: str, size: tuple[int, int], rate: float, count: int) -> None:
    with open_film(data / "driving" / f"{name}.mp4") as film:
        assert (film.width, film.height, film.bits, film.frame_count) == (*size, 8, count)
        assert film.rate_hz == pytest.approx(rate, abs=0.01)
        indices, times = zip(*((frame.index, frame.time_s) for frame in islice(film, 5)), strict=True)
    assert list(indices) == [0, 1, 2, 3, 4]
    assert np.allclose(np.diff(times), 1 / rate, atol=2e-4)


@pytest.mark.real_data
def test_luma_is_plane_0_and_expands_on_request(data: Path) -> None:
    path = data / "driving" / "day-motorway.mp4"
    with av.open(str(path)) as container:
        luma = next(container.decode(video=0)).to_ndarray()[:540, :960]  # yuv420p: luma rows come first
    with open_film(path) as plain, open_film(path, expand_range=True) as expanded:
        levels, stretched = next(iter(plain)).pixels, next(iter(expanded)).pixels
    assert np.array_equal(levels, luma)
    assert np.array_equal(stretched, np.clip(np.rint((luma - 16.0) * 255 / 219), 0, 255))


def bytes_of(plane: Any) -> NDArray[np.uint8]:
    return np.frombuffer(plane, np.uint8)


def ramp(pixel_format: str, color_range: int) -> av.VideoFrame:
    picture = av.VideoFrame(64, 16, pixel_format)
    for plane in picture.planes:
        bytes_of(plane)[:] = 128
    picture.color_range = color_range
    return picture


@pytest.mark.parametrize("pixel_format", ["yuv420p", "yuv444p", "nv12", "gray", "yuyv422", "yuvj420p", "y210le"])
@pytest.mark.parametrize("color_range", [planes.LIMITED, planes.FULL])
def test_levels_are_read_as_stored(pixel_format: str, color_range: int) -> None:
    picture, deep = ramp(pixel_format, color_range), pixel_format == "y210le"
    step = 2 if pixel_format in ("yuyv422", "y210le") else 1
    words = bytes_of(picture.planes[0]).view(np.uint16 if deep else np.uint8).reshape(16, -1)
    levels = np.arange(0, 1024, 16) if deep else np.arange(0, 256, 4)
    words[:, : 64 * step : step] = levels << 6 if deep else levels  # ten bits at the upper end of a word
    pixels, bits = planes.to_gray(picture, expand_range=False)
    assert bits == (10 if deep else 8)
    assert np.array_equal(pixels, np.tile(levels, (16, 1)))


@pytest.mark.parametrize("color_range", [0, planes.LIMITED, planes.FULL])
def test_range_of_black_and_white(color_range: int) -> None:
    picture = ramp("yuv420p", color_range)
    bytes_of(picture.planes[0])[:3] = 16, 235, 255
    pixels, _ = planes.to_gray(picture, expand_range=True)
    assert pixels[0, :3].tolist() == ([16, 235, 255] if color_range == planes.FULL else [0, 255, 255])


def test_ten_bits_expand() -> None:
    picture = ramp("yuv420p10le", planes.LIMITED)
    bytes_of(picture.planes[0]).view(np.uint16)[:] = 940
    pixels, bits = planes.to_gray(picture, expand_range=True)
    assert (bits, pixels.dtype.name, int(pixels.min())) == (10, "uint16", 1023)


@pytest.mark.parametrize("pixel_format", ["rgb24", "bgr0", "gbrp"])
def test_rgb_becomes_gray_without_a_shift(pixel_format: str) -> None:
    gray = np.tile(np.arange(0, 256, 4, dtype=np.uint8), (16, 1))
    picture = av.VideoFrame.from_ndarray(np.dstack([gray] * 3), "rgb24").reformat(format=pixel_format)
    pixels, _ = planes.to_gray(picture, expand_range=True)
    assert np.abs(pixels.astype(int) - gray).max() <= 1


def test_a_film_without_our_record(tmp_path: Path) -> None:
    rate = Fraction(30000, 1001)
    with open_film(write_video(tmp_path / "a.mov", range(7), 1 / rate, "mpeg4", rate)) as film:
        assert [film.rate_hz, film.frame_count] == pytest.approx([30000 / 1001, 7])
        assert [f.index for f in film] == list(range(7))
        assert "major_brand" in film.metadata


def test_raw_pictures_without_a_rate_need_one(tmp_path: Path) -> None:
    path = write_video(tmp_path / "a.mjpeg", range(7), codec="mjpeg", kind="mjpeg")
    with pytest.raises(MediaError, match="has no clock: say how many frames a second the camera took, by --fps"):
        open_film(path)
    with open_film(path, rate_hz=500) as film:
        assert [frame.time_s for frame in film] == pytest.approx(np.arange(7) / 500)
