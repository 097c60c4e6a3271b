"""Find out from a file's bytes whether it is whole: codecs stop silently at a cut and patch up damaged pictures."""

import os
import re
import zlib
from pathlib import Path
from typing import BinaryIO

_EBML, _SEGMENT = bytes.fromhex("1A45DFA3"), bytes.fromhex("18538067")
"""First bytes of a Matroska file, and of the segment in it (RFC 9559)."""

_NUT, _NUT_INDEX = b"nut/multimedia container", bytes.fromhex("4E58DD672F23E64E")
"""First bytes of a NUT file, and of its index (the NUT specification)."""

_Y4M = b"YUV4MPEG2 "
"""First bytes of a YUV4MPEG file (the mjpegtools' description, yuv4mpeg(5))."""

_Y4M_HEAD = 4096
"""Most bytes of its first line. Chosen: it names ten things or so."""

_Y4M_FRAME = b"FRAME\n"
"""Line before each of its frames, where nothing is noted of the frame."""

_Y4M_FORM = re.compile(rb"C(mono|420|411|422|444)(alpha|jpeg|mpeg2|paldv)?p?(9|1[0-6])?")
"""Its form of colours, with more bits than 8 at the end."""

_NUT_TAIL = 12
"""Bytes that end a NUT index: its own length (8) and a checksum (4)."""

_HEAD = 32
"""Bytes read to recognise a file: the longest signature, NUT's, has 24."""

_SLICE_TAIL = 8
"""Bytes that end an FFV1 slice with a checksum: its size (3), its status (1) and the checksum (4) (RFC 9043)."""

_CRC_START = 0xFFFFFFFF
"""zlib's CRC-32 begins and ends with an exclusive or by this, FFV1's does not: given it as the start value, zlib
returns it for a right slice, whose remainder is 0."""

_MIRROR = bytes(int(f"{byte:08b}"[::-1], 2) for byte in range(256))
"""Each byte with its bits read backwards."""


def ends_early(path: Path) -> bool | None:
    """Return whether a Matroska, NUT, MP4, AVI or YUV4MPEG file is cut short; None where its bytes do not show it."""
    size = os.path.getsize(path)
    with path.open("rb") as file:
        head = file.read(_HEAD)
        if head.startswith(_EBML):
            return _matroska_cut(file, size)
        if head.startswith(_NUT):
            return None if size < _NUT_TAIL or not _nut_index(file, size) else False
        if head[4:8] == b"ftyp":
            return _boxes_cut(file, size)
        if head.startswith(b"RIFF"):
            return _riff_cut(file, size)
        if head.startswith(_Y4M):
            return _y4m_cut(file, size)
    return None


def slices_whole(packet: bytes) -> bool:
    """Return whether every slice of an FFV1 picture has a right checksum.

    The decoder only logs a wrong checksum and shows the last picture in place of this one.
    """
    end = len(packet)
    while end > _SLICE_TAIL:
        start = end - _SLICE_TAIL - int.from_bytes(packet[end - _SLICE_TAIL : end - 5], "big")
        # FFV1 feeds the bits of a byte from the top, zlib from the bottom
        if start < 0 or zlib.crc32(packet[start:end].translate(_MIRROR), _CRC_START) != _CRC_START:
            return False
        end = start
    return end == 0


def _matroska_cut(file: BinaryIO, size: int) -> bool | None:
    file.seek(4)
    start = (_vint(file) or 0) + file.tell()
    if start > size:  # it may be more than any file can have, where the system seeks no place
        return True
    file.seek(start)
    if file.read(4) != _SEGMENT:
        return True
    length = _vint(file)
    return (
        None if length is None else file.tell() + length > size
    )  # None: the muxer did not finish, or it is a live stream


def _vint(file: BinaryIO) -> int | None:
    """Read a number of variable size of Matroska; None for the value that means "unknown"."""
    first = file.read(1) or b"\x01"
    extra = 8 - first[0].bit_length()
    value = int.from_bytes(bytes([first[0] & ((1 << (7 - extra)) - 1) if extra < 8 else 0]) + file.read(extra), "big")
    return None if value == (1 << 7 * (extra + 1)) - 1 else value


def _nut_index(file: BinaryIO, size: int) -> bool:
    file.seek(size - _NUT_TAIL)
    length = int.from_bytes(file.read(8), "big")
    if not _NUT_TAIL <= length <= size:
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


def _y4m_cut(file: BinaryIO, size: int) -> bool | None:
    file.seek(0)
    line = file.readline(_Y4M_HEAD)
    said = {word[:1]: word[1:] for word in line.split()[1:]}
    form = _Y4M_FORM.fullmatch(b"C" + said.get(b"C", b"420"))
    try:
        width, height = int(said[b"W"]), int(said[b"H"])
    except (KeyError, ValueError):
        return None
    if not form or file.read(len(_Y4M_FRAME)) != _Y4M_FRAME:
        return None
    across, down = {b"mono": (0, 0), b"420": (2, 2), b"411": (4, 1), b"422": (2, 1), b"444": (1, 1)}[form[1]]
    colours = 2 * -(-width // across) * -(-height // down) if across else 0
    levels = width * height * (2 if form[2] == b"alpha" else 1) + colours
    return (size - len(line)) % (len(_Y4M_FRAME) + levels * (2 if form[3] else 1)) != 0
