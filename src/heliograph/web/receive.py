"""The server's part of page *Receive*: a phone's film that was uploaded, or the frames of the browser's own camera."""

import asyncio
import contextlib
import json
from collections import OrderedDict
from collections.abc import Callable
from secrets import token_hex
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, Request, WebSocket
from fastapi.responses import FileResponse
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from starlette.background import BackgroundTask
from starlette.concurrency import run_in_threadpool
from starlette.requests import HTTPConnection
from starlette.websockets import WebSocketDisconnect

from heliograph.base.errors import HeliographError, MediaError
from heliograph.probe.cells import SIDES
from heliograph.signal.settings import SignalSettings
from heliograph.web.camera_frames import CameraFrames, KeptFrames, MessageError
from heliograph.web.reading import SIDES_TRIED, USUAL_HZ, Asked, read_camera, read_upload
from heliograph.web.screen import LEAST_RATE_HZ, MOST_RATE_HZ, screen_settings
from heliograph.web.security import PROTOCOL
from heliograph.web.shared import Shared, shared_of
from heliograph.web.told import GoneError, Told

FIRST_WORD_S = 10.0
"""Longest time in s in which a page says what it wants. Chosen."""

MOST_KEPT = 2
"""Cameras whose last frames are kept: 64 MB each at most."""

Take = Callable[[bytes | str], dict[str, Any] | None]
"""Takes a page's message; what it returns is told."""

router = APIRouter(prefix="/api/receive")


class Wish(BaseModel):
    """The first message of a page.

    Attributes
    ----------
    kind
        "film" for an upload, "camera" for frames that follow.
    film
        Name of the upload.
    side
        Cells of a side; None where they are to be found.
    rate_hz
        Patterns a second; None where they are to be found.
    """

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    kind: Literal["film", "camera"]
    film: Annotated[str, Field(max_length=64)] = ""
    side: Annotated[int, Field(ge=SIDES[0], le=SIDES[-1], multiple_of=SIDES.step)] | None = None
    rate_hz: Annotated[float, Field(ge=LEAST_RATE_HZ, le=MOST_RATE_HZ)] | None = None


class Kept:
    """The last frames of cameras of which little was read, until a page has them."""

    def __init__(self) -> None:
        self._known: OrderedDict[str, KeptFrames] = OrderedDict()

    def add(self, frames: KeptFrames) -> str:
        """Keep frames, and return the name by which they are asked for.

        Parameters
        ----------
        frames
            The last frames of a camera.
        """
        name = token_hex(16)
        self._known[name] = frames
        while len(self._known) > MOST_KEPT:
            self._known.popitem(last=False)
        return name

    def of(self, name: str) -> KeptFrames:
        """Return frames that were kept.

        Parameters
        ----------
        name
            What `add` returned.

        Raises
        ------
        MediaError
            There are none of that name.
        """
        if name not in self._known:
            raise MediaError("those frames are not here any more: start the camera again")
        return self._known[name]


def kept_of(connection: HTTPConnection) -> Kept:
    """What this server keeps of cameras.

    Parameters
    ----------
    connection
        Any request or WebSocket to the server.
    """
    state = connection.app.state
    if not hasattr(state, "kept_frames"):
        state.kept_frames = Kept()
    kept: Kept = state.kept_frames
    return kept


Here = Annotated[Shared, Depends(shared_of)]
Frames = Annotated[Kept, Depends(kept_of)]


@router.websocket("")
async def receive(socket: WebSocket, shared: Here, kept: Frames) -> None:
    """Read an upload or a camera for a page, and tell it all.

    Parameters
    ----------
    socket
        Its first message is a `Wish` in JSON. Of a camera, binary messages follow (`camera_frames.HEAD`), and the
        texts "save" and "end".
    shared
        Uploads and places.
    kept
        Where a camera's last frames go.
    """
    await socket.accept(PROTOCOL)
    try:
        wish = await _wish(socket)
        with shared.sessions.take():
            if wish.kind == "film":
                await _film(socket, shared, wish)
            else:
                await _camera(socket, kept, wish)
        await socket.close()
    except (HeliographError, ValidationError) as error:
        await _close(socket, error)
    except WebSocketDisconnect:
        pass
    except (TimeoutError, RuntimeError):  # the page is as good as gone
        with contextlib.suppress(RuntimeError, WebSocketDisconnect):
            await socket.close(1001)


@router.get("/kept/{name}")
async def saved(name: str, request: Request, frames: Frames) -> FileResponse:
    """Give the frames that a page asked to save, as a film that the command opens.

    Parameters
    ----------
    name
        What the page was told.
    request
        The request.
    frames
        Where they are kept.
    """
    film = frames.of(name)
    path = shared_of(request).uploads.folder() / f"kept-{token_hex(8)}.mkv"
    await run_in_threadpool(film.write, path)
    return FileResponse(path, filename="unread.mkv", background=BackgroundTask(path.unlink, missing_ok=True))


async def _wish(socket: WebSocket) -> Wish:
    text = await asyncio.wait_for(socket.receive(), FIRST_WORD_S)
    if text["type"] == "websocket.disconnect":
        raise WebSocketDisconnect
    if not isinstance(text.get("text"), str):
        raise MessageError("the first message says what to receive, in JSON")
    return Wish.model_validate_json(text["text"])


async def _film(socket: WebSocket, shared: Shared, wish: Wish) -> None:
    told = Told(socket)
    with shared.uploads.reading(wish.film) as path:

        def work() -> None:
            try:
                read_upload(path, _asked(wish), told.tell)
            except HeliographError as error:  # where it lies is nobody's business
                raise MediaError(str(error).replace(str(path), "the film")) from None

        await _work(socket, told, work, _refuse)


async def _camera(socket: WebSocket, kept: Kept, wish: Wish) -> None:
    told, camera = Told(socket), CameraFrames()
    signal: list[SignalSettings] = [screen_settings(wish.side or SIDES_TRIED[0], wish.rate_hz or USUAL_HZ).signal]

    def take(message: bytes | str) -> dict[str, Any] | None:
        if isinstance(message, bytes):
            camera.put(message)
        elif message == "end":
            camera.end()
        elif message == "save":
            return {"event": "kept", "name": kept.add(camera.kept(signal[0]))}
        else:
            raise MessageError("a page sends frames, 'save' and 'end'")
        return None

    def work() -> None:
        read_camera(camera, _asked(wish), told.tell, lambda settings: signal.__setitem__(0, settings.signal))

    await _work(socket, told, work, take, camera.end)


def _refuse(_message: bytes | str) -> None:
    raise MessageError("a page that has its film read says nothing")


def _asked(wish: Wish) -> Asked:
    return Asked(wish.side, wish.rate_hz)


async def _work(
    socket: WebSocket, told: Told, work: Callable[[], None], take: Take, stop: Callable[[], None] = lambda: None
) -> None:
    """Run a worker in its thread while the page is told what it tells, and heard; `stop` lets it wait no longer."""
    worker = asyncio.ensure_future(_run(work, told))
    telling, hearing = asyncio.ensure_future(told.forward()), asyncio.ensure_future(_hear(socket, told, take))
    try:
        await asyncio.wait((telling, hearing), return_when=asyncio.FIRST_COMPLETED)
        for one in (hearing, telling):
            if one.done():
                one.result()
    finally:
        told.gone()
        stop()
        telling.cancel()
        hearing.cancel()
        await asyncio.gather(telling, hearing, return_exceptions=True)
    await worker


async def _run(work: Callable[[], None], told: Told) -> None:
    """Run a worker to its end; what a user can mend is told as its last word."""

    def safely() -> None:
        try:
            work()
        except HeliographError as error:
            told.tell({"event": "error", "error": str(error)})

    with contextlib.suppress(GoneError):
        await run_in_threadpool(safely)
    await told.end()


async def _hear(socket: WebSocket, told: Told, take: Take) -> None:
    """Take a page's messages until it is gone."""
    while True:
        message = await socket.receive()
        if message["type"] == "websocket.disconnect":
            raise WebSocketDisconnect
        data = message.get("bytes")
        answer = take(message.get("text") or "" if data is None else data)
        if answer is not None:
            await told.answer(answer)


async def _close(socket: WebSocket, error: Exception) -> None:
    text = "that is no message of these pages" if isinstance(error, ValidationError) else str(error)
    with contextlib.suppress(RuntimeError, WebSocketDisconnect):
        await socket.send_text(json.dumps({"event": "error", "error": text}))
        await socket.close(1008)
