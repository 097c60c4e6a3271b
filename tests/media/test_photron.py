"""Photron .mraw recordings with .cih or .cihx headers."""

import os
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from film_checks import ends, form, holds, read, refused, same
from made_recordings import noise, write_mraw

from heliograph.media import open_film


@pytest.mark.parametrize(("word", "depth", "side", "header", "named"), [
    (8, 8, "Lower", ".cih", ".mraw"), (8, 12, "Higher", ".cihx", "header"), (12, 12, "Lower", ".cih", "header"),
    (16, 12, "Lower", ".cihx", ".mraw"), (16, 12, "Higher", ".cih", ".mraw"), (16, 16, "Lower", ".cihx", "header"),
])  # fmt: skip
def test_levels_rate_and_times(tmp_path: Path, word: int, depth: int, side: str, header: str, named: str) -> None:
    bits = min(word, depth)
    levels = noise(4, 6, 10, bits)
    path = write_mraw(tmp_path / "a.b.mraw", levels, word, depth, header, side=side, rate=4000.0)
    path = path if named == ".mraw" else path.with_suffix(header)
    assert form(path) == (10, 6, bits, 4000.0, 4)
    assert holds(path, levels, [0, 0.25e-3, 0.5e-3, 0.75e-3], range(4))
    with open_film(path) as film:
        assert (film.metadata["date"], film.metadata["camera"]) == ("2024/5/6", "FASTCAM Mini")


@pytest.mark.parametrize(("frames", "header"), [("a.Mraw", "a.Cih"), ("a.MRAW", "a.CIH"), ("a.mraw", "a.Cih")])
def test_suffixes_in_any_case_belong_together(tmp_path: Path, frames: str, header: str) -> None:
    write_mraw(tmp_path / "a.mraw", noise(4, 6, 10, 8), 8, 8).rename(tmp_path / frames)
    (tmp_path / "a.cih").rename(tmp_path / header)
    assert [len(read(tmp_path / name)) for name in (frames, header)] == [4, 4]


def test_an_odd_number_of_packed_levels(tmp_path: Path) -> None:
    levels = noise(1, 3, 5, 12)
    path = write_mraw(tmp_path / "a.mraw", levels, 12, 12)
    path.write_bytes(path.read_bytes().ljust(24, b"\0"))
    assert same(read(path), levels)


def test_the_rate_is_that_of_the_frames_that_were_saved(tmp_path: Path) -> None:
    levels = noise(3, 4, 4, 8)
    made = write_mraw(tmp_path / "a.mraw", levels, 8, 8, rate=10_000.0, step=10)
    with open_film(made) as film:
        assert (film.rate_hz, film.metadata["rate"], film.metadata["step"]) == (1000, "10000", "10")
    assert holds(made, levels, [0.0, 0.001, 0.002], range(3))
    # a given rate refers to saved frames, too
    assert holds(made, levels, [0.0, 0.002, 0.004], range(3), rate_hz=500)


@pytest.mark.parametrize("word", [8, 12, 16])
@pytest.mark.parametrize("lost", [1, 50])
def test_truncated_file_gives_its_complete_frames(tmp_path: Path, word: int, lost: int) -> None:
    levels = noise(5, 6, 10, 8)
    path = write_mraw(tmp_path / "a.mraw", levels, word, 8 if word == 8 else 12)
    os.truncate(path, path.stat().st_size - lost)
    assert ends(path, levels[:4], "a.mraw ends in the middle, after 4 whole frames")


LINES = {"width": "Image Width", "height": "Image Height", "frames": "Total Frame", "word": "Color Bit",
         "colour": "Color Type", "depth": "EffectiveBit Depth", "kind": "File Format",
         "rate": "Record Rate(fps)"}  # fmt: skip


@pytest.mark.parametrize(("said", "says"), [
    ({"rate": "nan"}, "says 'nan' for its record rate(fps): copy the header again, or correct it"),
    ({"rate": -5}, "says '-5' for its record rate(fps)"),
    ({"rate": 0}, "has no clock: say how many frames a second the camera took, by --fps"),
    ({"width": 0}, "frames of 0x6 pixels"),
    ({"width": 1 << 30, "height": 1 << 30}, "frames of 1073741824x1073741824 pixels"),
    ({"height": -6}, "'-6' for its image height"),
    ({"width": "wide"}, "'wide' for its image width"),
    *[({key: ""}, f"does not state its {line.lower()}: copy the header saved with the frames, or add the line")
      for key, line in LINES.items() if key in ("width", "height", "frames", "word")],
    ({"frames": 4}, "has 300 bytes, and a.cih says 4 frames of 60"),
    ({"frames": 0}, "says 0 frames"),
    ({"word": 10}, "mono of 10 bits, and gray of 8, 12 or 16"),
    ({"colour": "Color", "word": 24}, "color of 24 bits"),
    ({"depth": 6}, "levels of 6"),
    ({"kind": "Tiff"}, "its frames are Tiff files: give the folder"),
])  # fmt: skip
def test_wrong_headers_are_named(tmp_path: Path, said: dict[str, Any], says: str) -> None:
    path = write_mraw(tmp_path / "a.mraw", noise(5, 6, 10, 8), 8, 8)
    text = path.with_suffix(".cih").read_text()
    for key, value in said.items():
        text = re.sub(f"{re.escape(LINES[key])} : .*", f"{LINES[key]} : {value}", text)
    path.with_suffix(".cih").write_text(text)
    assert says in refused(path)[1]


@pytest.mark.parametrize("header", [".cih", ".cihx"])
@pytest.mark.parametrize(("encoding", "ending"), [
    ("utf-8", "\n"), ("utf-8-sig", "\r\n"), ("utf-16", "\r"), ("utf-16-le", "\r\n"), ("utf-16-be", "\n"),
    ("cp932", "\r\n"), ("latin-1", "\r"),
])  # fmt: skip
def test_headers_in_any_encoding(tmp_path: Path, header: str, encoding: str, ending: str) -> None:
    levels = noise(3, 6, 10, 8)
    name = "Gr\u00f6\u00dfe 5 \u00b5m" if encoding == "latin-1" else "\u9ad8\u901f\u30ab\u30e1\u30e9"
    path = write_mraw(tmp_path / "a.mraw", levels, 8, 8, header)
    data = path.with_suffix(header).read_bytes()
    start, end = (data.find(b"<cih>"), data.find(b"</cih>") + 6) if header == ".cihx" else (0, len(data))
    text = data[start:end].decode().replace("FASTCAM Mini", name).replace("\n", ending)
    around = (b"\x01\x02" * 8, b"\0\0") if header == ".cihx" else (b"", b"\0\0")
    path.with_suffix(header).write_bytes(around[0] + text.encode(encoding) + around[1])
    with open_film(path) as film:
        assert (film.width, film.height, film.rate_hz, film.metadata["camera"]) == (10, 6, 1000, name)
        assert same(list(film), levels)


@pytest.mark.parametrize(("held", "said"), [(8, 12), (8, 16), (12, 16)])
def test_levels_of_other_bits_than_the_header_says(tmp_path: Path, held: int, said: int) -> None:
    """Decoding would give fewer frames, all wrong."""
    path = write_mraw(tmp_path / "a.mraw", noise(4, 6, 10, 8), held, held)
    text = path.with_suffix(".cih").read_text().replace(f"Color Bit : {held}", f"Color Bit : {said}")
    path.with_suffix(".cih").write_text(text.replace(f"Depth : {held}", f"Depth : {said}"))
    got, says = refused(path)
    assert not got
    assert f"which are 4 frames of {held} bits, and a.cih says 4 frames of " in says
    assert f" bytes, {said} bits: give the matching header" in says


def test_a_file_without_its_other_half(tmp_path: Path) -> None:
    path = write_mraw(tmp_path / "a.mraw", noise(2, 4, 4, 8), 8, 8)
    path.with_suffix(".cih").rename(tmp_path / "b.cih")
    assert "a.mraw has no header next to it: copy a.cihx or .cih" in refused(path)[1]
    assert "b.cih has no frames next to it: copy b.mraw" in refused(tmp_path / "b.cih")[1]


@pytest.mark.parametrize(
    "text", [b"Dear film,\nthis is a letter.\n", b"\0" * 100, b"<cih><a></cih>", b"<cih>&x;</cih>"]
)
def test_other_files_than_headers_are_refused(tmp_path: Path, text: bytes) -> None:
    path = write_mraw(tmp_path / "a.mraw", noise(2, 4, 4, 8), 8, 8)
    path.with_suffix(".cih").write_bytes(text)
    assert "copy" in refused(path)[1]


@pytest.mark.parametrize("first", [b"II*\0", b"CI\x2c\0", b"\x93NUMPY"])
def test_frames_that_begin_like_another_kind(tmp_path: Path, first: bytes) -> None:
    levels = noise(2, 4, 8, 8)
    levels[0, 0, : len(first)] = list(first)
    assert same(read(write_mraw(tmp_path / "a.mraw", levels, 8, 8)), levels)


@pytest.mark.real_data
@pytest.mark.parametrize(("name", "size", "bits", "rate", "count"), [
    ("ball_12bit.mraw", (384, 384), 12, 30_000, 15), ("ball_12bit.cihx", (384, 384), 12, 30_000, 15),
    ("beam.mraw", (1024, 80), 12, 20, 4), ("data_showcase.cih", (640, 40), 8, 150, 75),
])  # fmt: skip
def test_real_recordings(data: Path, name: str, size: tuple[int, int], bits: int, rate: float, count: int) -> None:
    path = data / "photron" / name
    assert form(path) == (*size, bits, rate, count)
    got = read(path)
    assert [(frame.index, frame.time_s) for frame in got] == [(index, index / rate) for index in range(count)]
    assert all(frame.pixels.shape == size[::-1] for frame in got)


@pytest.mark.real_data
def test_packed_levels_of_a_real_camera_are_smooth(data: Path) -> None:
    """Swapped halves of the shared byte, or another byte order, give rough pictures."""
    with open_film(data / "photron" / "ball_12bit.mraw") as film:
        pixels = next(iter(film)).pixels
    raw = np.fromfile(data / "photron" / "ball_12bit.mraw", np.uint8, 384 * 384 * 3 // 2).reshape(-1, 3).astype(int)
    other = np.stack([raw[:, 0] | (raw[:, 1] & 15) << 8, raw[:, 1] >> 4 | raw[:, 2] << 4], axis=1).reshape(384, 384)
    steps = [float(np.abs(np.diff(one.astype(int), axis=1)).mean()) for one in (pixels, other)]
    assert steps[0] < 0.2 * steps[1]


def test_no_more_frames_are_expected_than_the_file_holds(tmp_path: Path) -> None:
    path = write_mraw(tmp_path / "a.mraw", noise(4, 6, 10, 8), 8, 8, frames=2_000_000_000)
    with open_film(path) as film:
        assert film.frame_count == 4
    assert len(refused(path)[0]) == 4
