"""Write recordings in the formats used by cameras and camera software."""

import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tifffile
from numpy.typing import NDArray

Levels = NDArray[Any]
"""Gray levels, shape (frames, rows, columns)."""

CIH = """#Camera Information Header
Date : 2024/5/6
Time : 12:34
Camera Type : FASTCAM Mini
Record Rate(fps) : {rate:g}
Total Frame : {frames}
Start Frame : 0
Save Step : {step}
Image Width : {width}
Image Height : {height}
Color Type : {colour}
Color Bit : {word}
File Format : {kind}
EffectiveBit Depth : {depth}
EffectiveBit Side : {side}
Comment Text : a: b
Date : 1999/1/1
"""

CIHX = """<?xml version="1.0" encoding="utf-8"?>
<cih><fileInfo><date>2024/5/6</date><time>12:34</time></fileInfo>
<imageFileInfo><fileFormat>{kind}</fileFormat></imageFileInfo>
<imageDataInfo><resolution><width>{width}</width><height>{height}</height></resolution>
<colorInfo><type>{colour}</type><bit>{word}</bit></colorInfo>
<effectiveBit><depth>{depth}</depth><side>{side}</side></effectiveBit></imageDataInfo>
<frameInfo><totalFrame>{frames}</totalFrame><skipFrame>{step}</skipFrame></frameInfo>
<recordInfo><recordRate>{rate:g}</recordRate></recordInfo>
<deviceInfo><deviceName>FASTCAM Mini</deviceName></deviceInfo></cih>"""

Y4M_FORMS = {"mono": 1, "420jpeg": 1.5, "422": 2, "444": 3, "mono12": 2, "420p10": 3, "mono16": 2}
"""Bytes per pixel for each .y4m colour space."""


def noise(frames: int, rows: int, columns: int, bits: int, seed: int = 0) -> Levels:
    levels = np.random.default_rng(seed).integers(0, 1 << bits, (frames, rows, columns))
    return levels.astype(np.uint8 if bits == 8 else np.uint16)


def packed(levels: Levels, bits: int) -> bytes:
    """Pack levels with `bits` bits each, most significant bit first."""
    words = levels.astype(">u2").reshape(-1, 1).view(np.uint8)
    return np.packbits(np.unpackbits(words, axis=1)[:, -bits:]).tobytes()


def write_mraw(path: Path, levels: Levels, word: int, depth: int, header: str = ".cih", **said: Any) -> Path:
    """Write a .mraw file and its header; return the .mraw path."""
    values = {"frames": len(levels), "height": levels.shape[1], "width": levels.shape[2], "word": word, "depth": depth,
              "rate": 1000.0, "step": 1, "side": "Lower", "colour": "Mono", "kind": "MRaw", **said}  # fmt: skip
    stored = levels.astype("<u2") << (max(word - depth, 0) if values["side"] == "Higher" else 0)
    path.write_bytes(packed(levels, 12) if word == 12 else stored.astype(f"<u{word // 8}").tobytes())
    if header == ".cihx":
        path.with_suffix(header).write_bytes(b"!!! not text \0\xff" + CIHX.format(**values).encode() + b"\0\0 end")
    else:
        path.with_suffix(header).write_bytes(CIH.format(**values).encode())
    return path


def write_cine(
    path: Path,
    frames: Sequence[Levels],
    word: int,
    depth: int,
    times_s: Sequence[float] | None = None,
    rate: int = 1000,
    upwards: bool = True,
    settings: int = 6000,
) -> Path:
    """Write a .cine file with 8, 16, 24 or 48 bits per pixel, or 10 or 12 packed bits; `settings` are raw bytes."""
    rows, columns = frames[0].shape[:2]
    packing = {10: 256, 12: 1024}.get(word, 0)
    setup = bytearray(settings)
    setup[140:144] = b"ST" + struct.pack("<H", len(setup))
    setup[768:772], setup[896:900] = struct.pack("<I", rate), struct.pack("<I", depth)
    blocks = struct.pack("<IHH", 12, 1003, 1) + bytes(4)
    if times_s is not None:
        stamps = [(1_700_000_000 << 32) + round(time_s * (1 << 32)) & ~3 | 2 for time_s in times_s]
        blocks += struct.pack("<IHH", 8 + 8 * len(stamps), 1002, 0) + struct.pack(f"<{len(stamps)}Q", *stamps)
    table = 84 + len(setup) + len(blocks)
    pictures = [_picture(frame, word, upwards) for frame in frames]
    size, notes = len(pictures[0]), struct.pack("<I4x", 12)
    start = table + 8 * len(frames)
    places = [start + number * (12 + size) for number in range(len(frames))]
    head = struct.pack("<2sHHHiIiIIIIQ", b"CI", 44, 0, 1, -3, 99, -3, len(frames), 44, 84, table, 1_700_000_000 << 32)
    height = rows if upwards else -rows
    bitmap = struct.pack("<IiiHHIIiiII", 40, columns, height, 1, 16 if packing else word, packing, size, 0, 0, 0, 0)
    body = b"".join(notes + struct.pack("<I", size) + picture for picture in pictures)
    path.write_bytes(head + bitmap + setup + blocks + struct.pack(f"<{len(frames)}Q", *places) + body)
    return path


def _picture(frame: Levels, word: int, upwards: bool) -> bytes:
    if word in (10, 12):
        return packed(frame, word)
    stored = frame.astype("u1" if word in (8, 24) else "<u2")
    return (stored[::-1] if upwards else stored).tobytes()


def write_pictures(folder: Path, levels: Levels, name: str = "img%04d.png", first: int = 1) -> Path:
    folder.mkdir(exist_ok=True)
    for number, picture in enumerate(levels, first):
        assert cv2.imwrite(str(folder / (name % number)), picture)
    return folder


def write_tiff(path: Path, levels: Levels, order: Any = "<", big: bool = False, **options: Any) -> Path:
    """Write a TIFF stack page by page, with two strips per page."""
    form = {"rowsperstrip": max(1, levels.shape[1] // 2), "metadata": None, "photometric": "minisblack", **options}
    with tifffile.TiffWriter(path, byteorder=order, bigtiff=big) as stack:
        for picture in levels:
            stack.write(picture, contiguous=False, **form)
    return path


def write_y4m(path: Path, form: str, frames: int = 5) -> Path:
    """Write a .y4m file with uniform 10x6 px frames."""
    size = int(10 * 6 * Y4M_FORMS[form])
    body = b"".join(b"FRAME\n" + bytes([number]) * size for number in range(frames))
    path.write_bytes(f"YUV4MPEG2 W10 H6 F1000:1 Ip A1:1 C{form}\n".encode() + body)
    return path


def write_kinds(folder: Path, levels: Levels, rate: int) -> dict[str, tuple[Path, bool]]:
    """Write an 8-bit film in each non-video format; return the path and True if the format lacks a frame rate."""
    np.save(folder / "a.npy", levels)
    times_s = [number / rate for number in range(len(levels))]
    return {
        "folder": (write_pictures(folder / "shots", levels), True),
        "pattern": (folder / "shots" / "img%04d.png", True),
        "tiff": (write_tiff(folder / "a.tif", levels), True),
        "npy": (folder / "a.npy", True),
        "mraw": (write_mraw(folder / "b.mraw", levels, 8, 8, rate=rate), False),
        "cine": (write_cine(folder / "a.cine", list(levels), 8, 8, times_s, rate), False),
    }
