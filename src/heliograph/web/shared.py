"""State that the pages of a server share: settings, films, and limits of concurrent work."""

import asyncio
import contextlib
import threading
from collections.abc import AsyncIterator, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, cast

from fastapi import Depends
from starlette.requests import ClientDisconnect, HTTPConnection, Request

from heliograph.base.errors import HeliographError, printable
from heliograph.link.settings import LinkSettings
from heliograph.web.sending import Sending
from heliograph.web.stores import Places, Store, StoredFilm


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """Limits of a server, far above normal use and far below the capacity of a laptop."""

    # Bytes of an uploaded film: two minutes of high-quality phone video are about 1 GB
    film_bytes: int = 2048 << 20
    # Stored uploads; a new film replaces the least recently used film
    films: int = 8
    # Bytes of all stored and running uploads
    stored_bytes: int = 4096 << 20
    # Bytes of a WebSocket message to the server: a raw picture of 2 megapixels
    message_bytes: int = 2 << 20
    # Longest pause in s in the middle of a request
    idle_s: float = 20.0
    # Time in s of an upload
    upload_s: float = 1800.0
    # Concurrent uploads
    uploads: int = 2
    # Concurrent receptions of *Watch* and *Receive*; each uses a core
    sessions: int = 4
    # Longest wait in s for the place of an ending reception
    place_s: float = 10.0
    # Concurrent connections
    connections: int = 64


@contextlib.contextmanager
def named_as(path: Path, name: str) -> Iterator[None]:
    """Replace the path of a film in errors of the block: pages do not learn folders of the server."""
    try:
        yield
    except HeliographError as error:
        shown = printable(str(path))
        if shown not in str(error):
            raise
        raise type(error)(str(error).replace(shown, name)) from error


class Shared:
    """State that the pages share."""

    def __init__(
        self,
        settings: LinkSettings,
        films: tuple[str, ...],
        limits: Limits,
        camera: tuple[str, ...],
        *,
        is_auto: bool,
        phone_url: str = "",
    ):
        # True if films decide the receiver
        self.is_auto = is_auto
        # Films and cameras of the command line, identified by number, and settings such as "exposure_us=500"
        self.settings, self.films, self.limits, self.camera = settings, films, limits, camera
        # Live cameras of the last search; identified by number
        self.cameras: list[str] = []
        # Present address of page *Receive* for other machines; empty if only this machine has access
        self.phone_url = phone_url
        # Set unless the first start compiles the receiver
        self.is_compiled = threading.Event()
        self.is_compiled.set()
        # Folder of films, set while the server runs
        self.folder = Path()
        self.uploads = Store[StoredFilm](
            limits.films,
            "that film is not here any more: upload it again",
            StoredFilm.drop,
            limits.stored_bytes,
            lambda film: film.size,
        )
        # Films of failed packets: two for each concurrent reception
        self.bundles = Store(2 * limits.sessions, "that film is not here any more: save it again", StoredFilm.drop)
        self.sendings = Store[Sending](16, "that text or file is not here any more: send it again")
        self.sessions = Places(limits.sessions, "receptions")
        self.running_uploads = Places(limits.uploads, "uploads")
        self.pattern_films = Places(2, "films of patterns")


def shared_of(connection: HTTPConnection) -> Shared:
    """Return the shared state of the server of a request or WebSocket."""
    return cast(Shared, connection.app.state.shared)


SharedState = Annotated[Shared, Depends(shared_of)]


async def body_of(request: Request, idle_s: float) -> AsyncIterator[bytes]:
    """Yield the parts of a request body; a long pause counts as a disconnection."""
    parts = request.stream()
    try:
        while (part := await asyncio.wait_for(anext(parts, None), idle_s)) is not None:
            yield part
    except TimeoutError:
        raise ClientDisconnect from None
