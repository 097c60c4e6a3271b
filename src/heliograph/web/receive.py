"""WebSocket of page *Receive*: reception of an uploaded film or of the camera of the browser."""

import asyncio
import contextlib
from typing import Annotated, Literal

from fastapi import APIRouter, WebSocket
from pydantic import Field, ValidationError

from heliograph.base.errors import HeliographError, MediaError
from heliograph.web.camera_frames import CameraFrames
from heliograph.web.connection import Outbox, closing, converse, taking_place
from heliograph.web.crashes import GoneError, in_thread
from heliograph.web.failures import FailureRecorder
from heliograph.web.link_estimate import LinkRequest
from heliograph.web.reading import PageReader
from heliograph.web.security import PROTOCOL
from heliograph.web.shared import Shared, SharedState, named_as

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
    async with closing(socket, "error", "error"):
        request = await _receive_request(socket)
        async with taking_place(shared.sessions, shared.limits.place_s):
            await _run(socket, shared, request)
        await socket.close()


async def _receive_request(socket: WebSocket) -> ReceiveRequest:
    try:
        async with asyncio.timeout(10.0):
            return ReceiveRequest.model_validate_json(await socket.receive_text())
    except TimeoutError:
        raise GoneError from None
    except (ValidationError, UnicodeError, KeyError):
        raise MediaError("the first message must be a request in JSON") from None


async def _run(socket: WebSocket, shared: Shared, request: ReceiveRequest) -> None:
    """Receive in a worker thread, send rows to the page, and handle messages of the page."""
    outbox, camera = Outbox(), CameraFrames()
    recorder = FailureRecorder(shared.folder, request.default_link.signal)
    reader = PageReader(request, outbox.tell, recorder, shared.bundles)

    async def handle(message: str | bytes) -> None:
        """Queue a frame, end the camera, or save the failed packets."""
        if request.kind == "film":
            raise MediaError("a page sends no messages during the reception of a film")
        if isinstance(message, bytes):
            camera.put(message)
        elif message == "end":
            camera.end()
        elif message == "save":
            try:
                bundle = await in_thread(lambda: recorder.save(shared.bundles))
                outbox.tell({"event": "saved", **bundle})
            except HeliographError as error:
                outbox.tell({"event": "refused", "error": str(error)})
        else:
            raise MediaError("a page sends frames, 'save' and 'end'")

    def work() -> None:
        with contextlib.closing(recorder):
            reader.read_upload(path) if path else reader.read_camera(camera)

    async def run_worker() -> None:
        await outbox.run(work)
        outbox.end()

    path = None
    with contextlib.ExitStack() as stack:
        if request.kind == "film":
            path = stack.enter_context(shared.uploads.of(request.film).reading())
            stack.enter_context(named_as(path, "the film"))
            stack.callback(shared.uploads.drop, request.film)
        worker = asyncio.create_task(run_worker())
        try:
            await converse(socket, outbox, handle)
        finally:
            camera.end(0.0)
            await asyncio.wait([worker])  # occupies the film and a place until the end
