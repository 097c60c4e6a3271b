"""The server's part of page *Watch*: what may be watched, and the WebSocket that shows it."""

from typing import Annotated, Any

from fastapi import APIRouter, Depends, WebSocket

from heliograph.base.files import shown_name
from heliograph.link.settings import PRESETS
from heliograph.media.live.camera import list_cameras
from heliograph.media.live.reader import is_camera
from heliograph.media.live.settings import camera_settings
from heliograph.receive.registry import RECEIVERS
from heliograph.web.crashes import closing, in_thread, taking_place
from heliograph.web.security import PROTOCOL
from heliograph.web.shared import Shared, shared_of
from heliograph.web.watching.session import Session

router = APIRouter(prefix="/api/watch")
Ours = Annotated[Shared, Depends(shared_of)]


@router.get("/sources")
async def sources(shared: Ours) -> dict[str, Any]:
    """What may be watched: films named with the command, presets of drives; and the receivers."""
    named = [film if is_camera(film) else shown_name(film) for film in shared.films]
    presets = [{"name": name, "text": text} for name, (text, _) in PRESETS.items()]
    return {"named": named, "presets": presets, "receivers": list(RECEIVERS.names())}


@router.get("/cameras")
async def cameras(shared: Ours) -> dict[str, Any]:
    """The live cameras of this machine, and what is missing to see others."""
    asked = camera_settings(shared.camera)
    found, lacking = await in_thread(lambda: list_cameras(asked))
    shared.cameras[:] = [one["name"] for one in found]
    return {"cameras": found, "lacking": lacking}


@router.websocket("")
async def watch(socket: WebSocket) -> None:
    """Show a reception to a page."""
    shared = shared_of(socket)
    await socket.accept(PROTOCOL if PROTOCOL in socket.scope.get("subprotocols", ()) else None)
    async with closing(socket, lambda line: {"event": "failed", "reason": line}), taking_place(shared.sessions):
        await Session(socket, shared).attend()
