"""What the pages of a server share: its settings, uploaded films, and places for those who receive."""

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import cast

from starlette.requests import HTTPConnection

from heliograph.base.errors import HeliographError, printable
from heliograph.link.settings import LinkSettings
from heliograph.web.failures import Bundles
from heliograph.web.limits import Limits
from heliograph.web.uploads import Uploads


@contextlib.contextmanager
def named_as(path: Path, name: str) -> Iterator[None]:
    """Replace a film's path in the errors of the block: where it lies is the server's own business."""
    try:
        yield
    except HeliographError as error:
        shown = printable(str(path))
        if shown not in str(error):
            raise
        raise type(error)(str(error).replace(shown, name)) from error


class BusyError(HeliographError):
    """All places are taken; it says so, and what to do."""


class Places:
    """A number of places; who finds none is told to come again."""

    def __init__(self, most: int, what: str):
        self._most, self._what, self.taken = most, what, 0

    @contextlib.contextmanager
    def take(self) -> Iterator[None]:
        """Take a place for as long as the block lasts; of the server's own thread alone."""
        if self.taken >= self._most:
            raise BusyError(f"{self._most} {self._what} run already: end one of them, or try again later")
        self.taken += 1
        try:
            yield
        finally:
            self.taken -= 1


@dataclass(frozen=True, slots=True)
class Shared:
    """What the pages share."""

    # The link as the command's options have it; pages begin with it
    settings: LinkSettings
    # Films and cameras that were named where the server was started; a page asks for them by number
    films: tuple[str, ...]
    # Sizes, times and numbers
    limits: Limits
    # Films that were uploaded
    uploads: Uploads
    # Settings of live cameras, such as "exposure_us=500"
    camera: tuple[str, ...] = ()
    # Places of those who receive
    sessions: Places = field(init=False)
    # Names of the live cameras that were found when a page last looked for them; pages ask for them by number
    cameras: list[str] = field(default_factory=list)
    # Films of what failed, until pages fetch them
    bundles: Bundles = field(default_factory=Bundles)

    def __post_init__(self) -> None:
        object.__setattr__(self, "sessions", Places(self.limits.sessions, "receptions"))


def shared_of(connection: HTTPConnection) -> Shared:
    """What the pages of the server share that a request or WebSocket came to."""
    return cast(Shared, connection.app.state.shared)
