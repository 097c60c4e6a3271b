"""Session of page *Watch*: commands of the page, and flow control of rows and scenes."""

import asyncio
import contextlib
from collections import deque
from typing import Annotated, Literal

from fastapi import WebSocket
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from heliograph.base.errors import HeliographError
from heliograph.web.crashes import INTERNAL, NORMAL, POLICY, TRY_AGAIN, in_thread
from heliograph.web.files import save_bundle
from heliograph.web.shared import Shared
from heliograph.web.watching.gate import Gate
from heliograph.web.watching.outbox import Outbox
from heliograph.web.watching.run import Run
from heliograph.web.watching.sources import WatchRequest

ROWS_IN_FLIGHT = 1 << 20
"""Bytes of rows that the page has not acknowledged; bounds the buffers between server and page."""

SCENES_IN_FLIGHT = 2
"""Scenes that the page has not acknowledged: the page draws a scene while another arrives."""


class Command(BaseModel):
    """Command of a page."""

    model_config = ConfigDict(extra="forbid", strict=True)

    do: Literal["open", "pause", "go", "step", "packet", "speed", "stop", "save", "took", "heard"]
    source: WatchRequest | None = None
    times: Annotated[float, Field(ge=1e-4, le=100, allow_inf_nan=False)] | None = None
    paused: bool = False
    rows: Annotated[int, Field(ge=0)] = 0


class Session:
    """Connection of a page that watches receptions."""

    def __init__(self, socket: WebSocket, shared: Shared):
        self._socket, self._shared, self._outbox = socket, shared, Outbox()
        self._run: Run | None = None
        self._speed: float | None = None
        self._free_scenes, self._invalid_commands = SCENES_IN_FLIGHT, 0
        self._row_sizes: deque[int] = deque()  # of unacknowledged rows
        self._rows_sent = 0
        self._bundles: list[str] = []

    async def run(self) -> None:
        """Execute commands, and send rows and scenes, until one side ends the session."""
        tasks = [asyncio.create_task(self._receive_commands()), asyncio.create_task(self._send())]
        try:
            done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            endings = [task.result() for task in done]
        finally:
            if self._run is not None:
                self._run.abandon()  # a cancellation may interrupt the wait below
            for name in self._bundles:
                self._shared.bundles.drop(name)
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            await self._end_run()  # the place of the session stays occupied until the reception ends
        for code, reason in filter(None, endings):
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(self._socket.close(code, reason), 1.0)

    async def _receive_commands(self) -> tuple[int, str] | None:
        """Execute commands until the page disconnects; return the close code and reason for a bad page."""
        while True:
            try:
                is_watching = self._run is not None and not self._run.is_over
                message = await asyncio.wait_for(self._socket.receive(), None if is_watching else 900.0)
            except TimeoutError:
                return NORMAL, "the page watches no source"
            if message["type"] == "websocket.disconnect":
                return None
            try:
                command = Command.model_validate_json(message.get("text") or "")
            except (ValidationError, UnicodeError):
                self._invalid_commands += 1
                if self._invalid_commands > 20:
                    return POLICY, "too many invalid commands"
                self._outbox.tell({"event": "refused", "reason": "invalid command"})
                continue
            try:
                await self._execute(command)
            except HeliographError as error:
                self._outbox.tell({"event": "refused", "reason": str(error)})

    async def _execute(self, command: Command) -> None:
        match command.do:
            case "took":
                self._free_scenes = min(self._free_scenes + 1, SCENES_IN_FLIGHT)
                self._outbox.filled.set()
            case "heard":
                while self._row_sizes and self._rows_sent - len(self._row_sizes) < command.rows:
                    self._row_sizes.popleft()
                self._outbox.filled.set()
            case "open" if command.source is not None:
                await self._end_run()
                gate = Gate(self._speed)
                if command.paused:
                    gate.pause()
                self._run = Run(command.source, self._shared, self._outbox, gate)
                self._run.start()
            case "save":
                await self._save()
            case "speed":
                self._speed = command.times
                if self._run is not None:
                    self._run.gate.run_at(command.times)
            case "stop" if self._run is not None:
                await in_thread(self._run.halt)
            case "pause" if self._run is not None:
                self._run.gate.pause()
            case "go" if self._run is not None:
                self._run.gate.go()
            case "step" | "packet" if self._run is not None:
                self._run.gate.step(to_packet=command.do == "packet")

    async def _end_run(self) -> None:
        run, self._run = self._run, None
        if run is not None:
            await in_thread(run.stop)

    async def _save(self) -> None:
        recorder = self._run.recorder if self._run is not None else None
        bundle = await save_bundle(recorder, self._shared.bundles)
        if bundle is None:
            self._outbox.tell({"event": "refused", "reason": "the reception has no frames yet"})
            return
        self._bundles.append(bundle["bundle"])
        self._outbox.tell({"event": "saved", **bundle})

    async def _send(self) -> tuple[int, str]:
        """Send rows and scenes, limited by acknowledgements; return the close code and reason."""
        outbox = self._outbox
        while not outbox.is_full:
            await outbox.filled.wait()
            outbox.filled.clear()
            while not outbox.is_full and sum(self._row_sizes) < ROWS_IN_FLIGHT and (row := outbox.next_row()):
                self._row_sizes.append(len(row))
                self._rows_sent += 1
                await self._socket.send_text(row)
            if self._free_scenes and (scene := outbox.next_scene()) is not None:
                self._free_scenes -= 1
                await self._socket.send_bytes(await in_thread(scene.encoded))
            if outbox.has_crashed and outbox.is_empty:
                return INTERNAL, ""  # the last row has the reason
        return TRY_AGAIN, "the page accepts rows too slowly"
