"""Routes of uploaded films and of films of failed packets."""

import asyncio
import contextlib
from typing import Any

from fastapi import APIRouter, Request
from fastapi.responses import FileResponse
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect

from heliograph.base.errors import MediaError
from heliograph.web.crashes import in_thread
from heliograph.web.failures import Bundles, FailureRecorder
from heliograph.web.shared import SharedState

router = APIRouter(prefix="/api")


@router.put("/films", status_code=201)
async def upload(request: Request, shared: SharedState, kind: str = "") -> dict[str, Any]:
    """Store a film, the body of a request; `kind` is the suffix of the name."""
    shared.uploads.check(request.headers.get("content-length", ""))
    try:
        return {"film": await shared.uploads.take(request.stream(), kind[:8])}
    except ClientDisconnect:
        raise MediaError("the upload was interrupted: send the film again") from None


@router.delete("/films/{name}", status_code=204)
async def forget(name: str, shared: SharedState) -> None:
    """Delete an uploaded film."""
    shared.uploads.drop(name)


@router.get("/bundles/{name}")
async def bundle(name: str, shared: SharedState) -> FileResponse:
    """Return a film of failed packets."""
    path = shared.bundles.of(name)
    if path is None or not path.is_file():
        raise HTTPException(404, "that film is not here any more: save it again")
    return FileResponse(path, media_type="application/x-hdf5", filename="failed.h5")


async def save_bundle(recorder: FailureRecorder | None, bundles: Bundles) -> dict[str, Any] | None:
    """Save the film of a recorder; delete the film if the page disconnects meanwhile."""
    if recorder is None:
        return None
    saving = asyncio.ensure_future(in_thread(lambda: bundles.save(recorder)))

    def discard(saved: "asyncio.Future[dict[str, Any] | None]") -> None:
        with contextlib.suppress(Exception, asyncio.CancelledError):
            if row := saved.result():
                bundles.drop(row["bundle"])

    try:
        return await asyncio.shield(saving)
    except asyncio.CancelledError:
        saving.add_done_callback(discard)
        raise
