"""Gray levels of a page of a TIFF file, decoded by tifffile and imagecodecs."""

import lzma
import struct
import zlib
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from heliograph.base.errors import MediaError
from heliograph.base.frames import BITS, Pixels
from heliograph.media import pictures

if TYPE_CHECKING:
    from tifffile import TiffPage

ERRORS = (
    ValueError, ArithmeticError, LookupError, TypeError, AttributeError, AssertionError, RuntimeError, MemoryError,
    ImportError, struct.error, zlib.error, lzma.LZMAError,
)  # fmt: skip
"""Errors of tifffile on damaged files, apart from its own and from OSError."""

_WHITE_IS_ZERO, _BLACK_IS_ZERO, _RGB, _PALETTE, _YCBCR, _MOSAIC = 0, 1, 2, 3, 6, 32803
"""Meanings of a pixel's samples (PhotometricInterpretation)."""

_SAMPLES = {_WHITE_IS_ZERO: 1, _BLACK_IS_ZERO: 1, _RGB: 3, _PALETTE: 1, _YCBCR: 3, _MOSAIC: 1}
"""Samples of a pixel that are its gray level or colour; further ones may be its opacity."""

_OPACITY = (1, 2)
"""Values of ExtraSamples for opacity."""

_PLAIN = 1
"""Value of Compression for none."""

_MEANING, _ORIENTATION = 262, 274
"""Tags of the meaning of the samples, and of the turn and mirroring of the page."""


def check_kind(path: Path, page: "TiffPage") -> None:
    """Refuse a page whose samples are neither gray nor red, green and blue."""
    wanted = _SAMPLES.get(_meaning(page))
    if wanted is None or page.samplesperpixel < wanted:
        kind = getattr(page.photometric, "name", page.photometric)
        raise MediaError(f"{path} has pixels of kind {kind}: save gray or RGB of 8 or 16 bits")
    if page.imagedepth > 1 and not is_plain(page):
        raise MediaError(
            f"{path} has {page.imagedepth} pictures in one page (ImageDepth) that is compressed or tiled: save a page "
            "for each frame"
        )
    if page.samplesperpixel > wanted == 1 and not all(extra in _OPACITY for extra in page.extrasamples or (0,)):
        raise MediaError(
            f"{path} has several channels ({page.samplesperpixel} samples a pixel): save one channel as a stack of its "
            "own, in ImageJ by Image > Color > Split Channels"
        )


def is_plain(page: "TiffPage") -> bool:
    """Return True if the levels lie in the file without compression, one row after the other."""
    return page.compression == _PLAIN and not page.is_tiled and _in_one_piece(page)


def plane_bytes(page: "TiffPage") -> int:
    """Return the bytes of one frame of a page without compression."""
    rows, row, bits = page.shaped[0] * page.shaped[2], page.shaped[3] * page.shaped[4], page.bitspersample
    words = 2 * rows * row
    # some programs write levels of 9 to 15 bits as words of 16 and state the bits of the level
    return words if 8 < bits < 16 and sum(page.databytecounts) == words else rows * -(-row * bits // 8)


def end(page: "TiffPage", plane: int) -> int:
    """Return the place behind the last byte of a frame."""
    if not page.dataoffsets or not all(page.dataoffsets) or not all(page.databytecounts):
        raise ValueError("a strip or tile is missing")
    if is_plain(page):
        return int(page.dataoffsets[0]) + plane_bytes(page) * (plane + 1)
    return int(max(place + size for place, size in zip(page.dataoffsets, page.databytecounts, strict=True)))


def read_levels(path: Path, page: "TiffPage", plane: int, channel: str) -> Pixels:
    """Return the gray levels of a frame, upright as the page says. Returns (rows, columns) uint8 or uint16."""
    picture = pictures.checked_form(path, _colours(page, _stored(page, plane)))
    return _upright(pictures.to_gray(picture, channel), int(page.tags.valueof(_ORIENTATION, default=1)))


def depth(page: "TiffPage", levels: Pixels, stated: int | None) -> int:
    """Return the bits of a gray level, 8 to 16."""
    least, most = BITS[levels.dtype]
    bits = page.bitspersample if page.bitspersample < most else stated or most
    return bits if least <= bits <= most and _meaning(page) != _PALETTE else most


def _meaning(page: "TiffPage") -> int:
    """Meaning of the samples; without a statement they are gray, or red, green and blue."""
    if _MEANING in page.tags:
        return int(page.photometric)
    return _RGB if page.samplesperpixel > 1 else _BLACK_IS_ZERO


def _in_one_piece(page: "TiffPage") -> bool:
    places, sizes = page.dataoffsets, page.databytecounts
    return all(place + size == following for place, size, following in zip(places, sizes, places[1:], strict=False))


def _colours(page: "TiffPage", stored: NDArray[Any]) -> NDArray[Any]:
    """Gray levels (rows, columns), or blue, green and red (rows, columns, 3)."""
    meaning, full_scale = _meaning(page), (1 << page.bitspersample) - 1
    samples = np.moveaxis(stored, 0, -1)[..., 0, :] if stored.shape[0] > 1 else stored[0]
    if meaning == _PALETTE:
        colours = np.asarray(page.colormap)
        samples = (colours >> 8 if colours.max() > 255 else colours).astype(np.uint8).T[samples[..., 0]]
    picture = samples[..., 2::-1] if _SAMPLES[meaning] == 3 or meaning == _PALETTE else samples[..., 0]
    if meaning == _WHITE_IS_ZERO and picture.dtype in BITS:
        picture = full_scale - picture
    return picture * np.uint8(255 // full_scale) if full_scale < 255 and meaning != _PALETTE else picture


def _stored(page: "TiffPage", plane: int) -> NDArray[Any]:
    """Numbers of a frame as they lie in the file, (planar samples, rows, columns, samples)."""
    if page.compression == _PLAIN and not page.is_tiled and page.bitspersample > 1 and page.fillorder == 1:
        return _uncompressed(page, plane)
    stored = page.asarray(squeeze=False, maxworkers=1)[:, 0]
    return stored.view(np.uint8) if stored.dtype == np.bool_ else stored.astype(stored.dtype.newbyteorder("="))


def _uncompressed(page: "TiffPage", plane: int) -> NDArray[Any]:
    file, size, bits = page.parent.filehandle, plane_bytes(page), page.bitspersample
    shape = (page.shaped[0], *page.shaped[2:])
    if page.dtype is None:
        raise ValueError(f"numbers of {bits} bits and kind {page.sampleformat}")
    if is_plain(page):
        data = bytearray(size)  # which may be written, so that no loop is compiled again
        file.seek(page.dataoffsets[0] + plane * size)
        held = file.readinto(data)
    else:
        data = bytearray()
        for place, length in zip(page.dataoffsets, page.databytecounts, strict=True):
            file.seek(place)
            data += file.read(min(length, size - len(data)))
        held = len(data)
    if held < size:
        raise ValueError(f"its strips hold {held} bytes, and its pixels take {size}")
    if bits % 8 and size < 2 * int(np.prod(shape)):
        from imagecodecs import packints_decode

        return packints_decode(bytes(data), page.dtype, bits, runlen=shape[2] * shape[3]).reshape(shape)
    kind = np.dtype(np.uint16) if bits % 8 else np.dtype(page.dtype)
    return np.frombuffer(data, kind.newbyteorder(page.parent.byteorder)).reshape(shape).astype(kind, copy=False)


def _upright(levels: Pixels, orientation: int) -> Pixels:
    """Levels turned and mirrored by the tag Orientation (TIFF 6.0, section 8)."""
    turned: Pixels = levels.T if orientation in (5, 6, 7, 8) else levels
    turned = turned[:, ::-1] if orientation in (2, 3, 6, 7) else turned
    turned = turned[::-1] if orientation in (3, 4, 7, 8) else turned
    return turned.copy() if turned is not levels else levels
