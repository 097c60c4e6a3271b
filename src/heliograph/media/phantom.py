"""Read recordings of Phantom cameras: .cine files of gray levels, with the stamps that the camera gave its frames."""

import struct
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from heliograph.base.errors import MediaError
from heliograph.base.frames import Pixels
from heliograph.media import images as pictures
from heliograph.media.numbered import blocks, camera_rate, expected_frames, packed_size, unpack
from heliograph.media.reader import Reading, checked_size
from heliograph.media.stamps import LIMITS, TimedReader, measure_pace

SUFFIXES = (".cine",)
"""Suffixes of Phantom recordings."""

SIGNATURE = b"CI\x2c\0"
"""First bytes of a recording: its mark, and the length of the file's header, 44."""

_FILE = struct.Struct("<2sHHHiIiIIIIQ")
"""The file's header: mark, length, compression, version; first frame and frames of the camera, then of the file; places
of the picture's header, of the camera's settings and of the table of frames; time of the trigger."""

_PICTURE = struct.Struct("<IiiHHIIiiII")
"""The picture's header, that of a Windows bitmap: length, columns, rows, planes, bits, packing, bytes, and others."""

_JPEG = 1
"""Compression of frames that are JPEG pictures."""

_PLAIN, _PACKED_10, _PACKED_12 = 0, 256, 1024
"""Packing of levels: whole bytes, 10 bits on a curve, 12 bits in proportion to the light."""

_SETTINGS = {"rate": 768, "levels": 896}
"""Places in the camera's settings of the frame rate and of the bits of a level, both of 32 bits. PyAV reads the same
rate of the recording in the tests."""

_STAMPS = 1002
"""Kind of the block that has the frames' times."""

_BLOCK = struct.Struct("<IHH")
"""Head of a block behind the settings: its length with this head, its kind, whether another follows."""

_SETTINGS_LENGTH = 142
"""Place in the camera's settings of their length, of 16 bits."""

_MARK = 140
"""Place in the camera's settings of their mark, "ST"."""

_TICKS = 1 << 32
"""Ticks of a stamp in a second."""

_FLAGS = 3
"""Bits of a stamp that are flags of the camera, not time: 0.5 ns."""

_LONGEST_GAP_S = 3600.0
"""Longest time between two frames in s. Chosen: a camera's memory holds minutes. The last stamp of the recording that
the tests read is 292 days late."""

_CODED_BLACK, _CODED_WHITE = 64, 1014
"""Codes of 10 bits for black and white."""

_LINEAR_BLACK, _LINEAR_WHITE = 64, 4064
"""Levels of 12 bits for the same."""

_MOST_FRAMES = 1 << 28
"""Most frames that a header may claim. Chosen: their places alone take 2 GB."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CineHeader:
    """What a recording says of itself."""

    # width, height: columns and rows in pixels, at least 1
    width: int
    height: int
    # Whether the last row stands first in the file
    upwards: bool
    # Number of frames in the file
    frames: int
    # Bits that a pixel takes in the file: 8, 10, 12, 16; 24 and 48 for colours
    word: int
    # Bits of a gray level, 8 to 16
    bits: int
    # Frames per second as set in the camera
    record_hz: float
    # Place of the table of frames
    table: int
    # Place of the frames' times; None where there are none
    stamps: int | None

    @property
    def frame_bytes(self) -> int:
        """Bytes of a frame's pixels."""
        pixels = self.width * self.height
        return packed_size(pixels, self.word) if self.word in (10, 12) else pixels * self.word // 8


class PhantomReader(TimedReader):
    """A Phantom recording; see `FilmReader`.

    Times are the camera's stamps, from the first frame on. Without stamps they follow from the rate. A stamp that is no
    later than the one before, or later by more than an hour, is replaced by one a period later. Levels packed in 10
    bits are on a curve, which is undone: they become 12 bits in proportion to the light.
    """

    def __init__(self, path: Path, reading: Reading) -> None:
        super().__init__(path, reading.rate_hz)
        self._header, self._channel = read_header(path), reading.channel
        self.width, self.height, self.bits = self._header.width, self._header.height, self._header.bits
        self.claimed_hz = camera_rate(path, reading.rate_hz, self._header.record_hz)
        self.frame_count = expected_frames(path, self._header.frames, self._header.frame_bytes)
        self.metadata = {}
        with suppress(MediaError):  # a cut file is reported after its whole frames
            self._pace = measure_pace([*islice(self._times(), LIMITS.sample_frames)])

    def _pictures(self) -> Iterator[tuple[float, Pixels, int]]:
        head = self._header
        if not head.frames:
            raise MediaError(f"{self.path} holds no frames: save the recording again")
        frames = blocks(self.path, self._places(), head.frame_bytes)
        for data, elapsed_s in zip(frames, self._times(), strict=False):
            pixels = _levels(data, head, self._channel)
            yield elapsed_s, pixels, self.bits

    def _places(self) -> Iterator[int]:
        """Yield the place of each frame's pixels, behind its notes."""
        table = (self._header.table + 8 * count for count in range(self._header.frames))
        with self.path.open("rb") as file:
            for count, entry in enumerate(blocks(self.path, table, 8)):
                place = int.from_bytes(entry, "little")
                file.seek(min(place, 1 << 62))
                notes = file.read(4)
                if len(notes) < 4:
                    raise MediaError(f"{self.path} ends in the middle, after {count} whole frames: copy it again")
                yield place + int.from_bytes(notes, "little")

    def _times(self) -> Iterator[float]:
        """Yield the time of each frame since the first in s; a stamp that cannot be is put a period after the last."""
        if self._header.stamps is None:
            yield from (count / self.claimed_hz for count in range(self._header.frames))
            return
        places = (self._header.stamps + 8 * count for count in range(self._header.frames))
        period, first, last = round(_TICKS / self.claimed_hz), None, 0
        for data in blocks(self.path, places, 8):
            stamp = int.from_bytes(data, "little") & ~_FLAGS
            if first is None:
                first = stamp
            elif not 0 < stamp - last <= _LONGEST_GAP_S * _TICKS:
                stamp = last + max(1, period)
            last = stamp
            yield (stamp - first) / _TICKS


def read_header(path: Path) -> CineHeader:
    """Read what a .cine file says of its frames."""
    size = path.stat().st_size
    with path.open("rb") as file:

        def at(place: int, length: int) -> bytes:
            file.seek(place)
            data = file.read(length)
            if len(data) < length:
                raise MediaError(f"{path} ends in the middle of its headers: copy it again")
            return data

        mark, _, compression, _, _, _, _, frames, picture, settings, table, _ = _FILE.unpack(at(0, _FILE.size))
        if mark != SIGNATURE[:2]:
            raise MediaError(f"{path} is no Phantom recording: give a .cine file")
        _, width, height, _, word, packing, *_ = _PICTURE.unpack(at(picture, _PICTURE.size))
        if at(settings + _MARK, 2) != b"ST":
            raise MediaError(
                f"{path} has no camera settings where its header says: it is damaged, or its version is not read; "
                "copy it again, or save it anew by the camera's program"
            )
        rate, levels = (int.from_bytes(at(settings + place, 4), "little") for place in _SETTINGS.values())
        stamps = _stamps(at, settings, table, frames)
    checked_size(path, width, abs(height))
    if compression == _JPEG or packing not in (_PLAIN, _PACKED_10, _PACKED_12):
        raise MediaError(f"{path} is compressed (kinds {compression} and {packing}): save it as raw .cine or as TIFF")
    if frames > min(_MOST_FRAMES, size):
        raise MediaError(
            f"{path} claims {frames} frames and has {size} bytes: it is cut, or its header is wrong; copy it again"
        )
    word = {_PACKED_10: 10, _PACKED_12: 12}.get(packing, word)
    return CineHeader(
        width=width,
        height=abs(height),
        upwards=packing == _PLAIN and height > 0,
        frames=frames,
        word=word,
        bits=_bits(path, word, levels),
        record_hz=float(rate),
        table=table,
        stamps=stamps,
    )


def linear(codes: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Return levels of 12 bits in proportion to the light.

    Cameras pack 10 bits on the curve of Rec. ITU-R BT.709, black at 64 and white at 1014. In 12 bits black is at 64 and
    white at 4064; codes above white are full scale. The vendor's own table is met within 3 of 4095 levels.
    """
    return _CURVE[codes]


def _curve() -> NDArray[np.uint16]:
    coded = (np.arange(1 << 10) - _CODED_BLACK) / (_CODED_WHITE - _CODED_BLACK)
    # V = 4.5 L below L = 0.018, else 1.099 L^0.45 - 0.099 (Rec. ITU-R BT.709, item 1.2)
    light = np.where(coded < 0.081, coded / 4.5, ((np.maximum(coded, 0) + 0.099) / 1.099) ** (1 / 0.45))
    levels = np.rint(_LINEAR_BLACK + (_LINEAR_WHITE - _LINEAR_BLACK) * light).astype(np.uint16)
    levels[_CODED_WHITE + 1 :] = (1 << 12) - 1
    return levels


_CURVE = _curve()
"""Level of 12 bits of each code of 10."""


def _bits(path: Path, word: int, levels: int) -> int:
    """Bits of a gray level; the settings tell how many of a word's 16 are used."""
    if word in (10, 12):
        return 12
    if word in (8, 24):
        return 8
    if word in (16, 48):
        return levels if 8 < levels <= 16 else 16
    raise MediaError(f"{path} has pixels of {word} bits, not of 8, 10, 12 or 16: save the recording as raw or as TIFF")


def _levels(data: bytearray, head: CineHeader, channel: str) -> Pixels:
    shape, pixels = (head.height, head.width), head.width * head.height
    if head.word in (10, 12):
        levels = unpack(data, head.word)[:pixels].reshape(shape)
        return linear(levels) if head.word == 10 else levels
    values = np.frombuffer(data, np.uint8 if head.bits == 8 else "<u2").astype(
        np.uint8 if head.bits == 8 else np.uint16
    )
    colours = head.word // (8 * values.itemsize)
    picture = values.reshape(*shape, colours) if colours > 1 else values.reshape(shape)
    return pictures.to_gray(picture[::-1] if head.upwards else picture, channel)


def _stamps(at: Callable[[int, int], bytes], settings: int, table: int, frames: int) -> int | None:
    """Place of the frames' times in the blocks behind the settings; None where there are none."""
    place = settings + int.from_bytes(at(settings + _SETTINGS_LENGTH, 2), "little")
    while place + _BLOCK.size <= table:
        length, kind, more = _BLOCK.unpack(at(place, _BLOCK.size))
        if kind == _STAMPS and length >= _BLOCK.size + 8 * frames:
            return place + _BLOCK.size
        if not more or length < _BLOCK.size:
            return None
        place += length
    return None
