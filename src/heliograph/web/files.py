"""Routes of uploaded films and of films of failed packets."""

import asyncio
import contextlib
import secrets
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Annotated, Any

from fastapi import APIRouter, Header, Request
from fastapi.responses import FileResponse

from heliograph.base.errors import HeliographError, MediaError
from heliograph.web.shared import Limits, Shared, SharedState, body_of
from heliograph.web.stores import StoredFilm

SUFFIXES = frozenset(
    ("mp4", "mov", "mkv", "webm", "avi", "nut", "y4m", "h5", "hdf5", "cine", "tif", "tiff", "npy", "png")
)
"""Accepted suffixes of stored films; readers recognise all other kinds by content."""

router = APIRouter(prefix="/api")


class TooLargeError(MediaError):
    """An upload exceeds the limit."""


@router.put("/films", status_code=201)
async def upload(
    request: Request, shared: SharedState, kind: str = "", content_length: Annotated[int, Header(ge=0)] = 0
) -> dict[str, Any]:
    """Store a film, the body of a request; `kind` is the suffix of the name."""
    _check_size(content_length, shared.limits)
    suffix = f".{kind.lower()}" if kind.lower() in SUFFIXES else ""
    film = StoredFilm(shared.folder / (secrets.token_hex(16) + suffix))
    with shared.running_uploads.take(), contextlib.ExitStack() as undo, film.reading():
        # running uploads count in the size of the store
        key = shared.uploads.add(film)
        undo.callback(shared.uploads.drop, key)
        await _write(film.path, body_of(request, shared.limits.idle_s), shared)
        undo.pop_all()
    return {"film": key}


@router.delete("/films/{name}", status_code=204)
async def forget(name: str, shared: SharedState) -> None:
    """Delete an uploaded film."""
    shared.uploads.drop(name)


@router.get("/bundles/{name}")
async def bundle(name: str, shared: SharedState) -> FileResponse:
    """Return a film of failed packets."""
    return FileResponse(shared.bundles.of(name).path, media_type="application/x-hdf5", filename="failed.h5")


async def _write(path: Path, parts: AsyncIterator[bytes], shared: Shared) -> None:
    limits = shared.limits
    size, end_s = 0, time.monotonic() + limits.upload_s
    try:
        with path.open("xb") as file:
            async for part in parts:
                size += len(part)
                _check_size(size, limits)
                if time.monotonic() > end_s:
                    raise MediaError(
                        f"the upload took more than {limits.upload_s:g} s: name the film on the command line"
                    )
                await asyncio.to_thread(file.write, part)
                shared.uploads.trim()
        shared.uploads.trim()
    except HeliographError:
        raise
    except OSError as error:
        raise MediaError(f"cannot store the film: {error.strerror or error}; make room and upload it again") from None
    if not size:
        raise MediaError("the film is empty: choose a file with content")


def _check_size(size: int, limits: Limits) -> None:
    if size > limits.film_bytes:
        raise TooLargeError(f"a film has at most {limits.film_bytes} bytes: name it on the command line")
