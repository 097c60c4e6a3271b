"""Read files up to a size limit, and write files atomically."""

import contextlib
import errno
import os
import shutil
import stat
import uuid
from collections.abc import Iterator
from pathlib import Path

from heliograph.base.errors import MediaError, printable

LONGEST_NAME = 255  # maximum length of a file name in bytes on common file systems

# advice by error number for failed writes
_CURES = {
    **dict.fromkeys((errno.ENOSPC, errno.EDQUOT, errno.EFBIG), "make room or choose another place"),
    **dict.fromkeys((errno.EACCES, errno.EPERM), "ask for the right to write there, or choose another place"),
    errno.ENAMETOOLONG: f"choose a name of at most {LONGEST_NAME} bytes, or a shorter path",
}


@contextlib.contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a hidden path to write to, then rename the file to `path`; raise a MediaError on failure."""
    with clear_write_errors(path):
        partial = partial_path(path)
        try:
            yield partial
            os.replace(partial, path)
        finally:
            with contextlib.suppress(OSError):
                partial.unlink()


def partial_path(path: Path, suffix: str = "") -> Path:
    """Return a hidden, unique path in the same folder; raise an OSError if the file name is too long."""
    with contextlib.suppress(FileNotFoundError):
        path.lstat()
    return path.with_name(f".{uuid.uuid4().hex[:8]}.partial{suffix}")


def shown_name(path: str | os.PathLike[str]) -> str:
    """Return the last part of a path as printable text."""
    return printable(Path(path).name or str(path))


def write_whole(path: Path, data: bytes) -> None:
    """Write a file atomically; raise a MediaError on failure."""
    with whole_file(path) as partial:
        partial.write_bytes(data)


def read_bounded(path: Path, most: int, cure: str = "is it the right file?") -> bytes:
    """Read a file or a pipe; raise an OSError for more than `most` bytes or for a pipe with no writer."""
    unblocked = getattr(os, "O_NONBLOCK", 0)  # opening a pipe with no writer would block
    with open(path, "rb", opener=lambda name, flags: os.open(name, flags | unblocked)) as file:
        if unblocked:
            os.set_blocking(file.fileno(), True)
        data = file.read(most + 1)
        if not data and stat.S_ISFIFO(os.fstat(file.fileno()).st_mode):
            raise OSError(errno.EPIPE, "a pipe that nobody writes to; save the text to a file first")
    if len(data) > most:
        raise OSError(errno.EFBIG, f"longer than {most:,} bytes; {cure}")
    return data


def room_for(path: Path, size: int) -> None:
    """Raise a MediaError if the disk has fewer than `size` free bytes."""
    try:
        free = shutil.disk_usage(path.parent).free
    except OSError:  # the write itself reports a missing folder
        return
    if size > free:
        takes, left = (f"{n / 1e9:,.1f} GB" if n >= 1e8 else f"{n / 1e6:,.1f} MB" for n in (size, free))
        raise MediaError(f"cannot write {path}: it takes {takes}, and {left} are free; write less, or elsewhere")


@contextlib.contextmanager
def clear_write_errors(path: Path) -> Iterator[None]:
    """Convert an OSError to a single-line MediaError with path and remedy."""
    try:
        yield
    except MediaError:
        raise
    except OSError as error:
        cure = _CURES.get(error.errno or 0, "choose another place")
        raise MediaError(f"cannot write {path}: {error.strerror or error}; {cure}") from None
