"""Films of a picture per frame: folders, numbered patterns, and animated GIF, PNG and WebP."""

import io
import re
import statistics
import struct
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from heliograph.base.errors import MediaError, brief
from heliograph.base.frames import BITS, Frame, Pixels
from heliograph.media import tiff
from heliograph.media.numbered import NumberedReader, camera_rate
from heliograph.media.reader import FilmReader, Reading, checked_size, checked_time

if TYPE_CHECKING:
    from PIL.Image import Image


LUMA = (0.114, 0.587, 0.299)
"""Weights of blue, green and red in luma (Rec. ITU-R BT.601)."""

SILENT = 0
"""OpenCV's level of logging at which it says nothing, LOG_LEVEL_SILENT."""

_BGR = {"blue": 0, "green": 1, "red": 2}
"""Place of each colour in a pixel of OpenCV and of .cine files."""


def decode(data: bytes) -> NDArray[np.generic] | None:
    """Return a PNG, TIFF, JPEG or other picture that OpenCV reads, turned as it says; None where it is damaged.

    Parameters
    ----------
    data
        The whole file, of which the first page is taken.

    Returns
    -------
    (rows, columns) for gray, (rows, columns, 3) for blue, green and red; of the file's own type.
    """
    import cv2

    with _silence():
        try:
            picture: NDArray[np.generic] | None = cv2.imdecode(np.frombuffer(data, np.uint8), _as_it_is())
        except cv2.error:
            return None
    return picture


def checked_form(path: Path, picture: NDArray[np.generic]) -> NDArray[np.generic]:
    """Return a picture if it is one of gray levels or of three colours."""
    if picture.dtype not in BITS or picture.shape[2:] not in ((), (3,)):
        kind = f"{picture.dtype} in {(*picture.shape, 1)[2]} channels"
        raise MediaError(f"{path} has pixels of {kind}: save gray or RGB of 8 or 16 bits")
    return picture


def to_gray(picture: NDArray[np.generic], channel: str) -> Pixels:
    """Return the gray levels of a picture. Returns (rows, columns) gray levels of the same type."""
    pixels: Pixels
    if picture.ndim == 2:
        pixels = np.ascontiguousarray(picture)
    elif channel == "luma":
        pixels = np.rint(picture @ np.array(LUMA)).astype(picture.dtype)
    else:
        pixels = np.ascontiguousarray(picture[..., _BGR[channel]])
    return pixels


def _as_it_is() -> int:
    """OpenCV's flags for a picture with its own bits, in gray or colour, turned as it says."""
    import cv2

    return int(cv2.IMREAD_ANYDEPTH | cv2.IMREAD_ANYCOLOR)


@contextmanager
def _silence() -> Iterator[None]:
    """Keep OpenCV from writing of damaged pictures to standard error: what is wrong is said in one line of our own."""
    import cv2

    # OpenCV 4.5 has no room of its own for it
    log = getattr(cv2.utils, "logging", cv2)
    before = log.getLogLevel()
    log.setLogLevel(SILENT)
    try:
        yield
    finally:
        log.setLogLevel(before)


_KINDS = {
    ".png": (".png",),
    ".jpg": (".jpg", ".jpeg", ".jpe"),
    ".tif": tiff.SUFFIXES,
    ".bmp": (".bmp", ".dib"),
    ".pgm": (".pgm", ".ppm", ".pnm", ".pbm", ".pam"),
    ".webp": (".webp",),
    ".jp2": (".jp2",),
}
"""Suffixes of each kind of picture that a folder is searched for."""

_KIND_OF = {suffix: kind for kind, suffixes in _KINDS.items() for suffix in suffixes}

PICTURE_SUFFIXES = tuple(_KIND_OF)
"""Suffixes of pictures that a folder is searched for."""

_PATTERN = re.compile(r"(?P<before>[^%]*)%(?:0(?P<digits>\d+))?d(?P<after>[^%]*)")
"""A name with one place for a number: %d, or %04d for four digits and more."""

_DIGITS = re.compile(r"([0-9]+)")
"""Numbers in a name; Python's \\d has digits of other scripts, too."""

_PNG = b"\x89PNG\r\n\x1a\n"
"""First bytes of a PNG file (PNG specification, 5.2)."""

_JPEG = b"\xff\xd8"
"""First bytes of a JPEG file (ITU-T T.81, B.1.1.3)."""

_STILLS = (_JPEG, b"BM", b"RIFF", b"\0\0\0\x0cjP  ", b"\xff\x4f\xff\x51")
"""First bytes of files that hold one picture, where the suffix says so: JPEG, BMP, WebP, JPEG 2000."""

_NETPBM = re.compile(rb"P([2-6])(?:\s+|#[^\n]*\n)+(\d+)(?:\s+|#[^\n]*\n)+(\d+)(?:(?:\s+|#[^\n]*\n)+(\d+))?\s")
"""Header of a PBM, PGM or PPM picture: its kind, columns, rows, and largest level."""

_JPEG_SCAN = 0xDA
"""Kind of the segment before the blocks of a JPEG picture (ITU-T T.81, table B.1)."""

_JPEG_NOTES = (frozenset(range(0xE0, 0xF0)) - {0xEE}) | {0xFE}
"""Kinds of the segments that applications write, and of comments (the same); APP14 says how colours are meant."""

_MOST_DIGITS = 255
"""Most digits of a number in a pattern: a name has no more characters."""

_MOST_BYTES = 1 << 31
"""Most bytes of a picture's file, which is read as a whole. Chosen: OpenCV takes no more."""

Numbered = list[tuple[int, str]]
"""Numbers of frames, rising from 0, and the names of their pictures."""


class ImagesReader(NumberedReader):
    """A film of a picture for each frame; see `FilmReader`. It has no clock, so the rate is needed."""

    _decodes = True
    faster = ("HDF5",)

    def __init__(self, path: Path, reading: Reading) -> None:
        super().__init__(path, reading.rate_hz)
        self._folder, self._names = _named(path)
        self._channel = reading.channel
        self.claimed_hz = camera_rate(path, reading.rate_hz)
        first, self.bits = self._picture(self._names[0][1], 0)
        self.height, self.width = first.shape
        self.frame_count = len(self._names)
        self.metadata = {}

    def _pictures(self) -> Iterator[tuple[int, Pixels]]:
        for count, (number, name) in enumerate(self._names):
            pixels, bits = self._picture(name, count)
            if pixels.shape != (self.height, self.width) or bits != self.bits:
                got = f"{pixels.shape[1]}x{pixels.shape[0]} pixels of {bits} bits"
                raise MediaError(
                    f"{self._folder / name} has {got}, those before {self.width}x{self.height} of {self.bits}: give "
                    "each recording a folder of its own"
                )
            yield number, pixels

    def _picture(self, name: str, count: int) -> tuple[Pixels, int]:
        """Gray levels of a picture, and their bits."""
        path = self._folder / name
        try:
            data = path.read_bytes() if path.is_file() and path.stat().st_size < _MOST_BYTES else b""
        except OSError as error:
            raise MediaError(f"cannot read {path}, after {count} frames: {error.strerror}") from error
        if data.startswith(tiff.SIGNATURES):
            return tiff.single_picture(path, self._channel)
        picture = decode(data) if data and _is_whole(path, data) and _scans_whole(data) else None
        if picture is None:
            raise MediaError(f"{path} is damaged or no picture, after {count} frames: copy it again, or take it away")
        checked_size(path, picture.shape[1], picture.shape[0])
        pixels = to_gray(checked_form(path, picture), self._channel)
        bits = 8 * pixels.itemsize
        if (header := _NETPBM.match(data)) is not None:
            _check_single(path, header, data)
            bits = max(8, int(header[4] or 255).bit_length())
        return pixels, bits


def is_picture(path: Path, head: bytes) -> bool:
    """Return True if a file is a single picture, which FFmpeg would take for a pattern or a stream."""
    if head.startswith(b"RIFF") and head[8:12] != b"WEBP":  # such as AVI
        return False
    return head.startswith(_PNG) or (head.startswith(_STILLS) and path.suffix.lower() in PICTURE_SUFFIXES)


def is_pattern(path: Path) -> bool:
    """Return whether a path names pictures by a number, such as img%04d.png, and is no file itself."""
    return _PATTERN.fullmatch(path.name) is not None and not path.exists()


def _is_whole(path: Path, data: bytes) -> bool:
    """True if Pillow does not know the kind of picture, or finds its size that of a camera and its PNG chunks whole."""
    from PIL import Image, UnidentifiedImageError

    with warnings.catch_warnings(action="ignore"):  # of sizes that are checked here
        try:
            with Image.open(io.BytesIO(data)) as image:
                checked_size(path, *image.size)
                if image.format in ANIMATED and (several := getattr(image, "n_frames", 1)) > 1:
                    raise MediaError(
                        f"{path} holds {several} pictures, not one: give it by its own name, not by its folder"
                    )
                if image.format == "PNG":
                    image.verify()
        except Image.DecompressionBombError:
            raise MediaError(f"{path} claims more pixels than any camera has: it is no frame, or damaged") from None
        except UnidentifiedImageError:
            return not data.startswith((_PNG, _JPEG))
        except MediaError:
            raise
        except (OSError, SyntaxError, ValueError, EOFError, struct.error, IndexError, KeyError, TypeError):
            return False
    return True


def _check_single(path: Path, header: re.Match[bytes], data: bytes) -> None:
    """Refuse a Netpbm file of several pictures, of which OpenCV reads the first."""
    kind, columns, rows, largest = (int(number or 0) for number in header.groups())
    samples = rows * columns * (3 if kind == 6 else 1)
    size = rows * -(-columns // 8) if kind == 4 else samples * (2 if largest > 255 else 1)
    if kind >= 4 and _NETPBM.match(data, header.end() + size):
        raise MediaError(f"{path} holds several pictures, not one: give it by its own name, not by its folder")


def _scans_whole(data: bytes) -> bool:
    """Whether a JPEG picture has all its blocks; of those that it lacks OpenCV makes gray ones. Others are whole.

    What a camera notes in the file is not looked at. Of forms that FFmpeg does not know this is not found out.
    """
    if not data.startswith(_JPEG):
        return True
    import av

    decoder = av.CodecContext.create("mjpeg", "r")
    decoder.options, decoder.thread_count = {"err_detect": "explode"}, 1
    try:
        decoder.decode(av.Packet(_without_notes(data)))
    except av.error.InvalidDataError:
        return False
    except av.error.FFmpegError:
        return True
    return True


def _without_notes(data: bytes) -> bytes:
    """A JPEG file without its segments APPn, but for the colours' APP14, and without comments."""
    kept, place = [_JPEG], len(_JPEG)
    while place + 4 <= len(data):
        kind, length = struct.unpack_from(">xBH", data, place)
        if kind == _JPEG_SCAN:
            break
        if kind not in _JPEG_NOTES:
            kept.append(data[place : place + 2 + length])
        place += 2 + length
    return b"".join([*kept, data[place:]])


def _named(path: Path) -> tuple[Path, Numbered]:
    """The folder of a film's pictures, and their names."""
    if path.is_dir():
        return path, _of_folder(path)
    return path.parent, [(0, path.name)] if path.exists() else _of_pattern(path)


def _of_folder(folder: Path) -> Numbered:
    try:
        names = [entry.name for entry in folder.iterdir() if _is_picture(entry)]
    except OSError as error:
        raise MediaError(f"cannot read the folder {folder}: {error.strerror}") from error
    if not names:
        kinds = ", ".join(PICTURE_SUFFIXES)
        raise MediaError(f"{folder} is a folder without pictures ({kinds}): give a film in it, or a folder of pictures")
    kinds_held = sorted({_KIND_OF[Path(name).suffix.lower()] for name in names})
    if len(kinds_held) > 1:
        raise MediaError(
            f"{folder} has pictures of several kinds ({', '.join(kinds_held)}): give those you mean as a pattern, such "
            f"as {folder / 'img%04d.png'}"
        )
    return list(enumerate(sorted(names, key=_natural)))


def _is_picture(entry: Path) -> bool:
    return entry.suffix.lower() in PICTURE_SUFFIXES and not entry.name.startswith(".") and not entry.is_dir()


def _of_pattern(path: Path) -> Numbered:
    parts = _PATTERN.fullmatch(path.name)
    assert parts is not None
    digits = min(int(parts["digits"] or 1), _MOST_DIGITS)
    name = re.compile(rf"{re.escape(parts['before'])}([0-9]+){re.escape(parts['after'])}")
    try:
        named = [(match[1], entry.name) for entry in path.parent.iterdir() if (match := name.fullmatch(entry.name))]
        # img1 and img01 have the same number: one of them is what the pattern makes of it
        found = [(int(number), held) for number, held in named if number == f"{int(number):0{digits}}"]
    except OSError as error:
        raise MediaError(f"cannot read the folder {path.parent}: {error.strerror}") from error
    if not found:
        raise MediaError(f"there is no picture {path}: check the name, and how many digits the number has")
    found.sort()
    return [(number - found[0][0], held) for number, held in found]


def _natural(name: str) -> tuple[list[tuple[int, int, str]], str]:
    """Key that sorts img10 behind img9, whatever characters names have."""
    parts = _DIGITS.split(name)  # numbers stand at odd places
    texts = [(1, 0, text) if place % 2 == 0 else (0, int(text), "") for place, text in enumerate(parts) if text]
    return texts, name


ANIMATED = ("GIF", "PNG", "WEBP")
"""Kinds of pictures that can be animated, under Pillow's names."""

SIGNATURES = (b"GIF8", b"\x89PNG\r\n\x1a\n", b"RIFF")
"""First bytes of such files; those that begin with RIFF may be films."""

_DEFAULT_S = 0.1
"""Time of a picture that states none, as browsers show it."""

_FRAMES_TIMED = 100
"""Pictures whose times tell the rate. Chosen: the times of later ones are read while they are decoded."""

_BROKEN = (OSError, SyntaxError, ValueError, EOFError, struct.error, IndexError, KeyError, TypeError)
"""Errors of Pillow on damaged files."""


class AnimationReader(FilmReader):
    """An animated picture; see `FilmReader`. Times are the sums of the times for which the pictures are shown."""

    _decodes = True
    faster = ("HDF5",)

    def __init__(self, path: Path, reading: Reading) -> None:
        super().__init__(path, reading.rate_hz)
        self._channel = reading.channel
        shown = [seconds for _, seconds in islice(self._decoded(), _FRAMES_TIMED)]
        self.claimed_hz = 1 / statistics.median(shown)
        with _opened(path) as image:
            self.width, self.height = image.size
            self.frame_count = getattr(image, "n_frames", 1)
        first, _ = next(self._decoded())
        self.bits = 8 * first.itemsize
        self.metadata = {}

    def _frames(self) -> Iterator[Frame]:
        index, time_s = -1, 0.0
        for count, (pixels, delay_s) in enumerate(self._decoded()):
            index = max(index + 1, round(checked_time(self.path, time_s, count) * self.rate_hz))
            yield Frame(index, time_s, pixels, self.bits)
            time_s += 1 / self._true_hz if self._true_hz else delay_s

    def _decoded(self) -> Iterator[tuple[Pixels, float]]:
        """Yield the gray levels of each picture and the time in s for which it is shown."""
        count = 0
        try:
            with _opened(self.path) as image:
                for count in range(getattr(image, "n_frames", 1)):
                    image.seek(count)
                    image.load()
                    yield _levels(image, self._channel), float(image.info.get("duration") or 0) / 1e3 or _DEFAULT_S
        except MediaError:
            raise
        except _BROKEN as error:
            raise MediaError(
                f"{self.path} cannot be read after {count} whole frames ({brief(error)}): copy it again"
            ) from None


def is_animation(path: Path, head: bytes) -> bool:
    """Return True if a file is a GIF, or a PNG or WebP file of several pictures."""
    if not head.startswith(SIGNATURES) or (head.startswith(b"RIFF") and path.suffix.lower() != ".webp"):
        return False
    try:
        with _opened(path) as image:
            return image.format == "GIF" or getattr(image, "n_frames", 1) > 1
    except (MediaError, *_BROKEN):
        return False


def _opened(path: Path) -> "Image":
    from PIL import Image

    try:
        image = Image.open(path, formats=ANIMATED)
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
