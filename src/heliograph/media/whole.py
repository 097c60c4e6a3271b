"""Detection of truncated and damaged video files; FFmpeg ends silently at a cut."""

import os
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

_MIRROR = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))  # each byte with reversed bits


def ends_early(path: Path, picture_bytes: int = 0) -> bool | None:
    """Return True if a Matroska, NUT, MP4, AVI or YUV4MPEG file is cut short; None if the bytes do not show it.

    For YUV4MPEG all pictures have `picture_bytes`.
    """
    size = os.path.getsize(path)
    with path.open("rb") as file:
        head = file.read(32)
        if head.startswith(bytes.fromhex("1A45DFA3")):  # EBML (RFC 9559)
            return _matroska_cut(file, size)
        if head.startswith(b"nut/multimedia container"):
            return False if _has_nut_index(file, size) else None
        if head[4:8] == b"ftyp":
            return _chunks_cut(file, size, _box_bytes)
        if head.startswith(b"RIFF"):
            return _chunks_cut(file, size, _riff_bytes)
        if head.startswith(b"YUV4MPEG2 ") and picture_bytes:
            file.seek(0)
            start = len(file.readline(4096))
            # pictures with parameters are left to FFmpeg
            return (size - start) % (6 + picture_bytes) != 0 if file.read(6) == b"FRAME\n" else None
    return None


def slices_whole(packet: bytes) -> bool:
    """True if every slice of an FFV1 picture has a correct checksum; the decoder logs errors and repeats a picture.

    A slice ends with a size (3 bytes), a status (1) and the checksum (4) (RFC 9043).
    """
    end = len(packet)
    while end > 8:
        start = end - 8 - int.from_bytes(packet[end - 8 : end - 5], "big")
        # FFV1 feeds the bits of a byte from the top, zlib from the bottom. zlib inverts the CRC at both ends, so
        # remainder 0 returns the start value
        if start < 0 or zlib.crc32(packet[start:end].translate(_MIRROR), 0xFFFFFFFF) != 0xFFFFFFFF:
            return False
        end = start
    return end == 0


def _matroska_cut(file: BinaryIO, size: int) -> bool | None:
    file.seek(4)
    start = (_vint(file) or 0) + file.tell()
    if start > size:  # seeking may fail at a huge place
        return True
    file.seek(start)
    if file.read(4) != bytes.fromhex("18538067"):  # the segment
        return True
    length = _vint(file)
    # if there is no length, the muxer did not finish, or the file is a live stream
    return None if length is None else file.tell() + length > size


def _vint(file: BinaryIO) -> int | None:
    """Read a number of variable size of Matroska; None for "unknown"."""
    first = file.read(1) or b"\x01"
    extra = 8 - first[0].bit_length()
    value = int.from_bytes(bytes([first[0] & ((1 << (7 - extra)) - 1) if extra < 8 else 0]) + file.read(extra), "big")
    return None if value == (1 << 7 * (extra + 1)) - 1 else value


def _has_nut_index(file: BinaryIO, size: int) -> bool:
    """True if the file ends with an index; the last fields are length (8 bytes) and checksum (4)."""
    file.seek(max(0, size - 12))
    length = int.from_bytes(file.read(8), "big")
    if not 12 <= length <= size:
        return False
    file.seek(size - length)
    return file.read(8) == bytes.fromhex("4E58DD672F23E64E")


def _chunks_cut(file: BinaryIO, size: int, count_bytes: Callable[[bytes], int | None]) -> bool:
    """True if the last of successive chunks is cut; `count_bytes` returns the length by the head, None for the end."""
    place = 0
    while place + 8 <= size:
        file.seek(place)
        length = count_bytes(file.read(16))
        if length is None:
            return False
        if length < 8:
            return True
        place += length
    return place > size


def _box_bytes(head: bytes) -> int | None:
    """Return the bytes of a box of MP4; the last box may state 0."""
    length = int.from_bytes(head[:4], "big")
    return int.from_bytes(head[8:], "big") if length == 1 else length or None


def _riff_bytes(head: bytes) -> int | None:
    """Return the bytes of a part of an AVI file; other data may follow."""
    length = int.from_bytes(head[4:8], "little")
    return 8 + length + (length & 1) if head.startswith(b"RIFF") else None
