"""Read recordings of Photron cameras: raw frames in a .mraw file, and their header beside it in .cih or .cihx."""

import codecs
import math
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from heliograph.base.errors import MediaError, brief
from heliograph.base.files import read_bounded
from heliograph.base.frames import Pixels
from heliograph.media.numbered import NumberedReader, blocks, camera_rate, expected_frames, packed_size, unpack
from heliograph.media.reader import Reading, checked_size

FRAMES_SUFFIX = ".mraw"
"""Suffix of the file of frames."""

HEADER_SUFFIXES = (".cihx", ".cih")
"""Suffixes of headers: XML, and lines of text by older programs."""

SUFFIXES = (FRAMES_SUFFIX, *HEADER_SUFFIXES)
"""Suffixes by which a recording may be named."""

_MOST_HEADER = 1 << 24
"""Most bytes of a header. Chosen: the largest that was seen has 19 kB, most of it tables of colours."""

_START, _END = "<cih>", "</cih>"
"""First and last element of the XML of a .cihx file; around it are bytes of another kind."""

_MARKS = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}
"""Encodings of text by its first bytes."""

_ENCODINGS = ("utf-8", "cp932")
"""Encodings without such bytes, of which the first that fits is taken; then Latin-1. The names of a header's lines are
the same in all."""

_XML_ENCODINGS = ("ascii", "utf-16-le", "utf-16-be")
"""Encodings of the tags of a .cihx file."""

_PRIVATE = re.compile("[\ue000-\uf8ff]")
"""Characters that no text has."""

_BLANKS = " \t\r\n\0"
"""Characters around a value."""

_WORDS = (8, 12, 16)
"""Bits that a level may take in the file."""

_PLACES = {
    "width": ("image width", "imageDataInfo/resolution/width"),
    "height": ("image height", "imageDataInfo/resolution/height"),
    "frames": ("total frame", "frameInfo/totalFrame"),
    "rate": ("record rate(fps)", "recordInfo/recordRate"),
    "step": ("save step", "frameInfo/skipFrame"),
    "word": ("color bit", "imageDataInfo/colorInfo/bit"),
    "colour": ("color type", "imageDataInfo/colorInfo/type"),
    "depth": ("effectivebit depth", "imageDataInfo/effectiveBit/depth"),
    "side": ("effectivebit side", "imageDataInfo/effectiveBit/side"),
    "kind": ("file format", "imageFileInfo/fileFormat"),
    "camera": ("camera type", "deviceInfo/deviceName"),
    "date": ("date", "fileInfo/date"),
    "time": ("time", "fileInfo/time"),
    "shutter": ("shutter speed(s)", "recordInfo/shutterSpeedNsec"),
    "comment": ("comment text", "basicInfo/comment"),
}
"""Where a header has each value: the name of its line in .cih, in small letters, and its path in .cihx."""

_NOTES = ("camera", "date", "time", "shutter", "comment", "rate", "step")
"""Values that become metadata of the film."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PhotronHeader:
    """What a header says of its frames."""

    # width, height: columns and rows in pixels, at least 1
    width: int
    height: int
    # Number of frames in the file
    frames: int
    # Frames per second that the camera took; 0 where the header does not say
    record_hz: float
    # Each so many-th frame was saved, at least 1
    step: int
    # Bits of a level in the file: 8, 12 (packed) or 16
    word: int
    # Bits of a gray level, 8 to 16
    bits: int
    # Bits by which a level is moved down, as some programs keep it at the upper end of its word
    shift: int
    # Camera, date and the like as text, by name
    notes: Mapping[str, str]

    @property
    def saved_hz(self) -> float:
        """Frames per second that are in the file; 0 where the header does not say."""
        return self.record_hz / self.step

    @property
    def frame_bytes(self) -> int:
        """Bytes of a frame in the file."""
        pixels = self.width * self.height
        return packed_size(pixels, 12) if self.word == 12 else pixels * self.word // 8


class PhotronReader(NumberedReader):
    """A Photron recording; see `FilmReader`.

    Its rate is that of the frames that were saved: the record rate over the save step. To the light a camera that takes
    10,000 frames a second and keeps each tenth is one of 1000; what it did not keep is not lost.
    """

    def __init__(self, path: Path, reading: Reading) -> None:
        frames, header = _pair(path)
        super().__init__(frames, reading.rate_hz)
        self._header = read_header(header)
        self.width, self.height, self.bits = self._header.width, self._header.height, self._header.bits
        self.claimed_hz = camera_rate(header, reading.rate_hz, self._header.saved_hz)
        self.frame_count = expected_frames(frames, self._header.frames, self._header.frame_bytes)
        self.metadata = dict(self._header.notes)
        _check_length(frames, header, self._header)

    def _pictures(self) -> Iterator[tuple[int, Pixels]]:
        head = self._header
        places = (count * head.frame_bytes for count in range(head.frames))
        for count, data in enumerate(blocks(self.path, places, head.frame_bytes)):
            yield count, _levels(data, head)


def read_header(path: Path) -> PhotronHeader:
    """Read a .cih or .cihx file."""
    try:
        data = read_bounded(path, _MOST_HEADER)
    except OSError as error:
        raise MediaError(f"cannot read {path}: {error.strerror}") from None
    is_xml = any(_START.encode(name) in data for name in _XML_ENCODINGS)
    texts = _of_xml(path, data) if is_xml else _of_lines(_decoded(data))
    if not any(texts.values()):
        raise MediaError(f"{path} is no header of a Photron recording: copy the .cih or .cihx file again")
    return _checked(path, texts)


def _checked(path: Path, texts: Mapping[str, str]) -> PhotronHeader:
    kind, colour = texts["kind"] or "mraw", texts["colour"].lower() or "mono"
    if kind.lower() != "mraw":
        raise MediaError(f"{path} says that its frames are {brief(kind)} files: give their folder and --fps")
    word = _whole(path, texts, "word")
    if word not in _WORDS or colour not in ("mono", "raw", "bayer"):
        raise MediaError(
            f"{path} says {brief(colour)} of {word} bits, and gray of 8, 12 or 16 bits can be read: save the recording "
            "as raw or monochrome, or as TIFF"
        )
    bits = min(_whole(path, texts, "depth", word), word)
    if bits < 8 + (word > 8):
        raise MediaError(
            f"{path} says that {word} bits hold levels of {bits}, fewer than can be read: save the recording in 8 bits"
        )
    width, height = _whole(path, texts, "width"), _whole(path, texts, "height")
    checked_size(path, width, height)
    return PhotronHeader(
        width=width,
        height=height,
        frames=_whole(path, texts, "frames"),
        record_hz=_rate(path, texts["rate"]),
        step=max(1, _whole(path, texts, "step", 1)),
        word=word,
        bits=bits,
        shift=word - bits if texts["side"].lower() == "higher" else 0,
        notes={name: texts[name] for name in _NOTES if texts[name]},
    )


def _levels(data: bytearray, head: PhotronHeader) -> Pixels:
    shape, pixels = (head.height, head.width), head.width * head.height
    if head.word == 8:
        return np.frombuffer(data, np.uint8).reshape(shape)
    levels = unpack(data, 12)[:pixels] if head.word == 12 else np.frombuffer(data, "<u2").astype(np.uint16)
    return np.right_shift(levels, np.uint16(head.shift)).reshape(shape)


def _pair(path: Path) -> tuple[Path, Path]:
    """The file of frames and its header, whichever of the two is named."""
    if path.suffix.lower() in HEADER_SUFFIXES:
        frames = _beside(path, (FRAMES_SUFFIX,))
        if frames is None:
            raise MediaError(f"{path} has no frames beside it: copy {path.stem}{FRAMES_SUFFIX} to the same folder")
        return frames, path
    header = _beside(path, HEADER_SUFFIXES)
    if header is None:
        raise MediaError(f"{path} has no header beside it: copy {path.stem}.cihx or .cih to the same folder")
    return path, header


def _beside(path: Path, suffixes: tuple[str, ...]) -> Path | None:
    try:
        # of two names that differ in case alone the one in small letters comes last, and stays
        held = {file.suffix.lower(): file for file in sorted(path.parent.iterdir()) if file.stem == path.stem}
    except OSError as error:
        raise MediaError(f"cannot read the folder {path.parent}: {error.strerror}") from error
    return next((held[suffix] for suffix in suffixes if suffix in held and held[suffix].is_file()), None)


def _check_length(frames: Path, header: Path, head: PhotronHeader) -> None:
    """Refuse a file that is longer than its header says, or has levels of other bits. A cut one is read."""
    claimed, size = head.frames * head.frame_bytes, frames.stat().st_size
    if size > claimed:
        raise MediaError(
            f"{frames} has {size} bytes, and {header.name} says {head.frames} frames of {head.frame_bytes}: give it "
            "its own header"
        )
    for word in _WORDS:
        if word != head.word and size == head.frames * replace(head, word=word).frame_bytes:
            raise MediaError(
                f"{frames} has {size} bytes, which are {head.frames} frames of {word} bits, and {header.name} says "
                f"{head.word} bits: give it its own header, or correct its color bit"
            )


def _decoded(data: bytes) -> str:
    """Text of a header; without a byte order mark, UTF-16 has a zero in every second place."""
    zeros = data[::2].count(0), data[1::2].count(0)
    wide = ("utf-16-be" if zeros[0] > zeros[1] else "utf-16-le") if max(zeros) > len(data) / 4 else None
    marked = next((name for mark, name in _MARKS.items() if data.startswith(mark)), wide)
    if marked:
        return data.decode(marked, "replace")
    for name in _ENCODINGS:
        with suppress(UnicodeDecodeError):
            text = data.decode(name)
            if not _PRIVATE.search(text):  # of which Shift-JIS makes some Latin-1
                return text
    return data.decode("latin-1")


def _of_xml(path: Path, data: bytes) -> dict[str, str]:
    # cut out of the file, it has no declarations, so nothing can be made to expand
    wrong: Exception | None = None
    for name in _XML_ENCODINGS:
        first, last = _START.encode(name), _END.encode(name)
        if first in data:
            cut = data[data.find(first) : data.rfind(last) + len(last)]
            try:
                root = ElementTree.fromstring(_decoded(cut) if name == "ascii" else cut.decode(name, "replace"))
                return {name: (root.findtext(place) or "").strip(_BLANKS) for name, (_, place) in _PLACES.items()}
            except (ElementTree.ParseError, ValueError) as error:
                wrong = error
    raise MediaError(
        f"{path} cannot be read, its XML is wrong ({brief(wrong)}): copy the header again, or correct it"
    ) from None


def _of_lines(text: str) -> dict[str, str]:
    held: dict[str, str] = {}
    for line in text.splitlines():
        name, colon, value = line.partition(":")
        if colon:
            held.setdefault(name.strip(_BLANKS).lower(), value.strip(_BLANKS))
    return {name: held.get(line, "") for name, (line, _) in _PLACES.items()}


def _whole(path: Path, texts: Mapping[str, str], name: str, missing: int | None = None) -> int:
    if not texts[name] and missing is not None:
        return missing
    try:
        value = int(texts[name])
    except ValueError:
        value = -1
    if not texts[name]:
        raise MediaError(
            f"{path} does not state its {_PLACES[name][0]}: copy the header that was saved with the frames, or add it"
        )
    if not 0 <= value < 1 << 31:
        raise MediaError(
            f"{path} says {texts[name]!r:.40} for its {_PLACES[name][0]}: copy the header again, or correct it"
        )
    return value


def _rate(path: Path, text: str) -> float:
    try:
        rate = float(text or 0)
    except ValueError:
        rate = math.nan
    if not 0 <= rate < math.inf:
        raise MediaError(f"{path} says {text!r:.40} for its record rate: give the rate by --fps, or copy it again")
    return rate
