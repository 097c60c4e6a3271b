"""The server's part of page *Receive*: a phone's film that was uploaded, or the frames of the browser's own camera."""

import asyncio
import contextlib
from collections.abc import Awaitable, Callable
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, WebSocket
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from starlette.websockets import WebSocketDisconnect

from heliograph.base.errors import HeliographError
from heliograph.probe.screens import SIDES
from heliograph.web.camera_frames import CameraFrames, MessageError
from heliograph.web.crashes import closing, in_thread, taking_place
from heliograph.web.failures import Saver
from heliograph.web.looking import Asked
from heliograph.web.reading import read_camera, read_upload
from heliograph.web.security import PROTOCOL
from heliograph.web.sending import LEAST_RATE_HZ, MOST_RATE_HZ
from heliograph.web.shared import Shared, named_as, shared_of
from heliograph.web.told import GoneError, Told

Take = Callable[[bytes | str], Awaitable[dict[str, Any] | None]]
"""Takes a page's message; what it returns is told."""

router = APIRouter(prefix="/api/receive")


class Wish(BaseModel):
    """The first message of a page."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)

    kind: Literal["film", "camera"]
    film: Annotated[str, Field(max_length=64)] = ""
    side: Annotated[int, Field(ge=SIDES[0], le=SIDES[-1], multiple_of=SIDES.step)] | None = None
    rate_hz: Annotated[float, Field(ge=LEAST_RATE_HZ, le=MOST_RATE_HZ)] | None = None


Here = Annotated[Shared, Depends(shared_of)]


@router.websocket("")
async def receive(socket: WebSocket, shared: Here) -> None:
    """Read an upload or a camera for a page, and tell it all.

    Parameters
    ----------
    socket
        Its first message is a `Wish` in JSON. Of a camera, binary messages follow (`camera_frames.HEAD`), and the
        texts "save" and "end".
    shared
        Uploads, places, and films of what failed.
    """
    await socket.accept(PROTOCOL)
    async with closing(socket, lambda line: {"event": "error", "error": line}):
        wish = await _wish(socket)
        async with taking_place(shared.sessions):
            if wish.kind == "film":
                await _film(socket, shared, wish)
            else:
                await _camera(socket, shared, wish)
        await socket.close()


async def _wish(socket: WebSocket) -> Wish:
    try:
        # Longest time in s in which a page says what it wants. Chosen
        text = await asyncio.wait_for(socket.receive(), 10.0)
    except TimeoutError:
        raise GoneError from None
    if text["type"] == "websocket.disconnect":
        raise WebSocketDisconnect
    if not isinstance(text.get("text"), str):
        raise MessageError("the first message says what to receive, in JSON")
    try:
        return Wish.model_validate_json(text["text"])
    except (ValidationError, UnicodeError):
        raise MessageError("that is no message of these pages") from None


async def _film(socket: WebSocket, shared: Shared, wish: Wish) -> None:
    told, saver = Told(socket), _saver(shared)
    with shared.uploads.reading(wish.film) as path:

        def work() -> None:
            try:
                with named_as(path, "the film"):
                    read_upload(path, _asked(wish), told.tell, saver)
            finally:
                saver.close()

        await _work(socket, told, work, _refuse)
    shared.uploads.drop(wish.film)  # what is read is not needed any more


async def _camera(socket: WebSocket, shared: Shared, wish: Wish) -> None:
    told, camera, saver = Told(socket), CameraFrames(), _saver(shared)

    async def take(message: bytes | str) -> dict[str, Any] | None:
        if isinstance(message, bytes):
            camera.put(message)
        elif message == "end":
            camera.end()
        elif message == "save":
            return await _saved(saver, shared)
        else:
            raise MessageError("a page sends frames, 'save' and 'end'")
        return None

    def work() -> None:
        try:
            read_camera(camera, _asked(wish), told.tell, saver)
        finally:
            saver.close()

    await _work(socket, told, work, take, lambda: camera.end(0.0))


def _saver(shared: Shared) -> Saver:
    return Saver(shared.uploads.folder(), shared.bundles)


async def _saved(saver: Saver, shared: Shared) -> dict[str, Any]:
    """What is told once what failed so far is saved; a page that goes meanwhile leaves nothing behind."""
    saving = asyncio.ensure_future(in_thread(saver.save))
    try:
        return {"event": "saved", **await asyncio.shield(saving)}
    except HeliographError as error:
        return {"event": "refused", "error": str(error)}
    except asyncio.CancelledError:
        saving.add_done_callback(lambda done: _thrown_away(done, shared))
        raise


def _thrown_away(saving: "asyncio.Future[dict[str, Any]]", shared: Shared) -> None:
    if not saving.cancelled() and saving.exception() is None:
        shared.bundles.drop(saving.result()["bundle"])


async def _refuse(_message: bytes | str) -> None:
    raise MessageError("a page that has its film read says nothing")


def _asked(wish: Wish) -> Asked:
    return Asked(wish.side, wish.rate_hz)


async def _work(
    socket: WebSocket, told: Told, work: Callable[[], None], take: Take, stop: Callable[[], None] = lambda: None
) -> None:
    """Run a worker in its thread, send its rows to the page and take the page's messages; `stop` ends its waiting."""
    worker = asyncio.ensure_future(_run(work, told))
    telling, hearing = asyncio.ensure_future(told.forward()), asyncio.ensure_future(_hear(socket, told, take))
    done: set[asyncio.Future[None]] = set()
    try:
        done, _ = await asyncio.wait((telling, hearing), return_when=asyncio.FIRST_COMPLETED)
    finally:
        told.gone()
        stop()
        telling.cancel()
        hearing.cancel()
        await asyncio.gather(telling, hearing, return_exceptions=True)
    await worker  # it holds the film, and its place among the receptions
    for task in done:
        task.result()


async def _run(work: Callable[[], None], told: Told) -> None:
    """Run a worker to its end."""
    try:
        with contextlib.suppress(GoneError):
            await in_thread(work)
    finally:
        await told.end()


async def _hear(socket: WebSocket, told: Told, take: Take) -> None:
    """Take a page's messages until it is gone."""
    while True:
        message = await socket.receive()
        if message["type"] == "websocket.disconnect":
            raise WebSocketDisconnect
        data = message.get("bytes")
        answer = await take(message.get("text") or "" if data is None else data)
        if answer is not None:
            await told.answer(answer)
