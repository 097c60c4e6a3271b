"""Read recordings of Phantom cameras: .cine files of gray levels, with the camera's time stamps."""

import math
import struct
from collections.abc import Iterator
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from heliograph.base.errors import MediaError
from heliograph.base.frames import Pixels
from heliograph.media.images import to_gray
from heliograph.media.reader import Reading, clear_read_errors, read_blocks, truncated
from heliograph.media.stamps import SAMPLE_FRAMES, BlockReader, measure_pace

SIGNATURE = b"CI\x2c\0"  # first bytes of a recording: the mark, and the length 44 of the file header

_TICKS = 1 << 32  # ticks of a stamp in a second


class PhantomReader(BlockReader):
    """A Phantom recording; see `FilmReader`.

    Times are the camera's stamps since the first frame, or follow from the rate if the file has no stamps. A stamp not
    later than the previous stamp, or more than an hour later, is replaced by a time a period later. The curve of levels
    packed in 10 bits is inverted: they become 12 bits in proportion to the light.
    """

    def __init__(self, path: Path, reading: Reading) -> None:
        super().__init__(path, reading)
        with clear_read_errors(path), path.open("rb") as file:
            try:
                record_hz = self._read_header(file)
            except struct.error:
                raise MediaError(f"{path} ends in the middle of its headers: copy it again") from None
        self._set_rate(record_hz)
        with suppress(MediaError):  # reading reports a cut file after the last good frame
            self._pace = measure_pace([*islice(self._times(), SAMPLE_FRAMES)])

    def _read_header(self, file: BinaryIO) -> float:
        """Read the headers and return the frame rate set in the camera."""
        path, size = self.path, self.path.stat().st_size
        mark, compression, frames, picture, settings, table = _unpack_at(file, 0, "<2s2xH14x4I")
        if mark != SIGNATURE[:2]:
            raise MediaError(f"{path} is no Phantom recording: give a .cine file")
        # the header of a Windows bitmap
        width, rows, word, packing = _unpack_at(file, picture, "<4xii2xHI")
        # Setup structure: Mark at byte 140, Length 142, FrameRate 768, RealBPP 896
        mark, length, rate, levels = _unpack_at(file, settings, "<140x2sH624xI124xI")
        if mark != b"ST":
            raise MediaError(f"{path} has no camera settings where its header points: copy the file again")
        if compression == 1 or packing not in (0, 256, 1024):  # JPEG pictures, or an unknown packing
            raise MediaError(f"{path} is compressed (kinds {compression}, {packing}): save it as raw .cine or as TIFF")
        if frames > min(1 << 28, size):  # the table of 2^28 frames takes 2 GB
            raise MediaError(f"{path} claims {frames} frames and has {size} bytes: it is cut or damaged; copy it again")
        word = {256: 10, 1024: 12}.get(packing, word)
        bits = {8: 8, 24: 8, 10: 12, 12: 12}.get(word, levels if 8 < levels <= 16 else 16)
        if word not in (8, 10, 12, 16, 24, 48):
            raise MediaError(f"{path} has pixels of {word} bits, not 8, 10, 12 or 16: save it as raw or as TIFF")
        self.width, self.height, self.bits = width, abs(rows), bits
        self._word, self._upwards, self._table = word, packing == 0 and rows > 0, table
        self._set_blocks(frames, packed_size(width * self.height, word))
        self._stamps = _find_stamps(file, settings + length, table, frames)
        return float(rate)

    def _places(self) -> Iterator[int]:
        """Yield the place of each frame's pixels, behind an annotation."""
        table = (self._table + 8 * count for count in range(self._claimed))
        with self.path.open("rb") as file:
            for count, entry in enumerate(read_blocks(self.path, table, 8)):
                place = int.from_bytes(entry, "little")
                file.seek(min(place, 1 << 62))
                annotation = file.read(4)  # starting with the length
                if len(annotation) < 4:
                    raise truncated(self.path, count)
                yield place + int.from_bytes(annotation, "little")

    def _times(self) -> Iterator[float]:
        """Yield the time of each frame since the first in s."""
        if self._stamps is None:
            yield from super()._times()
            return
        places = (self._stamps + 8 * count for count in range(self._claimed))
        period, first, last = max(1, round(_TICKS / self.claimed_hz)), None, 0
        for data in read_blocks(self.path, places, 8):
            stamp = int.from_bytes(data, "little") & ~3  # clears two flags of the camera
            if first is None:
                first = stamp
            elif not 0 < stamp - last <= 3600 * _TICKS:
                stamp = last + period
            last = stamp
            yield (stamp - first) / _TICKS

    def _levels(self, data: bytearray) -> Pixels:
        shape = (self.height, self.width, 3) if self._word in (24, 48) else (self.height, self.width)
        levels = read_levels(data, {24: 8, 48: 16}.get(self._word, self._word))[: math.prod(shape)].reshape(shape)
        if self._word == 10:
            return linear(levels)
        return to_gray(levels[::-1] if self._upwards else levels, self._channel)


def linear(codes: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Return levels of 12 bits in proportion to the light.

    Cameras pack 10 bits on the curve of Rec. ITU-R BT.709, black at 64 and white at 1014. In 12 bits black is at 64 and
    white at 4064; codes above white are full scale. The vendor's table agrees within 3 of 4095 levels.
    """
    coded = (np.arange(1 << 10) - 64) / (1014 - 64)
    # V = 4.5 L below L = 0.018, else 1.099 L^0.45 - 0.099 (Rec. ITU-R BT.709, item 1.2)
    light = np.where(coded < 0.081, coded / 4.5, ((np.maximum(coded, 0) + 0.099) / 1.099) ** (1 / 0.45))
    levels = np.rint(64 + (4064 - 64) * light).astype(np.uint16)
    levels[1014 + 1 :] = (1 << 12) - 1
    return levels[codes]


def read_levels(data: bytearray, word: int) -> Any:
    """Return gray levels in words of 8 or 16 bits, or densely packed with the upper bits first."""
    if word % 8:
        from imagecodecs import packints_decode

        return packints_decode(bytes(data), np.uint16, word)
    return np.frombuffer(data, np.dtype(f"<u{word // 8}")).astype(f"u{word // 8}", copy=False)


def packed_size(levels: int, bits: int) -> int:
    """Return the bytes of packed levels; the last byte-aligned group of levels is filled up."""
    group = {10: 4, 12: 2}.get(bits, 1)
    return -(-levels // group) * group * bits // 8


def _unpack_at(file: BinaryIO, place: int, form: str) -> tuple[Any, ...]:
    file.seek(place)
    return struct.unpack(form, file.read(struct.calcsize(form)))


def _find_stamps(file: BinaryIO, place: int, table: int, frames: int) -> int | None:
    """Return the place of the frame times in the blocks behind the settings; None if the file has none."""
    while place + 8 <= table:
        length, kind, more = _unpack_at(file, place, "<IHH")
        if kind == 1002 and length >= 8 + 8 * frames:
            return place + 8
        if not more or length < 8:
            break
        place += length
    return None
