"""Picture films: folders and patterns of PNG, TIFF and JPEG files, and .npy arrays."""

import os
import struct
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from film_checks import ends, form, holds, read, refused
from made_recordings import Levels, noise, write_pictures, write_tiff
from PIL import Image

from heliograph.media import open_film

RATE = {"rate_hz": 1000}


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("suffix", [".png", ".tif", ".TIFF"])
def test_a_folder_and_a_pattern(tmp_path: Path, bits: int, suffix: str) -> None:
    levels = noise(12, 6, 10, bits)
    write_pictures(tmp_path / "a", levels, f"img%d{suffix}", first=95)  # img100 comes after img99
    (tmp_path / "a" / "notes.txt").write_text("of the day")
    (tmp_path / "a" / ".hidden.png").write_text("of the system")
    for path in (tmp_path / "a", tmp_path / "a" / f"img%d{suffix}"):
        assert form(path, rate_hz=500) == (10, 6, bits, 500, 12)
        assert holds(path, levels, np.arange(12) / 500, rate_hz=500)


def test_a_number_that_a_pattern_lacks_is_a_lost_frame(tmp_path: Path) -> None:
    folder, levels = tmp_path / "a", noise(5, 6, 10, 8)
    write_pictures(folder, levels, "img%04d.png", first=7)
    (folder / "img0009.png").unlink()
    left = np.delete(levels, 2, axis=0)
    assert holds(folder / "img%04d.png", left, [0, 0.001, 0.003, 0.004], [0, 1, 3, 4], **RATE)
    assert holds(folder, left, indices=range(4), **RATE)


@pytest.mark.parametrize("bits", [8, 16])
def test_colours(tmp_path: Path, bits: int) -> None:
    colours = noise(2, 6, 30, bits).reshape(2, 6, 10, 3)  # OpenCV order: blue, green, red
    folder = write_pictures(tmp_path / "a", colours)
    for place, channel in enumerate(("blue", "green", "red")):
        assert holds(folder, colours[..., place], channel=channel, **RATE)
    assert holds(folder, np.rint(colours @ np.array([0.114, 0.587, 0.299])), **RATE)  # Rec. 601
    levels = np.arange(256, dtype=np.uint8).reshape(1, 16, 16)
    assert holds(write_pictures(tmp_path / "gray", np.stack([levels] * 3, axis=-1)), levels, **RATE)


def test_a_missing_rate_is_named(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", noise(2, 4, 4, 8))
    folder = write_pictures(tmp_path / "a", noise(2, 4, 4, 8))
    write_tiff(tmp_path / "a.tif", noise(2, 4, 4, 8))
    for path in (folder, folder / "img%04d.png", tmp_path / "a.npy", tmp_path / "a.tif"):
        cure = "by --fps (rate_hz; on page Watch Frames/s)"
        assert refused(path)[1] == f"{path} has no clock: say how many frames a second the camera took, {cure}"


def test_other_folders_than_films_are_named(tmp_path: Path) -> None:
    for name in ("empty", "float"):
        (tmp_path / name).mkdir()
    for name in ("%d.png", "%d.jpg"):
        write_pictures(tmp_path / "two", noise(2, 4, 4, 8), name)
    cv2.imwrite(str(tmp_path / "float" / "1.tif"), np.zeros((4, 4), np.float32))
    for path, says in {
        "empty": "is a folder without pictures", "two": "several kinds (.jpg, .png): give some of them as a pattern",
        "two/img%04d.png": "there is no picture", "none/img%04d.png": "cannot read the folder",
        "float": "pixels of float32 in 1 channels: save gray or RGB of 8 or 16 bits",
    }.items():  # fmt: skip
        assert ends(tmp_path / path, [], says, **RATE)


def test_a_damaged_picture_comes_after_those_before(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    levels = noise(5, 20, 30, 8)
    folder = write_pictures(tmp_path / "a", levels)
    third = folder / "img0003.png"
    whole = third.read_bytes()
    flipped = whole[:100] + bytes([whole[100] ^ 8]) + whole[101:]
    for data in (b"", b"Dear film", whole[:100], whole[: len(whole) // 2], flipped):
        third.write_bytes(data)
        assert ends(folder, levels[:2], f"{third} is damaged or no picture, after 2 frames", **RATE)
    assert capfd.readouterr().err == ""


def test_pictures_of_another_form_and_a_pipe_end_the_film(tmp_path: Path) -> None:
    levels = noise(3, 20, 30, 8)
    second = write_pictures(tmp_path / "a", levels) / "img0002.png"
    for other, says in ((noise(1, 10, 30, 8)[0], "30x10 pixels of 8 bits"),
                        (noise(1, 20, 30, 16)[0], "30x20 pixels of 16 bits")):  # fmt: skip
        cv2.imwrite(str(second), other)
        assert ends(tmp_path / "a", levels[:1], says, **RATE)
    second.unlink()
    os.mkfifo(second)
    assert ends(tmp_path / "a", levels[:1], "img0002.png is damaged or no picture, after 1 frames", **RATE)


@pytest.mark.parametrize("dtype", ["u1", "<u2", ">u2"])
def test_an_array(tmp_path: Path, dtype: str) -> None:
    levels, path = noise(4, 6, 10, 8 if dtype == "u1" else 16), tmp_path / "b.film"
    np.save(tmp_path / "a.npy", levels.astype(dtype))
    (tmp_path / "a.npy").rename(path)  # the format is identified by its first bytes
    assert form(path, rate_hz=250) == (10, 6, 8 * levels.itemsize, 250, 4)
    assert holds(path, levels, [0, 0.004, 0.008, 0.012], rate_hz=250)
    assert {frame.pixels.dtype for frame in read(path, **RATE)} == {levels.dtype}


def test_truncated_array_gives_its_complete_frames(tmp_path: Path) -> None:
    levels, path = noise(9, 6, 10, 16), tmp_path / "a.npy"
    np.save(path, levels)
    os.truncate(path, 128 + 4 * 120 + 60)
    assert form(path, **RATE)[-1] == 5  # not 9: a conversion must find room on the disk
    assert ends(path, levels[:4], "ends in the middle, after 4 whole frames", **RATE)


@pytest.mark.parametrize(("array", "says"), [
    (np.zeros((4, 6), np.uint8), "holds an array (4, 6) of uint8: a film is (frames, rows, columns)"),
    (np.zeros((4, 6, 8), np.float64), "of float64: a film is"), (np.zeros((4, 6, 8), np.int16), "of int16"),
    (np.zeros((4, 6, 8, 3), np.uint8), "(4, 6, 8, 3) of uint8"), (np.array([{}]), "holds an array (1,) of object"),
    (np.zeros((4, 0, 8), np.uint8), "frames of 8x0 pixels"), (np.zeros((0, 6, 8), np.uint8), "holds no frames"),
    (np.asfortranarray(np.zeros((4, 6, 8), np.uint8)), "Fortran's order"),
], ids=str)  # fmt: skip
def test_other_arrays_than_films_are_named(tmp_path: Path, array: Any, says: str) -> None:
    np.save(tmp_path / "a.npy", array)
    assert ends(tmp_path / "a.npy", [], says, **RATE)


@pytest.mark.parametrize("data", [b"Dear film", b"\x93NUMPY\x01\x00", b"\x93NUMPY\x09\x00" + bytes(99),
                                  b"\x93NUMPY\x01\x00\x10\x00" + b"(" * 16])  # fmt: skip
def test_other_files_than_arrays_are_refused(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "a.npy").write_bytes(data)
    assert ends(tmp_path / "a.npy", [], "is no array of NumPy, or damaged", **RATE)


def headed(path: Path, header: str) -> Path:
    """Write an .npy file with a given header text and 100 data bytes."""
    text = header.encode() + b"\n"
    path.write_bytes(b"\x93NUMPY\x01\0" + struct.pack("<H", len(text)) + text + bytes(100))
    return path


@pytest.mark.parametrize(("kind", "shape"), [
    ("()", "(2, 3, 4)"), ("('|u1',)", "(2, 3, 4)"), ("(('|u1',), (2,))", "(2, 3, 4)"), ("'>a2'", "(2, 3, 4)"),
    ("'|u1'", "(2, -9, -9)"),
])  # fmt: skip
def test_arrays_of_invalid_types_or_lengths_are_refused(tmp_path: Path, kind: str, shape: str) -> None:
    """NumPy raises an IndexError, or warns."""
    path = headed(tmp_path / "a.npy", f"{{'descr': {kind}, 'fortran_order': False, 'shape': {shape}, }}")
    assert "a.npy" in refused(path, **RATE)[1]


@pytest.mark.parametrize(("shape", "size"), [("(2L, 3L, 4L)", (4, 3)), ("(2, 3, 4)", (4, 3)), ("(2, True, 4)", (4, 1))])
def test_arrays_of_python_2_and_damaged_lengths_are_read(tmp_path: Path, shape: str, size: tuple[int, int]) -> None:
    path = headed(tmp_path / "a.npy", f"{{'descr': '|u1', 'fortran_order': False, 'shape': {shape}, }}")
    with open_film(path, rate_hz=10) as film:
        assert (len(list(film)), (film.width, film.height)) == (2, size)


def test_a_pattern_takes_no_other_names_and_one_name_of_a_number(tmp_path: Path) -> None:
    """Two names would give two frames with the same number and time."""
    levels = noise(3, 6, 10, 8)
    folder = write_pictures(tmp_path / "a", levels, "img%d.png")
    write_pictures(folder, levels[::-1], "img%02d.png")
    for other in ("img005.png", "img05.jpg", "ximg05.png", "img05.png.bak"):
        (folder / other).write_bytes((folder / "img1.png").read_bytes())
    for pattern, sent in (("img%d.png", levels), ("img%02d.png", levels[::-1])):
        assert holds(folder / pattern, sent, indices=range(3), **RATE)


def test_a_stack_among_pictures_is_refused(tmp_path: Path) -> None:
    write_tiff(tmp_path / "1.tif", noise(3, 6, 10, 8))
    for path in (tmp_path, tmp_path / "%d.tif"):
        assert ends(path, [], "1.tif has several pages, not one picture: give the file's name", **RATE)


@pytest.mark.parametrize("suffix", [".jpg", ".tif", ".png"])
def test_a_picture_of_too_many_pixels_is_refused(tmp_path: Path, suffix: str) -> None:
    path = write_pictures(tmp_path / "a", noise(1, 16, 24, 8), f"%d{suffix}") / f"1{suffix}"
    data = path.read_bytes()
    if suffix == ".jpg":
        data = data.replace(struct.pack(">HH", 16, 24), struct.pack(">HH", 30000, 30000), 1)
    elif suffix == ".png":
        head = b"IHDR" + struct.pack(">II", 30000, 30000) + data[24:29]
        data = data[:12] + head + struct.pack(">I", zlib.crc32(head)) + data[33:]
    else:
        for tag, number in ((256, 24), (257, 16)):
            entry = struct.pack("<HHI", tag, 3, 1)
            data = data.replace(entry + struct.pack("<I", number), entry + struct.pack("<I", 30000), 1)
    path.write_bytes(data)
    says = "has frames of 30000x30000 pixels" if suffix == ".tif" else "claims more pixels than any camera has"
    assert ends(tmp_path / "a", [], says, **RATE)


def jpeg(rng: np.random.Generator, rows: int = 64, columns: int = 96) -> Levels:
    return cv2.GaussianBlur(rng.integers(0, 256, (rows, columns)).astype(np.uint8), (0, 0), 2)


def test_a_jpeg_that_lacks_blocks_is_damaged(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """OpenCV fills missing blocks with gray."""
    pictures = [jpeg(np.random.default_rng(seed)) for seed in range(3)]
    second = write_pictures(tmp_path / "a", np.stack(pictures), "%d.jpg") / "2.jpg"
    data = second.read_bytes()
    half = len(data) * 2 // 3
    for damaged in (data[:half], data[:half] + bytes(len(data) - half), data[:half] + b"\xff\xd9"):
        second.write_bytes(damaged)
        got, says = refused(tmp_path / "a", **RATE)
        assert len(got) == 1
        assert says == f"{second} is damaged or no picture, after 1 frames: copy it again, or remove it"
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("options", [
    [], [cv2.IMWRITE_JPEG_PROGRESSIVE, 1], [cv2.IMWRITE_JPEG_RST_INTERVAL, 2], [cv2.IMWRITE_JPEG_OPTIMIZE, 1],
])  # fmt: skip
@pytest.mark.parametrize("colours", [1, 3])
def test_complete_jpegs_of_all_forms_are_read(tmp_path: Path, options: list[int], colours: int) -> None:
    """Include metadata unknown to FFmpeg, and trailing bytes."""
    gray = jpeg(np.random.default_rng(1), 41, 61)
    picture = gray if colours == 1 else np.stack([gray, gray // 2, 255 - gray], axis=-1)
    data = cv2.imencode(".jpg", picture, options)[1].tobytes()
    notes = b"".join(bytes([0xFF, kind, 0, 9]) + b"AVI1\xff\xd8\x00" for kind in (0xE0, 0xE1, 0xED, 0xFE))
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "1.jpg").write_bytes(data[:2] + notes + data[2:] + bytes(100))
    (frame,) = read(tmp_path / "a", rate_hz=10, channel="green")
    want: Any = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    assert np.array_equal(frame.pixels, want if want.ndim == 2 else want[..., 1])


@pytest.mark.parametrize(("name", "kind"), [
    ("one.png", "png"), ("one.jpg", "jpeg"), ("lit%03d.png", "png"), ("PNG", "png"), ("a.bmp", "bmp"),
    ("a.webp", "webp"), ("a.jp2", "jpeg2000"), ("lit%03d.bmp", "bmp"),
])  # fmt: skip
def test_a_single_picture_is_one_frame(tmp_path: Path, name: str, kind: str) -> None:
    """FFmpeg would take a name that resembles a pattern for a sequence."""
    levels, path = np.full((1, 16, 24), 77, np.uint8), tmp_path / name
    Image.fromarray(levels[0]).save(tmp_path / "made", kind, lossless=True)
    (tmp_path / "made").rename(path)
    assert form(path, **RATE) == (24, 16, 8, 1000, 1)
    assert holds(path, levels, **RATE)
    assert "has no clock" in refused(path)[1]


@pytest.mark.parametrize("suffix", [".bmp", ".BMP", ".dib", ".pgm", ".pnm", ".pam", ".jpeg", ".webp"])
def test_pictures_of_all_kinds_in_a_folder(tmp_path: Path, suffix: str) -> None:
    levels = np.full((3, 16, 24), 77, np.uint8) if suffix in (".jpeg", ".webp") else noise(3, 16, 24, 8)
    kind = {".dib": ".bmp", ".pnm": ".pgm"}.get(suffix, suffix.lower())
    for number, picture in enumerate(levels):
        (tmp_path / f"shot {number}{suffix}").write_bytes(cv2.imencode(kind, picture)[1].tobytes())
    for other in ("Thumbs.db", "desktop.ini", "._shot 0.png", ".DS_Store"):
        (tmp_path / other).write_bytes(b"of the system")
    for path in (tmp_path, tmp_path / f"shot %d{suffix}"):
        assert holds(path, levels, **RATE)
    if suffix == ".jpeg":  # suffixes of one kind belong together
        (tmp_path / "shot 0.jpeg").rename(tmp_path / "shot 0.JPG")
        (tmp_path / "shot 1.jpeg").rename(tmp_path / "shot 1.jpe")
        assert holds(tmp_path, levels, **RATE)


@pytest.mark.parametrize("digit", ["\u2460", "\u00b2", "\u0968", "\U0001d7d8"])
def test_digits_of_other_scripts_in_names(tmp_path: Path, digit: str) -> None:
    """`str.isdigit` accepts some digits that `int` rejects."""
    levels = noise(12, 6, 10, 8)
    for number, name in enumerate((f"{digit}%d.png", f"a{digit}b%d.png", f"%d{digit}.png")):
        folder = write_pictures(tmp_path / str(number), levels, name, first=0)
        assert holds(folder, levels, **RATE)
        assert holds(folder / name, levels, **RATE)


def test_names_that_are_not_utf_8(tmp_path: Path) -> None:
    folder = write_pictures(tmp_path / "a", noise(3, 6, 10, 8), "img%d.png")
    for number in (1, 2, 3):
        os.rename(folder / f"img{number}.png", os.fsencode(folder) + b"/\xff%d.png" % number)
    assert holds(folder, noise(3, 6, 10, 8), **RATE)


@pytest.mark.parametrize("suffix", [".bmp", ".pgm", ".webp", ".png", ".jpg", ".tif"])
def test_a_cut_picture_of_any_kind_is_one_line(tmp_path: Path, suffix: str, capfd: pytest.CaptureFixture[str]) -> None:
    data = cv2.imencode(suffix, noise(1, 20, 30, 8)[0])[1].tobytes()
    (tmp_path / f"1{suffix}").write_bytes(data)
    (tmp_path / f"2{suffix}").write_bytes(data[: len(data) // 2])
    got, says = refused(tmp_path, **RATE)
    assert len(got) == 1
    assert f"2{suffix}" in says
    if hasattr(cv2.utils, "logging"):  # older OpenCV prints read errors at any log level
        assert capfd.readouterr().err == ""


@pytest.mark.parametrize("largest", [1023, 4095, 65535])
def test_the_largest_level_of_a_pgm_states_its_bits(tmp_path: Path, largest: int) -> None:
    levels = noise(2, 6, 10, largest.bit_length())
    for number, picture in enumerate(levels):
        head = b"P5\n# of a camera\n10 6\n%d\n" % largest
        (tmp_path / f"{number}.pgm").write_bytes(head + picture.astype(">u2").tobytes())
    assert form(tmp_path, **RATE)[2] == largest.bit_length()
    assert holds(tmp_path, levels, **RATE)
    (tmp_path / "1.pgm").write_bytes(2 * (b"P5 10 6 255\n" + bytes(60)))
    assert "1.pgm holds several pictures, not one" in refused(tmp_path, **RATE)[1]


def animated(path: Path, levels: Levels, durations_ms: list[int], mode: str = "L") -> Path:
    images = [Image.fromarray(picture).convert(mode) for picture in levels]
    images[0].save(path, save_all=True, append_images=images[1:], duration=durations_ms, lossless=True)
    return path


@pytest.mark.parametrize(("name", "mode"), [
    ("a.gif", "L"), ("a.gif", "P"), ("a.png", "L"), ("a.png", "RGB"), ("a.webp", "RGB"), ("a.WEBP", "RGB"),
])  # fmt: skip
def test_animated_pictures_have_all_frames_at_their_times(tmp_path: Path, name: str, mode: str) -> None:
    levels = np.repeat(np.arange(0, 240, 40, dtype=np.uint8), 16 * 24).reshape(6, 16, 24)
    path = animated(tmp_path / name, levels, [20, 20, 40, 20, 20, 20], mode)
    assert form(path) == (24, 16, 8, 50, 6)
    assert holds(path, levels, [0, 0.02, 0.04, 0.08, 0.1, 0.12], [0, 1, 2, 4, 5, 6])


@pytest.mark.parametrize("name", ["a.gif", "a.png", "a.webp"])
def test_animations_at_a_rate_among_pictures_cut(tmp_path: Path, name: str, capfd: pytest.CaptureFixture[str]) -> None:
    path = animated(tmp_path / name, noise(6, 16, 24, 8), [10] * 6, "RGB")
    assert [frame.time_s for frame in read(path, rate_hz=1000)] == pytest.approx(np.arange(6) / 1000)
    if name != "a.gif":
        assert f"{name} holds 6 pictures, not one: give the file's name" in refused(tmp_path, **RATE)[1]
    os.truncate(path, path.stat().st_size * 2 // 3)
    assert name in refused(path)[1]
    assert capfd.readouterr().err == ""
