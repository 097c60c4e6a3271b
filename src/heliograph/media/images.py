"""Read films that are a picture for each frame: all pictures of a folder, or those of a pattern such as img%04d.png."""

import re
from collections.abc import Iterator
from pathlib import Path

from heliograph.base.errors import MediaError
from heliograph.base.frames import Pixels
from heliograph.media import pictures, tiff
from heliograph.media.numbered import NumberedReader, camera_rate
from heliograph.media.reader import checked_size
from heliograph.media.reading import Reading

PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", *tiff.SUFFIXES)
"""Suffixes of pictures that a folder is searched for."""

_PATTERN = re.compile(r"(?P<before>[^%]*)%(?:0(?P<digits>\d+))?d(?P<after>[^%]*)")
"""A name with one place for a number: %d, or %04d for four digits and more."""

_DIGITS = re.compile(r"(\d+)")
"""Numbers in a name."""

_PNG, _PNG_SIZE = b"\x89PNG\r\n\x1a\n", slice(16, 24)
"""First bytes of a PNG file, and where it has its columns and rows (PNG specification, 11.2.1)."""

_MOST_BYTES = 1 << 31
"""Most bytes of a picture's file, which is read as a whole. Chosen: OpenCV takes no more."""

Numbered = list[tuple[int, str]]
"""Numbers of frames, rising from 0, and the names of their pictures."""


class ImagesReader(NumberedReader):
    """A film of a picture for each frame; see `FilmReader`. It has no clock, so the rate is needed.

    Parameters
    ----------
    path
        A folder, whose pictures are taken in the order of their names, numbers in them as numbers; or a pattern, by
        which a missing number is a lost frame.
    reading
        How the film is to be read.

    Raises
    ------
    MediaError
        There is no picture, the folder has several kinds, no rate was given, or the first picture cannot be read.
    """

    def __init__(self, path: Path, reading: Reading) -> None:
        super().__init__(path, reading.rate_hz)
        self._folder, self._names = (path, _of_folder(path)) if path.is_dir() else (path.parent, _of_pattern(path))
        self._channel = reading.channel
        self.claimed_hz = camera_rate(path, reading.rate_hz)
        first = self._picture(self._names[0][1], 0)
        self.height, self.width = first.shape
        self.bits = 8 * first.itemsize
        self.frame_count = len(self._names)
        self.metadata = {}

    def _pictures(self) -> Iterator[tuple[int, Pixels]]:
        for count, (number, name) in enumerate(self._names):
            pixels = self._picture(name, count)
            if pixels.shape != (self.height, self.width) or 8 * pixels.itemsize != self.bits:
                got = f"{pixels.shape[1]}x{pixels.shape[0]} pixels of {8 * pixels.itemsize} bits"
                raise MediaError(
                    f"{self._folder / name} has {got}, those before {self.width}x{self.height} of {self.bits}: give "
                    "each recording a folder of its own"
                )
            yield number, pixels

    def _picture(self, name: str, count: int) -> Pixels:
        path = self._folder / name
        try:
            data = path.read_bytes() if path.is_file() and path.stat().st_size < _MOST_BYTES else b""
        except OSError as error:
            raise MediaError(f"cannot read {path}, after {count} frames: {error.strerror}") from error
        check_claim(path, data)
        picture = pictures.decode(data) if data else None
        if picture is None:
            raise MediaError(f"{path} is damaged or no picture, after {count} frames: copy it again, or take it away")
        return pictures.to_gray(pictures.checked_form(path, picture), self._channel)


def is_pattern(path: Path) -> bool:
    """Return whether a path names pictures by a number, such as img%04d.png, and is no file itself.

    Parameters
    ----------
    path
        What was given for a film.
    """
    return _PATTERN.fullmatch(path.name) is not None and not path.exists()


def check_claim(path: Path, data: bytes) -> None:
    """Check the size that a PNG picture claims, before memory is taken for it.

    Parameters
    ----------
    path
        Its file, for the error.
    data
        Bytes of the file; those of another kind are not looked at.

    Raises
    ------
    MediaError
        No camera has so many pixels, or there are none.
    """
    if data.startswith(_PNG):
        columns, rows = (int.from_bytes(data[_PNG_SIZE][k : k + 4], "big") for k in (0, 4))
        checked_size(path, columns, rows)


def _of_folder(folder: Path) -> Numbered:
    try:
        names = [entry.name for entry in folder.iterdir() if _is_picture(entry)]
    except OSError as error:
        raise MediaError(f"cannot read the folder {folder}: {error.strerror}") from error
    if not names:
        kinds = ", ".join(PICTURE_SUFFIXES)
        raise MediaError(f"{folder} is a folder without pictures ({kinds}): give a film in it, or a folder of pictures")
    kinds_held = sorted({Path(name).suffix for name in names})
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
    digits = int(parts["digits"] or 1)
    name = re.compile(rf"{re.escape(parts['before'])}(\d{{{min(digits, 99)},}}){re.escape(parts['after'])}")
    try:
        found = [
            (int(match[1]), entry.name) for entry in path.parent.iterdir() if (match := name.fullmatch(entry.name))
        ]
    except OSError as error:
        raise MediaError(f"cannot read the folder {path.parent}: {error.strerror}") from error
    if not found:
        raise MediaError(f"there is no picture {path}: check the name, and how many digits the number has")
    found.sort()
    return [(number - found[0][0], held) for number, held in found]


def _natural(name: str) -> list[tuple[int, int, str]]:
    """Order of names in which img10 comes after img9."""
    return [(0, int(part), "") if part.isdigit() else (1, 0, part) for part in _DIGITS.split(name) if part]
