"""TIFF stacks, as cameras' programs write them and compressed ones."""

import os
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from made_recordings import Levels, noise, write_imagej, write_tiff

from heliograph.base.errors import MediaError
from heliograph.base.frames import Frame
from heliograph.media import open_film, pictures, tiff
from heliograph.media.tiff_pages import opened_stack


def refused(path: Path) -> tuple[list[Frame], str]:
    """Frames before the error, and the error."""
    got: list[Frame] = []
    with pytest.raises(MediaError) as caught, open_film(path, rate_hz=1000) as film:
        got.extend(film)
    assert "\n" not in str(caught.value)
    return got, str(caught.value)


def same(frames: list[Frame], levels: Levels) -> bool:
    return all(np.array_equal(frame.pixels, sent) for frame, sent in zip(frames, levels, strict=True))


def by_opencv(path: Path, levels: Levels, compression: int) -> Path:
    assert cv2.imwritemulti(str(path), list(levels), [cv2.IMWRITE_TIFF_COMPRESSION, compression])
    return path


def test_without_a_rate_one_line_says_so(tmp_path: Path) -> None:
    path = write_tiff(tmp_path / "a.tif", noise(2, 4, 4, 8))
    with pytest.raises(MediaError, match=r"a\.tif has no clock: .* by --fps \(rate_hz; on page Watch Frames/s\)"):
        open_film(path)


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("big", [False, True])
def test_pages_as_they_lie(tmp_path: Path, bits: int, order: str, big: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pictures, "decode", None)  # OpenCV is not asked
    levels = noise(5, 6, 10, bits)
    with open_film(write_tiff(tmp_path / "a.bin", levels, order, big), rate_hz=500) as film:
        got = list(film)
        assert (film.width, film.height, film.bits, film.rate_hz, film.frame_count) == (10, 6, bits, 500, 5)
    assert same(got, levels)
    assert [frame.time_s for frame in got] == [0, 0.002, 0.004, 0.006, 0.008]


@pytest.mark.parametrize("compression", [1, 5, 8])
@pytest.mark.parametrize("bits", [8, 16])
def test_opencv_s_own_stacks_plain_and_compressed(tmp_path: Path, compression: int, bits: int) -> None:
    levels = noise(7, 20, 30, bits)
    with open_film(by_opencv(tmp_path / "a.tif", levels, compression), rate_hz=500) as film:
        assert same(list(film), levels)
        assert same(list(film), levels)
        assert film.frame_count == 7


def test_a_stack_too_long_for_memory_is_read_page_by_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tiff, "_MOST_DECODED", 100)
    levels = noise(4, 20, 30, 16)
    with open_film(by_opencv(tmp_path / "a.tif", levels, 5), rate_hz=500) as film:
        assert same(list(film), levels)


def test_our_own_writer_is_right(tmp_path: Path) -> None:
    """What the tests write is a TIFF to OpenCV, too."""
    levels = noise(3, 6, 10, 16)
    for order, big in (("<", False), (">", False), ("<", True)):
        _, pages = cv2.imreadmulti(str(write_tiff(tmp_path / "a.tif", levels, order, big)), flags=cv2.IMREAD_UNCHANGED)
        if not pages:
            pytest.skip("this OpenCV reads no TIFF of that kind")
        assert np.array_equal(pages, levels)


def test_colours(tmp_path: Path) -> None:
    colours = noise(2, 6, 30, 8).reshape(2, 6, 10, 3)
    by_opencv(tmp_path / "a.tif", colours, 1)
    with open_film(tmp_path / "a.tif", rate_hz=10, channel="green") as film:
        assert same(list(film), colours[..., 1])


def test_a_page_costs_the_same_wherever_it_stands(tmp_path: Path) -> None:
    """A stack of compressed pages is not walked through anew for each of them."""
    path = by_opencv(tmp_path / "a.tif", noise(300, 8, 8, 8), 5)
    with open_film(path, rate_hz=10) as film:
        assert len(list(film)) == 300
        assert film.read_s < 2


@pytest.mark.parametrize("compression", [1, 5])
def test_a_cut_stack_gives_its_whole_frames_first(tmp_path: Path, compression: int) -> None:
    levels = noise(9, 20, 30, 8)
    path = by_opencv(tmp_path / "a.tif", levels, compression)
    os.truncate(path, path.stat().st_size * 2 // 3)
    got, says = refused(path)
    assert 2 <= len(got) < 9
    assert same(got, levels[: len(got)])
    assert f"after {len(got)} whole frames: copy it again" in says


def test_a_damaged_page(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    levels = noise(5, 20, 30, 8)
    path = by_opencv(tmp_path / "a.tif", levels, 5)
    data = bytearray(path.read_bytes())
    with opened_stack(path) as stack:
        places = [page.place for page in stack.pages()]
    data[places[2] : places[2] + 300] = b"\xff" * 300
    path.write_bytes(data)
    got, says = refused(path)
    assert same(got, levels[:2])
    assert "is damaged after 2 whole frames" in says
    assert capfd.readouterr().err == ""


def test_pages_that_go_round_in_a_circle(tmp_path: Path) -> None:
    path = write_tiff(tmp_path / "a.tif", noise(3, 4, 4, 8))
    with opened_stack(path) as stack:
        first, *_, last = (page.place for page in stack.pages())
    data = bytearray(path.read_bytes())
    struct.pack_into("<I", data, last + 2 + 9 * 12, first)
    path.write_bytes(data)
    got, says = refused(path)
    assert len(got) == 3
    assert "is damaged after 3 whole frames" in says


def test_imagej_s_long_stacks(tmp_path: Path) -> None:
    levels = noise(4, 6, 10, 16)
    path = write_imagej(tmp_path / "a.tif", levels, b"ImageJ=1.54f\nimages=4\nslices=4\n")
    with open_film(path, rate_hz=10) as film:
        assert film.frame_count == 4
        assert same(list(film), levels)
    os.truncate(path, path.stat().st_size - 1)
    got, says = refused(path)
    assert same(got, levels[:3])
    assert "ends in the middle, after 3 whole frames" in says
    with open_film(write_imagej(path, levels, b"somebody else's\nimages=4\n"), rate_hz=10) as film:
        assert film.frame_count == 1


@pytest.mark.parametrize(("width", "says"), [(0, "frames of 0x4 pixels"), (1 << 30, "frames of 1073741824x4 pixels")])
def test_sizes_that_no_camera_has(tmp_path: Path, width: int, says: str) -> None:
    path = write_tiff(tmp_path / "a.tif", noise(1, 4, 4, 8))
    data = bytearray(path.read_bytes())
    struct.pack_into("<I", data, 8 + 2 + 8, width)
    path.write_bytes(data)
    assert says in refused(path)[1]


@pytest.mark.parametrize(
    "data", [b"II", b"II*\0", b"II*\0\0\0\0\0", b"II*\0\xff\xff\xff\xff", b"Dear film, hello there"]
)
def test_files_that_are_no_stack(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "a.tif").write_bytes(data)
    assert "a.tif" in refused(tmp_path / "a.tif")[1]


def test_a_page_of_another_size(tmp_path: Path) -> None:
    pages = [noise(1, 20, 30, 8)[0], noise(1, 10, 30, 8)[0]]
    assert cv2.imwritemulti(str(tmp_path / "a.tif"), pages)
    got, says = refused(tmp_path / "a.tif")
    assert len(got) == 1
    assert "has a page of 30x10 pixels of 8 bits after 1 of 30x20 of 8" in says


@pytest.mark.slow
def test_bytes_changed_by_chance_give_frames_or_one_clear_line(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    rng, path = np.random.default_rng(2), tmp_path / "b.tif"
    plain = write_tiff(tmp_path / "a.tif", noise(3, 6, 10, 16)).read_bytes()
    for whole in (plain, by_opencv(tmp_path / "a.tif", noise(3, 6, 10, 16), 5).read_bytes()):
        for _ in range(300):
            data = bytearray(whole)
            for place in rng.integers(0, len(data), 3):
                data[place] = rng.integers(256)
            path.write_bytes(data)
            try:
                with open_film(path, rate_hz=10) as film:
                    list(film)
            except MediaError as error:
                assert "\n" not in str(error)  # noqa: PT017 - mostly there is one
    if hasattr(cv2.utils, "logging"):  # older OpenCV writes of what it cannot read whatever its level of logging
        assert capfd.readouterr().err == ""


@pytest.mark.parametrize("bits", [8, 16])
def test_white_at_level_0(tmp_path: Path, bits: int) -> None:
    levels = noise(1, 6, 10, bits)
    data = write_tiff(tmp_path / "a.tif", levels).read_bytes()
    (tmp_path / "a.tif").write_bytes(
        data.replace(struct.pack("<HHII", 262, 3, 1, 1), struct.pack("<HHII", 262, 3, 1, 0))
    )
    with open_film(tmp_path / "a.tif", rate_hz=10) as film:
        assert np.array_equal(next(iter(film)).pixels, ~levels[0])
