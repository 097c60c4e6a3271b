"""Received files on disk: complete files under safe names, and symbols of incomplete files."""

import contextlib
import io
import re
import uuid
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path, PureWindowsPath

import numpy as np

from heliograph.base.errors import MediaError
from heliograph.base.files import clear_write_errors, read_bounded, write_whole
from heliograph.signal.fountain.files import FileGatherer, FileKey, FileProgress, WholeFile

PART_NAME = ".part-{key}-*.npz"  # names of symbol files
MAX_FILES = 1000  # maximum number of symbol files, and of files of the same name


def safe_name(name: str) -> str:
    """Return a received file name as a portable, visible name of at most 80 characters, free of folders."""
    last = PureWindowsPath(name.replace("\0", "")).name  # accepts both kinds of slash
    text = re.sub(r"[^\w.-]+", "_", last, flags=re.ASCII).strip("._")
    stem, dot, suffix = text.rpartition(".")
    text = f"{stem[:68]}.{suffix[:11]}" if dot and stem else text[:80]
    # device names of Windows
    reserved = re.fullmatch(r"con|prn|aux|nul|(com|lpt)\d", text.split(".")[0], re.IGNORECASE)
    return f"file-{text}" if reserved else text or "file"


class FileStore:
    """Folder for received files."""

    def __init__(self, folder: Path):
        self.folder = folder
        self.written: list[Path] = []

    def begin(self, files: FileGatherer) -> Iterator[FileProgress]:
        """Load the symbols of earlier passages into a gatherer; yield the progress of each file."""
        for _, key, symbols in self._parts("*"):
            progress = files.take(key, symbols)
            if progress is not None:
                yield progress

    def keep(self, whole: WholeFile, key: FileKey) -> Path:
        """Write a complete file, remove the symbols and return the path."""
        path = self._free(safe_name(whole.name), whole.data)
        self._create()
        if not path.exists():
            write_whole(path, whole.data)
        self.written.append(path)
        _remove(part for part, _, _ in self._parts(str(key)))
        return path

    def finish(self, files: FileGatherer) -> None:
        """Save the symbols of incomplete files for the next passage."""
        for progress in files.unfinished():
            key, symbols = progress.key, files.symbols_of(progress.key)
            if not symbols:
                continue
            old = [part for part, other, _ in self._parts(str(key)) if other == key]
            self._create()
            name = PART_NAME.format(key=key).replace("*", uuid.uuid4().hex[:8])
            write_whole(self.folder / name, _packed(key, symbols))
            _remove(old)

    def _create(self) -> None:
        with clear_write_errors(self.folder):
            self.folder.mkdir(parents=True, exist_ok=True)

    def _free(self, name: str, data: bytes) -> Path:
        """Return the first unused path for a name, or the path of an identical file; later candidates have a number."""
        stem, suffix = Path(name).stem, Path(name).suffix
        for number in range(1, MAX_FILES):
            path = self.folder / (name if number == 1 else f"{stem}-{number}{suffix}")
            if not path.exists() and not path.is_symlink():
                return path
            with contextlib.suppress(OSError):
                if path.stat().st_size == len(data) and read_bounded(path, len(data)) == data:
                    return path
        raise MediaError(f"{self.folder} has {MAX_FILES} files of the name {name}: move some away")

    def _parts(self, key: str) -> Iterator[tuple[Path, FileKey, Mapping[int, bytes]]]:
        """Yield the symbols of earlier passages; skip invalid files."""
        for path in sorted(self.folder.glob(PART_NAME.format(key=key)))[:MAX_FILES]:
            with contextlib.suppress(Exception):  # a damaged archive raises many kinds
                yield path, *_unpacked(read_bounded(path, 1 << 26))  # symbols of a file take at most 17 MB


def _remove(paths: Iterable[Path]) -> None:
    for path in paths:
        with contextlib.suppress(OSError):
            path.unlink()


def _packed(key: FileKey, symbols: Mapping[int, bytes]) -> bytes:
    out = io.BytesIO()
    numbers = np.array(sorted(symbols), np.uint32)
    data = np.frombuffer(b"".join(symbols[int(n)] for n in numbers), np.uint8).reshape(-1, key.size)
    np.savez(out, key=np.array([key.check, key.length, key.size, key.code], np.uint32), numbers=numbers, symbols=data)
    return out.getvalue()


def _unpacked(data: bytes) -> tuple[FileKey, Mapping[int, bytes]]:
    with np.load(io.BytesIO(data), allow_pickle=False) as archive:
        key = FileKey(*map(int, archive["key"]))
        numbers, rows = archive["numbers"], archive["symbols"]
    if rows.dtype != np.uint8 or rows.shape != (len(numbers), key.size):
        raise ValueError("the rows are no symbols")
    return key, {int(n): row.tobytes() for n, row in zip(numbers, rows, strict=True)}
