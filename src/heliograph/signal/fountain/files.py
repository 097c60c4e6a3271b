"""Files as symbols in blocks, and files from the symbols of any blocks that are enough (section 8.1)."""

import zlib
from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

from heliograph.base.errors import HeliographError
from heliograph.signal.block import FileBlock
from heliograph.signal.fountain.codes import BY_NUMBER, CODES, CodeName, Encoder

LONGEST_NAME = 255
"""Most bytes of a file's name: its length has one byte (section 8.1)."""

MOST_OPEN = 8
"""Most files that are gathered at once; of more, the one is forgotten that had no symbol for longest. Chosen."""

MOST_KNOWN = 256
"""Most files whose symbols are passed over because they are whole. Chosen."""

MOST_EXTRA = 64
"""Most symbols beyond those of the file itself that are kept. Chosen: of RaptorQ 3 are too few once in 2^32 files."""


@dataclass(frozen=True, slots=True)
class SentFile:
    """A file to be sent.

    Attributes
    ----------
    name
        What the receiver is to call it, at most 255 bytes of UTF-8; it is no path.
    data
        Its content, which may be empty.
    code
        Code that makes its symbols: "cauchy", which every receiver reads, or "raptorq".
    """

    name: str
    data: bytes
    code: CodeName = "cauchy"

    @property
    def packed(self) -> bytes:
        """Name and content as the symbols carry them."""
        name = self.name.encode()
        return bytes([len(name)]) + name + self.data


@dataclass(frozen=True, slots=True, order=True)
class FileKey:
    """What tells files apart: blocks that agree in it belong to one file, whichever array or layer they came from.

    Attributes
    ----------
    check
        CRC-32 of name and content.
    length
        Bytes of name and content.
    size
        Bytes of a symbol.
    code
        Number of the code.
    """

    check: int
    length: int
    size: int
    code: int

    @property
    def count(self) -> int:
        """Symbols that the file has itself."""
        return -(-self.length // self.size)

    def __str__(self) -> str:
        return f"{self.check:08x}"


@dataclass(frozen=True, slots=True)
class WholeFile:
    """A file that was received whole.

    Attributes
    ----------
    name
        Its name as it was sent: any text at all, not to be taken for a path.
    data
        Its content; the CRC-32 of both was right.
    """

    name: str
    data: bytes


@dataclass(frozen=True, slots=True)
class FileProgress:
    """What is there of a file.

    Attributes
    ----------
    key
        Which file it is.
    had
        Number of different symbols received.
    whole
        The file where these were enough; else None.
    reason
        Why it is not whole though they should be enough, in a line; else empty.
    """

    key: FileKey
    had: int
    whole: WholeFile | None = None
    reason: str = ""


class FileCarousel:
    """The symbols of a layer's files, file after file in turn, without end.

    Parameters
    ----------
    identity
        Number of the array, 0 to 29.
    layer
        "high", "middle" or "low".
    files
        Files to be sent, at least one.
    size
        Bytes that the layer's smallest block has for symbols.
    first
        Number of the symbol that the layer begins with, so that layers which send the same file send different ones.

    Raises
    ------
    ValueError
        A name is too long, a file has too many symbols, or a block has no room for one.
    HeliographError
        A code's package is not installed.
    """

    def __init__(self, identity: int, layer: str, files: Sequence[SentFile], size: int, first: int = 0):
        self._who, self._first = (layer, identity), first
        self._files = [(_key(one, size), _encoder(one, _key(one, size).size)) for one in files]

    def block(self, number: int, most: int, room: int) -> FileBlock:
        """Return a block of the transmission.

        Parameters
        ----------
        number
            Number of the block among the layer's blocks of files, from 0 at the start of the transmission.
        most
            Bytes that the layer's largest block has for symbols.
        room
            Bytes that this block has for symbols.
        """
        turn, place = divmod(number, len(self._files))
        key, encoder = self._files[place]
        numbers = _numbers_of(key, encoder)
        first = (self._first + turn * (most // key.size)) % numbers
        count = min(room // key.size, numbers - first)
        payload = b"".join(encoder.symbol(first + i) for i in range(count))
        layer, identity = self._who
        return FileBlock(layer, identity, key.code, first, key.length, key.size, key.check, payload)


def _key(file: SentFile, room: int) -> FileKey:
    """Which file it is; a ValueError where it cannot be sent in blocks that have so much room."""
    code, named = CODES[file.code], len(file.name.encode())
    if named > LONGEST_NAME:
        raise ValueError(f"a file's name has at most {LONGEST_NAME} bytes, not {named}")
    packed, size = file.packed, room // code.alignment * code.alignment
    if size < code.least:
        raise ValueError(f"a block has {max(room, 0)} bytes for a file's symbols; {file.code} needs {code.least}")
    if not code.fits(len(packed), size):
        raise ValueError(f"'{file.name:.40}' has {len(packed)} bytes with its name, too many in symbols of {size}")
    return FileKey(zlib.crc32(packed), len(packed), size, code.number)


@lru_cache(maxsize=4)
def _encoder(file: SentFile, size: int) -> Encoder:
    # several layers, and whoever counts errors, send the same file
    return CODES[file.code].encoder(file.packed, size)


def _numbers_of(key: FileKey, encoder: Encoder) -> int:
    """Symbols that are sent before they come again."""
    return getattr(encoder, "numbers", BY_NUMBER[key.code].numbers)


@dataclass(slots=True)
class FileGatherer:
    """Put files together from symbols in any order, of any arrays, layers and passages.

    Memory is bounded: `MOST_OPEN` files are gathered at once, each with no more symbols than it has itself, of RaptorQ
    a few more. A file whose CRC-32 is wrong at the end had a false symbol: it is gathered anew.
    """

    _open: OrderedDict[FileKey, dict[int, bytes]] = field(default_factory=OrderedDict)
    _known: OrderedDict[FileKey, None] = field(default_factory=OrderedDict)

    def add(self, block: FileBlock) -> FileProgress | None:
        """Take a block; return what is there of its file, or None where it brought nothing new.

        Parameters
        ----------
        block
            A block whose CRC was right.
        """
        key = FileKey(block.check, block.length, block.size, block.code)
        return self.take(key, dict(block.symbols()))

    def take(self, key: FileKey, symbols: Mapping[int, bytes]) -> FileProgress | None:
        """Take symbols of a file; return what is there of it, or None where they brought nothing new.

        Parameters
        ----------
        key
            Which file they are of.
        symbols
            Symbols by number, each of `key.size` bytes.
        """
        code = BY_NUMBER.get(key.code)
        if code is None or not code.fits(key.length, key.size) or key in self._known:
            return None
        had = self._open.setdefault(key, {})
        self._open.move_to_end(key)
        if len(self._open) > MOST_OPEN:
            self._open.popitem(last=False)
        new = {n: data for n, data in symbols.items() if n not in had and 0 <= n < code.numbers}
        if not new or len(had) >= key.count + MOST_EXTRA:
            return None
        had.update(new)
        return self._whole(key, had) if len(had) >= key.count else FileProgress(key, len(had))

    def unfinished(self) -> Iterator[FileProgress]:
        """Yield what is there of each file that lacks symbols."""
        for key, symbols in self._open.items():
            yield FileProgress(key, len(symbols))

    def symbols_of(self, key: FileKey) -> Mapping[int, bytes]:
        """Return the symbols by number that are there of a file which is not whole; none of another one.

        Parameters
        ----------
        key
            Which file it is.
        """
        return self._open.get(key, {})

    def _whole(self, key: FileKey, symbols: Mapping[int, bytes]) -> FileProgress:
        """The file of enough symbols; what was false is forgotten."""
        had = len(symbols)
        try:
            packed = BY_NUMBER[key.code].decode(symbols, key.length, key.size)
        except HeliographError as error:
            return FileProgress(key, had, reason=str(error))
        if packed is None:
            return FileProgress(key, had)
        packed = packed[: key.length]
        del self._open[key]
        if zlib.crc32(packed) != key.check or len(packed) <= packed[0]:
            return FileProgress(
                key, had, reason="its check value is wrong: a symbol was false, and it is gathered anew"
            )
        self._known[key] = None
        if len(self._known) > MOST_KNOWN:
            self._known.popitem(last=False)
        end = 1 + packed[0]
        return FileProgress(key, had, WholeFile(packed[1:end].decode("utf-8", "replace"), packed[end:]))
