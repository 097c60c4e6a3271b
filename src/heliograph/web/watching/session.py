"""A page that watches: its commands, and what it gets, as fast as it takes it."""

import asyncio
import contextlib
import json
import threading
from collections import deque
from pathlib import Path
from typing import Annotated, Literal

from fastapi import WebSocket
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from heliograph.base.errors import HeliographError
from heliograph.measure.journal import Row
from heliograph.web.crashes import INTERNAL, in_thread, is_crash, report
from heliograph.web.shared import Shared
from heliograph.web.watching.gate import Gate
from heliograph.web.watching.run import Run, Teller
from heliograph.web.watching.scene import Scene
from heliograph.web.watching.sources import Asked

MOST_WAITING = 16 << 20
"""Most bytes of rows that wait for a page; one that takes them more slowly is let go. Chosen: minutes of packets."""

ROWS_IN_FLIGHT = 1 << 20
"""Bytes of rows that may be on their way to a page; it says how many it has. So nothing piles up between server and
page, however slowly the page reads. Chosen."""

IN_FLIGHT = 2
"""Scenes that may be on their way to a page; it says when it has drawn one. Chosen: one is drawn while one comes."""

IDLE, WRONG, TOO_SLOW = 1000, 1008, 1013
"""Codes with which a WebSocket is closed (RFC 6455, section 7.4.1, and the registry of codes)."""


class Command(BaseModel):
    """What a page says."""

    model_config = ConfigDict(extra="forbid", strict=True)

    do: Literal["open", "pause", "go", "step", "packet", "speed", "stop", "save", "took", "heard"]
    source: Asked | None = None
    times: Annotated[float, Field(ge=1e-4, le=100, allow_inf_nan=False)] | None = None
    paused: bool = False
    rows: Annotated[int, Field(ge=0)] = 0


class Outbox:
    """What waits for a page: rows in order, and the newest scene; filled by the reception's thread."""

    def __init__(self, loop: asyncio.AbstractEventLoop):
        self._loop, self._lock = loop, threading.Lock()
        self._rows: deque[str] = deque()
        self._scene: Scene | None = None
        self._bytes, self.full, self.filled, self.crashed = 0, False, asyncio.Event(), False

    def tell(self, row: Row) -> None:
        """Put a row behind the others."""
        text = json.dumps(row)
        # Most bytes of a row; a longer one goes without its content. Chosen
        if len(text) > (1 << 20):
            text = json.dumps({k: v for k, v in row.items() if k not in ("data", "text")} | {"too_long": True})
        with self._lock:
            self.full |= self._bytes + len(text) > MOST_WAITING
            if not self.full:
                self._rows.append(text)
                self._bytes += len(text)
        self._wake()

    def fail(self, error: BaseException) -> None:
        """Put the row of an error behind the others; nothing follows an unexpected one."""
        self.tell({"event": "failed", "reason": report(error)})
        self.crashed = is_crash(error)
        self._wake()

    @property
    def is_empty(self) -> bool:
        """True if no row waits."""
        return not self._rows

    def show(self, scene: Scene) -> None:
        """Put a scene in the place of the one before, if that was not sent."""
        self._scene = scene
        self._wake()

    def next_row(self) -> str | None:
        """Take the row that waits longest; None where none does."""
        with self._lock:
            if not self._rows:
                return None
            text = self._rows.popleft()
            self._bytes -= len(text)
            return text

    def next_scene(self) -> Scene | None:
        """Take the newest scene; None where it was taken."""
        scene, self._scene = self._scene, None
        return scene

    def _wake(self) -> None:
        with contextlib.suppress(RuntimeError):  # the server has ended
            self._loop.call_soon_threadsafe(self.filled.set)


class Session:
    """A page that watches, from its coming to its going."""

    def __init__(self, socket: WebSocket, shared: Shared):
        self._socket, self._shared = socket, shared
        self._outbox = Outbox(asyncio.get_running_loop())
        self._run: Run | None = None
        self._speed: float | None = None
        self._credit, self._wrong = IN_FLIGHT, 0
        self._unheard: deque[int] = deque()
        self._unheard_bytes = self._rows_sent = 0
        self._mine: list[str] = []

    async def attend(self) -> None:
        """Do what the page says and send what it gets, until it goes or is let go."""
        tasks = [asyncio.create_task(self._hear()), asyncio.create_task(self._send())]
        try:
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            let_go = [task.result() for task in done]
        finally:
            if self._run is not None:
                self._run.abandon()  # what waits for its end may be broken off
            for name in self._mine:
                self._shared.bundles.drop(name)
            for task in tasks:
                task.cancel()
            await asyncio.wait(tasks)
            for task in tasks:  # one of the two finds out first that the page has gone
                if not task.cancelled():
                    task.exception()
            await self._end()  # the reception holds its frames, and its place, until it has ended
        for code, reason in filter(None, let_go):
            with contextlib.suppress(TimeoutError):
                # Longest time in s that a page that is let go is told so. Chosen
                await asyncio.wait_for(self._socket.close(code, reason), 1.0)

    async def _hear(self) -> tuple[int, str] | None:
        """Take commands until the page goes, or says what is none too often; why it is let go, if it is."""
        while True:
            try:
                # Time in s without a command after which a page that watches nothing is let go. Chosen
                wait_s = None if self._run is not None and not self._run.is_over else 900.0
                message = await asyncio.wait_for(self._socket.receive(), wait_s)
            except TimeoutError:
                return IDLE, "nothing is watched"
            if message["type"] == "websocket.disconnect":
                return None
            try:
                command = Command.model_validate_json(message.get("text") or "")
            except (ValidationError, UnicodeError):
                self._wrong += 1
                # Commands that are none before a page is let go. Chosen
                if self._wrong > 20:
                    return WRONG, "these are no commands"
                self._outbox.tell({"event": "refused", "reason": "that is no command of these pages"})
                continue
            try:
                await self._do(command)
            except HeliographError as error:
                self._outbox.tell({"event": "refused", "reason": str(error)})

    async def _do(self, command: Command) -> None:
        gate = None if self._run is None else self._run.gate
        if command.do == "took":
            self._credit = min(self._credit + 1, IN_FLIGHT)
            self._outbox.filled.set()
        elif command.do == "heard":
            while self._unheard and self._rows_sent - len(self._unheard) < command.rows:
                self._unheard_bytes -= self._unheard.popleft()
            self._outbox.filled.set()
        elif command.do == "open" and command.source is not None:
            await self._open(command.source, command.paused)
        elif command.do == "speed":
            self._speed = command.times
            if gate is not None:
                gate.run_at(command.times)
        elif command.do == "stop" and self._run is not None:
            await in_thread(self._run.halt)
        elif command.do == "save":
            await self._save()
        elif gate is not None:
            _turn(gate, command.do)

    async def _open(self, asked: Asked, paused: bool) -> None:
        await self._end()
        gate = Gate(self._speed)
        if paused:
            gate.pause()
        self._run = Run(asked, self._shared, Teller(self._outbox.tell, self._outbox.show, self._outbox.fail), gate)
        self._run.start()

    async def _end(self) -> None:
        run, self._run = self._run, None
        if run is not None:
            await in_thread(run.stop)

    async def _save(self) -> None:
        if self._run is None:
            path = None
        else:
            saving = asyncio.ensure_future(in_thread(self._run.save))
            try:
                path = await asyncio.shield(saving)
            except asyncio.CancelledError:  # the page has gone: nobody fetches it
                saving.add_done_callback(_thrown_away)
                raise
        if path is None:
            self._outbox.tell({"event": "refused", "reason": "there are no frames to save yet"})
            return
        size = path.stat().st_size
        self._mine.append(self._shared.bundles.add(path))
        self._outbox.tell({"event": "saved", "bundle": self._mine[-1], "bytes": size})

    async def _send(self) -> tuple[int, str]:
        """Send rows as they come, and scenes as the page takes them; why the page is let go."""
        outbox = self._outbox
        while not outbox.full:
            await outbox.filled.wait()
            outbox.filled.clear()
            while not outbox.full and self._unheard_bytes < ROWS_IN_FLIGHT and (row := outbox.next_row()) is not None:
                self._unheard.append(len(row))
                self._unheard_bytes, self._rows_sent = self._unheard_bytes + len(row), self._rows_sent + 1
                await self._socket.send_text(row)
            if self._credit and (scene := outbox.next_scene()) is not None:
                self._credit -= 1
                await self._socket.send_bytes(await in_thread(scene.encoded))
            if outbox.crashed and outbox.is_empty:
                return INTERNAL, ""  # the last row says why
        return TOO_SLOW, "this page takes what is sent too slowly"


def _thrown_away(saving: "asyncio.Future[Path | None]") -> None:
    path = None if saving.cancelled() or saving.exception() is not None else saving.result()
    if path is not None:
        path.unlink(missing_ok=True)


def _turn(gate: Gate, act: str) -> None:
    """Pause, step or go on."""
    if act == "pause":
        gate.pause()
    elif act == "go":
        gate.go()
    elif act in ("step", "packet"):
        gate.step(to_packet=act == "packet")
