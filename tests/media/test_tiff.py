"""TIFF stacks from camera software, and compressed stacks."""

import os
import struct
import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import tifffile
from film_checks import ends, form, holds, refused, same, starts
from made_recordings import Levels, noise, write_tiff

from heliograph.media import open_film, tiff

RATE = {"rate_hz": 1000}


def by_opencv(path: Path, levels: Levels, compression: int) -> Path:
    assert cv2.imwritemulti(str(path), list(levels), [cv2.IMWRITE_TIFF_COMPRESSION, compression])
    return path


@pytest.mark.parametrize(("bits", "order", "big"), [(8, "<", False), (16, ">", False), (16, "<", True)])
def test_pages_of_either_byte_order(tmp_path: Path, bits: int, order: str, big: bool) -> None:
    levels = noise(5, 6, 10, bits)
    path = write_tiff(tmp_path / "a.bin", levels, order, big)
    assert form(path, rate_hz=500) == (10, 6, bits, 500, 5)
    assert holds(path, levels, [0, 0.002, 0.004, 0.006, 0.008], rate_hz=500)


@pytest.mark.parametrize(("compression", "bits"), [(1, 8), (5, 8), (8, 16)])
def test_stacks_of_opencv_are_read(tmp_path: Path, compression: int, bits: int) -> None:
    levels = noise(7, 20, 30, bits)
    with open_film(by_opencv(tmp_path / "a.tif", levels, compression), rate_hz=500) as film:
        assert same(list(film), levels)
        assert same(list(film), levels)
        assert film.frame_count == 7


def test_a_frame_reads_only_its_page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Reading a compressed stack does not restart at its first page for each frame."""
    path, pages = by_opencv(tmp_path / "a.tif", noise(30, 8, 8, 8), 5), []
    real = tifffile.TiffPage

    def counted(*given: Any, **options: Any) -> Any:
        pages.append(options["index"])
        return real(*given, **options)

    with open_film(path, rate_hz=10) as film:
        monkeypatch.setattr(tifffile, "TiffPage", counted)
        assert len(list(film)) == 30
    assert len(pages) <= 2 * 30


def test_a_damaged_page(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    levels = noise(5, 20, 30, 8)
    path = by_opencv(tmp_path / "a.tif", levels, 5)
    with tifffile.TiffFile(path) as stack:
        place = stack.pages[2].offset
    overwrite(path, place, b"\xff" * 300)
    assert ends(path, levels[:2], "is damaged after 2 whole frames", **RATE)
    assert capfd.readouterr().err == ""


def overwrite(path: Path, place: int, data: bytes) -> None:
    held = path.read_bytes()
    path.write_bytes(held[:place] + data + held[place + len(data) :])


def test_a_circle_of_pages_is_damage(tmp_path: Path) -> None:
    levels = noise(3, 4, 4, 8)
    path = write_tiff(tmp_path / "a.tif", levels)
    with tifffile.TiffFile(path) as stack:
        first, link = stack.pages.first.offset, stack.pages.next_page_offset or 0
    overwrite(path, link, struct.pack("<I", first))
    assert ends(path, levels, "is damaged after 3 whole frames", **RATE)


def test_other_descriptions_than_of_stacks_are_ignored(tmp_path: Path) -> None:
    levels = noise(4, 6, 10, 16)
    path = write_tiff(tmp_path / "a.tif", levels[:1], description="somebody else's\nimages=4\n")
    path.write_bytes(path.read_bytes() + levels[1:].tobytes())
    assert holds(path, levels[:1], **RATE)


@pytest.mark.parametrize(("width", "says"), [(0, "frames of 0x4 pixels"), (1 << 30, "frames of 1073741824x4 pixels")])
def test_impossible_sizes_are_refused(tmp_path: Path, width: int, says: str) -> None:
    path = write_tiff(tmp_path / "a.tif", noise(1, 4, 4, 8))
    entry = struct.pack("<HHI", 256, 4, 1)
    path.write_bytes(path.read_bytes().replace(entry + struct.pack("<I", 4), entry + struct.pack("<I", width)))
    assert says in refused(path, **RATE)[1]


@pytest.mark.parametrize("data", [
    b"II", b"II*\0", b"II*\0\0\0\0\0", b"II*\0\xff\xff\xff\xff", b"Dear film, hello there", b"II*\0" + bytes(20),
])  # fmt: skip
def test_other_files_than_stacks_are_refused(tmp_path: Path, data: bytes) -> None:
    (tmp_path / "a.tif").write_bytes(data)
    says = "holds no pages: save it as TIFF" if len(data) == 24 else "a.tif"
    assert says in refused(tmp_path / "a.tif", **RATE)[1]


def test_a_page_of_another_size(tmp_path: Path) -> None:
    pages, path = [noise(1, 20, 30, 8)[0], noise(1, 10, 30, 8)[0]], tmp_path / "a.tif"
    assert cv2.imwritemulti(str(path), pages)
    says = "has 30x10 pixels of 8 bits after 1 whole frames, the film 30x20 of 8"
    assert ends(path, pages[:1], says, **RATE)


@pytest.mark.parametrize("bits", [8, 16])
def test_white_at_level_0_is_inverted(tmp_path: Path, bits: int) -> None:
    levels = noise(1, 6, 10, bits)
    assert holds(write_tiff(tmp_path / "a.tif", levels, photometric="miniswhite"), ~levels, **RATE)


def write(path: Path, levels: Any, **options: Any) -> Path:
    tifffile.imwrite(path, levels, **options)
    return path


@pytest.mark.parametrize("options", [
    {"truncate": True}, {"truncate": True, "bigtiff": True, "byteorder": ">"}, {"truncate": True, "imagej": True},
    {"imagej": True, "metadata": {"axes": "TYX"}}, {"imagej": True, "metadata": {"axes": "ZYX"}}, {"imagej": True},
    {"ome": True, "metadata": {"axes": "TYX"}}, {"ome": True, "metadata": {"axes": "ZYX"}},
    {"volumetric": True, "photometric": "minisblack"}, {"tile": (16, 16)}, {"rowsperstrip": 3},
    {"compression": "zlib", "predictor": 2}, {"compression": "zlib", "tile": (16, 16)},
    {"compression": "lzma", "byteorder": ">"}, {"compression": "jpegxl", "compressionargs": {"lossless": True}},
    *[{"compression": name} for name in ("zlib", "lzw", "packbits", "zstd", "jpeg2000", "lzma", "png")],
], ids=str)  # fmt: skip
def test_frames_of_stacks_as_programs_write_them(tmp_path: Path, options: dict[str, Any]) -> None:
    levels = noise(9, 20, 30, 16)
    path = write(tmp_path / "a.tif", levels, **options)
    assert form(path, **RATE)[-1] == 9
    assert holds(path, levels, **RATE)


def test_a_stack_written_frame_by_frame(tmp_path: Path) -> None:
    levels = noise(5, 20, 30, 8)
    for contiguous in (False, True):
        with tifffile.TiffWriter(tmp_path / "a.tif") as stack:
            for picture in levels:
                stack.write(picture, contiguous=contiguous)
        assert holds(tmp_path / "a.tif", levels, **RATE)


def test_two_series_in_one_directory_each(tmp_path: Path) -> None:
    levels, path = noise(8, 20, 30, 8), tmp_path / "a.tif"
    first, second = (
        bytearray(write(path, part, truncate=True, photometric="minisblack").read_bytes())
        for part in np.split(levels, 2)
    )
    with tifffile.TiffFile(path) as stack:
        page = stack.pages.first
        tags = [tag.offset for tag in page.tags if tag.count > 4 and tag.dtype == 2] + [page.tags[273].offset]
        last = page.offset + 2 + 12 * len(page.tags)
    # offsets in the second directory and its data grow by the length of the first file
    for place in (tag + 8 for tag in tags):
        struct.pack_into("<I", second, place, struct.unpack_from("<I", second, place)[0] + len(first))
    struct.pack_into("<I", first, last, len(first) + 8)
    path.write_bytes(first + second)
    assert holds(path, levels, **RATE)


@pytest.mark.parametrize("kind", [
    {"truncate": True}, {"imagej": True}, {"imagej": True, "truncate": True}, {"compression": "zlib"},
    {"tile": (16, 16)}, {"compression": "lzw", "rowsperstrip": 7}, {"metadata": None},
], ids=str)  # fmt: skip
def test_truncated_stack_of_any_layout_gives_its_complete_frames(tmp_path: Path, kind: dict[str, Any]) -> None:
    """Without metadata, tifffile writes the directories but the first behind all pixels."""
    levels = noise(9, 20, 30, 8)
    path = write(tmp_path / "a.tif", levels, **kind)
    os.truncate(path, path.stat().st_size * 2 // 3)
    got, says = refused(path, **RATE)
    assert len(got) == 1 if "metadata" in kind else 4 <= len(got) < 9
    assert starts(got, levels)
    assert f"ends in the middle, after {len(got)} whole frames: copy it again" in says


@pytest.mark.parametrize(("shape", "options", "says"), [
    ((5, 2, 8, 8), {"imagej": True, "metadata": {"axes": "TCYX"}}, "several channels (channels=2, frames=5 in its"),
    ((2, 8, 8), {"imagej": True}, "several channels (channels=2 in its"),
    ((5, 2, 8, 8), {"ome": True, "metadata": {"axes": "TCYX"}}, "several channels (SizeC=2, SizeT=5 in its"),
    ((5, 2, 8, 8), {"metadata": {"axes": "TCYX"}}, "several channels (T=5, C=2 in its"),
    ((5, 2, 8, 8), {"imagej": True, "metadata": {"axes": "TZYX"}}, "several axes of pictures (slices=2, frames=5 in"),
    ((5, 2, 8, 8), {"ome": True, "metadata": {"axes": "TZYX"}}, "several axes of pictures (SizeZ=2, SizeT=5 in"),
    ((5, 2, 8, 8), {}, "several axes of pictures (axis 0=5, axis 1=2 in"),
    ((5, 8, 8, 2), {"photometric": "minisblack", "planarconfig": "contig"}, "several channels (2 samples a pixel)"),
    ((16, 16, 16), {"volumetric": True, "photometric": "minisblack", "compression": "zlib"}, "16 pictures in one page"),
])  # fmt: skip
def test_stacks_of_more_than_one_axis_are_named(tmp_path: Path, shape: Any, options: dict[str, Any], says: str) -> None:
    _, message = refused(write(tmp_path / "a.tif", np.zeros(shape, np.uint8), **options), **RATE)
    assert says in message
    assert "save" in message


def test_red_green_and_blue_in_any_layout(tmp_path: Path) -> None:
    colours = noise(3, 20, 90, 8).reshape(3, 20, 30, 3)
    opaque = np.concatenate([colours, colours[..., :1]], axis=-1)
    for pixels, options in (
        (colours, {}), (colours, {"truncate": True}), (colours, {"ome": True, "metadata": {"axes": "TYXS"}}),
        (np.moveaxis(colours, -1, 1), {"planarconfig": "separate"}), (opaque, {"extrasamples": ["unassalpha"]}),
    ):  # fmt: skip
        write(tmp_path / "a.tif", pixels, photometric="rgb", **options)
        for place, channel in enumerate(("red", "green", "blue")):
            assert holds(tmp_path / "a.tif", colours[..., place], channel=channel, **RATE)


def test_a_palette_gives_its_colours(tmp_path: Path) -> None:
    levels = noise(2, 20, 30, 8)
    palette = np.stack([np.arange(256), np.arange(256)[::-1], np.zeros(256)]).astype(np.uint16) * 257
    write(tmp_path / "a.tif", levels, photometric="palette", colormap=palette)
    for channel, want in {"red": levels, "green": ~levels, "blue": levels * 0}.items():
        assert holds(tmp_path / "a.tif", want, channel=channel, **RATE)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_pages_are_put_upright(tmp_path: Path, orientation: int) -> None:
    stored = noise(1, 20, 30, 8)[0]
    upright = {1: stored, 2: stored[:, ::-1], 3: stored[::-1, ::-1], 4: stored[::-1], 5: stored.T,
               6: np.rot90(stored, -1), 7: np.rot90(stored, 2).T, 8: np.rot90(stored)}[orientation]  # fmt: skip
    path = write_tiff(tmp_path / "a.tif", stored[np.newaxis], extratags=[(274, "H", 1, orientation)])
    assert holds(path, [upright], **RATE)


def packed_page(path: Path, levels: Levels, bits: int, compression: int = 1, words: bool = False) -> Path:
    """Write a single-page TIFF with packed levels, or with 16-bit words."""
    rows, columns = levels.shape
    places = np.unpackbits(levels.astype(">u2").reshape(rows, columns, 1).view(np.uint8), axis=2)[..., -bits:]
    data = levels.astype("<u2").tobytes() if words else np.packbits(places.reshape(rows, -1), axis=1).tobytes()
    data = data if compression == 1 else zlib.compress(data)
    tags = {256: columns, 257: rows, 258: bits, 259: compression, 262: 1, 273: 134, 277: 1, 278: rows, 279: len(data)}
    entries = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in tags.items())
    path.write_bytes(struct.pack("<2sHIH", b"II", 42, 8, len(tags)) + entries + bytes(16) + data)
    return path


@pytest.mark.parametrize(("bits", "columns", "compression"), [
    (1, 30, 1), (1, 33, 1), (2, 31, 1), (4, 33, 1), (9, 30, 1), (10, 31, 1), (11, 33, 1), (12, 31, 1), (14, 30, 1),
    (4, 30, 8), (12, 30, 8),
])  # fmt: skip
def test_packed_levels_of_any_bits(tmp_path: Path, bits: int, columns: int, compression: int) -> None:
    levels = np.random.default_rng(bits).integers(0, 1 << bits, (7, columns)).astype(np.uint16)
    path = packed_page(tmp_path / "a.tif", levels, bits, compression)
    assert form(path, **RATE)[2] == max(8, bits)
    assert holds(path, [levels if bits > 8 else levels * (255 // ((1 << bits) - 1))], **RATE)


def test_words_of_16_bits_under_a_statement_of_12(tmp_path: Path) -> None:
    levels = noise(1, 7, 30, 12)[0]
    path = packed_page(tmp_path / "a.tif", levels, 12, words=True)
    assert form(path, **RATE)[2] == 12
    assert holds(path, [levels], **RATE)
    levels[2, 3] = 4096
    says = "has a gray level of 4096 after 0 whole frames, and its header says 12 bits"
    assert ends(packed_page(tmp_path / "a.tif", levels, 12, words=True), [], says, **RATE)


def test_an_unknown_compression_is_named(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = packed_page(tmp_path / "a.tif", noise(1, 20, 30, 8)[0], 8, compression=44444)
    assert "44444" in refused(path, **RATE)[1]
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("kind", [np.float32, np.int16, np.uint32, np.complex64])
def test_other_numbers_than_levels_are_named(tmp_path: Path, kind: Any) -> None:
    path = write(tmp_path / "a.tif", np.zeros((2, 8, 8), kind))
    assert ends(path, [], f"pixels of {np.dtype(kind)} in 1 channels: save gray or RGB of 8 or 16 bits", **RATE)


def test_reduced_copies_are_left_out(tmp_path: Path) -> None:
    levels = noise(4, 20, 30, 8)
    with tifffile.TiffWriter(tmp_path / "a.tif") as stack:
        for picture in levels:
            stack.write(picture, subifds=1, metadata=None)
            stack.write(picture[::2, ::2], subfiletype=1, metadata=None)  # in the page's SubIFDs
            stack.write(picture[::2, ::2], subfiletype=1, metadata=None)  # next to the page
    assert holds(tmp_path / "a.tif", levels, **RATE)


def test_a_picture_taken_out_of_a_stack_keeps_its_description(tmp_path: Path) -> None:
    picture = noise(1, 20, 30, 8)
    path = write(tmp_path / "a.tif", picture[0], description="ImageJ=1.54f\nimages=110\nframes=110\n", metadata=None)
    assert not tiff.is_stack(path)
    assert holds(path, picture, **RATE)


@pytest.mark.parametrize("compression", ["zlib", "lzma"])
def test_wrong_bytes_in_a_compressed_page_are_found(tmp_path: Path, compression: str) -> None:
    levels = noise(5, 20, 30, 8)
    path = write(tmp_path / "a.tif", levels, compression=compression)
    with tifffile.TiffFile(path) as stack:
        place = stack.pages[3].dataoffsets[0]
    overwrite(path, place + 50, b"\xaa" * 10)
    assert ends(path, levels[:3], "has a page after 3 whole frames that cannot be decoded", **RATE)


def test_pictures_below_a_small_copy_are_not_read(tmp_path: Path) -> None:
    """Camera raw files have the full picture below a small preview."""
    picture, path = noise(1, 20, 30, 8)[0], tmp_path / "a.tif"
    with tifffile.TiffWriter(path) as stack:
        stack.write(picture[::2, ::2], subifds=1, subfiletype=1, metadata=None)
        stack.write(picture, metadata=None)
    assert ends(path, [], "holds only small copies, as cameras' raw files do: save it as TIFF", **RATE)
