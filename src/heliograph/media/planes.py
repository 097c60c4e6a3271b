"""Copy gray levels into and out of the codec's picture buffers, bit for bit."""

import functools
import re
from typing import Any

import numpy as np

from heliograph.base.frames import Pixels
from heliograph.media.libraries import av

NO_TURN = (False, False, False)  # parameters of `upright` that change nothing

LIMITED, FULL = 1, 2
"""FFmpeg's AVCOL_RANGE_MPEG (levels 16 to 235) and AVCOL_RANGE_JPEG (levels 0 to 255)."""

# formats with pure luma in plane 0, samples in the low bits, little endian
_LUMA_FIRST = re.compile(r"(gray|yuva?4[0-4][0-4]p|yuvj4[0-4][0-4]p|nv(12|21|16|24))(9le|1[0-6]le)?")
_GRAY = {8: "gray", 9: "gray9le", 10: "gray10le", 12: "gray12le", 14: "gray14le", 16: "gray16le"}
"""FFmpeg's gray pixel formats by bits."""


def gray_format(bits: int) -> str:
    """Return FFmpeg's name of the smallest gray pixel format for the bits."""
    return _GRAY[min(held for held in _GRAY if held >= bits)]


def to_video(pixels: Pixels, pixel_format: str, span: int = FULL) -> "av.VideoFrame":
    """Copy gray levels into a picture with neutral colour planes, if any."""
    if span == LIMITED:
        pixels = np.rint(16 + np.arange(256) * 219 / 255).astype(np.uint8)[pixels]
    rows, columns = pixels.shape
    picture = av.VideoFrame(columns, rows, pixel_format)
    _plane(picture, 0, 8 * pixels.itemsize)[:rows, :columns] = pixels
    for index in range(1, len(picture.planes)):
        _plane(picture, index, 8)[:] = 128
    picture.color_range = span
    return picture


def to_gray(picture: "av.VideoFrame", expand_range: bool, channel: str = "luma") -> tuple[Pixels, int]:
    """Return a copy of the gray levels, and the bits.

    Luma keeps the stored levels, and so do numbers if the palette is missing. Colours are converted by Rec. ITU-R
    BT.601. Red, green and blue of YUV follow from the matrix of the file, Rec. 601 or 709, by default 601, full range.
    """
    if picture.format.name == "pal8":
        _repair_palette(picture)
        if channel == "luma":
            colours = [_colour(picture, name)[0] for name in ("red", "green", "blue")]
            return np.rint(np.tensordot((0.299, 0.587, 0.114), colours, 1)).astype(np.uint8), 8
    if channel != "luma" and (len(picture.format.components) > 2 or picture.format.has_palette):
        return _colour(picture, channel)
    limited = _is_limited(picture)
    if not _LUMA_FIRST.fullmatch(picture.format.name):
        picture = _as_gray(picture)
    bits = picture.format.components[0].bits
    pixels = _plane(picture, 0, bits)[: picture.height, : picture.width]
    if expand_range and limited:
        # a damaged film may hold levels above full scale
        return _expansion(bits)[np.minimum(pixels, (1 << bits) - 1)], bits
    return pixels.copy(), bits


def _is_limited(picture: "av.VideoFrame") -> bool:
    """True if black is at 16 and white at 235; YUV video of unknown range counts as limited."""
    name = picture.format.name
    if picture.format.is_rgb or picture.format.has_palette or name.startswith(("mono", "yuvj")):
        return False
    return picture.color_range == LIMITED or (picture.color_range != FULL and not name.startswith("gray"))


def _repair_palette(picture: "av.VideoFrame") -> None:
    """Replace a constant palette by gray levels: AVI files of gray levels may lack a palette."""
    plane: Any = picture.planes[1]
    palette = np.frombuffer(plane, np.uint8).reshape(-1, 4)
    if not np.ptp(palette, axis=0).any():
        palette[:, :3], palette[:, 3] = np.arange(256)[:, None], 255


def _as_gray(picture: "av.VideoFrame") -> "av.VideoFrame":
    bits = max(picture.format.components[0].bits, 8)
    if not picture.format.is_rgb and len(picture.format.components) > 2:
        # from YUV to YUV luma keeps the levels; a conversion to gray may stretch the range
        return picture.reformat(format=f"yuv444p{bits}le" if bits > 8 else "yuv444p")
    # the same range on both sides, full range, keeps the levels
    return picture.reformat(format=_GRAY.get(bits, "gray16le"), src_color_range="JPEG", dst_color_range="JPEG")


def _colour(picture: "av.VideoFrame", channel: str) -> tuple[Pixels, int]:
    bits = min(held for held in _GRAY if held >= picture.format.components[0].bits)
    colours = picture.reformat(format="gbrp" if bits == 8 else f"gbrp{bits}le")
    plane = ("green", "blue", "red").index(channel)
    return _plane(colours, plane, bits)[: picture.height, : picture.width].copy(), bits


def _plane(picture: "av.VideoFrame", index: int, bits: int) -> Pixels:
    plane: Any = picture.planes[index]  # lines are padded to line_size
    if bits == 8:
        return np.frombuffer(plane, np.uint8).reshape(-1, plane.line_size)
    return np.frombuffer(plane, np.uint16).reshape(-1, plane.line_size // 2)


def upright(pixels: Pixels, is_transposed: bool, rows_reversed: bool, columns_reversed: bool) -> Pixels:
    """Transpose levels, then reverse the order of rows and columns; upright pixels stay the same array."""
    if (is_transposed, rows_reversed, columns_reversed) == NO_TURN:
        return pixels
    turned: Any = pixels.T if is_transposed else pixels
    return np.ascontiguousarray(turned[:: -1 if rows_reversed else 1, :: -1 if columns_reversed else 1])


@functools.lru_cache
def _expansion(bits: int) -> Pixels:
    """Return the full-range level of each limited-range level."""
    unit = 1 << (bits - 8)
    levels = (np.arange(1 << bits) - 16 * unit) * ((1 << bits) - 1) / (219 * unit)
    levels = np.clip(np.rint(levels), 0, (1 << bits) - 1)
    return levels.astype(np.uint8) if bits == 8 else levels.astype(np.uint16)
