"""Films of a picture per frame: folders, numbered patterns, and animated GIF, PNG and WebP."""

import io
import re
import statistics
import struct
import warnings
from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from heliograph.base.errors import MediaError, brief
from heliograph.base.frames import BITS, Pixels
from heliograph.media import tiff
from heliograph.media.libraries import Image, av, cv2
from heliograph.media.reader import Reading, checked_size, clear_read_errors
from heliograph.media.stamps import TimedReader

_KINDS = {
    ".png": ".png", ".jpg": ".jpg", ".jpeg": ".jpg", ".jpe": ".jpg", ".tif": ".tif", ".tiff": ".tif", ".bmp": ".bmp",
    ".dib": ".bmp", ".pgm": ".pgm", ".ppm": ".pgm", ".pnm": ".pgm", ".pbm": ".pgm", ".pam": ".pgm", ".webp": ".webp",
    ".jp2": ".jp2",
}  # fmt: skip
PICTURE_SUFFIXES = tuple(_KINDS)  # suffixes of pictures in a folder

_PNG = b"\x89PNG\r\n\x1a\n"
_JPEG = b"\xff\xd8"
# header of a PBM, PGM or PPM picture: kind, columns, rows, and largest level
_NETPBM = re.compile(rb"P([2-6])(?:\s+|#[^\n]*\n)+(\d+)(?:\s+|#[^\n]*\n)+(\d+)(?:(?:\s+|#[^\n]*\n)+(\d+))?\s")
# a name with a number: %d, or %04d for four digits and more
_PATTERN = re.compile(r"(?P<before>[^%]*)%(?:0(?P<digits>\d+))?d(?P<after>[^%]*)")

_ANIMATED = ("GIF", "PNG", "WEBP")  # Pillow's names of formats for animations
_BROKEN = (OSError, SyntaxError, ValueError, EOFError, struct.error, IndexError, KeyError, TypeError)
"""Errors of Pillow for damaged files."""


def checked_form(path: Path, picture: NDArray[np.generic]) -> NDArray[np.generic]:
    """Refuse a picture with other channels than gray or three colours."""
    if picture.dtype not in BITS or picture.shape[2:] not in ((), (3,)):
        kind = f"{picture.dtype} in {(*picture.shape, 1)[2]} channels"
        raise MediaError(f"{path} has pixels of {kind}: save gray or RGB of 8 or 16 bits")
    return picture


def to_gray(picture: NDArray[np.generic], channel: str) -> Pixels:
    """Return the gray levels of a picture, (rows, columns) or (rows, columns, 3) for blue, green and red."""
    pixels: Pixels
    if picture.ndim == 2:
        pixels = np.ascontiguousarray(picture)
    elif channel == "luma":  # Rec. ITU-R BT.601
        pixels = np.rint(picture @ np.array([0.114, 0.587, 0.299])).astype(picture.dtype)
    else:
        pixels = np.ascontiguousarray(picture[..., ("blue", "green", "red").index(channel)])
    return pixels


class ImagesReader(TimedReader):
    """A film of a picture for each frame; see `FilmReader`. Pictures have no clock, so the rate is needed."""

    _decodes = True

    def __init__(self, path: Path, reading: Reading) -> None:
        super().__init__(path, reading)
        if path.is_dir():
            self._files = _list_folder(path)
        else:
            self._files = [(0, path)] if path.exists() else _list_pattern(path)
        self._number_frames()
        first, self.bits = self._picture(0)
        self.height, self.width = first.shape
        self.frame_count = len(self._files)

    def _pictures(self) -> Iterator[tuple[float, Pixels, int]]:
        for count, (number, _) in enumerate(self._files):
            yield number / self.claimed_hz, *self._picture(count)

    def _frame_name(self, count: int) -> str:
        return str(self._files[count][1])

    def _picture(self, count: int) -> tuple[Pixels, int]:
        """Return the gray levels of a picture, and the bits."""
        path = self._files[count][1]
        with clear_read_errors(f"{path}, after {count} frames"):
            # OpenCV reads less than 2 GiB
            data = path.read_bytes() if path.is_file() and path.stat().st_size < 1 << 31 else b""
        if data.startswith(tiff.SIGNATURES):
            return tiff.read_picture(path, self._channel)
        picture = _decode(data) if data and _is_sound(path, data) else None
        if picture is None:
            raise MediaError(f"{path} is damaged or no picture, after {count} frames: copy it again, or remove it")
        checked_size(path, picture.shape[1], picture.shape[0])
        pixels = to_gray(checked_form(path, picture), self._channel)
        bits = 8 * pixels.itemsize
        if (header := _NETPBM.match(data)) is not None:
            _check_single(path, header, data)
            bits = max(8, int(header[4] or 255).bit_length())
        return pixels, bits


def is_picture(path: Path, head: bytes) -> bool:
    """True if a file is a single picture, which FFmpeg would read as a pattern or a stream."""
    if head.startswith(b"RIFF") and head[8:12] != b"WEBP":  # such as AVI
        return False
    # JPEG, BMP, WebP and JPEG 2000 need the suffix as well
    stills = (_JPEG, b"BM", b"RIFF", b"\0\0\0\x0cjP  ", b"\xff\x4f\xff\x51")
    return head.startswith(_PNG) or (head.startswith(stills) and path.suffix.lower() in PICTURE_SUFFIXES)


def is_pattern(path: Path) -> bool:
    """True if a path names pictures by a number, such as img%04d.png, and no file has this name."""
    return _PATTERN.fullmatch(path.name) is not None and not path.exists()


def _decode(data: bytes) -> NDArray[np.generic] | None:
    """Decode a picture by OpenCV, gray or blue, green and red, with Exif orientation; None if damaged."""
    log = getattr(cv2.utils, "logging", cv2)  # OpenCV 4.5 has no module for it
    before = log.getLogLevel()
    log.setLogLevel(0)  # LOG_LEVEL_SILENT: errors report damage
    try:
        flags = int(cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR)
        picture: NDArray[np.generic] | None = cv2.imdecode(np.frombuffer(data, np.uint8), flags)
    except cv2.error:
        return None
    finally:
        log.setLogLevel(before)
    return picture


def _is_sound(path: Path, data: bytes) -> bool:
    """Check a PNG or JPEG picture, as OpenCV fills missing parts; True for other kinds."""
    try:
        with _opened(path, io.BytesIO(data)) as image:
            if image.format in _ANIMATED and (several := getattr(image, "n_frames", 1)) > 1:
                raise MediaError(f"{path} holds {several} pictures, not one: give the file's name, not the folder's")
            if image.format == "JPEG":
                return _has_all_blocks(data)
            if image.format == "PNG":
                image.verify()
    except MediaError:
        raise
    except _BROKEN:
        return not data.startswith((_PNG, _JPEG))
    return True


def _has_all_blocks(data: bytes) -> bool:
    """True if FFmpeg decodes all blocks of a JPEG picture, or does not know the form (ITU-T T.81, annex B)."""
    kept, place = [_JPEG], len(_JPEG)
    while place + 4 <= len(data) and data[place + 1] != 0xDA:  # up to the first scan
        end = place + 2 + int.from_bytes(data[place + 2 : place + 4], "big")
        if not (0xE0 <= data[place + 1] <= 0xEF or data[place + 1] == 0xFE):  # FFmpeg may misread notes of cameras
            kept.append(data[place:end])
        place = end
    decoder = av.CodecContext.create("mjpeg", "r")
    decoder.options, decoder.thread_count = {"err_detect": "explode"}, 1
    try:
        decoder.decode(av.Packet(b"".join([*kept, data[place:]])))
    except av.error.FFmpegError as error:
        return not isinstance(error, av.error.InvalidDataError)
    return True


def _check_single(path: Path, header: re.Match[bytes], data: bytes) -> None:
    """Refuse a Netpbm file of several pictures; OpenCV would read the first."""
    kind, columns, rows, largest = (int(number or 0) for number in header.groups())
    samples = rows * columns * (3 if kind == 6 else 1)
    size = rows * -(-columns // 8) if kind == 4 else samples * (2 if largest > 255 else 1)
    if kind >= 4 and _NETPBM.match(data, header.end() + size):
        raise MediaError(f"{path} holds several pictures, not one: give the file's name, not the folder's")


def _list_folder(folder: Path) -> list[tuple[int, Path]]:
    """Return the frame number and path of each picture in a folder."""
    with clear_read_errors(f"the folder {folder}"):
        files = [file for file in folder.iterdir() if file.suffix.lower() in _KINDS and not file.is_dir()]
    files = sorted((file for file in files if not file.name.startswith(".")), key=_natural_order)
    kinds = ", ".join(sorted({_KINDS[file.suffix.lower()] for file in files}))
    if not files:
        known = ", ".join(_KINDS)
        raise MediaError(f"{folder} is a folder without pictures ({known}): give a film in it, or a folder of pictures")
    if "," in kinds:
        name = folder / "img%04d.png"
        raise MediaError(f"{folder} has pictures of several kinds ({kinds}): give some of them as a pattern: {name}")
    return list(enumerate(files))


def _list_pattern(path: Path) -> list[tuple[int, Path]]:
    """Return the frame number and path of each picture of a pattern, counted from the first."""
    parts = _PATTERN.fullmatch(path.name)
    assert parts is not None
    digits = min(int(parts["digits"] or 1), 255)  # a name has no more characters
    name = re.compile(rf"{re.escape(parts['before'])}([0-9]+){re.escape(parts['after'])}")
    with clear_read_errors(f"the folder {path.parent}"):
        named = [(match[1], entry) for entry in path.parent.iterdir() if (match := name.fullmatch(entry.name))]
    # img1 and img01 have the same number; the pattern selects a name
    found = sorted((int(number), file) for number, file in named if number == f"{int(number):0{digits}}")
    if not found:
        raise MediaError(f"there is no picture {path}: check the name, and how many digits the number has")
    return [(number - found[0][0], file) for number, file in found]


def _natural_order(path: Path) -> tuple[list[tuple[int, int, str]], str]:
    """Return a sort key, by which img10 follows img9, for any characters."""
    parts = re.split(r"([0-9]+)", path.name)  # numbers stand at odd places; \d has digits of other scripts, too
    texts = [(1, 0, text) if place % 2 == 0 else (0, int(text), "") for place, text in enumerate(parts) if text]
    return texts, path.name


class AnimationReader(TimedReader):
    """An animated picture; see `FilmReader`. Times are sums of the display times."""

    _decodes = True

    def __init__(self, path: Path, reading: Reading) -> None:
        super().__init__(path, reading)
        first, _ = next(self._decoded())
        (self.height, self.width), self.bits = first.shape, 8 * first.itemsize
        self.claimed_hz = 1 / statistics.median(delay_s for _, delay_s in islice(self._decoded(), 100))

    def _pictures(self) -> Iterator[tuple[float, Pixels, int]]:
        time_s = 0.0
        for pixels, delay_s in self._decoded():
            yield time_s, pixels, self.bits
            time_s += delay_s

    def _decoded(self) -> Iterator[tuple[Pixels, float]]:
        """Yield the gray levels of each picture and the display time in s."""
        count = 0
        try:
            with _opened(self.path, self.path, _ANIMATED) as image:
                self.frame_count = getattr(image, "n_frames", 1)
                for count in range(self.frame_count):
                    image.seek(count)
                    image.load()
                    # browsers use 0.1 s if the time is missing
                    yield _levels(image, self._channel), float(image.info.get("duration") or 100) / 1e3
        except MediaError:
            raise
        except _BROKEN as error:
            text = f"cannot be read after {count} whole frames ({brief(error)}): copy it again"
            raise MediaError(f"{self.path} {text}") from None


def is_animation(path: Path, head: bytes) -> bool:
    """True if a file is a GIF, or a PNG or WebP file of several pictures."""
    if not (head.startswith((b"GIF8", _PNG)) or (head.startswith(b"RIFF") and path.suffix.lower() == ".webp")):
        return False
    try:
        with _opened(path, path, _ANIMATED) as image:
            return image.format == "GIF" or getattr(image, "n_frames", 1) > 1
    except _BROKEN:
        return False


def _opened(path: Path, source: Path | io.BytesIO, formats: tuple[str, ...] | None = None) -> "Image.Image":
    with warnings.catch_warnings(action="ignore"):  # of the size, which is checked here
        try:
            image = Image.open(source, formats=formats)
        except Image.DecompressionBombError:
            raise MediaError(f"{path} claims more pixels than any camera has: it is no film, or damaged") from None
    checked_size(path, *image.size)
    return image


def _levels(image: "Image.Image", channel: str) -> Pixels:
    if image.mode == "L" or image.mode.startswith("I;16"):
        levels = np.array(image)
        return to_gray(levels.astype(levels.dtype.newbyteorder("=")), channel)
    return to_gray(np.array(image.convert("RGB"))[..., ::-1], channel)
