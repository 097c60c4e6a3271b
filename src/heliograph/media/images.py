"""Films of a picture per frame: folders, numbered patterns, and animated GIF, PNG and WebP."""

import io
import re
import statistics
import struct
import warnings
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from heliograph.base.errors import MediaError, brief
from heliograph.base.frames import BITS, Pixels
from heliograph.base.lazy import LazyModule
from heliograph.media import tiff
from heliograph.media.reader import Reading, checked_size, clear_read_errors
from heliograph.media.stamps import TimedReader

if TYPE_CHECKING:
    import av
    import cv2
    from PIL.Image import Image
else:
    av = LazyModule("av")
    cv2 = LazyModule("cv2")

_KINDS = {
    ".png": ".png", ".jpg": ".jpg", ".jpeg": ".jpg", ".jpe": ".jpg", ".tif": ".tif", ".tiff": ".tif", ".bmp": ".bmp",
    ".dib": ".bmp", ".pgm": ".pgm", ".ppm": ".pgm", ".pnm": ".pgm", ".pbm": ".pgm", ".pam": ".pgm", ".webp": ".webp",
    ".jp2": ".jp2",
}  # fmt: skip
PICTURE_SUFFIXES = tuple(_KINDS)
"""Suffixes of pictures in a folder."""

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
    faster = ("HDF5",)

    def __init__(self, path: Path, reading: Reading) -> None:
        super().__init__(path, reading)
        self._folder, self._names = _find_pictures(path)
        self._number_frames()
        first, self.bits = self._picture(0)
        self.height, self.width = first.shape
        self.frame_count = len(self._names)

    def _pictures(self) -> Iterator[tuple[float, Pixels, int]]:
        for count, (number, _) in enumerate(self._names):
            yield number / self.claimed_hz, *self._picture(count)

    def _frame_name(self, count: int) -> str:
        return str(self._folder / self._names[count][1])

    def _picture(self, count: int) -> tuple[Pixels, int]:
        """Return the gray levels of a picture, and the bits."""
        path = self._folder / self._names[count][1]
        try:
            # OpenCV reads less than 2 GiB
            data = path.read_bytes() if path.is_file() and path.stat().st_size < 1 << 31 else b""
        except OSError as error:
            raise MediaError(f"cannot read {path}, after {count} frames: {error.strerror}") from error
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
    from PIL import Image, UnidentifiedImageError

    with warnings.catch_warnings(action="ignore"):  # the size is checked here
        try:
            with Image.open(io.BytesIO(data)) as image:
                checked_size(path, *image.size)
                if image.format in _ANIMATED and (several := getattr(image, "n_frames", 1)) > 1:
                    raise MediaError(
                        f"{path} holds {several} pictures, not one: give the file's name, not the folder's"
                    )
                if image.format == "JPEG":
                    return _has_all_blocks(data)
                if image.format == "PNG":
                    image.verify()
        except Image.DecompressionBombError:
            raise MediaError(f"{path} claims more pixels than any camera has: it is no frame, or damaged") from None
        except UnidentifiedImageError:
            return not data.startswith((_PNG, _JPEG))
        except MediaError:
            raise
        except _BROKEN:
            return False
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


def _find_pictures(path: Path) -> tuple[Path, list[tuple[int, str]]]:
    """Return a film's folder, and the frame number and name of each picture."""
    if path.is_dir():
        return path, _list_folder(path)
    return path.parent, [(0, path.name)] if path.exists() else _list_pattern(path)


def _list_folder(folder: Path) -> list[tuple[int, str]]:
    with clear_read_errors(f"the folder {folder}"):
        names = [entry.name for entry in folder.iterdir() if _is_named_picture(entry)]
    if not names:
        kinds = ", ".join(PICTURE_SUFFIXES)
        raise MediaError(f"{folder} is a folder without pictures ({kinds}): give a film in it, or a folder of pictures")
    kinds_held = sorted({_KINDS[Path(name).suffix.lower()] for name in names})
    if len(kinds_held) > 1:
        kinds, name = ", ".join(kinds_held), folder / "img%04d.png"
        raise MediaError(f"{folder} has pictures of several kinds ({kinds}): give some of them as a pattern: {name}")
    return list(enumerate(sorted(names, key=_natural_order)))


def _is_named_picture(entry: Path) -> bool:
    return entry.suffix.lower() in PICTURE_SUFFIXES and not entry.name.startswith(".") and not entry.is_dir()


def _list_pattern(path: Path) -> list[tuple[int, str]]:
    parts = _PATTERN.fullmatch(path.name)
    assert parts is not None
    digits = min(int(parts["digits"] or 1), 255)  # a name has no more characters
    name = re.compile(rf"{re.escape(parts['before'])}([0-9]+){re.escape(parts['after'])}")
    with clear_read_errors(f"the folder {path.parent}"):
        named = [(match[1], entry.name) for entry in path.parent.iterdir() if (match := name.fullmatch(entry.name))]
    # img1 and img01 have the same number; the pattern selects a name
    found = sorted((int(number), held) for number, held in named if number == f"{int(number):0{digits}}")
    if not found:
        raise MediaError(f"there is no picture {path}: check the name, and how many digits the number has")
    return [(number - found[0][0], held) for number, held in found]


def _natural_order(name: str) -> tuple[list[tuple[int, int, str]], str]:
    """Return a sort key, by which img10 follows img9, for any characters."""
    parts = re.split(r"([0-9]+)", name)  # numbers stand at odd places; \d has digits of other scripts, too
    texts = [(1, 0, text) if place % 2 == 0 else (0, int(text), "") for place, text in enumerate(parts) if text]
    return texts, name


class AnimationReader(TimedReader):
    """An animated picture; see `FilmReader`. Times are sums of the display times."""

    _decodes = True
    faster = ("HDF5",)

    def __init__(self, path: Path, reading: Reading) -> None:
        super().__init__(path, reading)
        self.claimed_hz = 1 / statistics.median(delay_s for _, delay_s in islice(self._decoded(), 100))
        with _opened(path) as image:
            self.width, self.height = image.size
            self.frame_count = getattr(image, "n_frames", 1)
        first, _ = next(self._decoded())
        self.bits = 8 * first.itemsize

    def _pictures(self) -> Iterator[tuple[float, Pixels, int]]:
        time_s = 0.0
        for pixels, delay_s in self._decoded():
            yield time_s, pixels, self.bits
            time_s += delay_s

    def _decoded(self) -> Iterator[tuple[Pixels, float]]:
        """Yield the gray levels of each picture and the display time in s."""
        count = 0
        try:
            with _opened(self.path) as image:
                for count in range(getattr(image, "n_frames", 1)):
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
        with _opened(path) as image:
            return image.format == "GIF" or getattr(image, "n_frames", 1) > 1
    except (MediaError, *_BROKEN):
        return False


def _opened(path: Path) -> "Image":
    from PIL import Image

    try:
        image = Image.open(path, formats=_ANIMATED)
    except Image.DecompressionBombError:
        raise MediaError(f"{path} claims more pixels than any camera has: it is no film, or damaged") from None
    except _BROKEN as error:
        raise MediaError(f"{path} cannot be read as an animated picture ({brief(error)}): copy it again") from None
    checked_size(path, *image.size)
    return image


def _levels(image: "Image", channel: str) -> Pixels:
    if image.mode == "L" or image.mode.startswith("I;16"):
        levels = np.array(image)
        return to_gray(levels.astype(levels.dtype.newbyteorder("=")), channel)
    return to_gray(np.array(image.convert("RGB"))[..., ::-1], channel)
