"""Pixel formats of cameras by the pixel format naming convention (PFNC), converted to gray levels."""

import re
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.base.errors import MediaError, shown
from heliograph.base.frames import Pixels
from heliograph.media.images import to_gray

_LUMA = {"YUV422_8": 0, "YCbCr422_8": 0, "YUV422_8_UYVY": 1, "YUV422Packed": 1}
"""Formats of a luma and a chroma byte a pixel, with the place of the luma."""


@dataclass(frozen=True, slots=True)
class PixelFormat:
    """Format of a transmitted pixel."""

    # Name by the convention, such as "Mono12p"
    name: str
    # Bits of a gray level, 8 to 16
    bits: int
    # Bits of a transmitted pixel
    stored: int
    # "p" or "Packed" if levels share bytes
    packing: str = ""
    # Order of the colours, such as "RGBa"; "Y" for luma with chroma; empty for gray levels and mosaics
    colours: str = ""

    def size(self, width: int, height: int, padding: int) -> int:
        """Return the bytes of a picture."""
        bits = width * self.stored
        return (-(-bits // 8) + padding) * height - padding if padding else -(-bits * height // 8)

    def pixels(self, data: NDArray[np.uint8], width: int, height: int, padding: int, channel: str) -> Pixels:
        """Return a picture's gray levels."""
        needed = self.size(width, height, padding)
        if len(data) < needed:
            raise MediaError(f"a picture of {width}x{height} pixels in {self.name} has {len(data)} bytes, not {needed}")
        if not padding:
            return self._levels(data[:needed], width * height, channel).reshape(height, width)
        row = -(-width * self.stored // 8)
        rows = np.ndarray((height, row), np.uint8, data, 0, (row + padding, 1))
        levels: Any = np.stack([self._levels(np.ascontiguousarray(line), width, channel) for line in rows])
        return levels

    def _levels(self, data: NDArray[np.uint8], count: int, channel: str) -> Pixels:
        """Return the gray levels of consecutive pixels."""
        if self.colours == "Y":
            if channel != "luma":
                raise MediaError(f"of {self.name} the luma is read: leave out --channel, or set pixel_format to RGB8")
            return np.ascontiguousarray(data[_LUMA[self.name] :: 2][:count])
        if self.colours:
            picture = data.reshape(1, count, len(self.colours))[..., :3]
            return to_gray(picture[..., ::-1] if self.colours.startswith("R") else picture, channel)[0]
        if not self.packing:
            return data if self.stored == 8 else data.view("<u2")
        data = np.append(data, np.zeros(-len(data) % (5 if (self.packing, self.bits) == ("p", 10) else 3), np.uint8))
        return (_unpack_low_first if self.packing == "p" else _unpack_pairs)(data, self.bits)[:count]


def _unpack_low_first(data: NDArray[np.uint8], bits: int) -> NDArray[np.uint16]:
    """Return densely packed gray levels, the lower bits first (PFNC, "p")."""
    held, size = {10: (4, 5), 12: (2, 3)}[bits]  # levels and bytes of a group
    groups = data[: len(data) // size * size].reshape(-1, size).astype(np.uint16)
    levels = np.empty((len(groups), held), np.uint16)
    for place in range(held):
        first, shift = divmod(place * bits, 8)
        levels[:, place] = (groups[:, first] >> shift | groups[:, first + 1] << (8 - shift)) & ((1 << bits) - 1)
    return levels.ravel()


def _unpack_pairs(data: NDArray[np.uint8], bits: int) -> NDArray[np.uint16]:
    """Return gray levels of GigE Vision 1: two upper bytes around a byte with the lower bits of both."""
    groups = data[: len(data) // 3 * 3].reshape(-1, 3).astype(np.uint16)
    lower = bits - 8
    levels = np.empty((len(groups), 2), np.uint16)
    levels[:, 0] = groups[:, 0] << lower | groups[:, 1] & ((1 << lower) - 1)
    levels[:, 1] = groups[:, 2] << lower | groups[:, 1] >> 4 & ((1 << lower) - 1)
    return levels.ravel()


def pixel_format(name: str) -> PixelFormat:
    """Return the pixel format of a name."""
    if gray := re.fullmatch(r"(?:Mono|Bayer(?:RG|GR|GB|BG))(8|10|12|14|16)(p|Packed)?", name):
        bits, packing = int(gray[1]), gray[2] or ""
        if not packing:
            return PixelFormat(name, bits, 8 if bits == 8 else 16)
        if bits in (10, 12):
            return PixelFormat(name, bits, bits if packing == "p" else 12, packing)
    if colour := re.fullmatch(r"(RGB|BGR|RGBa|BGRa)8(?:Packed)?", name):
        return PixelFormat(name, 8, 8 * len(colour[1]), colours=colour[1])
    if name in _LUMA:
        return PixelFormat(name, 8, 16, colours="Y")
    raise MediaError(
        f"pixels in {shown(name)} are not read; set pixel_format to one of Mono8, Mono10, Mono12, Mono14, Mono16, the "
        "same as Bayer mosaics, with p or Packed at the end for 10 and 12 bits; RGB8, BGR8, RGBa8, BGRa8, YUV422_8, "
        "YUV422_8_UYVY, YCbCr422_8"
    )
