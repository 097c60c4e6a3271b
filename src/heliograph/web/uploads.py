"""Films that a browser sends: whole, bounded, under names of the server's own, gone when the server ends."""

import asyncio
import contextlib
import secrets
import shutil
import tempfile
import time
from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Annotated, Any

from fastapi import APIRouter, Depends, Request
from starlette.requests import ClientDisconnect

from heliograph.base.errors import MediaError
from heliograph.web.limits import MB, MOST_DIGITS, Limits

SUFFIXES = {
    name: f".{name}"
    for name in ("mp4", "mov", "mkv", "webm", "avi", "nut", "y4m", "h5", "hdf5", "cine", "tif", "tiff", "npy", "png")
}  # fmt: skip
"""What a film's name may end in on the disk, by what a browser says of its kind. All else is a video by its content."""

PART = MB
"""Bytes that are written at once."""


class TooLargeError(MediaError):
    """An upload is larger than the server takes."""


@dataclass(slots=True)
class Upload:
    """A film that was uploaded."""

    # Where it is
    path: Path
    # Its length
    bytes: int
    # How many read it now; it is kept as long
    readers: int = 0


class Uploads:
    """Uploaded films, in a folder of the server's own that only its user may look into; `close` removes it."""

    def __init__(self, limits: Limits):
        self._limits = limits
        self._folder: Path | None = None
        self._films: dict[str, Upload] = {}
        self._running = 0

    def check(self, length: str) -> None:
        """Refuse a film that is said to be too large before it comes."""
        if length.isascii() and length.isdecimal() and int(length[:MOST_DIGITS]) > self._limits.film_bytes:
            raise self._too_large()

    async def take(self, parts: AsyncIterator[bytes], kind: str) -> str:
        """Store a film as it comes, and return the name by which pages ask for it."""
        if self._running >= self._limits.uploads:
            raise MediaError(f"{self._limits.uploads} films are being uploaded: try again when they are there")
        name = secrets.token_hex(16)
        path = self.folder() / f"{name}{SUFFIXES.get(kind.lower(), '')}"
        self._running += 1
        try:
            size = await self._write(path, parts)
        except BaseException:
            path.unlink(missing_ok=True)
            raise
        finally:
            self._running -= 1
        self._films[name] = Upload(path, size)
        self._thin()
        return name

    @contextlib.contextmanager
    def reading(self, name: str) -> Iterator[Path]:
        """Path of an uploaded film, which stays for as long as the block lasts."""
        film = self._films.get(name)
        if film is None:
            raise MediaError("that film is not here any more: upload it again")
        film.readers += 1
        try:
            yield film.path
        finally:
            film.readers -= 1

    def drop(self, name: str) -> None:
        """Remove a film that nobody reads; any other name is passed over."""
        film = self._films.get(name)
        if film is not None and not film.readers:
            del self._films[name]
            film.path.unlink(missing_ok=True)

    def folder(self) -> Path:
        """Folder for files of the server's own, made when first asked for."""
        if self._folder is None:
            self._folder = Path(tempfile.mkdtemp(prefix="heliograph-"))
        return self._folder

    def close(self) -> None:
        """Remove all films, and their folder."""
        self._films.clear()
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)
            self._folder = None

    def _too_large(self) -> TooLargeError:
        return TooLargeError(f"a film has at most {self._limits.film_bytes} bytes: name it on the command line")

    def _thin(self) -> None:
        for name in [*self._films][: max(0, len(self._films) - self._limits.films)]:
            self.drop(name)

    async def _write(self, path: Path, parts: AsyncIterator[bytes]) -> int:
        size, until, waiting = 0, time.monotonic() + self._limits.upload_s, bytearray()
        with path.open("xb") as file:
            async for part in parts:
                size += len(part)
                if size > self._limits.film_bytes:
                    raise self._too_large()
                if time.monotonic() > until:
                    raise MediaError(
                        f"the upload took more than {self._limits.upload_s:g} s: name the film on the command line"
                    )
                waiting += part
                if len(waiting) >= PART:
                    await _put(file, waiting)
                    waiting = bytearray()
            await _put(file, waiting)
        if not size:
            raise MediaError("the film is empty: choose a file with content")
        return size


async def _put(file: IO[bytes], data: bytearray) -> None:
    try:
        await asyncio.to_thread(file.write, data)
    except OSError as error:
        raise MediaError(f"the film finds no room: {error.strerror or error}; make room and upload it again") from None


def _uploads(request: Request) -> Uploads:
    uploads: Uploads = request.app.state.shared.uploads
    return uploads


router = APIRouter(prefix="/api/films")
Kept = Annotated[Uploads, Depends(_uploads)]


@router.put("", status_code=201)
async def upload(request: Request, films: Kept, kind: str = "") -> dict[str, Any]:
    """Take a film as the body of a request; `kind` is what its name ends in."""
    try:
        films.check(request.headers.get("content-length", ""))
        return {"film": await films.take(request.stream(), kind[:8])}
    except ClientDisconnect:
        raise MediaError("the upload broke off: send the film again") from None


@router.delete("/{name}", status_code=204)
async def forget(name: str, films: Kept) -> None:
    """Remove an uploaded film."""
    films.drop(name)
