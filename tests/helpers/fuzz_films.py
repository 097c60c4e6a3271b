"""Film parsers for `parser_fuzz`, with small valid films."""

import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tifffile
from film_checks import write_levels
from made_recordings import noise, write_cine, write_mraw, write_tiff, write_y4m

from heliograph.link.truth import noted_signal
from heliograph.media import open_film

FRAMES_READ = 200  # frame limit, since a damaged film may claim too many frames
MARK = b"--part--"  # separates mutated parts: files that belong together, or data protected by checksums
RATE_HZ = 1000.0  # frame rate for films without timestamps
SETTINGS_BYTES = 904
"""Smallest camera settings block in a .cine file; real blocks are mostly zeros, which would waste mutations."""
PNG = b"\x89PNG\r\n\x1a\n"  # PNG signature
CODECS = {".h5": None, ".mkv": "ffv1", ".nut": "ffv1", ".mp4": "h264", ".avi": "mjpeg"}  # codec per film format
WITHOUT_CLOCK = (".npy", ".tif", ".png", ".jpg")  # film formats that lack a frame rate
Parser = Callable[[bytes, Path], object]
Seeds = dict[str, tuple[Parser, list[bytes]]]  # parser and valid inputs by name


def read(path: Path, rate_hz: float | None = None) -> None:
    with open_film(path, rate_hz=rate_hz) as film:
        noted_signal(film)
        for _, _ in zip(film, range(FRAMES_READ), strict=False):
            pass


def film_parser(suffix: str) -> Parser:
    def parse(data: bytes, folder: Path) -> None:
        path = folder / f"a{suffix}"
        path.write_bytes(rejoined(data) if suffix == ".png" else data)
        read(path, RATE_HZ if suffix in WITHOUT_CLOCK else None)

    return parse


def photron_parser(header: str) -> Parser:
    """Return a parser for a mutated header and its mutated frames; the header or the frames name the film."""

    def parse(data: bytes, folder: Path) -> None:
        path = folder / f"photron{header[1:]}" / f"a{header}"
        path.parent.mkdir(exist_ok=True)
        said, _, frames = data.partition(MARK)
        path.write_bytes(said)
        path.with_suffix(".mraw").write_bytes(frames)
        read(path if header == ".cih" else path.with_suffix(".mraw"))

    return parse


def shots_parser(suffix: str, whole: bytes) -> Parser:
    """Return a parser for three pictures, the second one mutated, read as a folder or as a pattern."""

    def parse(data: bytes, folder: Path) -> None:
        place = folder / f"shots{suffix[1:]}"
        place.mkdir(exist_ok=True)
        for number, held in enumerate((whole, rejoined(data) if suffix == ".png" else data, whole)):
            (place / f"{number}{suffix}").write_bytes(held)
        read(place if len(data) % 2 else place / f"%d{suffix}", RATE_HZ)

    return parse


def chunks(picture: bytes) -> bytes:
    """Return kind and content of each PNG chunk, so that mutations pass the checksums."""
    parts, place = [], len(PNG)
    while place < len(picture):
        length = int.from_bytes(picture[place : place + 4], "big")
        parts.append(picture[place + 4 : place + 8 + length])
        place += 12 + length
    return MARK.join(parts)


def rejoined(data: bytes) -> bytes:
    """Reassemble a PNG picture from chunks with correct checksums; return a complete picture unchanged."""
    if data.startswith(PNG[:2]):
        return data
    parts = data.split(MARK)
    held = [max(0, len(part) - 4).to_bytes(4, "big") + part + zlib.crc32(part).to_bytes(4, "big") for part in parts]
    return PNG + b"".join(held)


def coded(suffix: str, picture: Any, *options: int) -> bytes:
    return bytes(cv2.imencode(suffix, picture, list(options))[1])


def film_seeds(folder: Path, note: str) -> Seeds:
    """Return parsers with films from `create_film`, from cameras, and from pictures."""
    found, metadata = {}, {"heliograph_signal": note}
    for suffix, codec in CODECS.items():
        path = write_levels(folder / f"b{suffix}", noise(12, 16, 24, 8), codec=codec, metadata=metadata)
        found[suffix] = [path.read_bytes()]
    found |= {**foreign(folder), ".png": still(".png", deep=True), ".jpg": still(".jpg")}
    films = {f"film{suffix}": (film_parser(suffix), good) for suffix, good in found.items()}
    for header in (".cih", ".cihx"):
        films[f"film{header}"] = (photron_parser(header), photron(folder, header))
    for suffix in (".png", ".jpg", ".tif"):
        good = still(suffix)
        films[f"shots{suffix}"] = (shots_parser(suffix, good[0]), good)
    return films


def foreign(folder: Path) -> dict[str, list[bytes]]:
    """Return valid single-file films from other software, by suffix."""
    path, times_s = folder / "c", [0.25, 0.251, 0.252]
    arrays = []
    for levels in (noise(3, 6, 8, 8), noise(3, 6, 8, 16).astype(">u2")):
        np.save(folder / "c.npy", levels)
        arrays.append((folder / "c.npy").read_bytes())
    cines = [
        write_cine(path, list(noise(3, 6, columns, depth)), word, depth, stamps, settings=SETTINGS_BYTES).read_bytes()
        for word, depth, columns, stamps in ((8, 8, 8, times_s), (16, 12, 8, None), (10, 10, 8, times_s),
                                             (12, 12, 8, None))
    ]  # fmt: skip
    colours = noise(3, 6, 24, 8).reshape(3, 6, 8, 3)
    cines.append(write_cine(path, list(colours), 24, 8, times_s, settings=SETTINGS_BYTES).read_bytes())
    stacks = [
        write_tiff(path, noise(3, 6, 8, bits), order, big).read_bytes()
        for bits, order, big in ((8, "<", False), (16, ">", False), (16, "<", True))
    ]
    tifffile.imwrite(path, noise(4, 6, 10, 16), imagej=True, truncate=True)
    stacks.append(path.read_bytes())
    cv2.imwritemulti(str(folder / "c.tif"), list(noise(3, 16, 24, 8)))  # compressed
    stacks.append((folder / "c.tif").read_bytes())
    raw = [write_y4m(path, form).read_bytes() for form in ("mono", "420jpeg", "420p10")]
    return {".npy": arrays, ".cine": cines, ".tif": stacks, ".y4m": raw}


def photron(folder: Path, header: str) -> list[bytes]:
    """Return headers and frames for each bit depth and alignment."""
    good = []
    for word, depth, side in ((8, 8, "Lower"), (12, 12, "Lower"), (16, 12, "Higher")):
        path = write_mraw(folder / "c.mraw", noise(3, 4, 4, depth), word, depth, header, side=side)
        good.append(path.with_suffix(header).read_bytes() + MARK + path.read_bytes())
    return good


def still(suffix: str, deep: bool = False) -> list[bytes]:
    """Return encoded pictures: 8-bit gray first, then colour, and 16-bit if `deep`."""
    soft: Any = cv2.GaussianBlur(noise(1, 16, 24, 8)[0], (0, 0), 2)
    coloured = np.dstack([soft, soft // 2, 255 - soft])
    good = [coded(suffix, soft), coded(suffix, coloured)]
    if suffix == ".jpg":
        good.append(coded(suffix, coloured, cv2.IMWRITE_JPEG_PROGRESSIVE, 1))
    if deep:
        good.append(coded(suffix, soft.astype(np.uint16) * 257))
    return [*good, *map(chunks, good)] if suffix == ".png" else good
