"""Reception as a page for replay: page Watch in a single HTML file, with frames and rows of a run, and no server."""

import contextlib
import json
import lzma
from base64 import b64encode
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

from heliograph.base.files import shown_name, whole_file
from heliograph.base.frames import Frame
from heliograph.link.film import FrameProgress, silent
from heliograph.link.settings import LinkSettings
from heliograph.measure.journal import Journal, Row
from heliograph.measure.reception import ReceptionCounter, receive_and_count
from heliograph.media import FilmReader
from heliograph.receive.api import AnyObserver
from heliograph.receive.events import DecodeEvent, ignore
from heliograph.receive.packet import Packet
from heliograph.receive.settings import ReceiveSettings
from heliograph.signal.message import Message
from heliograph.signal.settings import SignalSettings
from heliograph.web.camera_frames import Frames
from heliograph.web.watching.rows import source_row, state_row
from heliograph.web.watching.scene import SceneObserver

PAGE = Path(__file__).with_name("pages") / "replay.html"  # page *Watch* in a single file, with RUN in place of the run

RECORDED_RUN = Path(__file__).with_name("recorded-run.json.xz")
"""Reception of the recorded drive for `page_of`, by `scripts/make_drive.py`."""

MAX_BYTES = 14_000_000  # maximum size of frames and soft values in the page: a page has at most 15 MB
FIRST_INTERVAL_S = 0.01  # shortest time between two frames, for short films


@contextlib.contextmanager
def open_replay(
    path: str | Path, source: FilmReader, signal: SignalSettings, settings: ReceiveSettings, reception: ReceptionCounter
) -> Iterator["ReplayLog"]:
    """Write a page at the end of the block."""
    log = ReplayLog(signal, settings, reception)
    has_truth = reception.errors is not None
    log.tell(source_row(source, shown_name(source.path), signal, settings.receiver, has_truth=has_truth))
    with whole_file(Path(path)) as partial:
        partial.touch()  # a folder that is missing is an error before the reception
        yield log
        partial.write_text(log.page(), encoding="utf-8")


def receive_and_record(
    path: Path,
    film: FilmReader,
    signal: SignalSettings,
    settings: LinkSettings,
    reception: ReceptionCounter,
    observe: AnyObserver | None = None,
    progress: FrameProgress = silent,
) -> Iterator[tuple[Packet, list[Message]]]:
    """Receive a film as `receive_and_count`, and write the page."""
    with open_replay(path, film, signal, settings.receive, reception) as log:
        journal = Journal(settings.receive.calibration, log.tell)

        def observe_all(event: Any) -> None:
            for observer in (journal.observe, log.observe, observe or ignore):
                observer(event)

        def frames() -> Iterator[Frame]:
            for frame in film:
                log.frame(frame)
                yield frame

        shown = Frames(str(film.path), frames())
        for packet, messages in receive_and_count(shown, signal, settings, reception, observe_all, progress):
            journal.read(packet, messages, reception.progress)
            yield packet, messages


def page_of(run: str) -> str:
    """Return the page of a run in JSON."""
    before, after = PAGE.read_text(encoding="utf-8").split(">RUN<")
    run = run.replace("</", "<\\/")  # "</" would end the element
    return f"{before}>{run}<{after}"


@cache
def recorded_page() -> str:
    """Return the page of the recorded drive."""
    return page_of(lzma.decompress(RECORDED_RUN.read_bytes()).decode())


class ReplayLog:
    """Observer of a reception that keeps rows, and as many frames as fit."""

    def __init__(self, signal: SignalSettings, settings: ReceiveSettings, reception: ReceptionCounter):
        self._observer, self._reception = SceneObserver(signal, settings.calibration), reception
        # JSON texts in order of time, and True for frames and soft values, which long runs thin out
        self._entries, self._bytes = list[tuple[str, bool]](), 0
        self._newest: Frame | None = None
        self._interval_s, self._due_s = FIRST_INTERVAL_S, float("-inf")

    def frame(self, frame: Frame) -> None:
        """Take the next frame; the last frame is complete by now."""
        if self._newest is not None and self._newest.time_s >= self._due_s:
            self._keep_frame(self._newest)
        self._newest = frame

    def observe(self, event: object) -> None:
        """Take an event of the receiver."""
        self._observer(event)
        if isinstance(event, DecodeEvent):
            for row in self._observer.packet_rows():
                self._keep(row, can_drop=True)

    def tell(self, row: Row) -> None:
        """Take a row of the journal; the counts follow each packet."""
        self._keep(row)
        if row["event"] == "packet":
            self._keep(self._state())

    def page(self) -> str:
        """Return the page as HTML."""
        if self._newest is not None:
            self._keep_frame(self._newest)
        self._keep(self._state())
        return page_of("[" + ",\n".join(text for text, _ in self._entries) + "]")

    def _state(self) -> Row:
        counts = state_row(self._reception, 0.0 if self._newest is None else self._newest.time_s)
        return {**counts, "seconds": 0.0, "paused": False, "stages": {}, "failed": 0, "save_bytes": 0}

    def _keep_frame(self, frame: Frame) -> None:
        self._keep({"scene": b64encode(self._observer.scene(frame).encoded()).decode("ascii")}, can_drop=True)
        self._due_s = frame.time_s + self._interval_s

    def _keep(self, row: Row, *, can_drop: bool = False) -> None:
        """Keep a row; if the page becomes too large, drop every second frame and every second packet's soft values."""
        text = json.dumps(row)
        self._entries.append((text, can_drop))
        self._bytes += len(text)
        if self._bytes > MAX_BYTES:
            kept, seen = list[tuple[str, bool]](), {True: 0, False: 0}
            for entry, is_optional in self._entries:
                is_frame = entry.startswith('{"scene"')
                seen[is_frame] += is_optional
                if not is_optional or seen[is_frame] % 2:
                    kept.append((entry, is_optional))
            self._entries, self._bytes = kept, sum(len(entry) for entry, _ in kept)
            self._interval_s *= 2
