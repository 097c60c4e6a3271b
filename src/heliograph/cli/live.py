"""Reception from a live camera: messages and news as they come, until Ctrl-C."""

import contextlib
import signal
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Any

from heliograph.base.errors import MediaError
from heliograph.cli import console

if TYPE_CHECKING:
    from heliograph.base.frames import Frame
    from heliograph.link.outlets import Outlet
    from heliograph.media import FilmReader
    from heliograph.media.live.grabber import CameraCounts
    from heliograph.media.live.reader import LiveReader
    from heliograph.media.live.recorder import Recorder
    from heliograph.receive import Packet, ReceiveSettings
    from heliograph.signal.message import Message
    from heliograph.signal.settings import SignalSettings


@dataclass(frozen=True, slots=True)
class Told:
    """Where news go: options of the command, as they were given."""

    follow: bool = False
    verbose: bool = False
    send: tuple[str, ...] = ()


class News:
    """Hands rows to all who asked for them; an outlet that fails is told once and left out, the others go on."""

    def __init__(self, told: Told):
        self._told = told
        self._outlets: list[Outlet] = []
        self._open = contextlib.ExitStack()

    def __enter__(self) -> "News":
        from heliograph.link.outlets import open_outlet

        with contextlib.ExitStack() as undo:
            for address in self._told.send:
                outlet = open_outlet(address)
                undo.callback(outlet.close)
                self._outlets.append(outlet)
                console.complain(f"news are sent to {outlet.address}")
            self._open = undo.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()

    def tell(self, row: Mapping[str, Any]) -> None:
        """Hand a row on."""
        if self._told.follow:
            console.say_json(row)
        if self._told.verbose and row["event"] != "end":
            from heliograph.measure.journal import sentence

            for line in sentence(row).splitlines():
                console.tell(line)
        for outlet in list(self._outlets):
            try:
                outlet.send(row)
            except OSError as error:
                self._outlets.remove(outlet)
                console.complain(f"nothing more is sent to {outlet.address}: {error.strerror or error}")


SHOWN = 60
"""Most characters of a message's text that are shown as it comes. Chosen."""


@dataclass(frozen=True, slots=True)
class LiveOptions:
    """Options for live cameras, as they were given."""

    camera: list[str] | None
    duration: float | None
    record: Path | None = None
    record_s: float = 0.0

    def keywords(self, film: Path) -> dict[str, Any]:
        """Return them as `open_film` takes them; a MediaError where they are given with a recording."""
        from heliograph.media.live.reader import is_camera

        options = {"--camera": self.camera or None, "--duration": self.duration, "--record": self.record}
        given = [name for name, value in options.items() if value is not None]
        if given and not is_camera(film):
            are = "is" if len(given) == 1 else "are"
            raise MediaError(f"{' and '.join(given)} {are} for a live camera, such as camera:aravis, not {film}")
        duration = [] if self.duration is None else [f"duration_s={self.duration}"]
        return {"camera": [*(self.camera or ()), *duration]}


class Watch:
    """A film that is being received: passes a recording on as it is, and looks after a live camera."""

    def __init__(self, source: "FilmReader", live: "LiveReader | None", recorder: "Recorder | None", aloud: bool):
        self.path, self.frame_count = source.path, source.frame_count
        self._source, self._live, self._recorder, self._aloud = source, live, recorder, aloud
        self._read = False
        self.unseen = ""

    @property
    def is_live(self) -> bool:
        """Whether it is a live camera."""
        return self._live is not None

    def __iter__(self) -> "Iterator[Frame]":
        if self._live is None:
            yield from self._source
            return
        for frame in self._source:
            if self._recorder is not None:
                self._recorder.saw(frame)
            yield frame
        counts = self._live.counts
        if counts is not None and not counts.frames:
            raise MediaError(f"{self.path} gave no frame: see that its trigger is off or has pulses, and its exposure")

    def observe(self, event: Any) -> None:
        """Take note of arrays that are lost, and of a screen that is not there."""
        from heliograph.receive.events import DetectEvent, LostEvent, UnseenEvent

        if isinstance(event, LostEvent):
            self._failed()
        elif isinstance(event, UnseenEvent):
            self.unseen = "no screen is visible, or none that can be read"
            console.complain(f"{self.path}: {self.unseen}, in the first {event.searched_s:.1f} s")
        elif isinstance(event, DetectEvent):
            self.unseen = ""

    def packet(self, packet: "Packet") -> None:
        """Take note of a packet."""
        self._read = True
        if packet.status != "ok":
            self._failed()

    def message(self, message: "Message") -> None:
        """Show a message as it comes."""
        from heliograph.road.codec import road_values, road_words

        if self._aloud:
            road = road_values(message.data)
            console.say(
                f"array {message.identity}, {message.layer}, message {message.stream}: {len(message.data)} bytes, "
                f"{_shown(message.data) if road is None else road_words(road)}"
            )

    @property
    def recorded(self) -> Path | None:
        """The film of what failed; None where there is none."""
        return self._recorder.path if self._recorder is not None and self._recorder.written else None

    def finish(self) -> dict[str, Any]:
        """Write what is to be recorded; return what became of a camera's frames, empty of a recording."""
        if self._live is None:
            return {}
        if not self._read:
            self._failed()
        if self._recorder is not None:
            self._recorder.close()
        counts = self._live.counts
        form = self._live.form
        report = {"name": str(self.path), "model": form.model, "settings": dict(form.settings)}
        return {"camera": report | (asdict(counts) if counts is not None else {})}

    def show(self) -> None:
        """Say what became of a camera's frames."""
        show_counts(self._live)
        if self._recorder is not None and self._recorder.written:
            kept = f"the last {self._recorder.written} frames"
            path = self._recorder.path
            console.say(f"what failed is in {kept} of {path}" if self._read else f"{kept} are kept in {path}")

    def _failed(self) -> None:
        if self._recorder is not None:
            self._recorder.failed()


@contextlib.contextmanager
def watched(
    source: "FilmReader", options: LiveOptions, light: "SignalSettings", receiver: "ReceiveSettings", aloud: bool
) -> Iterator[Watch]:
    """Look after a film that is received: Ctrl-C ends a live camera's like its end; a second one breaks off."""
    from heliograph.link.truth import signal_note
    from heliograph.link.warm_up import warm_up
    from heliograph.media.live.reader import live_of
    from heliograph.media.live.recorder import Recorder

    live = live_of(source)
    if live is None:
        yield Watch(source, None, None, aloud)
        return
    attend(live)
    recorder = None
    if options.record is not None:
        recorder = Recorder(options.record, options.record_s, source, signal_note(light))
        if recorder.seconds < options.record_s:
            console.complain(f"{options.record} keeps {recorder.seconds:.1f} s: more would not find room in memory")
    warm_up(light, receiver, source.bits)
    with ended_by_ctrl_c(live):
        yield Watch(source, live, recorder, aloud)


def attend(live: "LiveReader") -> None:
    """Say what a camera made of its settings, and when it is lost or back."""
    for text in live.form.departures:
        console.complain(f"{live.path}: {text}")
    live.say = console.complain


@contextlib.contextmanager
def ended_by_ctrl_c(live: "LiveReader | None") -> Iterator[None]:
    """Let the first Ctrl-C end a camera's film, and the second one break off; a recording's it breaks off at once."""
    if live is None:
        yield
        return
    kinds = (signal.SIGINT, signal.SIGTERM)
    before = {kind: signal.getsignal(kind) for kind in kinds}

    def end(_number: int, _frame: FrameType | None) -> None:
        live.stop()
        for kind in kinds:
            signal.signal(kind, signal.default_int_handler)

    for kind in kinds:
        signal.signal(kind, end)
    try:
        yield
    finally:
        for kind in kinds:
            signal.signal(kind, before[kind])


def show_counts(live: "LiveReader | None") -> None:
    """Say what became of a camera's frames."""
    if live is not None and live.counts is not None:
        console.say(_counted(live.counts))


def _counted(counts: "CameraCounts") -> str:
    """Counts of a camera as a line."""
    clock = "the host's clock, as the camera has no stamps" if counts.host_clock else "the camera's clock"
    parts = [f"camera: {counts.frames} frames, {counts.rate_hz:.1f} a second by {clock}"]
    for number, text in (
        (counts.lost, "{} lost on the way"),
        (counts.incomplete, "{} incomplete and left out"),
        (counts.skipped, "{} not taken, by gaps in its stamps"),
        (counts.dropped, "{} dropped before the receiver, which was busy"),
        (counts.waiting, "{} still waiting for it at the end"),
        (counts.jumps, "its clock jumped: {}"),
        (counts.reconnections, "reconnected: {}"),
    ):
        if number:
            parts.append(text.format(number))
    return "; ".join(parts)


def _shown(data: bytes) -> str:
    """A message's beginning: its text, or its bytes in hexadecimal where it is none."""
    try:
        text = data.decode()
    except UnicodeDecodeError:
        text = ""
    if not text or not all(character.isprintable() or character.isspace() for character in text):
        return data[: SHOWN // 2].hex() + ("..." if len(data) > SHOWN // 2 else "")
    line = " ".join(text.split())
    return f"'{line}'" if len(line) <= SHOWN else f"'{line[: SHOWN - 3]}...'"
