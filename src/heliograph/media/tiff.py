"""Read TIFF stacks with tifffile, one frame in memory at a time."""

import logging
import struct
from collections.abc import Iterator, Mapping
from itertools import islice
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Self

from heliograph.base.errors import MediaError, brief
from heliograph.base.frames import Pixels
from heliograph.media import tiff_pages
from heliograph.media.numbered import NumberedReader, camera_rate
from heliograph.media.reader import checked_size
from heliograph.media.reading import Reading
from heliograph.media.tiff_descriptions import Description, read_description

if TYPE_CHECKING:
    from tifffile import TiffPage

SUFFIXES = (".tif", ".tiff")
"""Suffixes of stacks."""

SIGNATURES = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
"""First bytes of a TIFF file in either byte order, and of BigTIFF (TIFF 6.0, section 2)."""

_REDUCED = 1
"""Bit of NewSubfileType by which a page is a smaller copy of another one (TIFF 6.0, section 8)."""

# Python prints warnings of a logger without any handler to standard error
logging.getLogger("tifffile").addHandler(logging.NullHandler())


class _PagesEndError(Exception):
    """The pages of a file end here, for the reason given."""


def is_stack(path: Path) -> bool:
    """Return True if a TIFF file has more than one frame, and so is a film of its own; False if it is damaged."""
    try:
        with _Stack(path) as stack:
            return stack.has_several()
    except (MediaError, _PagesEndError):
        return False


class TiffReader(NumberedReader):
    """A TIFF stack; see `FilmReader`. It has no clock, so the rate is needed."""

    _decodes = True
    faster = ("HDF5",)

    def __init__(self, path: Path, reading: Reading) -> None:
        super().__init__(path, reading.rate_hz)
        self._channel = reading.channel
        self.claimed_hz = camera_rate(path, reading.rate_hz)
        with _Stack(path) as stack:
            stack.check_axes()
            first, self.bits = stack.first_levels(self._channel)
            self.frame_count = stack.count()
        self.height, self.width = first.shape
        self.metadata = {}

    def _pictures(self) -> Iterator[tuple[int, Pixels]]:
        count = 0
        with _Stack(self.path) as stack:
            try:
                for page, plane in stack.frames():
                    pixels, bits = stack.levels(page, plane, count, self._channel)
                    if pixels.shape != (self.height, self.width) or bits != self.bits:
                        rows, columns = pixels.shape
                        raise MediaError(
                            f"{self.path} has a page of {columns}x{rows} pixels of {bits} bits after {count} of "
                            f"{self.width}x{self.height} of {self.bits}: save it without that page"
                        )
                    yield count, pixels
                    count += 1
            except _PagesEndError as error:
                raise _cut(self.path, error, count) from None


def single_picture(path: Path, channel: str) -> tuple[Pixels, int]:
    """Return the gray levels of a TIFF file that is one picture, and their bits."""
    with _Stack(path) as stack:
        try:
            several = stack.has_several()
        except _PagesEndError as error:
            raise _cut(path, error, 0) from None
        if several:
            raise MediaError(
                f"{path} has several pages, not one picture: give a stack by its own name, not by its folder"
            )
        return stack.first_levels(channel)


def _cut(path: Path, error: _PagesEndError, count: int) -> MediaError:
    return MediaError(f"{path} {error} after {count} whole frames: copy it again")


class _Stack:
    """A TIFF file that is open."""

    def __init__(self, path: Path) -> None:
        import tifffile

        self._path = path
        self._errors = (*tiff_pages.ERRORS, tifffile.TiffFileError)
        try:
            self._tif = tifffile.TiffFile(path, is_ome=False)  # whose series may lie in other files
        except OSError as error:
            raise MediaError(f"cannot read {path}: {error.strerror or brief(error)}") from None
        except self._errors as error:
            raise MediaError(
                f"{path} cannot be read as TIFF ({brief(error)}): give a TIFF stack, or copy it again if it is one"
            ) from None
        self._file = self._tif.filehandle
        self._description: Description | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._tif.close()

    def frames(self) -> Iterator[tuple["TiffPage", int]]:
        """Yield each frame as its page and its number in the page's data, without reduced copies of other pages."""
        pages, ending = self._pages(), None
        page = next(pages, None)
        while page is not None:
            following = None
            try:
                following = next(pages, None)
            except _PagesEndError as error:
                ending = error
            yield from ((page, plane) for plane in range(self._frames_of(page, following, whole=ending is None)))
            page = following
        if ending is not None:
            raise ending

    def has_several(self) -> bool:
        """Return True if there is more than one frame."""
        return len(list(islice(self.frames(), 2))) > 1

    def count(self) -> int | None:
        """Return how many frames there are, reduced copies included; None if the file is damaged."""
        try:
            directories = sum(1 for _ in self._directories())
            return directories if directories > 1 else sum(1 for _ in self.frames())
        except _PagesEndError:
            return None

    def check_axes(self) -> None:
        """Refuse a stack that has several channels, or two axes of frames, by its description."""
        axes: Mapping[str, int] = self._stated().axes
        text = ", ".join(f"{name}={length}" for name, length in axes.items())
        if self._stated().has_channels:
            raise MediaError(
                f"{self._path} has several channels ({text} in its description): save one channel as a stack of its "
                "own, in ImageJ by Image > Color > Split Channels"
            )
        if len(axes) > 1:
            raise MediaError(
                f"{self._path} has several axes of pictures ({text} in its description), and a film has one: save a "
                "stack along the axis of time, in ImageJ by Image > Hyperstacks > Reduce Dimensionality"
            )

    def first_levels(self, channel: str) -> tuple[Pixels, int]:
        """Gray levels of the first frame, and their bits."""
        try:
            first = next(self.frames(), None)
            if first is None:
                if not len(self._tif.pages):
                    raise MediaError(f"{self._path} holds no pages: save it again")
                raise MediaError(
                    f"{self._path} holds small copies alone; pictures in sub-directories, as in cameras' raw files, "
                    "are not read: save them as TIFF"
                )
            return self.levels(*first, 0, channel)
        except _PagesEndError as error:
            raise _cut(self._path, error, 0) from None

    def levels(self, page: "TiffPage", plane: int, count: int, channel: str) -> tuple[Pixels, int]:
        """Gray levels of a frame, and their bits; `count` whole frames came before."""
        try:
            checked_size(self._path, page.imagewidth, page.imagelength)
            tiff_pages.check_kind(self._path, page)
            if tiff_pages.end(page, plane) > self._file.size:
                raise _PagesEndError("ends in the middle,")
            pixels = tiff_pages.read_levels(self._path, page, plane, channel)
            return pixels, tiff_pages.depth(page, pixels, self._stated().bits)
        except MediaError:
            raise
        except (OSError, *self._errors) as error:
            raise MediaError(
                f"{self._path} has a page after {count} whole frames that cannot be decoded ({brief(error)}): it is "
                "damaged, or of a kind that is not read; copy it again, or save gray or RGB of 8 or 16 bits"
            ) from None

    def _stated(self) -> Description:
        """The description of the first page."""
        if self._description is None:
            try:
                page = next(self._pages(), None)
            except _PagesEndError:
                page = None
            self._description = Description() if page is None else read_description(page)
        return self._description

    def _directories(self) -> Iterator[int]:
        """Yield the place of each page's directory."""
        form = self._tif.tiff
        self._file.seek(8 if self._tif.is_bigtiff else 4)
        place, seen = self._number(form.offsetformat, form.offsetsize), set[int]()
        while place:
            if place in seen:
                raise _PagesEndError("is damaged")
            if place >= self._file.size:
                raise _PagesEndError("ends in the middle,")
            seen.add(place)
            yield place
            self._file.seek(place)
            tags = self._number(form.tagnoformat, form.tagnosize)
            self._file.seek(min(place + form.tagnosize + tags * form.tagsize, self._file.size))
            place = self._number(form.offsetformat, form.offsetsize)

    def _number(self, form: str, size: int) -> int:
        data = self._file.read(size)
        if len(data) < size:
            raise _PagesEndError("ends in the middle,")
        return int(struct.unpack(form, data)[0])

    def _pages(self) -> Iterator["TiffPage"]:
        """Yield the pages but for reduced copies of others."""
        import tifffile

        for number, place in enumerate(self._directories()):
            self._file.seek(place)
            try:
                page = tifffile.TiffPage(self._tif, index=number)
                reduced = int(page.subfiletype) & _REDUCED
            except (OSError, *self._errors):
                raise _PagesEndError("is damaged") from None
            if not reduced:
                yield page

    def _frames_of(self, page: "TiffPage", following: "TiffPage | None", *, whole: bool) -> int:
        """Frames that follow one another in a page's data; `whole` is True if the chain of pages ends as it should."""
        try:
            stated = read_description(page)
            frames = stated.frames if stated.in_one_page or not whole else 1
            frames = max(frames, page.imagedepth)
            if frames == 1 and page.index == 0 and following is None and whole:
                series = self._tif.series[0]  # of other programs' forms, such as MetaMorph's
                if series.dataoffset == page.dataoffsets[0] and not series.size % page.size:
                    frames = series.size // page.size
            if frames == 1 or not tiff_pages.is_plain(page):
                return 1
            start, size = page.dataoffsets[0], tiff_pages.plane_bytes(page)
            if following is None:
                # a picture that was taken out of a stack may keep the stack's description
                return frames if self._file.size >= start + 2 * size or page.imagedepth > 1 else 1
            others = range(start + size, start + frames * size)
            return 1 if following.offset in others or following.dataoffsets[0] in others else frames
        except (OSError, *self._errors):
            return 1
