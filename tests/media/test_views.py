"""Crop, rotation, orientation and colour of a film, and all colours at once."""

from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest
from film_checks import ends, form, holds, read, refused, write_levels
from made_recordings import Y4M_FORMS, noise, write_y4m

import heliograph
from heliograph.base.errors import MediaError
from heliograph.media import open_film, planes


def film(path: Path, bits: int = 8) -> Path:
    return write_levels(path, noise(3, 6, 10, bits), 100, bits, metadata={"a": "b"})


@pytest.mark.parametrize(("crop", "rotate", "kind"), [
    ((2, 1, 5, 4), 0, "a.h5"), (None, 90, "a.mkv"), ((2, 1, 5, 4), 90, "a.h5"), ((0, 0, 10, 6), 180, "a.mkv"),
    ((2, 1, 5, 4), 270, "a.mkv"), ((9, 5, 1, 1), 270, "a.h5"),
])  # fmt: skip
def test_crop_then_turn(tmp_path: Path, crop: Any, rotate: int, kind: str) -> None:
    (x, y, width, height), path = crop or (0, 0, 10, 6), film(tmp_path / kind, 12)
    # clockwise: by 90 degrees the upper left moves to the upper right
    turned = [np.rot90(sent[y : y + height, x : x + width], -rotate // 90) for sent in noise(3, 6, 10, 12)]
    options = {"crop": crop, "rotate": rotate, "rate_hz": 200}
    assert form(path, **options) == (*turned[0].shape[::-1], 12, 200, 3)
    assert holds(path, turned, [0.0, 0.005, 0.01], range(3), **options)
    with open_film(path, **options) as seen:
        assert (seen.metadata["a"], {frame.bits for frame in seen}) == ("b", {12})


@pytest.mark.parametrize(("options", "says"), [
    ({"crop": (0, 0, 11, 6)}, "the crop 0,0,11,6 reaches beyond the frames of"),
    ({"crop": (5, 3, 5, 4)}, "which have 10x6 pixels"),
    *[({"crop": crop}, "a crop is x, y, width and height in whole pixels")
      for crop in ((0, 0, 0, 6), (-1, 0, 5, 5), (0, 0, 5), (0, 0, 5, 2.5), "abcd")],
    ({"rotate": 45}, "turned by 0, 90, 180 or 270 degrees clockwise, not by 45"),
    ({"binning": 0}, "squares of 1 to 16 pixels a side are averaged, not of 0: give 2 for a Bayer mosaic"),
    ({"binning": 2.0}, "squares of 1 to 16 pixels a side are averaged"),
    ({"binning": 7}, "is seen in 10x6 pixels, less than a square of 7: average fewer"),
    ({"channel": "alpha"}, "there is no channel 'alpha': choose one of luma, red, green, blue"),
])  # fmt: skip
def test_wrong_views_are_named(tmp_path: Path, options: dict[str, Any], says: str) -> None:
    assert says in refused(film(tmp_path / "a.h5"), **options)[1]


def test_a_view_is_closed_with_its_film_and_gives_the_frames_before_damage(tmp_path: Path) -> None:
    path, levels = tmp_path / "a.npy", noise(3, 6, 10, 8)
    np.save(path, levels)
    path.write_bytes(path.read_bytes()[:-1])
    assert ends(path, [levels[0].T[:, ::-1], levels[1].T[:, ::-1]], "after 2 whole frames", rate_hz=10, rotate=90)
    with open_film(path, rate_hz=10, rotate=90) as seen:
        pass
    with pytest.raises(MediaError, match="is closed"):
        iter(seen)


def coded(path: Path, pixel_format: str, *, degrees: int = 0, codec: str = "ffv1", **options: Any) -> Path:
    """Write a video with two pictures, a colour per quadrant, and orientation metadata."""
    rgb = np.zeros((16, 32, 3), np.uint8)
    rgb[:8, :16], rgb[:8, 16:], rgb[8:, :16], rgb[8:, 16:] = (255, 0, 0), (0, 255, 0), (0, 0, 255), (90, 90, 90)
    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream(codec, rate=Fraction(50))
        stream.width, stream.height, stream.pix_fmt = 32, 16, pixel_format
        if degrees:
            if not hasattr(stream, "set_display_rotation"):
                pytest.skip("this PyAV writes no display matrix")
            stream.set_display_rotation(degrees, **options)
        for number in range(2):
            picture = av.VideoFrame.from_ndarray(rgb, "rgb24").reformat(format=pixel_format)
            picture.pts = number
            container.mux(stream.encode(picture))
        container.mux(stream.encode())
    return path


def quarters(pixels: Any) -> list[list[int]]:
    """Return the level at the centre of each quadrant, upper quadrants first."""
    rows, columns = pixels.shape
    return [[int(pixels[y, x]) for x in (columns // 4, 3 * columns // 4)] for y in (rows // 4, 3 * rows // 4)]


@pytest.mark.parametrize(("turn", "expected"), [
    ({}, [[255, 0], [0, 90]]), ({"degrees": 90}, [[0, 90], [255, 0]]), ({"degrees": 180}, [[90, 0], [0, 255]]),
    ({"degrees": 270}, [[0, 255], [90, 0]]), ({"degrees": 360, "hflip": True}, [[0, 255], [90, 0]]),
    ({"degrees": 360, "vflip": True}, [[0, 90], [255, 0]]),
])  # fmt: skip
def test_turned_and_mirrored_videos_are_upright(tmp_path: Path, turn: dict[str, Any], expected: Any) -> None:
    """PyAV angles are anticlockwise."""
    with open_film(coded(tmp_path / "a.mkv", "bgr0", **turn), channel="red") as seen:
        assert (seen.width, seen.height) == ((16, 32) if turn.get("degrees") in (90, 270) else (32, 16))
        for frame in seen:
            assert (frame.pixels.shape, quarters(frame.pixels)) == ((seen.height, seen.width), expected)


CHANNELS = {
    "red": [[255, 0], [0, 90]], "green": [[0, 255], [0, 90]], "blue": [[0, 0], [255, 90]],
    "luma": [[76, 150], [29, 90]],  # Rec. 601: 0.299, 0.587 and 0.114 of 255
}  # fmt: skip
"""Levels of the quadrants of `coded`."""


@pytest.mark.parametrize(("pixel_format", "codec", "tolerance"), [
    ("bgr0", "ffv1", 1), ("bgra", "ffv1", 1), ("yuv444p", "ffv1", 2), ("yuv420p", "mpeg4", 8),
])  # fmt: skip
def test_a_channel_of_colours(tmp_path: Path, pixel_format: str, codec: str, tolerance: int) -> None:
    path = coded(tmp_path / "a.mkv", pixel_format, codec=codec)
    for channel, expected in CHANNELS.items():
        got = quarters(read(path, channel=channel, expand_range=True)[0].pixels)
        assert np.abs(np.subtract(got, expected)).max() <= tolerance


def test_colours_by_the_matrix_that_the_file_states() -> None:
    """Green has 0.7152 of white's luma in Rec. 709, and 0.587 in Rec. 601."""
    if int(av.__version__.split(".")[0]) < 17:
        pytest.skip("this PyAV does not take colours by the matrix that is stated")
    green = np.zeros((16, 32, 3), np.uint8)
    green[..., 1] = 255
    picture = av.VideoFrame.from_ndarray(green, "rgb24").reformat(format="yuv444p", dst_colorspace="ITU709")
    picture.colorspace = av.video.reformatter.Colorspace.ITU709
    assert int(planes.to_gray(picture, True)[0][0, 0]) == pytest.approx(0.7152 * 255, abs=2)
    levels = [int(planes.to_gray(picture, True, channel)[0][0, 0]) for channel in ("red", "green", "blue")]
    assert levels == pytest.approx([0, 255, 0], abs=2)


@pytest.mark.parametrize("pixel_format", ["gray", "gray10le", "ya8"])
def test_gray_pictures_are_the_same_in_all_channels(pixel_format: str) -> None:
    picture = av.VideoFrame.from_ndarray(noise(1, 16, 32, 8)[0], "gray").reformat(format=pixel_format)
    luma, bits = planes.to_gray(picture, False)
    for channel in ("red", "green", "blue"):
        pixels, same_bits = planes.to_gray(picture, False, channel)
        assert (pixels.tolist(), same_bits) == (luma.tolist(), bits)


def test_red_of_ten_bits() -> None:
    rgb = np.full((16, 32, 3), (200, 0, 0), np.uint8)
    picture = av.VideoFrame.from_ndarray(rgb, "rgb24").reformat(format="gbrp10le")
    pixels, bits = planes.to_gray(picture, False, "red")
    assert (bits, pixels.dtype.name) == (10, "uint16")
    assert abs(int(pixels[0, 0]) - 200 * 1023 / 255) <= 3


@pytest.mark.parametrize("kind", Y4M_FORMS)
def test_y4m_is_read_and_a_cut_is_found(tmp_path: Path, kind: str) -> None:
    path = write_y4m(tmp_path / "a.y4m", kind)
    assert [(frame.time_s, int(frame.pixels[0, 0]) & 255) for frame in read(path)] == [(k / 1000, k) for k in range(5)]
    width, height, _, rate_hz, _ = form(path)
    assert (width, height, rate_hz) == (10, 6, 1000)
    data, whole = path.read_bytes(), [frame.pixels for frame in read(path)]
    for lost in (1, 30):
        path.write_bytes(data[:-lost])
        assert ends(path, whole[:4], "ends in the middle, after 4 whole frames")


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("side", [2, 3])
def test_squares_become_their_mean(tmp_path: Path, bits: int, side: int) -> None:
    """Binning follows the crop and precedes the rotation."""
    rows, columns = 5 // side, 9 // side
    part = noise(3, 6, 10, bits)[:, : rows * side, 1 : 1 + columns * side]
    means = np.floor(part.reshape(3, rows, side, columns, side).mean((2, 4)) + 0.5)
    path, options = film(tmp_path / "a.h5", bits), {"crop": (1, 0, 9, 5), "binning": side, "rotate": 90}
    assert form(path, **options)[:3] == (rows, columns, bits)
    assert holds(path, means[:, ::-1].swapaxes(1, 2), **options)
    assert {frame.pixels.dtype for frame in read(path, **options)} == {part.dtype}


def test_full_scale_stays_full_scale_in_squares(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.full((2, 32, 32), 65535, np.uint16))
    with open_film(tmp_path / "a.npy", rate_hz=10, binning=16) as seen:
        assert np.unique(next(iter(seen)).pixels).tolist() == [65535]


COLOURS = np.random.default_rng(0).integers(0, 256, (3, 6, 8, 3), dtype=np.uint8)
"""Three RGB frames, (rows, columns, 3)."""


def test_pictures_are_read_in_their_colours(tmp_path: Path) -> None:
    for number, colours in enumerate(COLOURS):
        cv2.imwrite(str(tmp_path / f"img{number}.png"), colours[..., ::-1])
    with heliograph.open_colours(tmp_path, rate_hz=50) as film:
        assert (film.width, film.height, film.bits, film.rate_hz, film.frame_count) == (8, 6, 8, 50, 3)
        np.testing.assert_array_equal(list(film), COLOURS)
        np.testing.assert_array_equal(next(iter(film)), COLOURS[0])
    with pytest.raises(heliograph.MediaError, match="closed"):
        list(film)
    with heliograph.open_colours(tmp_path, rate_hz=50, crop=(2, 1, 4, 3), rotate=90) as film:
        np.testing.assert_array_equal(next(iter(film)), np.rot90(COLOURS[0, 1:4, 2:6], -1))


def test_a_gray_film_has_three_equal_colours_and_a_channel_is_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "gray.npy", COLOURS[..., 0].astype(np.uint16))
    with heliograph.open_colours(tmp_path / "gray.npy", rate_hz=50) as film:
        np.testing.assert_array_equal(list(film), COLOURS[..., :1].repeat(3, axis=3))
    with pytest.raises(heliograph.MediaError, match="has all channels: leave channel out"):
        heliograph.open_colours(tmp_path, channel="red")
    with pytest.raises(heliograph.MediaError, match="there is no file"):
        heliograph.open_colours(tmp_path / "none.mkv")
