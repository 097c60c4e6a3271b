"""TIFF stacks by tifffile, read frame by frame."""

import logging
import math
import re
import struct
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from heliograph.base.errors import MediaError, brief
from heliograph.base.frames import BITS, Pixels
from heliograph.media import images, planes
from heliograph.media.libraries import tifffile
from heliograph.media.reader import Reading, checked_size
from heliograph.media.stamps import TimedReader

SUFFIXES = (".tif", ".tiff")  # suffixes of stacks

SIGNATURES = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
"""First bytes of a TIFF file in either byte order, and of BigTIFF (TIFF 6.0, section 2)."""

# values of PhotometricInterpretation
_WHITE_IS_ZERO, _BLACK_IS_ZERO, _RGB, _PALETTE, _YCBCR, _MOSAIC = 0, 1, 2, 3, 6, 32803
_SAMPLES = {_WHITE_IS_ZERO: 1, _BLACK_IS_ZERO: 1, _RGB: 3, _PALETTE: 1, _YCBCR: 3, _MOSAIC: 1}
"""Samples of a pixel for gray or colour; further samples may be opacity."""

_TURNS = {
    2: (False, False, True), 3: (False, True, True), 4: (False, True, False), 5: (True, False, False),
    6: (True, False, True), 7: (True, True, True), 8: (True, True, False),
}  # fmt: skip
"""Parameters of `planes.upright` by the tag Orientation (TIFF 6.0, section 8)."""

_SPLIT = "save one channel, in ImageJ by Image > Color > Split Channels"

# the errors below report problems of tifffile
logging.getLogger("tifffile").addHandler(logging.NullHandler())


@dataclass(frozen=True, slots=True)
class Description:
    """Description of a stack."""

    # Lengths above 1 of the axes besides rows and columns, under the names of the description
    axes: Mapping[str, int] = field(default_factory=dict)
    # Number of pictures; 1 if the description states none
    frames: int = 1
    # True if the program writes stacks as a page with all pictures as data
    in_one_page: bool = True
    # Bits of a gray level; None if the description states none
    bits: int | None = None


def read_description(page: "tifffile.TiffPage") -> Description:
    """Return the axes and bits stated by a page's description, of ImageJ, OME-XML or tifffile."""
    text = page.description
    if text.startswith("ImageJ="):
        lengths = re.findall(r"^(images|channels|slices|frames)=(\d{1,9})\s*$", text, re.MULTILINE)
        axes = {name: int(length) for name, length in lengths}
        images = axes.pop("images", 1)
        return Description(_long(axes), max(1, images))
    if (pixels := re.search(r"<(?:\w+:)?Pixels\b[^>]*>", text)) is not None:
        lengths = re.findall(r"\b(SizeZ|SizeT|SizeC|SignificantBits)\s*=\s*[\"'](\d{1,9})[\"']", pixels[0])
        axes = {name: int(length) for name, length in lengths}
        bits = axes.pop("SignificantBits", None)
        axes["SizeC"] = axes.get("SizeC", 1) // max(1, page.samplesperpixel)
        return Description(_long(axes), math.prod(axes.values()), in_one_page=False, bits=bits)
    try:
        stated = tifffile.tifffile.shaped_description_metadata(text)
        shape, letters = [int(length) for length in stated["shape"]], str(stated.get("axes", ""))
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return Description()
    outer, inner = shape[: -len(page.shape)], shape[-len(page.shape) :]
    if not outer or inner != list(page.shape) or min(outer) < 1:
        return Description()
    names = letters if len(letters) == len(shape) else [f"axis {number}" for number in range(len(outer))]
    return Description(_long(dict(zip(names, outer, strict=False))), math.prod(outer))


def _long(lengths: Mapping[str, int]) -> dict[str, int]:
    return {name: length for name, length in lengths.items() if length > 1}


def _check_kind(path: Path, page: "tifffile.TiffPage") -> None:
    """Refuse a page with other samples than gray or red, green and blue."""
    wanted = _SAMPLES.get(_meaning(page))
    if wanted is None or page.samplesperpixel < wanted:
        kind = getattr(page.photometric, "name", page.photometric)
        raise MediaError(f"{path} has pixels of kind {kind}: save gray or RGB of 8 or 16 bits")
    if page.imagedepth > 1 and not _is_raw(page):
        raise MediaError(f"{path} has {page.imagedepth} pictures in one page that is compressed or tiled: save pages")
    # values 1 and 2 of ExtraSamples are opacity
    if page.samplesperpixel > wanted == 1 and not all(extra in (1, 2) for extra in page.extrasamples or (0,)):
        raise MediaError(f"{path} has several channels ({page.samplesperpixel} samples a pixel): {_SPLIT}")


def _is_raw(page: "tifffile.TiffPage") -> bool:
    """True if the numbers lie in the file as words, row after row."""
    places, sizes, bits = page.dataoffsets, page.databytecounts, page.bitspersample
    in_one_piece = all(place + size == end for place, size, end in zip(places, sizes, places[1:], strict=False))
    # some programs write levels of 9 to 15 bits as words of 16 and state the bits of the level
    in_words = page.dtype is not None and (bits % 8 == 0 or (bits > 8 and sum(sizes) == page.nbytes))
    return page.compression == page.fillorder == 1 and not page.is_tiled and in_one_piece and in_words


def _frame_bytes(page: "tifffile.TiffPage") -> int:
    """Return the bytes of a frame in a page of words."""
    return int(page.nbytes) // page.imagedepth


def _end(page: "tifffile.TiffPage", plane: int) -> int:
    """Return the place behind the last byte of a frame."""
    if not page.dataoffsets or not all(page.dataoffsets) or not all(page.databytecounts):
        raise ValueError("a strip or tile is missing")
    if _is_raw(page):
        return int(page.dataoffsets[0]) + _frame_bytes(page) * (plane + 1)
    return int(max(place + size for place, size in zip(page.dataoffsets, page.databytecounts, strict=True)))


def _bits(page: "tifffile.TiffPage", levels: Pixels, stated: int | None) -> int:
    """Return the bits of a gray level, 8 to 16."""
    least, most = BITS[levels.dtype]
    bits = page.bitspersample if page.bitspersample < most else stated or most
    return bits if least <= bits <= most and _meaning(page) != _PALETTE else most


def _meaning(page: "tifffile.TiffPage") -> int:
    """Return the meaning of the samples: gray, or red, green and blue, if the page states none."""
    if "PhotometricInterpretation" in page.tags:
        return int(page.photometric)
    return _RGB if page.samplesperpixel > 1 else _BLACK_IS_ZERO


def _colours(page: "tifffile.TiffPage", stored: NDArray[Any]) -> NDArray[Any]:
    """Return gray levels (rows, columns), or blue, green and red (rows, columns, 3)."""
    meaning, full_scale = _meaning(page), (1 << page.bitspersample) - 1
    samples = np.moveaxis(stored, 0, -1)[..., 0, :] if stored.shape[0] > 1 else stored[0]
    if meaning == _PALETTE:
        colours = np.asarray(page.colormap)
        samples = (colours >> 8 if colours.max() > 255 else colours).astype(np.uint8).T[samples[..., 0]]
    picture = samples[..., 2::-1] if _SAMPLES[meaning] == 3 or meaning == _PALETTE else samples[..., 0]
    if meaning == _WHITE_IS_ZERO and picture.dtype in BITS:
        picture = full_scale - picture
    return picture * np.uint8(255 // full_scale) if full_scale < 255 and meaning != _PALETTE else picture


def _stored(page: "tifffile.TiffPage", plane: int) -> NDArray[Any]:
    """Return the numbers of a frame as stored, (planar samples, rows, columns, samples)."""
    if _is_raw(page):
        shape = (page.shaped[0], *page.shaped[2:])
        dtype = np.dtype(page.dtype).newbyteorder(page.parent.byteorder)
        place = page.dataoffsets[0] + plane * _frame_bytes(page)
        stored = page.parent.filehandle.read_array(dtype, math.prod(shape), place).reshape(shape)
    else:
        stored = page.asarray(squeeze=False, maxworkers=1)[:, 0]
    dtype = np.dtype(np.uint8) if stored.dtype == np.bool_ else stored.dtype.newbyteorder("=")
    return stored.astype(dtype, copy=False)


def is_stack(path: Path) -> bool:
    """True if a TIFF file has more than one frame, and so is a film; False if damaged."""
    try:
        with _Stack(path) as stack:
            return stack.has_several()
    except MediaError:
        return False


class TiffReader(TimedReader):
    """A TIFF stack; see `FilmReader`. Stacks have no clock, so the rate is needed."""

    _decodes = True

    def __init__(self, path: Path, reading: Reading) -> None:
        super().__init__(path, reading)
        with _Stack(path) as stack:
            stack.check_axes()
            first, self.bits = stack.first_levels(self._channel)
            self.frame_count = stack.count()
        self._number_frames()
        self.height, self.width = first.shape

    def _pictures(self) -> Iterator[tuple[float, Pixels, int]]:
        count = 0
        with _Stack(self.path) as stack:
            for page, plane in stack.frames():
                yield count / self.claimed_hz, *stack.levels(page, plane, count, self._channel)
                count += 1
            stack.check_end(count)


def read_picture(path: Path, channel: str) -> tuple[Pixels, int]:
    """Return the gray levels of a TIFF file of a single picture, and the bits."""
    with _Stack(path) as stack:
        if stack.has_several():
            raise MediaError(f"{path} has several pages, not one picture: give the file's name")
        stack.check_end(0)
        return stack.first_levels(channel)


class _Stack:
    """An open TIFF file."""

    def __init__(self, path: Path) -> None:
        self._path = path
        try:
            self._tif = tifffile.TiffFile(path, is_ome=False)  # series of OME may lie in other files
        except OSError as error:
            raise MediaError(f"cannot read {path}: {error.strerror or brief(error)}") from None
        except Exception as error:  # tifffile and codecs raise many types
            raise MediaError(f"{path} cannot be read as TIFF ({brief(error)}): copy it again") from None
        self._file = self._tif.filehandle
        self._description: Description | None = None
        self._ending = ""  # reason for an irregular end of the pages

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._tif.close()

    def frames(self) -> Iterator[tuple["tifffile.TiffPage", int]]:
        """Yield each frame as a page and the number in the page's data; skip reduced copies of other pages."""
        pages = self._pages()
        page = next(pages, None)
        while page is not None:
            following = next(pages, None)
            yield from ((page, plane) for plane in range(self._frames_of(page, following)))
            page = following

    def has_several(self) -> bool:
        """True if the file has more than one frame."""
        return len(list(islice(self.frames(), 2))) > 1

    def check_end(self, count: int) -> None:
        """Raise an error if the pages end irregularly behind `count` frames."""
        if self._ending:
            raise MediaError(f"{self._path} {self._ending} after {count} whole frames: copy it again")

    def count(self) -> int | None:
        """Return the number of frames and reduced copies; None if the file is damaged."""
        directories = sum(1 for _ in self._directories())
        count = directories if directories > 1 else sum(1 for _ in self.frames())
        return None if self._ending else count

    def check_axes(self) -> None:
        """Refuse a stack of several channels, or two axes of frames, by the description."""
        axes = self._stated().axes
        text = ", ".join(f"{name}={length}" for name, length in axes.items())
        # tifffile by default writes any stack as channels of ImageJ, which shows 7 at most
        if any(name in axes and (len(axes) > 1 or axes[name] <= 7) for name in ("channels", "SizeC", "C")):
            raise MediaError(f"{self._path} has several channels ({text} in its description): {_SPLIT}")
        if len(axes) > 1:
            cure = "save one axis, in ImageJ by Image > Hyperstacks > Reduce Dimensionality"
            raise MediaError(f"{self._path} has several axes of pictures ({text} in its description): {cure}")

    def first_levels(self, channel: str) -> tuple[Pixels, int]:
        """Return the gray levels of the first frame, and the bits."""
        first = next(self.frames(), None)
        if first is not None:
            return self.levels(*first, 0, channel)
        self.check_end(0)
        held = "only small copies, as cameras' raw files do" if len(self._tif.pages) else "no pages"
        raise MediaError(f"{self._path} holds {held}: save it as TIFF with a page for each picture")

    def levels(self, page: "tifffile.TiffPage", plane: int, count: int, channel: str) -> tuple[Pixels, int]:
        """Return the gray levels of a frame behind `count` others, upright, and the bits."""
        try:
            checked_size(self._path, page.imagewidth, page.imagelength)
            _check_kind(self._path, page)
            if _end(page, plane) > self._file.size:
                raise MediaError(f"{self._path} ends in the middle, after {count} whole frames: copy it again")
            picture = images.checked_form(self._path, _colours(page, _stored(page, plane)))
            turn = _TURNS.get(int(page.tags.valueof("Orientation", default=1)), planes.NO_TURN)
            pixels = planes.upright(images.to_gray(picture, channel), *turn)
            return pixels, _bits(page, pixels, self._stated().bits)
        except MediaError:
            raise
        except Exception as error:  # tifffile and codecs raise many types
            text = f"a page after {count} whole frames that cannot be decoded ({brief(error)})"
            raise MediaError(f"{self._path} has {text}: copy it again, or save gray or RGB of 8 or 16 bits") from None

    def _stated(self) -> Description:
        """Return the description of the first page."""
        if self._description is None:
            next(self._pages(), None)
        return self._description or Description()

    def _directories(self) -> Iterator[int]:
        """Yield the place of each page's directory; tifffile hides the reason for the end of the chain."""
        form, places = self._tif.tiff, set[int]()
        self._ending = ""
        try:
            self._file.seek(8 if self._tif.is_bigtiff else 4)
            place = self._number(form.offsetformat, form.offsetsize)
            while place:
                if place in places:
                    self._ending = "is damaged"
                    return
                places.add(place)
                self._file.seek(min(place, self._file.size))
                tags = self._number(form.tagnoformat, form.tagnosize)
                yield place
                self._file.seek(min(place + form.tagnosize + tags * form.tagsize, self._file.size))
                place = self._number(form.offsetformat, form.offsetsize)
        except struct.error:
            self._ending = "ends in the middle,"

    def _number(self, form: str, size: int) -> int:
        return int(struct.unpack(form, self._file.read(size))[0])

    def _pages(self) -> Iterator["tifffile.TiffPage"]:
        """Yield the pages except for reduced copies of others."""
        for number, place in enumerate(self._directories()):
            self._file.seek(place)
            try:
                page = tifffile.TiffPage(self._tif, index=number)
                is_reduced = int(page.subfiletype) & 1  # TIFF 6.0, section 8
                if self._description is None and not is_reduced:
                    self._description = read_description(page)
            except Exception:  # tifffile raises many types
                self._ending = "is damaged"
                return
            if not is_reduced:
                yield page

    def _frames_of(self, page: "tifffile.TiffPage", following: "tifffile.TiffPage | None") -> int:
        """Return the number of frames in a page's data."""
        complete = not self._ending
        try:
            stated = read_description(page)
            frames = stated.frames if stated.in_one_page or not complete else 1
            frames = max(frames, page.imagedepth)
            if frames == 1 and page.index == 0 and following is None and complete:
                series = self._tif.series[0]  # forms of other programs, such as MetaMorph
                if series.dataoffset == page.dataoffsets[0] and not series.size % page.size:
                    frames = series.size // page.size
            if frames == 1 or not _is_raw(page):
                return 1
            start, size = page.dataoffsets[0], _frame_bytes(page)
            if following is None:
                # a picture cut out of a stack may keep the description of the stack
                return frames if self._file.size >= start + 2 * size or page.imagedepth > 1 else 1
            others = range(start + size, start + frames * size)
            return 1 if following.offset in others or following.dataoffsets[0] in others else frames
        except Exception:  # tifffile raises many types
            return 1
