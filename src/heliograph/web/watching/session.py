"""Session of page *Watch*: commands of the page."""

import asyncio
from math import inf
from typing import Annotated, Literal

from fastapi import WebSocket
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from heliograph.base.errors import HeliographError, MediaError
from heliograph.web.connection import Outbox, converse
from heliograph.web.crashes import in_thread
from heliograph.web.shared import Shared
from heliograph.web.watching.gate import Gate
from heliograph.web.watching.run import Run
from heliograph.web.watching.sources import WatchRequest
from heliograph.web.wording import page_words

FRAMES = {"pause": 0, "go": inf, "packet": inf}
"""Frames that pass after a command; a step passes the number of the command."""


class Command(BaseModel):
    """Command of a page."""

    model_config = ConfigDict(extra="forbid", strict=True)

    do: Literal["open", "pause", "go", "step", "packet", "speed", "stop", "save", "took", "heard"]
    source: WatchRequest | None = None
    times: Annotated[float, Field(ge=1e-4, le=100, allow_inf_nan=False)] | None = None
    paused: bool = False
    rows: Annotated[int, Field(ge=0)] = 0
    frames: Annotated[int, Field(ge=1, le=1 << 40)] = 1


class Session:
    """Connection of a page that watches receptions."""

    def __init__(self, socket: WebSocket, shared: Shared):
        # the page acknowledges rows every 0.1 s
        self._socket, self._shared, self._outbox = socket, shared, Outbox(max_unheard=400)
        self._run: Run | None = None
        self._worker: asyncio.Task[None] | None = None
        self._speed: float | None = None
        self._bundles: list[str] = []

    async def run(self) -> None:
        """Execute commands until the page disconnects, or watches no source for 15 minutes."""
        try:
            await converse(self._socket, self._outbox, self._handle, self._timeout_s)
        finally:
            for name in self._bundles:
                self._shared.bundles.drop(name)
            await self._end_run()  # the place of the session stays occupied until the reception ends

    def _timeout_s(self) -> float | None:
        return 900.0 if self._worker is None or self._worker.done() else None

    async def _handle(self, message: str | bytes) -> None:
        try:
            await self._execute(Command.model_validate_json(message))
        except (ValidationError, UnicodeError):
            self._outbox.tell({"event": "refused", "reason": "invalid command"})
        except HeliographError as error:
            self._outbox.tell({"event": "refused", "reason": page_words(str(error))})

    async def _execute(self, command: Command) -> None:
        match command.do:
            case "took":
                self._outbox.acknowledge_picture()
            case "heard":
                self._outbox.acknowledge_rows(command.rows)
            case "open" if command.source is not None:
                await self._end_run()
                gate = Gate(self._speed)
                if command.paused:
                    gate.allow(0)
                self._run = Run(command.source, self._shared, self._outbox, gate)
                self._worker = asyncio.create_task(self._outbox.run(self._run.watch))
            case "speed":
                self._speed = command.times
                if self._run is not None:
                    self._run.gate.run_at(command.times)
            case "save":
                await self._save()
            case "stop" if self._run is not None and self._worker is not None:
                self._run.stop()
                await asyncio.wait([self._worker])
            case "pause" | "go" | "step" | "packet" if self._run is not None:
                self._run.gate.allow(FRAMES.get(command.do, command.frames), until_packet=command.do == "packet")

    async def _end_run(self) -> None:
        """Stop the reception, and discard unsaved frames."""
        run, worker, self._run = self._run, self._worker, None
        if run is not None and worker is not None:
            run.stop()
            worker.add_done_callback(lambda _: run.discard())  # a cancellation may interrupt the wait
            await asyncio.wait([worker])

    async def _save(self) -> None:
        recorder = None if self._run is None else self._run.recorder
        if recorder is None:
            raise MediaError("the reception has no frames yet")
        bundle = await in_thread(lambda: recorder.save(self._shared.bundles))
        self._bundles.append(bundle["bundle"])
        self._outbox.tell({"event": "saved", **bundle})
