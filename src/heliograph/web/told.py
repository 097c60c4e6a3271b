"""What a worker tells a page: rows in a queue of bounded length, by which a slow page holds up its worker alone."""

import asyncio
from collections.abc import Mapping
from concurrent.futures import Future
from typing import Any

from starlette.websockets import WebSocket

MOST_WAITING = 200
"""Rows that wait for a page at most. Chosen."""

PATIENCE_S = 30.0
"""Longest time in s that a page may take for its oldest row, after which it counts as gone. Chosen."""


class GoneError(Exception):
    """Nobody listens any more."""


class Told:
    """Rows on their way from a worker to a page; made in the server's own thread."""

    def __init__(self, socket: WebSocket):
        self._socket, self._loop = socket, asyncio.get_running_loop()
        self._rows: asyncio.Queue[Mapping[str, Any] | None] = asyncio.Queue(MOST_WAITING)
        self._gone = False

    def tell(self, row: Mapping[str, Any]) -> None:
        """Queue a row; called by the worker's thread, which waits where the page is slow."""
        self.check()
        putting: Future[None] = asyncio.run_coroutine_threadsafe(self._rows.put(row), self._loop)
        try:
            putting.result(PATIENCE_S)
        except TimeoutError:
            putting.cancel()
            raise GoneError from None

    async def answer(self, row: Mapping[str, Any]) -> None:
        """Queue a row; called in the server's own thread."""
        await self._rows.put(row)

    def check(self) -> None:
        """Raise a `GoneError` where nobody listens any more."""
        if self._gone:
            raise GoneError

    def gone(self) -> None:
        """Say that the page is gone: the worker ends with what it tells next."""
        self._gone = True
        while not self._rows.empty():  # whoever waits to put one in must not wait on
            self._rows.get_nowait()

    async def forward(self) -> None:
        """Send rows until the worker has ended; raise a `GoneError` if the page takes none of them."""
        while (row := await self._rows.get()) is not None:
            try:
                await asyncio.wait_for(self._socket.send_json(row), PATIENCE_S)
            except TimeoutError:
                raise GoneError from None

    async def end(self) -> None:
        """Let `forward` end, once all was sent."""
        await self._rows.put(None)
