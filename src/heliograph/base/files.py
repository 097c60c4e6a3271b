"""Files that appear whole or not at all."""

import contextlib
import os
import uuid
from collections.abc import Iterator
from pathlib import Path

from heliograph.base.errors import MediaError


@contextlib.contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Give a hidden name beside `path` to write to; what is there takes the place of `path` when all went well.

    Whatever goes wrong, Ctrl-C included, the hidden file is removed and `path` stays as it was.

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
    """Write a file, whole or not at all; a MediaError where that cannot be."""
    with whole_file(path) as partial:
        partial.write_bytes(data)


@contextlib.contextmanager
def clear_write_errors(path: Path) -> Iterator[None]:
    """Turn what the system says of writing `path` into a MediaError of one line."""
    try:
        yield
    except MediaError:
        raise
    except OSError as error:
        raise MediaError(f"cannot write {path}: {error.strerror or error}; make room or choose another place") from None
