"""Is a file whole? Codecs stop quietly at a cut and patch damaged pictures up, so look at the bytes themselves."""

import os
import zlib
from pathlib import Path
from typing import BinaryIO

_EBML, _SEGMENT = bytes.fromhex("1A45DFA3"), bytes.fromhex("18538067")
_NUT, _NUT_INDEX = b"nut/multimedia container", bytes.fromhex("4E58DD672F23E64E")
_MIRROR = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))


def ends_early(path: Path) -> bool | None:
    """Return whether a Matroska, NUT, MP4 or AVI file is cut short: True or False, None where it does not tell."""
    size = os.path.getsize(path)
    with path.open("rb") as file:
        head = file.read(32)
        if head.startswith(_EBML):
            return _matroska_cut(file, size)
        if head.startswith(_NUT):
            return None if size < 12 or not _nut_index(file, size) else False
        if head[4:8] == b"ftyp":
            return _boxes_cut(file, size)
        if head.startswith(b"RIFF"):
            return _riff_cut(file, size)
    return None


def slices_whole(packet: bytes) -> bool:
    """Return whether every slice of an FFV1 version 3 picture (with ``slicecrc=1``) carries a right checksum.

    The decoder itself only logs a wrong one and shows the last picture in its place.
    """
    end = len(packet)
    while end > 8:
        start = end - 8 - int.from_bytes(packet[end - 8 : end - 5], "big")
        # FFV1 feeds the bits of a byte from the top, zlib from the bottom; both start from, and end at, zero.
        if start < 0 or zlib.crc32(packet[start:end].translate(_MIRROR), 0xFFFFFFFF) != 0xFFFFFFFF:
            return False
        end = start
    return end == 0


def _matroska_cut(file: BinaryIO, size: int) -> bool | None:
    file.seek(4)
    file.seek(_vint(file) or 0, os.SEEK_CUR)
    if file.read(4) != _SEGMENT:
        return True
    length = _vint(file)
    return None if length is None else file.tell() + length > size  # None: the muxer never finished, or a live stream


def _vint(file: BinaryIO) -> int | None:
    first = file.read(1) or b"\x01"
    extra = 8 - first[0].bit_length()
    value = int.from_bytes(bytes([first[0] & ((1 << (7 - extra)) - 1) if extra < 8 else 0]) + file.read(extra), "big")
    return None if value == (1 << 7 * (extra + 1)) - 1 else value


def _nut_index(file: BinaryIO, size: int) -> bool:
    file.seek(size - 12)  # an index ends with its own length and a checksum
    length = int.from_bytes(file.read(8), "big")
    if not 12 <= length <= size:
        return False
    file.seek(size - length)
    return file.read(8) == _NUT_INDEX


def _boxes_cut(file: BinaryIO, size: int) -> bool:
    place = 0
    while place < size:
        file.seek(place)
        head = file.read(16)
        length = int.from_bytes(head[:4], "big")
        if length == 1:  # a 64-bit length follows
            length = int.from_bytes(head[8:], "big")
        if length == 0:  # up to the end of the file
            return False
        if length < 8:
            return True
        place += length
    return place > size


def _riff_cut(file: BinaryIO, size: int) -> bool:
    place = 0
    while place + 8 <= size:
        file.seek(place)
        head = file.read(8)
        if not head.startswith(b"RIFF"):
            return False
        length = int.from_bytes(head[4:], "little")
        place += 8 + length + (length & 1)
    return place > size
