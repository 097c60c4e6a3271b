"""Read TIFF stacks: a page for each frame, one in memory at a time.

Pages of gray levels without compression are read from the file as they lie. All others OpenCV decodes.
"""

from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import numpy as np

from heliograph.base.errors import MediaError
from heliograph.base.frames import Pixels
from heliograph.media import pictures
from heliograph.media.numbered import NumberedReader, camera_rate
from heliograph.media.packed import unpack
from heliograph.media.reader import checked_size
from heliograph.media.reading import Reading
from heliograph.media.tiff_pages import Page, Stack, opened_stack

SUFFIXES = (".tif", ".tiff")
"""Suffixes of stacks."""

SIGNATURES = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
"""First bytes of a TIFF file in either order of bytes, and of BigTIFF (TIFF 6.0, section 2)."""

_MOST_DECODED = (1 << 31) - 1
"""Most bytes of a file that OpenCV decodes from memory."""


def is_stack(path: Path) -> bool:
    """Return whether a TIFF file has more than one page, and so is a film of its own; False of a damaged one.

    Parameters
    ----------
    path
        An existing file, of which the directories of pages are read, and no levels.
    """
    try:
        with opened_stack(path) as stack:
            return (stack.count() or 0) > 1
    except MediaError:
        return False


class TiffReader(NumberedReader):
    """A TIFF stack; see `FilmReader`. It has no clock, so the rate is needed.

    Parameters
    ----------
    path
        The stack, a TIFF file.
    reading
        How the film is to be read.

    Raises
    ------
    MediaError
        The file is no TIFF, its first page cannot be read, or no rate was given.
    """

    _decodes = True
    faster = ("HDF5",)

    def __init__(self, path: Path, reading: Reading) -> None:
        super().__init__(path, reading.rate_hz)
        self._channel = reading.channel
        self.claimed_hz = camera_rate(path, reading.rate_hz)
        with opened_stack(path) as stack:
            page = next(stack.pages(), None)
            if page is None:
                raise MediaError(f"{path} holds no pages: save it again")
            first, self.bits = _page(path, stack, page, 0, self._channel)
            self.frame_count = stack.count()
        self.height, self.width = first.shape
        self.metadata = {}

    def _pictures(self) -> Iterator[tuple[int, Pixels]]:
        with opened_stack(self.path) as stack:
            for number, page in enumerate(stack.pages()):
                pixels, bits = _page(self.path, stack, page, number, self._channel)
                if pixels.shape != (self.height, self.width) or bits != self.bits:
                    raise MediaError(
                        f"{self.path} has a page of {page.width}x{page.height} pixels of {bits} bits after {number} of "
                        f"{self.width}x{self.height} of {self.bits}: save it without that page"
                    )
                yield number, pixels


def single_picture(path: Path, channel: str) -> tuple[Pixels, int]:
    """Return the gray levels of a TIFF file that is one picture, and their bits.

    Parameters
    ----------
    path
        The TIFF file to read.
    channel
        "luma", "red", "green" or "blue": what is taken of a colour.

    Raises
    ------
    MediaError
        It has several pages, or none; or is no TIFF, is damaged, or of a kind that is not read.
    """
    with opened_stack(path) as stack:
        pages = list(islice(stack.pages(), 2))
        if len(pages) != 1:
            held = "several pages" if pages else "no pages"
            raise MediaError(f"{path} has {held}, not one picture: give a stack by its own name, not by its folder")
        return _page(path, stack, pages[0], 0, channel)


def _page(path: Path, stack: Stack, page: Page, count: int, channel: str) -> tuple[Pixels, int]:
    """Gray levels of a page, and their bits."""
    checked_size(path, page.width, page.height)
    if page.strips is not None:
        return _levels(stack, page, page.strips, count), page.bits
    if stack.size > _MOST_DECODED:
        picture = pictures.read_page(path, page.number)
    else:
        with stack.first(page) as held:
            picture = pictures.decode(held)
    if picture is None:
        raise MediaError(
            f"{path} has a page after {count} whole frames that is damaged, or of a kind that is not read: copy it "
            "again, or save gray or RGB of 8 or 16 bits"
        )
    pixels = pictures.to_gray(pictures.checked_form(path, picture), channel)
    if page.white_first and pixels.itemsize > 1:  # OpenCV turns levels of 8 bits itself
        pixels = ~pixels
    return pixels, 8 * pixels.itemsize


def _levels(stack: Stack, page: Page, strips: tuple[tuple[int, int], ...], count: int) -> Pixels:
    """Gray levels that lie in the file as they are."""
    data = bytearray()
    for place, length in strips:  # which may claim more than the page has
        data += stack.read(place, min(length, page.held_bytes - len(data)), count)
    shape = (page.height, page.width)
    if page.bits == 12:
        return unpack(bytes(data), 12).reshape(shape)
    if page.bits == 8:
        return np.frombuffer(data, np.uint8).reshape(shape)
    return np.frombuffer(data, f"{stack.order}u2").astype(np.uint16).reshape(shape)
