"""Write files that appear whole or not at all."""

import contextlib
import errno
import os
import shutil
import stat
import uuid
from collections.abc import Iterator
from pathlib import Path

from heliograph.base.errors import MediaError


@contextlib.contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Give a hidden name beside `path` to write to; the file written there replaces `path` at the end of the block.

    After any exception, Ctrl-C included, the hidden file is removed and `path` stays as it was.

    Parameters
    ----------
    path
        Target; its folder must exist.

    Yields
    ------
    Path
        The hidden name to write to.

    Raises
    ------
    MediaError
        The file cannot be written.
    """
    partial = path.with_name(f".{path.name}.{uuid.uuid4().hex[:8]}.partial")
    try:
        with clear_write_errors(path):
            yield partial
            os.replace(partial, path)
    finally:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)


def write_whole(path: Path, data: bytes) -> None:
    """Write a file, whole or not at all.

    Parameters
    ----------
    path
        Target; an existing file is replaced.
    data
        All of its bytes.

    Raises
    ------
    MediaError
        The file cannot be written.
    """
    with whole_file(path) as partial:
        partial.write_bytes(data)


def read_bounded(path: Path, most: int, cure: str = "is it the right file?") -> bytes:
    """Read a file of bounded length, or a pipe that somebody writes to.

    Parameters
    ----------
    path
        The file, or what stands for one, such as /dev/stdin.
    most
        Most bytes that are taken.
    cure
        What to do about a longer one, for the error.

    Returns
    -------
    All of its bytes.

    Raises
    ------
    OSError
        It cannot be read, is longer, or is a pipe that nobody writes to; ``strerror`` says which.
    """
    # a pipe without a writer would be waited for without end
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
    """Check that a file finds room before it is written.

    Parameters
    ----------
    path
        The file, whose folder need not exist.
    size
        Its length in bytes, or the least it can have.

    Raises
    ------
    MediaError
        The disk has less room.
    """
    try:
        free = shutil.disk_usage(path.parent).free
    except OSError:  # what is wrong with the folder is said where the file is written
        return
    if size > free:
        raise MediaError(
            f"cannot write {path}: it takes {_size(size)}, and {_size(free)} are free; write less, or elsewhere"
        )


def _size(size: int) -> str:
    return f"{size / 1e9:,.1f} GB" if size >= 1e8 else f"{size / 1e6:,.1f} MB"


@contextlib.contextmanager
def clear_write_errors(path: Path) -> Iterator[None]:
    """Turn an OSError raised in the block into a MediaError of one line.

    Parameters
    ----------
    path
        File or folder that the block writes; the message names it.

    Raises
    ------
    MediaError
        The block raised an OSError.
    """
    try:
        yield
    except MediaError:
        raise
    except OSError as error:
        raise MediaError(f"cannot write {path}: {error.strerror or error}; {_cure(error)}") from None


FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
"""Errors of a disk or a quota that is full."""


def _cure(error: OSError) -> str:
    """What helps where something cannot be written."""
    if error.errno in FULL:
        return "make room or choose another place"
    if error.errno in (errno.EACCES, errno.EPERM):
        return "ask for the right to write there, or choose another place"
    return "choose another place"
