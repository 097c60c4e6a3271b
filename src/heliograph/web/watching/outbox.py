"""Queue of rows and scenes from a reception to a page."""

import asyncio
import contextlib
import json
import threading
from collections import deque

from heliograph.measure.journal import Row
from heliograph.web.crashes import is_crash, report
from heliograph.web.watching.scene import Scene

MAX_WAITING = 16 << 20
"""Bytes of waiting rows: minutes of packets. Slower pages are disconnected."""


class Outbox:
    """Queue of rows, and the newest scene; filled by the thread of a reception."""

    def __init__(self) -> None:
        self._loop, self._lock = asyncio.get_running_loop(), threading.Lock()
        self._rows: deque[str] = deque()
        self._scene: Scene | None = None
        self._bytes, self.is_full, self.filled, self.has_crashed = 0, False, asyncio.Event(), False

    def tell(self, row: Row) -> None:
        """Append a row; rows above 1 MB lose the content."""
        text = json.dumps(row)
        if len(text) > (1 << 20):
            text = json.dumps({k: v for k, v in row.items() if k not in ("data", "text")} | {"too_long": True})
        with self._lock:
            self.is_full |= self._bytes + len(text) > MAX_WAITING
            if not self.is_full:
                self._rows.append(text)
                self._bytes += len(text)
        self._wake()

    def fail(self, error: BaseException) -> None:
        """Append the row of an error; an unexpected error ends the session."""
        self.tell({"event": "failed", "reason": report(error)})
        self.has_crashed = is_crash(error)
        self._wake()

    @property
    def is_empty(self) -> bool:
        """True if no row waits."""
        return not self._rows

    def show(self, scene: Scene) -> None:
        """Replace the waiting scene."""
        self._scene = scene
        self._wake()

    def next_row(self) -> str | None:
        """Remove the first row."""
        with self._lock:
            if not self._rows:
                return None
            text = self._rows.popleft()
            self._bytes -= len(text)
            return text

    def next_scene(self) -> Scene | None:
        """Remove the waiting scene."""
        scene, self._scene = self._scene, None
        return scene

    def _wake(self) -> None:
        with contextlib.suppress(RuntimeError):  # the event loop has ended
            self._loop.call_soon_threadsafe(self.filled.set)
