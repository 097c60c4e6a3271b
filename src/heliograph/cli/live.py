"""Output of events during a reception, and control of live cameras."""

import contextlib
import signal
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from types import FrameType
from typing import Any, Protocol

from heliograph.base.errors import MediaError
from heliograph.base.frames import Frame
from heliograph.cli import console
from heliograph.cli.options import EventOptions, OutputOptions, RecordOptions
from heliograph.link.outlets import Outlet, open_outlet
from heliograph.link.truth import signal_note
from heliograph.link.warm_up import warm_up
from heliograph.measure.journal import sentence
from heliograph.measure.reception import ReceptionCounter
from heliograph.media import FilmReader
from heliograph.media.live.reader import LiveReader, live_of
from heliograph.media.live.recorder import Recorder
from heliograph.receive.events import DetectEvent, LostEvent, UnseenEvent
from heliograph.receive.packet import Packet
from heliograph.receive.settings import ReceiveSettings
from heliograph.signal.settings import SignalSettings


class Log(Protocol):
    """Recording of a reception."""

    def frame(self, frame: Frame) -> None:
        """Take the next frame."""

    def observe(self, event: Any) -> None:
        """Take an event of the receiver."""

    def tell(self, row: Mapping[str, Any]) -> None:
        """Take a row of the journal."""


@contextlib.contextmanager
def open_logs(
    options: OutputOptions,
    source: FilmReader,
    light: SignalSettings,
    receiver: ReceiveSettings,
    counts: ReceptionCounter,
) -> Iterator[list[Log]]:
    """Open the recordings of a reception: a page for replay, and a file for the viewer Rerun."""
    logs = list[Log]()
    with contextlib.ExitStack() as stack:
        if options.replay is not None:
            from heliograph.web.replay import open_replay

            logs.append(stack.enter_context(open_replay(options.replay, source, light, receiver, counts)))
        if options.rerun is not None:
            from heliograph.web.rerun_log import open_rerun  # imports Matplotlib

            logs.append(stack.enter_context(open_rerun(options.rerun, light.side, receiver.calibration)))
        yield logs


@contextlib.contextmanager
def open_events(options: EventOptions, logs: Sequence[Log] = ()) -> Iterator[Callable[[Mapping[str, Any]], None]]:
    """Yield an output of events as JSON lines, as sentences, to network clients, and to a recording.

    A failing address is dropped.
    """
    with contextlib.ExitStack() as stack:
        outlets = list[Outlet]()
        for address in options.send or ():
            outlets.append(stack.enter_context(contextlib.closing(open_outlet(address))))
            console.complain(f"events are sent to {outlets[-1].address}")

        def tell(row: Mapping[str, Any]) -> None:
            if options.follow:
                console.say_json(row)
            if options.verbose and row["event"] != "end":
                for line in sentence(row).splitlines():
                    console.tell(line)
            for log in logs if row["event"] != "end" else ():
                log.tell(row)
            for outlet in list(outlets):
                try:
                    outlet.send(row)
                except OSError as error:
                    outlets.remove(outlet)
                    console.complain(f"cannot send events to {outlet.address} any more: {error.strerror or error}")

        yield tell


class FilmMonitor:
    """Frames of a film or live camera during a reception; records failures of a live camera."""

    def __init__(
        self,
        source: FilmReader,
        live: LiveReader | None = None,
        recorder: Recorder | None = None,
        logs: Sequence[Log] = (),
    ):
        self.path, self.live = source.path, live
        self._source, self._recorder, self._logs = source, recorder, logs
        self._has_packet = False
        # Reason of a missing array; empty if unknown
        self.unseen = ""

    def __iter__(self) -> Iterator[Frame]:
        for frame in self._source:
            if self._recorder is not None:
                self._recorder.saw(frame)
            for log in self._logs:
                log.frame(frame)
            yield frame
        counts = self.live.counts if self.live is not None else None
        if counts is not None and not counts.frames:
            raise MediaError(f"{self.path} gave no frame: check exposure and trigger, which must be off or have pulses")

    def observe(self, event: Any) -> None:
        """Record lost arrays and missing screens."""
        for log in self._logs:
            log.observe(event)
        if isinstance(event, LostEvent):
            self._fail()
        elif isinstance(event, UnseenEvent):
            self.unseen = "no readable screen is visible"
            console.complain(f"{self.path}: {self.unseen}, in the first {event.searched_s:.1f} s")
        elif isinstance(event, DetectEvent):
            self.unseen = ""

    def add_packet(self, packet: Packet) -> None:
        """Record a packet."""
        self._has_packet = True
        if packet.status != "ok":
            self._fail()

    def finish(self) -> dict[str, Any]:
        """Finish the recording; return the report of a live camera, empty for films."""
        if self.live is None:
            return {}
        if not self._has_packet:
            self._fail()
        if self._recorder is not None:
            self._recorder.close()
        counts, form = self.live.counts, self.live.form
        report = {"name": str(self.path), "model": form.model, "settings": dict(form.settings)}
        return {"camera": report | (asdict(counts) if counts is not None else {})}

    def show(self, *, has_array: bool) -> None:
        """Print the remedy for a missing array, the counts of a live camera, and the recording."""
        recorded = self._recorder.path if self._recorder is not None and self._recorder.written else None
        if not has_array:
            command = f"heliograph probe {console.argument(recorded or self.path)}"
            console.say_prose(f"'{command}' describes the frames, and explains why no array is read")
        show_counts(self.live)
        if self._recorder is not None and recorded is not None:
            frames = f"the last {self._recorder.written} frames"
            kept = f"the failures are in {frames} of" if self._has_packet else f"{frames} are kept in"
            console.say(f"{kept} {recorded}")

    def _fail(self) -> None:
        if self._recorder is not None:
            self._recorder.failed()


@contextlib.contextmanager
def monitored(
    source: FilmReader,
    options: RecordOptions,
    light: SignalSettings,
    receiver: ReceiveSettings,
    logs: Sequence[Log] = (),
) -> Iterator[FilmMonitor]:
    """Monitor a film during the block; the first Ctrl-C ends the frames of a live camera."""
    live = live_of(source)
    if live is None:
        yield FilmMonitor(source, logs=logs)
        return
    report_camera(live)
    recorder = None
    if options.record is not None:
        recorder = Recorder(options.record, options.record_s, source, signal_note(light))
        if recorder.seconds < options.record_s:
            console.complain(f"{options.record} keeps {recorder.seconds:.1f} s: the memory has no room for more")
    warm_up(light, receiver, source.bits)
    with ended_by_ctrl_c(live):
        yield FilmMonitor(source, live, recorder, logs)


def report_camera(live: LiveReader) -> None:
    """Print settings that a camera changed, and later lost and restored connections."""
    for text in live.form.departures:
        console.complain(f"{live.path}: {text}")
    live.say = console.complain


@contextlib.contextmanager
def ended_by_ctrl_c(live: LiveReader | None) -> Iterator[None]:
    """Let the first Ctrl-C end the frames of a live camera, and the second Ctrl-C interrupt the command."""
    if live is None:
        yield
        return
    signals = (signal.SIGINT, signal.SIGTERM)
    handlers = {number: signal.getsignal(number) for number in signals}

    def end(_number: int, _frame: FrameType | None) -> None:
        live.stop()
        for number in signals:
            signal.signal(number, signal.default_int_handler)

    for number in signals:
        signal.signal(number, end)
    try:
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)


def show_counts(live: LiveReader | None) -> None:
    """Print the counts of a live camera."""
    counts = live.counts if live is not None else None
    if counts is None:
        return
    clock = "the clock of the host, as the camera has no time stamps" if counts.host_clock else "the camera's clock"
    parts = [f"camera: {counts.frames} frames, {counts.rate_hz:.1f} per second by {clock}"]
    for number, text in (
        (counts.lost, "{} lost in transfer"),
        (counts.incomplete, "{} incomplete and skipped"),
        (counts.skipped, "{} not captured, by gaps in the time stamps"),
        (counts.dropped, "{} dropped by the busy receiver"),
        (counts.waiting, "{} waiting at the end"),
        (counts.jumps, "clock jumps: {}"),
        (counts.reconnections, "reconnected: {}"),
    ):
        if number:
            parts.append(text.format(number))
    console.say("; ".join(parts))
