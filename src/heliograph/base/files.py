"""Write files that appear whole or not at all."""

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
"""Most bytes of a file name that usual file systems allow."""


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
    """Return a hidden, unique name beside a file, short enough for any file system.

    Parameters
    ----------
    path
        The file, whose own name may be as long as the file system allows.
    suffix
        End of the hidden name.

    Raises
    ------
    OSError
        The file's own name cannot be one, for example because it is too long.
    """
    with contextlib.suppress(FileNotFoundError):
        path.lstat()
    return path.with_name(f".{uuid.uuid4().hex[:8]}.partial{suffix}")


def path_beside(path: Path, ending: str) -> Path:
    """Return the name of a file that belongs to another: that name with an ending.

    A name that would be longer than file systems allow is cut, and gets a digest of the whole one.

    Parameters
    ----------
    path
        The file that the other one belongs to.
    ending
        What its name has at the end, such as ".truth.npz".
    """
    name = os.fsencode(path.name)
    if len(name) + len(ending) > LONGEST_NAME:
        digest = hashlib.sha256(name).hexdigest()[:8]
        kept = name[: LONGEST_NAME - len(ending) - len(digest) - 1].decode(errors="ignore")
        return path.with_name(f"{kept}-{digest}{ending}")
    return path.with_name(path.name + ending)


def shown_name(path: str | os.PathLike[str]) -> str:
    """Return a file's name without its folders, as text that pages and reports can show.

    Parameters
    ----------
    path
        The file.
    """
    return printable(Path(path).name or str(path))


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
    if error.errno == errno.ENAMETOOLONG:
        return f"choose a name of at most {LONGEST_NAME} bytes, or a shorter path"
    return "choose another place"
