"""State that the pages of a server share: settings, films, and limits of concurrent work."""

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, cast

from fastapi import Depends
from starlette.requests import HTTPConnection

from heliograph.base.errors import HeliographError, printable
from heliograph.link.settings import LinkSettings
from heliograph.web.failures import Bundles
from heliograph.web.limits import Limits
from heliograph.web.sending import Sendings
from heliograph.web.uploads import Uploads


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


class BusyError(HeliographError):
    """Too much concurrent work of a kind."""


class Places:
    """Limit of concurrent work of a kind, used by the event loop only."""

    def __init__(self, count: int, name: str):
        self._count, self._name, self.taken = count, name, 0

    @contextlib.contextmanager
    def take(self) -> Iterator[None]:
        """Occupy a place during the block; raise a BusyError if all places are occupied."""
        if self.taken >= self._count:
            raise BusyError(f"{self._count} {self._name} run already: end a session, or try again later")
        self.taken += 1
        try:
            yield
        finally:
            self.taken -= 1


@dataclass(slots=True)
class Shared:
    """State that the pages share."""

    # Initial settings of the pages
    settings: LinkSettings
    # Films and cameras of the command line; identified by number
    films: tuple[str, ...]
    limits: Limits
    # Settings of live cameras, such as "exposure_us=500"
    camera: tuple[str, ...] = ()
    # Live cameras of the last search; identified by number
    cameras: list[str] = field(default_factory=list)
    bundles: Bundles = field(default_factory=Bundles)
    sendings: Sendings = field(default_factory=Sendings)
    pattern_films: Places = field(default_factory=lambda: Places(2, "films of patterns"))
    uploads: Uploads = field(init=False)
    sessions: Places = field(init=False)

    def __post_init__(self) -> None:
        self.uploads, self.sessions = Uploads(self.limits), Places(self.limits.sessions, "receptions")


def shared_of(connection: HTTPConnection) -> Shared:
    """Return the shared state of the server of a request or WebSocket."""
    return cast(Shared, connection.app.state.shared)


SharedState = Annotated[Shared, Depends(shared_of)]
