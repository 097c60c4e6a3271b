"""Files from the air on the disk: whole ones under names that are safe, and the symbols of those that are not whole."""

import contextlib
import io
import re
import uuid
from collections.abc import Iterator, Mapping
from pathlib import Path, PureWindowsPath

import numpy as np

from heliograph.base.errors import MediaError
from heliograph.base.files import clear_write_errors, read_bounded, write_whole
from heliograph.signal.fountain.files import FileGatherer, FileKey, FileProgress, WholeFile

LONGEST = 80
"""Most characters of a file's name on the disk. Chosen."""

PARTS = ".part-{key}-*.npz"
"""Names of the files that hold symbols."""

MOST_PARTS = 1000
"""Most such files that are read. Chosen."""

_NO_SUCH_FILE = (OSError, ValueError, LookupError, TypeError, EOFError, NotImplementedError)
"""All that reading a damaged archive raises; the last one where it claims a compression that Python does not have."""

RESERVED = {"con", "prn", "aux", "nul", *(f"{kind}{n}" for kind in ("com", "lpt") for n in range(10))}
"""Names that are no files under Windows, whatever their suffix."""


def safe_name(name: str) -> str:
    """Return a file's name from the air as one that can do no harm: no folder, no mark, not hidden, not reserved."""
    last = PureWindowsPath(name.replace("\0", "")).name  # takes both kinds of slash for one
    text = re.sub(r"[^\w.-]+", "_", last, flags=re.ASCII).strip("._")
    stem, dot, suffix = text.rpartition(".")
    text = f"{stem[: LONGEST - 12]}.{suffix[:11]}" if dot and stem else text[:LONGEST]
    return f"file-{text}" if text.split(".")[0].lower() in RESERVED else text or "file"


class FileStore:
    """A folder that gets files from the air."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.written: list[Path] = []

    def begin(self, files: FileGatherer) -> Iterator[FileProgress]:
        """Give a gatherer the symbols of earlier passages; yield what is there of each file."""
        for _, key, symbols in self._parts("*"):
            progress = files.take(key, symbols)
            if progress is not None:
                yield progress

    def keep(self, whole: WholeFile, key: FileKey) -> Path:
        """Write a whole file, and remove its symbols; return where it is."""
        path = self._free(safe_name(whole.name), whole.data)
        with clear_write_errors(self.folder):
            self.folder.mkdir(parents=True, exist_ok=True)
        if not path.exists():
            write_whole(path, whole.data)
        self.written.append(path)
        for part, _, _ in self._parts(str(key)):
            with contextlib.suppress(OSError):
                part.unlink()
        return path

    def finish(self, files: FileGatherer) -> None:
        """Keep the symbols of files that are not whole for the next passage."""
        for progress in files.unfinished():
            key, symbols = progress.key, files.symbols_of(progress.key)
            if not symbols:
                continue
            old = [part for part, other, _ in self._parts(str(key)) if other == key]
            with clear_write_errors(self.folder):
                self.folder.mkdir(parents=True, exist_ok=True)
            name = PARTS.format(key=key).replace("*", uuid.uuid4().hex[:8])
            write_whole(self.folder / name, _packed(key, symbols))
            for part in old:
                with contextlib.suppress(OSError):
                    part.unlink()

    def _free(self, name: str, data: bytes) -> Path:
        """A path of that name that is free, or holds the same; else of the name with a number."""
        stem, suffix = Path(name).stem, Path(name).suffix
        for number in range(1, MOST_PARTS):
            path = self.folder / (name if number == 1 else f"{stem}-{number}{suffix}")
            if not path.exists() and not path.is_symlink():
                return path
            with contextlib.suppress(OSError):
                if path.stat().st_size == len(data) and read_bounded(path, len(data)) == data:
                    return path
        raise MediaError(f"{self.folder} has {MOST_PARTS} files of the name {name}: move some away")

    def _parts(self, key: str) -> Iterator[tuple[Path, FileKey, Mapping[int, bytes]]]:
        """Symbols that an earlier passage left; what is no such file is passed over."""
        for path in sorted(self.folder.glob(PARTS.format(key=key)))[:MOST_PARTS]:
            with contextlib.suppress(*_NO_SUCH_FILE):
                # most bytes of such a file: a file's symbols are 17 MB at most
                yield path, *_unpacked(read_bounded(path, (1 << 26)))


def _packed(key: FileKey, symbols: Mapping[int, bytes]) -> bytes:
    out = io.BytesIO()
    numbers = np.array(sorted(symbols), np.uint32)
    data = np.frombuffer(b"".join(symbols[int(n)] for n in numbers), np.uint8).reshape(-1, key.size)
    np.savez(out, key=np.array([key.check, key.length, key.size, key.code], np.uint32), numbers=numbers, symbols=data)
    return out.getvalue()


def _unpacked(data: bytes) -> tuple[FileKey, Mapping[int, bytes]]:
    import zipfile

    try:
        with np.load(io.BytesIO(data), allow_pickle=False) as held:
            key = FileKey(*(int(one) for one in held["key"]))
            numbers, rows = held["numbers"], held["symbols"]
    except zipfile.BadZipFile:
        raise ValueError("no archive") from None
    if rows.dtype != np.uint8 or rows.shape != (len(numbers), key.size):
        raise ValueError("no symbols")
    return key, {int(n): row.tobytes() for n, row in zip(numbers, rows, strict=True)}
