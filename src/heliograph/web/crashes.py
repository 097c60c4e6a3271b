"""Worker threads of the server: unexpected exceptions are logged and reported to the page; memory is released."""

import asyncio
import contextlib
import ctypes
import gc
import logging
import re
from collections.abc import AsyncIterator, Callable, Mapping
from typing import Any, TypeVar

from starlette.concurrency import run_in_threadpool
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect, WebSocketState

from heliograph.base.errors import HeliographError, brief
from heliograph.media.live.camera import CameraCrashError
from heliograph.web.row_queue import GoneError
from heliograph.web.shared import BusyError, Places

T = TypeVar("T")

LOG = logging.getLogger("heliograph.web")

NORMAL, GOING_AWAY, POLICY, INTERNAL, TRY_AGAIN = 1000, 1001, 1008, 1011, 1013
"""Close codes of WebSockets (RFC 6455, section 7.4.1, and the IANA registry)."""


def release_memory() -> None:
    """Return freed memory to the system.

    The C library of Linux (glibc) keeps freed memory in an arena for each thread. Frames of a reception leave gaps that
    only `malloc_trim` returns; otherwise the server grows with each receiving thread.
    """
    gc.collect()
    # other C libraries and systems return memory automatically
    with contextlib.suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).malloc_trim(ctypes.c_size_t(0))


class CrashError(Exception):
    """Unexpected exception of a worker thread; the cause is the exception."""


def is_crash(error: BaseException) -> bool:
    """Return True if an error is unexpected and needs a traceback."""
    return isinstance(error, CameraCrashError) or not isinstance(error, HeliographError)


def report(error: BaseException) -> str:
    """Return an error as one line for a page; log the traceback of an unexpected error."""
    cause = error.__cause__ if isinstance(error, CrashError) and error.__cause__ is not None else error
    line = str(cause) if isinstance(cause, HeliographError) else _line_of(cause)
    if is_crash(cause):
        LOG.error("%s", line, exc_info=cause)
    return line


def _line_of(error: BaseException) -> str:
    if isinstance(error, MemoryError):
        return "not enough memory for frames of that size: end other receptions, or use a smaller film"
    if isinstance(error, OSError) and error.strerror:
        return f"input or output failed: {brief(error.strerror)}"
    try:
        # pages do not learn folders of the server
        text = re.sub(r"(?<!\w)/(?:[^\s/'\"]+/)+", "", brief(error)) if isinstance(error, Exception) else ""
    except Exception:  # the conversion of an exception to text may fail
        text = ""
    name = type(error).__name__ + (f": {text}" if text else "")
    return f"the server failed by an internal error ({name}); please report it with the traceback in the server's log"


async def in_thread(work: Callable[[], T]) -> T:
    """Run a function in a worker thread, and return the result.

    Unexpected exceptions become a `CrashError`: `KeyboardInterrupt` and `SystemExit` of a worker thread would end the
    event loop.
    """

    def guarded() -> T:
        try:
            return work()
        except (HeliographError, GoneError):
            raise
        except BaseException as error:
            raise CrashError from error

    return await run_in_threadpool(guarded)


@contextlib.asynccontextmanager
async def taking_place(places: Places) -> AsyncIterator[None]:
    """Occupy a place during the block; release memory at the end."""
    with places.take():
        try:
            yield
        finally:
            # a separate task survives the cancellation of this task
            await asyncio.shield(asyncio.ensure_future(in_thread(release_memory)))


@contextlib.asynccontextmanager
async def closing(socket: WebSocket, row_of: Callable[[str], Mapping[str, Any]]) -> AsyncIterator[None]:
    """Report an exception of the block to the page, and close the WebSocket."""
    try:
        yield
    except WebSocketDisconnect:
        pass
    except GoneError:
        await _close(socket, GOING_AWAY)
    except Exception as error:
        is_disconnected = WebSocketState.DISCONNECTED in (socket.client_state, socket.application_state)
        if isinstance(error, RuntimeError) and is_disconnected:
            return
        code = TRY_AGAIN if isinstance(error, BusyError) else INTERNAL if is_crash(error) else POLICY
        await _close(socket, code, row_of(report(error)))


async def _close(socket: WebSocket, code: int, row: Mapping[str, Any] | None = None) -> None:
    with contextlib.suppress(RuntimeError, WebSocketDisconnect):
        if row is not None:
            await socket.send_json(row)
        await socket.close(code)


class CrashReports:
    """Middleware that reports unexpected exceptions of request handlers."""

    def __init__(self, app: ASGIApp):
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on; see ASGI."""
        is_started = False

        async def send_and_note(message: Message) -> None:
            nonlocal is_started
            is_started = True
            await send(message)

        try:
            await self._app(scope, receive, send_and_note)
        except Exception as error:
            if scope["type"] != "http":
                raise
            line = report(error)
            if is_started:  # the server closes the connection of an incomplete response
                raise
            await JSONResponse({"error": line}, 500)(scope, receive, send)
