"""Films uploaded by browsers: complete, limited in size, and deleted when the server ends."""

import asyncio
import contextlib
import secrets
import shutil
import tempfile
import time
from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO

from heliograph.base.errors import MediaError
from heliograph.web.limits import MAX_LENGTH_DIGITS, MB, Limits

SUFFIXES = frozenset(
    ("mp4", "mov", "mkv", "webm", "avi", "nut", "y4m", "h5", "hdf5", "cine", "tif", "tiff", "npy", "png")
)
"""Accepted suffixes of stored films; readers recognise all other kinds by content."""


class TooLargeError(MediaError):
    """An upload exceeds the limit."""


@dataclass(slots=True)
class Upload:
    """Uploaded film."""

    path: Path
    # Readers at present; the film stays until the last reader ends
    readers: int = 0


class Uploads:
    """Uploaded films in a private temporary folder; `close` removes the folder."""

    def __init__(self, limits: Limits):
        self._limits = limits
        self._folder: Path | None = None
        self._films: dict[str, Upload] = {}
        self._running = 0

    def check(self, length: str) -> None:
        """Reject a film by the Content-Length of the request."""
        if length.isascii() and length.isdecimal() and int(length[:MAX_LENGTH_DIGITS]) > self._limits.film_bytes:
            raise self._too_large()

    async def take(self, parts: AsyncIterator[bytes], kind: str) -> str:
        """Store a film and return the key."""
        if self._running >= self._limits.uploads:
            raise MediaError(f"{self._limits.uploads} films are being uploaded: try again after they end")
        name = secrets.token_hex(16)
        path = self.folder() / (f"{name}.{kind.lower()}" if kind.lower() in SUFFIXES else name)
        self._running += 1
        try:
            await self._write(path, parts)
        except BaseException:
            path.unlink(missing_ok=True)
            raise
        finally:
            self._running -= 1
        self._films[name] = Upload(path)
        for old in [*self._films][: max(0, len(self._films) - self._limits.films)]:
            self.drop(old)
        return name

    @contextlib.contextmanager
    def reading(self, name: str) -> Iterator[Path]:
        """Yield the path of a film, which stays during the block."""
        film = self._films.get(name)
        if film is None:
            raise MediaError("that film is not here any more: upload it again")
        film.readers += 1
        try:
            yield film.path
        finally:
            film.readers -= 1

    def drop(self, name: str) -> None:
        """Remove an unused film; ignore unknown names."""
        film = self._films.get(name)
        if film is not None and not film.readers:
            del self._films[name]
            film.path.unlink(missing_ok=True)

    def folder(self) -> Path:
        """Return the folder for files of the server, created on first use."""
        if self._folder is None:
            self._folder = Path(tempfile.mkdtemp(prefix="heliograph-"))
        return self._folder

    def close(self) -> None:
        """Remove all films and the folder."""
        self._films.clear()
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)
            self._folder = None

    def _too_large(self) -> TooLargeError:
        return TooLargeError(f"a film has at most {self._limits.film_bytes} bytes: name it on the command line")

    async def _write(self, path: Path, parts: AsyncIterator[bytes]) -> None:
        size, end_s, buffer = 0, time.monotonic() + self._limits.upload_s, bytearray()
        with path.open("xb") as file:
            async for part in parts:
                size += len(part)
                if size > self._limits.film_bytes:
                    raise self._too_large()
                if time.monotonic() > end_s:
                    raise MediaError(
                        f"the upload took more than {self._limits.upload_s:g} s: name the film on the command line"
                    )
                buffer += part
                if len(buffer) >= MB:
                    await _append(file, buffer)
                    buffer = bytearray()
            await _append(file, buffer)
        if not size:
            raise MediaError("the film is empty: choose a file with content")


async def _append(file: IO[bytes], data: bytearray) -> None:
    try:
        await asyncio.to_thread(file.write, data)
    except OSError as error:
        raise MediaError(f"cannot store the film: {error.strerror or error}; make room and upload it again") from None
