"""Write files that appear whole or not at all."""

import contextlib
import errno
import os
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
