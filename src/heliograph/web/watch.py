"""Routes and WebSocket of page *Watch*."""

from typing import Any

from fastapi import APIRouter, WebSocket

from heliograph.base.files import shown_name
from heliograph.link.settings import PRESETS
from heliograph.media.live.camera import list_cameras
from heliograph.media.live.reader import is_camera
from heliograph.media.live.settings import camera_settings
from heliograph.receive.registry import RECEIVERS, is_bound
from heliograph.web.connection import closing, taking_place
from heliograph.web.crashes import in_thread
from heliograph.web.recorded_drive import RECORDED_DRIVE
from heliograph.web.security import PROTOCOL
from heliograph.web.shared import SharedState
from heliograph.web.watching.session import Session

router = APIRouter(prefix="/api/watch")


@router.get("/sources")
async def sources(shared: SharedState) -> dict[str, Any]:
    """Return the films of the command line, the presets of drives, and the receivers."""
    names = [film if is_camera(film) else shown_name(film) for film in shared.films]
    presets = [{"name": name, "text": text} for name, (text, _) in PRESETS.items()]
    recorded = shared.films == (str(RECORDED_DRIVE),)
    receivers = [name for name in RECEIVERS.names() if not is_bound(name)]
    return {"named": names, "recorded": recorded, "presets": presets, "receivers": receivers}


@router.get("/cameras")
async def cameras(shared: SharedState) -> dict[str, Any]:
    """Return the live cameras of this machine, and the missing requirements of other kinds."""
    settings = camera_settings(shared.camera)
    found, missing = await in_thread(lambda: list_cameras(settings))
    shared.cameras[:] = [camera["name"] for camera in found]
    return {"cameras": found, "lacking": missing}


@router.websocket("")
async def watch(socket: WebSocket, shared: SharedState) -> None:
    """Show receptions to a page."""
    await socket.accept(PROTOCOL if PROTOCOL in socket.scope.get("subprotocols", ()) else None)
    async with closing(socket, "failed", "reason"), taking_place(shared.sessions, shared.limits.place_s):
        await Session(socket, shared).run()
