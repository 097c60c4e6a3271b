"""Read bounded files, and write files that appear completely or not at all."""

import contextlib
import errno
import hashlib
import os
import shutil
import stat
import uuid
from collections.abc import Iterator
from pathlib import Path

from heliograph.base.errors import MediaError, printable

LONGEST_NAME = 255
"""Bytes of a file name that usual file systems allow."""


@contextlib.contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield a hidden path to write to; the file replaces `path` after the block, and is removed after an exception.

    The folder must exist. A file that cannot be written raises a MediaError.
    """
    with clear_write_errors(path):
        partial = partial_path(path)
    try:
        with clear_write_errors(path):
            yield partial
            os.replace(partial, path)
    finally:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)


def partial_path(path: Path, suffix: str = "") -> Path:
    """Return a hidden, unique path in the folder of a file; raise an OSError if the name of the file is too long."""
    with contextlib.suppress(FileNotFoundError):
        path.lstat()
    return path.with_name(f".{uuid.uuid4().hex[:8]}.partial{suffix}")


def path_beside(path: Path, ending: str) -> Path:
    """Return the path of a file that belongs to another: the name with an ending, cut to the longest name allowed."""
    name = os.fsencode(path.name)
    if len(name) + len(ending) > LONGEST_NAME:
        digest = hashlib.sha256(name).hexdigest()[:8]
        kept = name[: LONGEST_NAME - len(ending) - len(digest) - 1].decode(errors="ignore")
        return path.with_name(f"{kept}-{digest}{ending}")
    return path.with_name(path.name + ending)


def shown_name(path: str | os.PathLike[str]) -> str:
    """Return the last part of a path as printable text."""
    return printable(Path(path).name or str(path))


def write_whole(path: Path, data: bytes) -> None:
    """Write a file completely or not at all; raise a MediaError if it cannot be written."""
    with whole_file(path) as partial:
        partial.write_bytes(data)


def read_bounded(path: Path, most: int, cure: str = "is it the right file?") -> bytes:
    """Read a file or a pipe; raise an OSError for more than `most` bytes or for a pipe that has no writer."""
    # opening a pipe that has no writer would block
    descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    with open(descriptor, "rb") as file:
        if hasattr(os, "set_blocking"):
            os.set_blocking(descriptor, True)
        data = file.read(most + 1)
        if not data and stat.S_ISFIFO(os.fstat(descriptor).st_mode):
            raise OSError(errno.EPIPE, "a pipe that nobody writes to; save the text to a file first")
    if len(data) > most:
        raise OSError(errno.EFBIG, f"longer than {most:,} bytes; {cure}")
    return data


def room_for(path: Path, size: int) -> None:
    """Raise a MediaError if the disk has less room than a file of `size` bytes needs."""
    try:
        free = shutil.disk_usage(path.parent).free
    except OSError:  # writing the file reports the folder
        return
    if size > free:
        raise MediaError(
            f"cannot write {path}: it takes {_size(size)}, and {_size(free)} are free; write less, or elsewhere"
        )


def _size(size: int) -> str:
    return f"{size / 1e9:,.1f} GB" if size >= 1e8 else f"{size / 1e6:,.1f} MB"


@contextlib.contextmanager
def clear_write_errors(path: Path) -> Iterator[None]:
    """Turn an OSError of the block into a MediaError of one line that names the path and the cure."""
    try:
        yield
    except MediaError:
        raise
    except OSError as error:
        raise MediaError(f"cannot write {path}: {error.strerror or error}; {_cure(error)}") from None


def _cure(error: OSError) -> str:
    """Return the advice for an error of writing."""
    if error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG):
        return "make room or choose another place"
    if error.errno in (errno.EACCES, errno.EPERM):
        return "ask for the right to write there, or choose another place"
    if error.errno == errno.ENAMETOOLONG:
        return f"choose a name of at most {LONGEST_NAME} bytes, or a shorter path"
    return "choose another place"
