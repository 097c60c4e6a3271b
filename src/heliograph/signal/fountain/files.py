"""Encode files as symbols in blocks, and reconstruct files from a sufficient set of symbols (section 8.1)."""

import zlib
from collections import OrderedDict, deque
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache

from heliograph.base.errors import HeliographError
from heliograph.signal.block import AnyFileBlock, FileBlock, FileNotice, SymbolBlock, small_symbol_bytes, symbol_bytes
from heliograph.signal.fountain.codes import BY_NUMBER, CODES, CodeName, Encoder

LONGEST_NAME = 255  # maximum file name length in bytes: the length field is a byte (section 8.1)

NOTICE_TURNS = 8
"""Turns per file description in small blocks (section 8.1). Descriptions take an eighth of the light, and three layers
send a description in every second packet at 8 x 8 LEDs."""


@dataclass(frozen=True, slots=True)
class SentFile:
    """File to send."""

    # File name for the receiver, at most 255 bytes UTF-8; no path
    name: str
    # File content, possibly empty
    data: bytes
    # Symbol code: "cauchy", which every receiver supports, or "raptorq"
    code: CodeName = "cauchy"

    @property
    def packed(self) -> bytes:
        """Name and content as encoded in the symbols."""
        name = self.name.encode()
        return bytes([len(name)]) + name + self.data


@dataclass(frozen=True, slots=True, order=True)
class FileKey:
    """File key: blocks with equal keys belong to the same file, regardless of array and layer."""

    # CRC-32 of name and content
    check: int
    # Length of name and content in bytes
    length: int
    # Symbol size in bytes
    size: int
    # Code number
    code: int

    @property
    def count(self) -> int:
        """Number of source symbols."""
        return -(-self.length // self.size)

    def __str__(self) -> str:
        return f"{self.check:08x}"


@dataclass(frozen=True, slots=True)
class WholeFile:
    """Complete received file with a correct CRC-32."""

    # Transmitted name: any text, not a safe path
    name: str
    data: bytes


@dataclass(frozen=True, slots=True)
class FileProgress:
    """File progress."""

    key: FileKey
    # Number of different received symbols
    had: int
    # Complete file, or None
    whole: WholeFile | None = None
    # Single-line reason if sufficient symbols gave no file, otherwise empty
    reason: str = ""


class FileCarousel:
    """Endless sequence of file symbols for a layer, alternating between files.

    `bits` has the information bits of each block size in the layer; a single small size selects small blocks (section
    7.2). Layers with the same file send different symbols, from number `first` on.
    """

    def __init__(self, identity: int, layer: str, files: Sequence[SentFile], bits: Collection[int], first: int = 0):
        self._who, self._first, self._most = (layer, identity), first, symbol_bytes(max(bits))
        # at most 40 bytes (section 7.2): above, the header of section 7.1 takes less than half of the block
        small = len(set(bits)) == 1 and max(bits) <= 320
        self._files = []
        for file in files:
            room = small_symbol_bytes(max(bits)) if small and file.code == "cauchy" else 0
            key = _key(file, room or symbol_bytes(min(bits)))
            self._files.append((key, _encoder(file, key.size), room > 0))

    def block(self, number: int, k: int) -> AnyFileBlock:
        """Return file block `number` in the layer, counted from 0, with `k` information bits."""
        turn, place = divmod(number, len(self._files))
        key, encoder, small = self._files[place]
        (layer, identity), numbers = self._who, encoder.numbers
        # layers with the same file send the description at different times
        if small and turn % NOTICE_TURNS == (0 if layer == "high" else 4):
            return FileNotice(layer, identity, key.length, key.check)
        if small:
            first = (self._first + turn) % numbers
            return SymbolBlock(layer, identity, key.check >> 24, first, encoder.symbol(first))
        first = (self._first + turn * (self._most // key.size)) % numbers
        count = min(symbol_bytes(k) // key.size, numbers - first)
        payload = b"".join(encoder.symbol(first + i) for i in range(count))
        return FileBlock(layer, identity, key.code, first, key.length, key.size, key.check, payload)


def _key(file: SentFile, room: int) -> FileKey:
    """Return the key of a file; raise a ValueError if blocks with `room` bytes cannot carry the file."""
    code, named = CODES[file.code], len(file.name.encode())
    if named > LONGEST_NAME:
        raise ValueError(f"a file's name has at most {LONGEST_NAME} bytes, not {named}")
    packed, size = file.packed, room // code.alignment * code.alignment
    if size < code.min_bytes:
        raise ValueError(f"a block has {max(room, 0)} bytes for a file's symbols; {file.code} needs {code.min_bytes}")
    if not code.fits(len(packed), size):
        raise ValueError(f"'{file.name:.40}' has {len(packed)} bytes with its name, too many in symbols of {size}")
    return FileKey(zlib.crc32(packed), len(packed), size, code.number)


@lru_cache(maxsize=4)
def _encoder(file: SentFile, size: int) -> Encoder:
    # several layers, and error counters, encode the same file
    return CODES[file.code].encoder(file.packed, size)


@dataclass(slots=True)
class FileGatherer:
    """Reconstruct files from symbols in any order, from any array, layer and passage.

    A wrong CRC-32 after decoding means a wrong symbol: the gatherer then drops all symbols of the file.
    """

    # Maximum number of incomplete files; a new file replaces the file with the oldest last symbol
    max_open: int = 8
    # Maximum number of remembered complete files, for which symbols are ignored, and of file descriptions
    max_known: int = 256
    # Maximum number of stored symbols beyond the source count; with 3, RaptorQ decoding fails for one file in 2^32
    max_extra: int = 64
    _open: OrderedDict[FileKey, dict[int, bytes]] = field(default_factory=OrderedDict)
    _known: OrderedDict[FileKey, None] = field(default_factory=OrderedDict)
    _told: OrderedDict[tuple[int, int], FileNotice] = field(default_factory=OrderedDict)
    # Symbols with no file description: 256 packets at 8 x 8 LEDs
    _unknown: deque[SymbolBlock] = field(default_factory=lambda: deque(maxlen=1024))

    def add(self, block: AnyFileBlock) -> FileProgress | None:
        """Add a block with a correct CRC; return the file progress, or None if the block adds no symbol."""
        if isinstance(block, FileNotice):
            return self._named(block)
        if isinstance(block, SymbolBlock):
            notice = self._told.get((block.identity, block.tag))
            if notice is None:
                self._unknown.append(block)
                return None
            return self._symbol(block, notice)
        return self.take(FileKey(block.check, block.length, block.size, block.code), dict(block.symbols()))

    def _named(self, notice: FileNotice) -> FileProgress | None:
        """Store a file description, and add earlier symbols with the same tag."""
        who = notice.identity, notice.tag
        self._told[who] = notice
        self._told.move_to_end(who)
        if len(self._told) > self.max_known:
            self._told.popitem(last=False)
        waiting = list(self._unknown)
        self._unknown.clear()
        progress = None
        for block in waiting:
            if (block.identity, block.tag) == who:
                progress = self._symbol(block, notice) or progress
            else:
                self._unknown.append(block)
        return progress

    def _symbol(self, block: SymbolBlock, notice: FileNotice) -> FileProgress | None:
        key = FileKey(notice.check, notice.length, len(block.payload), CODES["cauchy"].number)
        return self.take(key, {block.number: block.payload})

    def take(self, key: FileKey, symbols: Mapping[int, bytes]) -> FileProgress | None:
        """Add symbols of a file by number; return the file progress, or None if no symbol is new."""
        code = BY_NUMBER.get(key.code)
        if code is None or not code.fits(key.length, key.size) or key in self._known:
            return None
        had = self._open.setdefault(key, {})
        self._open.move_to_end(key)
        if len(self._open) > self.max_open:
            self._open.popitem(last=False)
        new = {n: data for n, data in symbols.items() if n not in had and 0 <= n < code.numbers}
        if not new or len(had) >= key.count + self.max_extra:
            return None
        had.update(new)
        return self._whole(key, had) if len(had) >= key.count else FileProgress(key, len(had))

    def unfinished(self) -> Iterator[FileProgress]:
        """Yield the progress of each incomplete file."""
        for key, symbols in self._open.items():
            yield FileProgress(key, len(symbols))

    def symbols_of(self, key: FileKey) -> Mapping[int, bytes]:
        """Return the received symbols of an incomplete file by number; an empty mapping for other files."""
        return self._open.get(key, {})

    def _whole(self, key: FileKey, symbols: Mapping[int, bytes]) -> FileProgress:
        """Decode a file from sufficient symbols; drop all symbols if the CRC-32 is wrong."""
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
                key, had, reason="the check value is wrong: a symbol was false, so the symbols are collected again"
            )
        self._known[key] = None
        if len(self._known) > self.max_known:
            self._known.popitem(last=False)
        end = 1 + packed[0]
        return FileProgress(key, had, WholeFile(packed[1:end].decode("utf-8", "replace"), packed[end:]))
