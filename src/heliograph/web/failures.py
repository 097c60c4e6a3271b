"""Frames of failed packets, kept as films that pages may download."""

import secrets
import threading
from collections import OrderedDict, deque
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any

from fastapi import APIRouter, Depends
from fastapi.responses import FileResponse
from starlette.exceptions import HTTPException
from starlette.requests import HTTPConnection

from heliograph.base.errors import HeliographError, MediaError
from heliograph.base.frames import Frame
from heliograph.link.truth import signal_note
from heliograph.media import FilmWriter, create_film
from heliograph.media.record import FASTEST_HZ
from heliograph.receive import Packet
from heliograph.signal.settings import SignalSettings

MOST = 8
"""Films that are kept: two for each page that may receive at once. Chosen."""


class Bundles:
    """The films there are; of any thread."""

    def __init__(self) -> None:
        self._known: OrderedDict[str, Path] = OrderedDict()
        self._lock = threading.Lock()

    def add(self, path: Path) -> str:
        """Keep a film, and return the name by which a page asks for it."""
        name = secrets.token_hex(16)
        with self._lock:
            self._known[name] = path
            old = [self._known.popitem(last=False)[1] for _ in range(len(self._known) - MOST)]
        for one in old:
            one.unlink(missing_ok=True)
        return name

    def drop(self, name: str) -> None:
        """Remove a film; any other name is passed over."""
        with self._lock:
            path = self._known.pop(name, None)
        if path is not None:
            path.unlink(missing_ok=True)

    def of(self, name: str) -> Path | None:
        """Path of a film; None where there is none of that name."""
        with self._lock:
            return self._known.get(name)


def bundles_of(connection: HTTPConnection) -> Bundles:
    """What is kept of what failed."""
    kept: Bundles = connection.app.state.shared.bundles
    return kept


router = APIRouter(prefix="/api/bundles")


@router.get("/{name}")
async def bundle(name: str, kept: Annotated[Bundles, Depends(bundles_of)]) -> FileResponse:
    """Give a film of what failed."""
    path = kept.of(name)
    if path is None or not path.is_file():
        raise HTTPException(404, "that film is not here any more: save it again")
    return FileResponse(path, media_type="application/x-hdf5", filename="failed.h5")


BEFORE, AFTER = 1.2, 0.2
"""Packets' times kept before a packet that failed begins, so that its array is found and followed as it was, and after
its end. Chosen."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Form:
    """Form of the frames that are kept, and what their film notes."""

    # width, height, bits: of its frames
    width: int
    height: int
    bits: int
    # Frames a second; None where their times tell
    rate_hz: float | None
    # The light's signal, as it is received
    signal: SignalSettings
    # Text that is kept with it
    metadata: dict[str, str] = field(default_factory=dict)


class Failures:
    """Holds the last frames, and writes those about packets that failed; frames of one thread, saving in any."""

    # Most bytes of frames in a film of what failed. Chosen; what fails after it is full is left out
    def __init__(self, folder: Path, form: Form, most: int = (1 << 30)):
        self._folder, self._form, self._lock = folder, form, threading.Lock()
        size = form.width * form.height * (1 if form.bits == 8 else 2)
        # Most bytes of frames that are held in memory. Chosen: 0.5 s of 1024 x 512 pixels at 1000 frames/s
        self._size, self._most, self._most_written = size, max(2, (256 << 20) // size), most
        self._frames: deque[Frame] = deque()
        self._film: FilmWriter | None = None
        self._error: MediaError | None = None
        self._until_s = self._last_s = float("-inf")
        self.packets, self.full = 0, False

    def saw(self, frame: Frame) -> None:
        """Take a frame; nobody writes to its pixels any more."""
        kept_s = (1 + BEFORE + AFTER) * self._form.signal.packet_s
        with self._lock:
            held = self._frames
            held.append(frame)
            while len(held) > self._most or held[0].time_s < frame.time_s - kept_s:
                held.popleft()
            if frame.time_s <= self._until_s:
                self._write(frame)

    def expect(self, signal: SignalSettings) -> None:
        """Take another signal for that of the light from now on."""
        with self._lock:
            self._form = replace(self._form, signal=signal)

    def failed(self, packet: Packet) -> None:
        """Keep the frames of a packet."""
        packet_s = self._form.signal.packet_s
        first_s = packet.start_time_s - BEFORE * packet_s
        with self._lock:
            if self.full:
                return
            self.packets += 1
            self._until_s = max(self._until_s, packet.start_time_s + (1 + AFTER) * packet_s)
            for frame in self._frames:
                if first_s <= frame.time_s <= self._until_s:
                    self._write(frame)

    def save(self) -> Path | None:
        """Finish the film of the failure, or else of the last frames, and begin a new film."""
        with self._lock:
            if self._film is None:
                for frame in self._frames:
                    self._write(frame)
            film, self._film = self._film, None
            error, self._error = self._error, None
            self.packets, self.full, self._last_s = 0, False, float("-inf")
            if error is not None:
                raise error
            if film is None:
                return None
            film.finish()
            return film.path

    def close(self) -> None:
        """Throw away what was not saved."""
        with self._lock:
            self._frames.clear()
            if self._film is not None:
                self._film.abort()
                self._film = None

    def _write(self, frame: Frame) -> None:
        """Write a frame; where there is no room for it the reception goes on, and `save` says so."""
        if frame.time_s <= self._last_s or self.full:
            return
        try:
            if self._film is None:
                self._film = self._created()
            self._film.write(frame)
        except MediaError as error:
            film, self._film, self._error, self.full = self._film, None, error, True
            if film is not None:
                film.abort()
            return
        self._last_s = frame.time_s
        self.full = self._film.frames_written * self._size >= self._most_written

    def _created(self) -> FilmWriter:
        form = self._form
        path = self._folder / f"{secrets.token_hex(16)}.h5"
        notes = {**form.metadata, **signal_note(form.signal)}
        rate_hz = min(form.rate_hz or self._rate_hz(), FASTEST_HZ)
        return create_film(path, width=form.width, height=form.height, rate_hz=rate_hz, bits=form.bits, metadata=notes)

    def _rate_hz(self) -> float:
        first, last = self._frames[0], self._frames[-1]
        return max((last.index - first.index) / max(last.time_s - first.time_s, 1e-3), 1.0)


class Saver:
    """Keeps frames while they are read; of the reader's thread, but `save` of any."""

    def __init__(self, folder: Path, bundles: Bundles):
        self._folder, self._bundles = folder, bundles
        self._failures: Failures | None = None
        self._signal: SignalSettings | None = None

    def begin(self, signal: SignalSettings) -> None:
        """Begin anew; what was kept goes."""
        self.close()
        self._signal = signal

    def expect(self, signal: SignalSettings) -> None:
        """Take another signal for that of the light; what is kept stays."""
        self._signal = signal
        if self._failures is not None:
            self._failures.expect(signal)

    def saw(self, frame: Frame) -> None:
        """Take a frame; nobody writes to its pixels any more."""
        if self._failures is None:
            assert self._signal is not None
            rows, columns = frame.pixels.shape
            form = Form(width=columns, height=rows, bits=frame.bits, rate_hz=None, signal=self._signal)
            # Most bytes of frames of a film that is saved: 40 s of 480 x 480 pixels at 30 frames a second. Chosen
            self._failures = Failures(self._folder, form, (256 << 20))
        self._failures.saw(frame)

    def read(self, packet: Packet) -> None:
        """Keep the frames of a packet of which not all was read."""
        if packet.status != "ok" and self._failures is not None:
            self._failures.failed(packet)

    def save(self) -> dict[str, Any]:
        """Finish the film, and return by which name a page fetches it, and its bytes."""
        path = None if self._failures is None else self._failures.save()
        if path is None:
            raise MediaError("no frames were taken yet: start the camera")
        size = path.stat().st_size
        return {"bundle": self._bundles.add(path), "bytes": size}

    def offered(self) -> dict[str, Any] | None:
        """The same, where that cannot fail."""
        try:
            return self.save()
        except HeliographError:
            return None

    def close(self) -> None:
        """Throw away what was not saved."""
        if self._failures is not None:
            self._failures.close()
            self._failures = None
