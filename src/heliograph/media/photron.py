"""Read recordings of Photron cameras: raw frames in a .mraw file and the header in a .cih or .cihx file."""

import codecs
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from heliograph.base.errors import MediaError, brief
from heliograph.base.files import read_bounded
from heliograph.base.frames import Pixels
from heliograph.media.phantom import packed_size, read_levels
from heliograph.media.reader import Reading, clear_read_errors
from heliograph.media.stamps import BlockReader

_CODECS = ("ascii", "utf-16-le", "utf-16-be")
_BLANK = " \t\r\n\0"
SUFFIXES = (".mraw", ".cihx", ".cih")  # suffixes of the frames, and of headers in XML and in lines of text

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
"""Name of each value's line in .cih, in small letters, and the path in .cihx."""


class PhotronReader(BlockReader):
    """A Photron recording; see `FilmReader`.

    The rate counts saved frames: the record rate over the save step. A recording of 10,000 frames a second with
    a step of 10 has 1000 frames a second; the others do not count as lost.
    """

    def __init__(self, path: Path, reading: Reading) -> None:
        frames, header = _find_pair(path)
        super().__init__(frames, reading)
        texts = _read_header(header)
        self._check_kind(header, texts)
        self.width, self.height = _number(header, texts, "width"), _number(header, texts, "height")
        self._set_blocks(_number(header, texts, "frames"), packed_size(self.width * self.height, self._word))
        saved_hz = _number(header, texts, "rate", 0, float) / max(1, _number(header, texts, "step", 1))
        self._number_frames(saved_hz, header)
        notes = ("camera", "date", "time", "shutter", "comment", "rate", "step")
        self.metadata = {name: texts[name] for name in notes if texts[name]}
        self._check_length(header)

    def _check_kind(self, header: Path, texts: Mapping[str, str]) -> None:
        """Set the bits of a level and of a word, or refuse the kind."""
        kind, colour = texts["kind"] or "mraw", texts["colour"].lower() or "mono"
        if kind.lower() != "mraw":
            raise MediaError(f"{header} states that its frames are {brief(kind)} files: give the folder and --fps")
        self._word = _number(header, texts, "word")
        if self._word not in (8, 12, 16) or colour not in ("mono", "raw", "bayer"):
            held = f"{brief(colour)} of {self._word} bits"
            raise MediaError(f"{header} says {held}, and gray of 8, 12 or 16 bits is read: save it as raw or as TIFF")
        self.bits = min(_number(header, texts, "depth", self._word), self._word)
        if self.bits < 8 + (self._word > 8):
            raise MediaError(f"{header} says that {self._word} bits hold levels of {self.bits}: save it in 8 bits")
        # some programs keep a level at the upper end of the word
        self._shift = self._word - self.bits if texts["side"].lower() == "higher" else 0

    def _check_length(self, header: Path) -> None:
        """Refuse a file longer than in the header, or with levels of other bits; a cut file is read."""
        size, frames, pixels = self.path.stat().st_size, self._claimed, self.width * self.height
        words = [word for word in {8, 12, 16} - {self._word} if size == frames * packed_size(pixels, word)]
        if words or size > frames * self._frame_bytes:
            held = f"{size} bytes" + (f", which are {frames} frames of {words[0]} bits" if words else "")
            stated = f"{frames} frames of {self._frame_bytes} bytes, {self._word} bits"
            raise MediaError(f"{self.path} has {held}, and {header.name} says {stated}: give the matching header")

    def _levels(self, data: bytearray) -> Pixels:
        levels = read_levels(data, self._word)[: self.width * self.height]
        return np.right_shift(levels, levels.dtype.type(self._shift)).reshape(self.height, self.width)


def _find_pair(path: Path) -> tuple[Path, Path]:
    """Return the file of frames and the header; `path` is either."""
    with clear_read_errors(f"the folder {path.parent}"):
        pair = [file for file in sorted(path.parent.iterdir()) if file.stem == path.stem and file.is_file()]
    files = {file.suffix.lower(): file for file in pair}  # in sorted order small letters come last, and win
    files[path.suffix.lower()] = path
    header = path if path.suffix.lower() != ".mraw" else files.get(".cihx", files.get(".cih"))
    if header is None:
        raise MediaError(f"{path} has no header next to it: copy {path.stem}.cihx or .cih to the same folder")
    if ".mraw" not in files:
        raise MediaError(f"{path} has no frames next to it: copy {path.stem}.mraw to the same folder")
    return files[".mraw"], header


def _read_header(path: Path) -> dict[str, str]:
    """Return the values of a header as text, empty if missing."""
    with clear_read_errors(path):
        data = read_bounded(path, 1 << 24)
    is_xml = any("<cih>".encode(codec) in data for codec in _CODECS)
    texts = _parse_xml(path, data) if is_xml else _parse_lines(_decode(data))
    if not any(texts.values()):
        raise MediaError(f"{path} is no header of a Photron recording: copy the .cih or .cihx file again")
    return texts


def _decode(data: bytes) -> str:
    """Return the text of a header; UTF-16 that lacks a byte order mark has a zero in every second place."""
    zeros = data[::2].count(0), data[1::2].count(0)
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return data.decode("utf-16", "replace")
    if max(zeros) > len(data) / 4:
        return data.decode("utf-16-be" if zeros[0] > zeros[1] else "utf-16-le", "replace")
    for name in ("utf-8-sig", "cp932"):
        with suppress(UnicodeDecodeError):
            text = data.decode(name)
            if not re.search("[\ue000-\uf8ff]", text):  # private characters, into which Shift-JIS turns some Latin-1
                return text
    return data.decode("latin-1")


def _parse_xml(path: Path, data: bytes) -> dict[str, str]:
    # the element <cih> has no declarations, so no entity can expand
    wrong: Exception | None = None
    for codec in _CODECS:  # in either byte order of UTF-16 the tag of the other seems to begin a byte later
        start, end = data.find("<cih>".encode(codec)), data.rfind("</cih>".encode(codec)) + len("</cih>".encode(codec))
        text = _decode(data[start:end]) if codec == "ascii" else data[start:end].decode(codec, "replace")
        try:
            root = ElementTree.fromstring(text if start >= 0 else "")
            return {name: (root.findtext(place) or "").strip(_BLANK) for name, (_, place) in _PLACES.items()}
        except (ElementTree.ParseError, ValueError) as error:
            wrong = error if start >= 0 else wrong
    raise MediaError(f"{path} cannot be read, the XML is wrong ({brief(wrong)}): copy the header again") from None


def _parse_lines(text: str) -> dict[str, str]:
    lines = [line.partition(":") for line in text.splitlines() if ":" in line]
    # the first of several lines of a name counts
    values = {name.strip(_BLANK).lower(): value.strip(_BLANK) for name, _, value in reversed(lines)}
    return {name: values.get(line, "") for name, (line, _) in _PLACES.items()}


def _number(path: Path, texts: Mapping[str, str], name: str, missing: int | None = None, kind: Any = int) -> Any:
    """Return a number of the header."""
    text, line = texts[name] or ("" if missing is None else str(missing)), _PLACES[name][0]
    if not text:
        raise MediaError(f"{path} does not state its {line}: copy the header saved with the frames, or add the line")
    with suppress(ValueError):
        if 0 <= kind(text) < 1 << 31:
            return kind(text)
    raise MediaError(f"{path} says {text!r:.40} for its {line}: copy the header again, or correct it")
