"""Bounded queue of rows from a worker thread to a page."""

import asyncio
from collections.abc import Mapping
from typing import Any

from starlette.websockets import WebSocket

MAX_ROWS = 200

TIMEOUT_S = 30.0
"""Time in s for a page to accept a row; a slower page counts as disconnected."""


class GoneError(Exception):
    """The page has disconnected."""


class RowQueue:
    """Queue of rows from a worker to a page; a slow page blocks no other worker."""

    def __init__(self, socket: WebSocket):
        self._socket, self._loop = socket, asyncio.get_running_loop()
        self._rows: asyncio.Queue[Mapping[str, Any] | None] = asyncio.Queue(MAX_ROWS)
        self._is_cancelled = False

    def put(self, row: Mapping[str, Any]) -> None:
        """Append a row from the worker thread; raise a GoneError if the page has disconnected."""
        if self._is_cancelled:
            raise GoneError
        future = asyncio.run_coroutine_threadsafe(self._rows.put(row), self._loop)
        try:
            future.result(TIMEOUT_S)
        except TimeoutError:
            future.cancel()
            raise GoneError from None

    async def put_in_loop(self, row: Mapping[str, Any]) -> None:
        """Append a row from the event loop."""
        await self._rows.put(row)

    def cancel(self) -> None:
        """End the worker at the next row."""
        self._is_cancelled = True
        while not self._rows.empty():  # wakes a blocked worker
            self._rows.get_nowait()

    async def forward(self) -> None:
        """Send rows until `end`; raise a GoneError if the page accepts no row in time."""
        while (row := await self._rows.get()) is not None:
            try:
                await asyncio.wait_for(self._socket.send_json(row), TIMEOUT_S)
            except TimeoutError:
                raise GoneError from None

    async def end(self) -> None:
        """End `forward` after the last row."""
        await self._rows.put(None)
