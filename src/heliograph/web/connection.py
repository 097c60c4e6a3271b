"""WebSocket of a page: rows and pictures from a worker thread, messages of the page, and reports of errors."""

import asyncio
import contextlib
import ctypes
import gc
import json
import threading
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable
from math import inf

from starlette.websockets import WebSocket, WebSocketDisconnect, WebSocketState

from heliograph.measure.journal import Row
from heliograph.web.crashes import GoneError, in_thread, is_crash, report
from heliograph.web.stores import BusyError, Places

GOING_AWAY, POLICY, INTERNAL, TRY_AGAIN = 1001, 1008, 1011, 1013
"""Close codes of WebSockets (RFC 6455, section 7.4.1, and the IANA registry)."""


class Outbox:
    """Queue of rows, and the newest picture, from a worker thread to a page.

    `max_unheard` limits the rows that the page has not acknowledged, and thus the buffers between server and page.
    """

    def __init__(self, max_unheard: float = inf, max_waiting_bytes: int = 16 << 20):
        self._loop, self._lock, self._changed = asyncio.get_running_loop(), threading.Lock(), asyncio.Event()
        self._max_unheard, self._max_waiting_bytes = max_unheard, max_waiting_bytes
        self._rows: deque[str] = deque()
        self._waiting_bytes, self._sent, self._heard = 0, 0, 0
        self._picture: Callable[[], bytes] | None = None
        # the page draws a picture while another arrives
        self._free_pictures = 2
        self._is_closed = self._is_ended = False
        self._error: Exception | None = None

    def tell(self, row: Row) -> None:
        """Append a row; raise a GoneError after the end of the connection, or if the page accepts rows too slowly."""
        if self._is_closed:
            raise GoneError
        text = json.dumps(row)
        with self._lock:
            self._waiting_bytes += len(text)
            if self._waiting_bytes > self._max_waiting_bytes:
                self._rows.clear()
                self._is_closed = self._is_ended = True
                self._error = BusyError("the page accepts rows too slowly")
            else:
                self._rows.append(text)
        self._wake()

    def show(self, picture: Callable[[], bytes]) -> None:
        """Replace the waiting picture, a function that returns the message."""
        with self._lock:
            self._picture = picture
        self._wake()

    def acknowledge_rows(self, count: int) -> None:
        """Count the rows that the page has received."""
        self._heard = max(self._heard, min(count, self._sent))
        self._changed.set()

    def acknowledge_picture(self) -> None:
        """Allow another picture."""
        self._free_pictures = min(self._free_pictures + 1, 2)
        self._changed.set()

    def end(self, error: Exception | None = None) -> None:
        """End `send_to` after the last row, with the error if there is one."""
        self._is_ended, self._error = True, self._error or error
        self._changed.set()

    def close(self) -> None:
        """End the worker at the next row."""
        self._is_closed = True

    async def run(self, work: Callable[[], None]) -> None:
        """Run a function in a worker thread; an error ends `send_to`."""
        try:
            await in_thread(work)
        except GoneError:
            pass
        except Exception as error:
            self.end(error)

    async def send_to(self, socket: WebSocket) -> None:
        """Send rows and pictures until the end."""
        while not (self._is_ended and not self._rows):
            await self._changed.wait()
            self._changed.clear()
            while self._sent - self._heard < self._max_unheard and (text := self._next_row()):
                self._sent += 1
                await socket.send_text(text)
            if self._free_pictures and self._picture is not None:
                with self._lock:
                    picture, self._picture = self._picture, None
                self._free_pictures -= 1
                await socket.send_bytes(await in_thread(picture))
        if self._error is not None:
            raise self._error

    def _next_row(self) -> str:
        with self._lock:
            text = self._rows.popleft() if self._rows else ""
            self._waiting_bytes -= len(text)
        return text

    def _wake(self) -> None:
        with contextlib.suppress(RuntimeError):  # the event loop has ended
            self._loop.call_soon_threadsafe(self._changed.set)


async def converse(
    socket: WebSocket,
    outbox: Outbox,
    handle: Callable[[str | bytes], Awaitable[None]],
    timeout_s: Callable[[], float | None] = lambda: None,
) -> None:
    """Send rows and handle messages until the last row, or until the page disconnects or sends nothing in time."""
    tasks = [asyncio.create_task(outbox.send_to(socket)), asyncio.create_task(_receive(socket, handle, timeout_s))]
    try:
        done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in done:
            task.result()
    finally:
        outbox.close()
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def _receive(
    socket: WebSocket, handle: Callable[[str | bytes], Awaitable[None]], timeout_s: Callable[[], float | None]
) -> None:
    while True:
        try:
            message = await asyncio.wait_for(socket.receive(), timeout_s())
        except TimeoutError:
            raise GoneError from None
        if message["type"] == "websocket.disconnect":
            raise WebSocketDisconnect
        data = message.get("bytes")
        await handle(message.get("text") or "" if data is None else data)


@contextlib.asynccontextmanager
async def taking_place(places: Places, wait_s: float) -> AsyncIterator[None]:
    """Occupy a place during the block, if need be after a wait for receptions that end; release memory at the end."""
    for _ in range(int(20 * wait_s)):
        if places.are_taken:
            await asyncio.sleep(0.05)
    with places.take():
        try:
            yield
        finally:
            # a separate task survives the cancellation of this task
            await asyncio.shield(asyncio.ensure_future(in_thread(release_memory)))


def release_memory() -> None:
    """Return freed memory to the system.

    The C library of Linux (glibc) keeps freed memory in an arena for each thread. Frames of a reception leave gaps that
    only `malloc_trim` returns; otherwise the server grows with each receiving thread.
    """
    gc.collect()
    # other C libraries and systems return memory automatically
    with contextlib.suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).malloc_trim(ctypes.c_size_t(0))


@contextlib.asynccontextmanager
async def closing(socket: WebSocket, event: str, key: str) -> AsyncIterator[None]:
    """Report an exception of the block to the page in a row, and close the WebSocket."""
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
        await _close(socket, code, {"event": event, key: report(error)})


async def _close(socket: WebSocket, code: int, row: Row | None = None) -> None:
    # the pings of the server disconnect unresponsive pages
    with contextlib.suppress(RuntimeError, WebSocketDisconnect):
        if row is not None:
            await socket.send_json(row)
        await socket.close(code)
