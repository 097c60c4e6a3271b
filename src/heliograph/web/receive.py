"""WebSocket of page *Receive*: reception of an uploaded film or of the camera of the browser."""

import asyncio
import contextlib
import functools
from collections.abc import Awaitable, Callable
from typing import Annotated, Any, Literal

from fastapi import APIRouter, WebSocket
from pydantic import Field, ValidationError
from starlette.websockets import WebSocketDisconnect

from heliograph.base.errors import HeliographError, MediaError
from heliograph.web.camera_frames import CameraFrames, MessageError
from heliograph.web.crashes import closing, in_thread, taking_place
from heliograph.web.failures import Bundles, FailureRecorder
from heliograph.web.files import save_bundle
from heliograph.web.link_estimate import LinkRequest
from heliograph.web.reading import PageReader
from heliograph.web.row_queue import GoneError, RowQueue
from heliograph.web.security import PROTOCOL
from heliograph.web.shared import SharedState, named_as

Handle = Callable[[bytes | str], Awaitable[dict[str, Any] | None]]
"""Handles a message of a page, and returns an optional answer."""

router = APIRouter(prefix="/api/receive")


class ReceiveRequest(LinkRequest):
    """First message of a page, in JSON."""

    kind: Literal["film", "camera"]
    film: Annotated[str, Field(max_length=64)] = ""


@router.websocket("")
async def receive(socket: WebSocket, shared: SharedState) -> None:
    """Receive an upload or a camera, and report to the page.

    The first message is a `ReceiveRequest`. From a camera, binary messages follow (see `camera_frames.HEAD`), and the
    texts "save" and "end".
    """
    await socket.accept(PROTOCOL)
    async with closing(socket, lambda line: {"event": "error", "error": line}):
        request = await _receive_request(socket)
        async with taking_place(shared.sessions):
            rows = RowQueue(socket)
            # 256 MB: 40 s of 480 x 480 pixels at 30 frames/s
            recorder = FailureRecorder(shared.uploads.folder(), max_bytes=256 << 20)
            reader = PageReader(request, rows.put, recorder, shared.bundles)
            if request.kind == "film":
                with shared.uploads.reading(request.film) as path, named_as(path, "the film"):
                    await _run(socket, rows, recorder, lambda: reader.read_upload(path), _reject)
                shared.uploads.drop(request.film)
            else:
                camera = CameraFrames()
                handle = functools.partial(_handle_camera, camera, recorder, shared.bundles)
                await _run(socket, rows, recorder, lambda: reader.read_camera(camera), handle, lambda: camera.end(0.0))
        await socket.close()


async def _receive_request(socket: WebSocket) -> ReceiveRequest:
    try:
        message = await asyncio.wait_for(socket.receive(), 10.0)
    except TimeoutError:
        raise GoneError from None
    if message["type"] == "websocket.disconnect":
        raise WebSocketDisconnect
    if not isinstance(message.get("text"), str):
        raise MessageError("the first message must be a request in JSON")
    try:
        return ReceiveRequest.model_validate_json(message["text"])
    except (ValidationError, UnicodeError):
        raise MessageError("invalid request") from None


async def _reject(_message: bytes | str) -> None:
    raise MessageError("a page sends no messages during the reception of a film")


async def _handle_camera(
    camera: CameraFrames, recorder: FailureRecorder, bundles: Bundles, message: bytes | str
) -> dict[str, Any] | None:
    """Queue a frame, end the camera, or save the failed packets."""
    if isinstance(message, bytes):
        camera.put(message)
    elif message == "end":
        camera.end()
    elif message == "save":
        return await _save(recorder, bundles)
    else:
        raise MessageError("a page sends frames, 'save' and 'end'")
    return None


async def _save(recorder: FailureRecorder, bundles: Bundles) -> dict[str, Any]:
    """Save the failed packets so far, and return the answer to the page."""
    try:
        bundle = await save_bundle(recorder, bundles)
        if bundle is None:
            raise MediaError("the camera has sent no frames: start the camera")
    except HeliographError as error:
        return {"event": "refused", "error": str(error)}
    return {"event": "saved", **bundle}


async def _run(
    socket: WebSocket,
    rows: RowQueue,
    recorder: FailureRecorder,
    work: Callable[[], None],
    handle: Handle,
    stop: Callable[[], None] = lambda: None,
) -> None:
    """Run a worker, send rows to the page, and handle messages of the page; `stop` unblocks the worker."""

    def work_and_discard() -> None:
        with contextlib.closing(recorder):
            work()

    async def run_worker() -> None:
        try:
            with contextlib.suppress(GoneError):
                await in_thread(work_and_discard)
        finally:
            await rows.end()

    worker = asyncio.ensure_future(run_worker())
    tasks = [asyncio.create_task(rows.forward()), asyncio.create_task(_handle_messages(socket, rows, handle))]
    done = set[asyncio.Task[None]]()
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    finally:
        rows.cancel()
        stop()
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
    await worker  # occupies the film and a place until the end
    for task in done:
        task.result()


async def _handle_messages(socket: WebSocket, rows: RowQueue, handle: Handle) -> None:
    """Handle messages until the page disconnects."""
    while True:
        message = await socket.receive()
        if message["type"] == "websocket.disconnect":
            raise WebSocketDisconnect
        data = message.get("bytes")
        answer = await handle(message.get("text") or "" if data is None else data)
        if answer is not None:
            await rows.put_in_loop(answer)
