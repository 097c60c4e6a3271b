"""The pages of a TIFF file: where each has its tags, and what they say (TIFF 6.0, sections 2 and 8; BigTIFF)."""

import mmap
import re
import struct
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import BinaryIO

from heliograph.base.errors import MediaError

_KIND, _WIDTH, _HEIGHT, _BITS, _COMPRESSION, _MEANING = 254, 256, 257, 258, 259, 262
"""Tags of a page: kind of page, columns, rows, bits, compression, meaning of the levels."""

_FILL, _STRIPS, _ORIENTATION, _SAMPLES, _LENGTHS, _FORMAT = 266, 273, 274, 277, 279, 339
"""Tags of a page: order of bits, places of the strips, orientation, samples of a pixel, lengths of the strips, kind of
numbers."""

_ONES = (_COMPRESSION, _MEANING, _FILL, _ORIENTATION, _SAMPLES, _FORMAT)
"""Tags that are 1 for plain gray levels: no compression, 0 is black, upper bits first, upright, one whole number a
pixel."""

_TAGS = (_KIND, _WIDTH, _HEIGHT, _BITS, _STRIPS, _LENGTHS, *_ONES)
"""Tags that are read."""

_TYPES = {1: "B", 3: "H", 4: "I", 16: "Q"}
"""Types of whole numbers in a tag, as `struct` calls them: 8, 16, 32 and 64 bits."""

_DESCRIPTION, _TEXT = 270, 2
"""Tag of a page's description, and the type of texts."""

_IMAGEJ = re.compile(rb"ImageJ=.*?\nimages=(\d{1,9})\n", re.DOTALL)
"""Description by which ImageJ notes how many pictures follow one another behind a single page: so it writes stacks that
are too long for places of 32 bits."""

_REDUCED = 1
"""Bit of a page's kind by which it is a small picture of another page."""

_MOST_TAGS = 4096
"""Most tags of a page. Chosen: pages have about 20; a damaged one may claim 65,535 and more."""

_MOST_NUMBERS = 1 << 20
"""Most numbers in a tag. Chosen: a page has a strip or less for each row."""

Tags = Mapping[int, tuple[int, ...]]
"""Numbers of a page's tags, by tag."""


@dataclass(frozen=True, slots=True)
class Page:
    """A page of a stack.

    Attributes
    ----------
    number
        Number of the page in the file, from 0; small pictures of other pages count, too.
    place
        Place of its tags in the file.
    width, height
        Columns and rows in pixels.
    bits
        Bits of a sample.
    white_first
        Whether level 0 is white.
    strips
        Place and length of each piece of gray levels; None where they do not lie in the file as they are.
    """

    number: int
    place: int
    width: int
    height: int
    bits: int
    white_first: bool
    strips: tuple[tuple[int, int], ...] | None

    @property
    def held_bytes(self) -> int:
        """Bytes of its gray levels, where they lie in the file as they are."""
        return self.width * self.height * self.bits // 8


class Stack:
    """A TIFF file that is open.

    Parameters
    ----------
    path
        The file, for errors.
    file
        The same, open for reading bytes.

    Attributes
    ----------
    size
        Bytes of the file.
    order
        Order of bytes, "<" or ">", as `struct` and NumPy call it.

    Raises
    ------
    MediaError
        It is no TIFF.
    """

    def __init__(self, path: Path, file: BinaryIO) -> None:
        self._path, self._file = path, file
        self.size = path.stat().st_size
        head = file.read(16)
        self.order = "<" if head[:2] == b"II" else ">"
        mark = struct.unpack(f"{self.order}H", head[2:4])[0] if len(head) >= 8 else 0
        if head[:2] not in (b"II", b"MM") or mark not in (42, 43):
            raise MediaError(f"{path} is no TIFF file, or damaged: give a stack of pages, or copy it again")
        self._big = mark == 43
        # where the file has the place of its first page, and of what kind places are
        self._first_at, self._place = (8, "Q") if self._big else (4, "I")

    def pages(self) -> Iterator[Page]:
        """Yield the pages in their order, but for small pictures of others.

        Raises
        ------
        MediaError
            The file ends within a page, or its pages go round in a circle; the pages before are delivered.
        """
        frames = 0
        for number, (place, entries, following) in enumerate(self._walk()):
            tags = self._tags(entries, frames)
            if not tags.get(_KIND, (0,))[0] & _REDUCED:
                page = self._page(number, place, tags, frames)
                yield page
                frames += 1
                if not number and not following:
                    yield from _behind(page, self._pictures(entries))

    def count(self) -> int | None:
        """Return how many pages there are; None where the file is damaged."""
        try:
            pages = [(entries, following) for _, entries, following in islice(self._walk(), 1)]
            if pages and not pages[0][1]:
                return self._pictures(pages[0][0])
            return sum(1 for _ in self._walk())
        except MediaError:
            return None

    def read(self, place: int, length: int, count: int) -> bytes:
        """Return bytes of the file.

        Parameters
        ----------
        place
            The first of them.
        length
            How many there are.
        count
            Number of whole frames before them, which the error tells.

        Raises
        ------
        MediaError
            The file has no such place.
        """
        if place + length > self.size:
            raise MediaError(f"{self._path} ends in the middle, after {count} whole frames: copy it again")
        self._file.seek(place)
        return self._file.read(length)

    @contextmanager
    def first(self, page: Page) -> Iterator[mmap.mmap]:
        """Give the whole file in memory that is not taken before it is read, as if a page were its first.

        So a decoder that walks from page to page finds each at once.

        Parameters
        ----------
        page
            The page that is to be the first.
        """
        with mmap.mmap(self._file.fileno(), 0, access=mmap.ACCESS_COPY) as held:
            place = struct.pack(f"{self.order}{self._place}", page.place)
            held[self._first_at : self._first_at + len(place)] = place
            yield held

    def _walk(self) -> Iterator[tuple[int, bytes, int]]:
        """Yield the place of each page's tags, the tags, and the place of the next page's."""
        count_kind, entry_bytes = ("Q", 20) if self._big else ("H", 12)
        place, seen = self._number(self._place, self._first_at, 0), set[int]()
        while place:
            if place in seen:
                raise damaged(self._path, len(seen))
            seen.add(place)
            tags = self._number(count_kind, place, len(seen) - 1)
            if not 0 < tags <= _MOST_TAGS:
                raise damaged(self._path, len(seen) - 1)
            start = place + struct.calcsize(f"={count_kind}")
            entries = self.read(start, tags * entry_bytes, len(seen) - 1)
            following = self._number(self._place, start + tags * entry_bytes, len(seen) - 1)
            yield place, entries, following
            place = following

    def _number(self, kind: str, place: int, count: int) -> int:
        (number,) = struct.unpack(self.order + kind, self.read(place, struct.calcsize(f"={kind}"), count))
        return int(number)

    def _tags(self, entries: bytes, count: int) -> Tags:
        form = struct.Struct(f"{self.order}HH{self._place}")
        step, room = form.size + struct.calcsize(f"={self._place}"), struct.calcsize(f"={self._place}")
        tags: dict[int, tuple[int, ...]] = {}
        for start in range(0, len(entries), step):
            tag, kind, numbers = form.unpack_from(entries, start)
            if tag not in _TAGS or kind not in _TYPES or not 0 < numbers <= _MOST_NUMBERS:
                continue
            values = struct.Struct(f"{self.order}{numbers}{_TYPES[kind]}")
            held = entries[start + form.size : start + step]
            if values.size > room:
                held = self.read(struct.unpack(self.order + self._place, held)[0], values.size, count)
            tags[tag] = values.unpack_from(held)
        return tags

    def _pictures(self, entries: bytes) -> int:
        """Pictures that follow one another behind the only page, as its description says; 1 where it says none."""
        form, room = struct.Struct(f"{self.order}HH{self._place}"), struct.calcsize(f"={self._place}")
        for start in range(0, len(entries), form.size + room):
            tag, kind, length = form.unpack_from(entries, start)
            if (tag, kind) == (_DESCRIPTION, _TEXT) and room < length <= _MOST_NUMBERS:
                place = struct.unpack_from(self.order + self._place, entries, start + form.size)[0]
                said = _IMAGEJ.match(self.read(place, length, 0))
                return max(1, int(said[1])) if said else 1
        return 1

    def _page(self, number: int, place: int, tags: Tags, count: int) -> Page:
        if _WIDTH not in tags or _HEIGHT not in tags:
            raise damaged(self._path, count)
        width, height, bits = tags[_WIDTH][0], tags[_HEIGHT][0], tags.get(_BITS, (1,))[0]
        plain = all(tags.get(tag, (1,)) == (1,) for tag in _ONES) and _MEANING in tags
        whole_bytes = bits in (8, 16) or (bits == 12 and width % 2 == 0)
        strips = tuple(zip(tags.get(_STRIPS, ()), tags.get(_LENGTHS, ()), strict=False))
        enough = sum(length for _, length in strips) >= width * height * bits // 8
        white_first = tags.get(_MEANING) == (0,)
        return Page(
            number, place, width, height, bits, white_first, strips if plain and whole_bytes and enough else None
        )


def _behind(page: Page, pictures: int) -> Iterator[Page]:
    """Yield the pictures that follow a page without pages of their own."""
    if page.strips is not None:
        start = page.strips[0][0]
        for number in range(1, pictures):
            yield replace(page, strips=((start + number * page.held_bytes, page.held_bytes),))


@contextmanager
def opened_stack(path: Path) -> Iterator[Stack]:
    """Open a TIFF file for its pages.

    Parameters
    ----------
    path
        The TIFF file to read.

    Raises
    ------
    MediaError
        It cannot be read, or is no TIFF.
    """
    try:
        file = path.open("rb")
    except OSError as error:
        raise MediaError(f"cannot read {path}: {error.strerror}") from error
    with file:
        yield Stack(path, file)


def damaged(path: Path, count: int) -> MediaError:
    """Return the error of a stack that is damaged.

    Parameters
    ----------
    path
        The file, which the error names.
    count
        Number of whole frames before the damage.
    """
    return MediaError(f"{path} is damaged after {count} whole frames: copy it again")
