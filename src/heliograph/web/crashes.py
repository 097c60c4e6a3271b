"""Unexpected exceptions: logged with a traceback and reported to the page as one line; memory is returned."""

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
from heliograph.web.shared import BusyError, Places
from heliograph.web.told import GoneError


def release_memory() -> None:
    """Return freed memory to the system.

    The C library of Linux (glibc) keeps freed memory in an arena for each thread. Frames of a reception leave gaps that
    only `malloc_trim` gives back; without it the server grows with each thread that has received.
    """
    gc.collect()
    with contextlib.suppress(
        AttributeError, OSError, TypeError
    ):  # other C libraries, and systems, return it themselves
        ctypes.CDLL(None).malloc_trim(ctypes.c_size_t(0))


T = TypeVar("T")

LOG = logging.getLogger("heliograph.web")

FOLDERS = re.compile(r"(?<!\w)/(?:[^\s/'\"]+/)+")
"""Folders of a path within a text: where files of the server lie concerns no page."""

GOING_AWAY, POLICY, INTERNAL, TRY_AGAIN = 1001, 1008, 1011, 1013
"""Codes with which a WebSocket is closed (RFC 6455, section 7.4.1, and the registry of codes)."""


class CrashError(Exception):
    """Unexpected exception of a worker thread; the exception is its cause."""


def is_crash(error: BaseException) -> bool:
    """Return True if an error is unexpected, so that its traceback is needed to mend it."""
    return isinstance(error, CameraCrashError) or not isinstance(error, HeliographError)


def report(error: BaseException) -> str:
    """Return an error as one line for a page; log an unexpected one with its traceback."""
    cause = error.__cause__ if isinstance(error, CrashError) and error.__cause__ is not None else error
    line = str(cause) if isinstance(cause, HeliographError) else _line_of(cause)
    if is_crash(cause):
        LOG.error("%s", line, exc_info=cause)
    return line


def _line_of(error: BaseException) -> str:
    if isinstance(error, MemoryError):
        return "not enough memory for frames of that size: end other receptions, or take a smaller film"
    if isinstance(error, OSError) and error.strerror:
        return f"input or output failed: {brief(error.strerror)}"
    try:
        text = FOLDERS.sub("", brief(error)) if isinstance(error, Exception) else ""
    except Exception:  # an exception whose text cannot be made is still named
        text = ""
    named = type(error).__name__ + (f": {text}" if text else "")
    return f"the server failed by an internal error ({named}); please report it with the traceback in the server's log"


async def in_thread(work: Callable[[], T]) -> T:
    """Run work in a worker thread, and return its result.

    An exception of any kind is raised here as a `CrashError`, but for those that are expected. `KeyboardInterrupt` and
    `SystemExit` of a worker thread would end the server's loop.
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
    """Take a place for the block; return its memory to the system at the end."""
    with places.take():
        try:
            yield
        finally:
            # a task of its own, which goes on where this one is cancelled
            await asyncio.shield(asyncio.ensure_future(in_thread(release_memory)))


@contextlib.asynccontextmanager
async def closing(socket: WebSocket, row_of: Callable[[str], Mapping[str, Any]]) -> AsyncIterator[None]:
    """Close a WebSocket that the block ends by an exception, after a row that says why."""
    try:
        yield
    except WebSocketDisconnect:
        pass
    except GoneError:
        await _close(socket, GOING_AWAY)
    except Exception as error:
        if isinstance(error, RuntimeError) and _is_disconnected(socket):
            return
        code = TRY_AGAIN if isinstance(error, BusyError) else INTERNAL if is_crash(error) else POLICY
        await _close(socket, code, row_of(report(error)))


def _is_disconnected(socket: WebSocket) -> bool:
    return WebSocketState.DISCONNECTED in (socket.client_state, socket.application_state)


async def _close(socket: WebSocket, code: int, row: Mapping[str, Any] | None = None) -> None:
    with contextlib.suppress(RuntimeError, WebSocketDisconnect):
        if row is not None:
            await socket.send_json(row)
        await socket.close(code)


class CrashReports:
    """Middleware that answers a request whose handler crashed."""

    def __init__(self, app: ASGIApp):
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on; see ASGI."""
        begun = False

        async def noted(message: Message) -> None:
            nonlocal begun
            begun = True
            await send(message)

        try:
            await self._app(scope, receive, noted)
        except Exception as error:
            if scope["type"] != "http":
                raise
            line = report(error)
            if begun:  # a half answer cannot be mended: the server breaks the connection off
                raise
            await JSONResponse({"error": line}, 500)(scope, receive, send)
