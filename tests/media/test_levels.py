"""Levels are linear light: palettes are applied, and no level exceeds the stated bit depth."""

from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import tifffile
from film_checks import read, refused, same
from made_recordings import write_cine, write_mraw
from made_videos import write_avi
from numpy.typing import NDArray

from heliograph.media import open_film

RAMP = np.repeat(np.arange(256, dtype=np.uint8)[:, None], 3, axis=1)
NUMBERS = np.random.default_rng(1).integers(0, 256, (4, 24, 50), dtype=np.uint8)


@pytest.mark.parametrize(("palette", "levels", "upwards"), [
    (None, NUMBERS, False), (np.zeros((256, 3), np.uint8), NUMBERS, False), (RAMP, NUMBERS, True),
    (RAMP[::-1], 255 - NUMBERS, False), (RAMP // 2, NUMBERS // 2, False),
    (RAMP * np.array([1, 0, 0], np.uint8), np.rint(0.114 * NUMBERS), True),
    (RAMP * np.array([0, 1, 0], np.uint8), np.rint(0.587 * NUMBERS), False),
], ids=["missing", "black", "gray", "inverted", "half", "blue", "green"])  # fmt: skip
def test_a_palette_gives_the_gray_levels(
    tmp_path: Path, palette: NDArray[np.uint8] | None, levels: NDArray[Any], upwards: bool
) -> None:
    with open_film(write_avi(tmp_path / "a.avi", NUMBERS, palette, upwards=upwards)) as film:
        assert (film.bits, film.rate_hz) == (8, 1000)
        assert np.array_equal([frame.pixels for frame in film], levels)


@pytest.mark.parametrize(("fourcc", "channel"), [
    (bytes(4), "red"), (bytes(4), "green"), (bytes(4), "blue"), (b"Y800", "luma"), (b"GREY", "luma"), (b"Y8  ", "luma"),
])  # fmt: skip
def test_gray_levels_without_a_palette_are_read_as_stored(tmp_path: Path, fourcc: bytes, channel: str) -> None:
    assert same(read(write_avi(tmp_path / "a.avi", NUMBERS, fourcc=fourcc), channel=channel), NUMBERS)


def test_an_unknown_form_of_pixels_is_an_error(tmp_path: Path) -> None:
    path = write_avi(tmp_path / "a.avi", NUMBERS.astype(np.uint16), fourcc=b"Y16 ")
    assert "coded in a way that this FFmpeg cannot read" in refused(path)[1]


def bright_hdf5(path: Path, levels: NDArray[np.uint16]) -> Path:
    with h5py.File(path, "w") as file:
        file["frames"], file["times_s"], file.attrs["bits"] = levels, np.arange(len(levels)) / 1000, 12
    return path


def bright_y4m(path: Path, levels: NDArray[np.uint16]) -> Path:
    body = b"".join(b"FRAME\n" + pixels.tobytes() for pixels in levels)
    path.write_bytes(b"YUV4MPEG2 W%d H%d F1000:1 Ip A1:1 Cmono12\n" % levels.shape[:0:-1] + body)
    return path


def bright_pictures(path: Path, levels: NDArray[np.uint16]) -> Path:
    path.mkdir()
    for number, picture in enumerate(levels):
        head = b"P5\n# of a camera\n%d %d\n4095\n" % picture.shape[::-1]
        (path / f"{number}.pgm").write_bytes(head + picture.astype(">u2").tobytes())
    return path


def bright_tiff(path: Path, levels: NDArray[np.uint16]) -> Path:
    tifffile.imwrite(path, levels, ome=True, metadata={"axes": "TYX", "SignificantBits": 12})
    return path


@pytest.mark.parametrize(("make", "name"), [
    (bright_hdf5, "a.h5"), (bright_y4m, "a.y4m"), (bright_pictures, "shots"),
    (bright_tiff, "a.tif"), (lambda path, levels: write_cine(path, list(levels), 16, 12), "a.cine"),
    (lambda path, levels: write_mraw(path, levels, 16, 12), "a.mraw"),
])  # fmt: skip
def test_a_level_above_the_stated_bits_is_an_error(tmp_path: Path, make: Any, name: str) -> None:
    levels = np.full((4, 8, 16), 4095, np.uint16)
    levels[2, 3, 5] = 4096
    frames, says = refused(make(tmp_path / name, levels), rate_hz=1000)
    assert "gray level of 4096 after 2 whole frames, and its header says 12 bits" in says
    assert [frame.bits for frame in frames] == [12, 12]
