"""Watched reception in a worker thread: frames pass a gate, and results go to the outbox of a page."""

import contextlib
import time
from collections.abc import Iterator
from typing import Any

from heliograph.base.errors import HeliographError
from heliograph.base.frames import Frame
from heliograph.link.warm_up import warm_up
from heliograph.measure.journal import Journal, Row
from heliograph.measure.live_film import LiveFilm
from heliograph.measure.reception import ReceptionCounter, receive_and_count
from heliograph.media.live.reader import LiveReader
from heliograph.receive.events import DecodeEvent, DetectEvent, EqualiseEvent, ExtractEvent, LostEvent, TrackEvent
from heliograph.web.camera_frames import Frames
from heliograph.web.connection import Outbox
from heliograph.web.crashes import is_crash
from heliograph.web.failures import FailureRecorder
from heliograph.web.shared import Shared
from heliograph.web.watching.gate import Gate
from heliograph.web.watching.rows import source_row, state_row
from heliograph.web.watching.scene import SceneObserver
from heliograph.web.watching.sources import Source, WatchRequest, opened
from heliograph.web.wording import page_words

SCENE_S = 1 / 30  # shortest time in s between scenes

STAGES: dict[type, str] = {
    DetectEvent: "find",
    TrackEvent: "follow",
    ExtractEvent: "take pairs",
    EqualiseEvent: "equalise",
    DecodeEvent: "decode",
    LostEvent: "follow",
}
"""Stages by final event."""


class Run:
    """Watched reception; `watch` runs in a worker thread."""

    def __init__(self, request: WatchRequest, shared: Shared, outbox: Outbox, gate: Gate):
        self._request, self._shared, self._outbox, self.gate = request, shared, outbox, gate
        self.recorder: FailureRecorder | None = None
        self._newest: Frame | None = None
        self._live: LiveReader | None = None
        self._start_s = self._counts_s = time.monotonic()
        self._scene_s = float("-inf")
        self._stages: dict[str, float] = {}
        self._mark_s = time.perf_counter()

    def stop(self) -> None:
        """Stop before the next frame; failed packets can still be saved."""
        self.gate.stop()
        if self._live is not None:
            self._live.stop()  # ends the wait for a frame

    def discard(self) -> None:
        """Discard unsaved frames."""
        if self.recorder is not None:
            self.recorder.close()

    def watch(self) -> None:
        """Receive the source, and report the results or an expected error."""
        try:
            with opened(self._request, self._shared) as source:
                self._receive(source)
        except HeliographError as error:
            if is_crash(error):
                raise
            self._outbox.tell({"event": "failed", "reason": page_words(str(error), self._request.changes)})

    def _receive(self, source: Source) -> None:
        tell = self._outbox.tell
        live, receiver = source.live is not None, source.settings.receive.receiver
        tell(source_row(source, source.name, source.signal, receiver, is_live=live, has_truth=source.truth is not None))
        if source.live is not None:
            self._prepare_camera(source, source.live)
        self.recorder = FailureRecorder(
            self._shared.folder, source.signal, rate_hz=source.rate_hz, metadata=source.metadata
        )
        observer = SceneObserver(source.signal, source.settings.receive.calibration)
        reception = ReceptionCounter(source.truth)
        try:
            self._report_packets(source, observer, reception, self.recorder)
        finally:
            if self._newest is not None:
                self._outbox.show(observer.scene(self._newest).encoded)
            tell(self._counts(reception))
        tell({"event": "end", "stopped": self.gate.stopped})

    def _prepare_camera(self, source: Source, live: LiveReader) -> None:
        """Report settings that the camera changed, and lost connections; compile the receiver."""
        self._live = live

        def say(text: str) -> None:
            self._outbox.tell({"event": "camera", "text": text})

        for text in live.form.departures:
            say(text)
        live.say = say
        with contextlib.suppress(HeliographError):
            warm_up(source.signal, source.settings.receive, live.bits)

    def _report_packets(
        self, source: Source, observer: SceneObserver, reception: ReceptionCounter, recorder: FailureRecorder
    ) -> None:
        """Receive the frames, and report events and packets."""
        journal = Journal(source.settings.receive.calibration, self._outbox.tell)

        def observe(event: Any) -> None:
            self._mark(STAGES.get(type(event), "search"))
            observer(event)
            journal.observe(event)
            self._mark("show")

        def frames() -> Iterator[Frame]:
            """Yield frames after the gate; show each frame after the reception."""
            self._mark("show")
            for frame in source.frames:
                self._mark("render" if isinstance(source.frames, LiveFilm) else "read")
                self._show(observer, reception)
                self._mark("show")
                if not self.gate.pass_through(frame.time_s):
                    break
                self._mark("wait")
                recorder.add_frame(frame)
                if self._newest is None:
                    # before the first search, which may compile functions
                    self._outbox.show(observer.scene(frame).encoded)
                self._newest = frame
                while not (self._shared.is_compiled.wait(0.1) or self.gate.stopped):
                    pass
                yield frame
                self._mark("search")

        film = Frames(source.name, frames())
        for packet, messages in receive_and_count(film, source.signal, source.settings, reception, observe):
            self._mark("search")
            for row in observer.packet_rows():
                self._outbox.tell(row)
            journal.read(packet, messages, reception.progress)
            self._outbox.tell({"event": "unfinished", "messages": reception.report(1.0)["unfinished"][:40]})
            recorder.add_packet(packet)
            self.gate.end_packet()
            self._mark("show")

    def _mark(self, stage: str) -> None:
        """Add the time since the last mark to a stage."""
        now = time.perf_counter()
        self._stages[stage] = self._stages.get(stage, 0.0) + now - self._mark_s
        self._mark_s = now

    def _show(self, observer: SceneObserver, reception: ReceptionCounter) -> None:
        """Show the last frame and report the counts, periodically and before a pause."""
        now, is_held = time.monotonic(), self.gate.holds
        if self._newest is not None and (now >= self._scene_s + SCENE_S or is_held):
            # follow the refresh of the screen, unless frames arrive more slowly
            self._scene_s = now if now >= self._scene_s + 2 * SCENE_S else self._scene_s + SCENE_S
            self._outbox.show(observer.scene(self._newest).encoded)
        if now >= self._counts_s + 0.5 or is_held:
            self._counts_s = now
            self._outbox.tell(self._counts(reception))

    def _counts(self, reception: ReceptionCounter) -> Row:
        time_s = 0.0 if self._newest is None else self._newest.time_s
        return state_row(reception, time_s) | {
            "seconds": round(time.monotonic() - self._start_s, 3),
            "paused": self.gate.paused,
            "stages": {name: round(seconds, 4) for name, seconds in self._stages.items()},
            "failed": 0 if self.recorder is None else self.recorder.packets,
            "save_bytes": 0 if self.recorder is None else self.recorder.size,
        }
