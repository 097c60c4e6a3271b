"""Films of what failed that pages may fetch, by names of the server's own; the oldest go first."""

import secrets
import threading
from collections import OrderedDict
from pathlib import Path
from typing import Annotated

from fastapi import APIRouter, Depends
from fastapi.responses import FileResponse
from starlette.exceptions import HTTPException
from starlette.requests import HTTPConnection

MOST = 8
"""Films that are kept: two for each page that may receive at once. Chosen."""


class Bundles:
    """The films there are; of any thread."""

    def __init__(self) -> None:
        self._known: OrderedDict[str, Path] = OrderedDict()
        self._lock = threading.Lock()

    def add(self, path: Path) -> str:
        """Keep a film, and return the name by which a page asks for it."""
        name = secrets.token_hex(16)
        with self._lock:
            self._known[name] = path
            old = [self._known.popitem(last=False)[1] for _ in range(len(self._known) - MOST)]
        for one in old:
            one.unlink(missing_ok=True)
        return name

    def drop(self, name: str) -> None:
        """Remove a film; any other name is passed over."""
        with self._lock:
            path = self._known.pop(name, None)
        if path is not None:
            path.unlink(missing_ok=True)

    def of(self, name: str) -> Path | None:
        """Path of a film; None where there is none of that name."""
        with self._lock:
            return self._known.get(name)


def bundles_of(connection: HTTPConnection) -> Bundles:
    """What is kept of what failed."""
    kept: Bundles = connection.app.state.shared.bundles
    return kept


router = APIRouter(prefix="/api/bundles")


@router.get("/{name}")
async def bundle(name: str, kept: Annotated[Bundles, Depends(bundles_of)]) -> FileResponse:
    """Give a film of what failed."""
    path = kept.of(name)
    if path is None or not path.is_file():
        raise HTTPException(404, "that film is not here any more: save it again")
    return FileResponse(path, media_type="application/x-hdf5", filename="failed.h5")
