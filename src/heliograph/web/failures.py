"""Recorder of failed packets: films for download."""

import secrets
import threading
from collections import deque
from pathlib import Path
from typing import Any

from heliograph.base.errors import MediaError
from heliograph.base.frames import Frame
from heliograph.link.truth import signal_note
from heliograph.media import FilmWriter, create_film
from heliograph.media.record import FASTEST_HZ
from heliograph.receive import Packet
from heliograph.signal.settings import SignalSettings
from heliograph.web.stores import Store, StoredFilm

BEFORE, AFTER = 1.2, 0.2
"""Recorded time before and after a failed packet, in packets; detection and tracking need the time before."""


class FailureRecorder:
    """Recorder of the frames of failed packets; one thread receives, any thread saves.

    `signal` may change between frames. Frames must not change after `add_frame`.
    """

    def __init__(
        self,
        folder: Path,
        signal: SignalSettings,
        *,
        rate_hz: float | None = None,
        metadata: dict[str, str] | None = None,
        max_bytes: int = 1 << 30,
    ):
        self._folder, self._rate_hz, self._metadata, self._max_bytes = folder, rate_hz, metadata or {}, max_bytes
        self._lock = threading.RLock()
        self._film: FilmWriter | None = None
        self.restart(signal)

    def restart(self, signal: SignalSettings) -> None:
        """Discard unsaved frames and start with a new signal."""
        with self._lock:
            self.close()
            self.signal = signal
            self._error: MediaError | None = None
            self._end_s = self._last_s = float("-inf")
            self.packets, self._is_full = 0, False

    def add_frame(self, frame: Frame) -> None:
        """Buffer a frame, and record the frame if it belongs to a failed packet."""
        with self._lock:
            frames = self._frames
            frames.append(frame)
            first_s = frame.time_s - (1 + BEFORE + AFTER) * self.signal.packet_s
            # 256 MB of frames: 0.5 s of 1024 x 512 pixels at 1000 frames/s
            max_frames = max(2, (256 << 20) // frame.pixels.nbytes)
            while len(frames) > max_frames or frames[0].time_s < first_s:
                frames.popleft()
            if frame.time_s <= self._end_s:
                self._write(frame)

    def add_packet(self, packet: Packet) -> None:
        """Record the frames of a packet unless all codewords were decoded."""
        with self._lock:
            if packet.status == "ok" or self._is_full:
                return
            self.packets += 1
            packet_s, start_s = self.signal.packet_s, packet.start_time_s
            self._end_s = max(self._end_s, start_s + (1 + AFTER) * packet_s)
            for frame in self._frames:
                if start_s - BEFORE * packet_s <= frame.time_s <= self._end_s:
                    self._write(frame)

    def save(self, films: Store[StoredFilm]) -> dict[str, Any]:
        """Store the film of failed packets, by default of the last frames; return key and size."""
        with self._lock:
            if self._film is None:
                for frame in self._frames:
                    self._write(frame)
            film, error = self._film, self._error
            self._film = self._error = None
            self.packets, self._is_full, self._last_s = 0, False, float("-inf")
            if error is not None:
                raise error
            if film is None:
                raise MediaError("the reception has no frames yet")
            film.finish()
            return {"bytes": film.path.stat().st_size, "bundle": films.add(StoredFilm(film.path))}

    def close(self) -> None:
        """Discard unsaved frames."""
        with self._lock:
            self._frames = deque[Frame]()
            if self._film is not None:
                self._film.abort()
                self._film = None

    def _write(self, frame: Frame) -> None:
        """Write a frame; after an error of the disk the reception continues, and `save` raises the error."""
        if frame.time_s <= self._last_s or self._is_full:
            return
        try:
            self._film = self._film or self._create_film(frame)
            self._film.write(frame)
            self._last_s = frame.time_s
            self._is_full = self._film.frames_written * frame.pixels.nbytes >= self._max_bytes
        except MediaError as error:
            if self._film is not None:
                self._film.abort()
            self._film, self._error, self._is_full = None, error, True

    def _create_film(self, frame: Frame) -> FilmWriter:
        first, last, (rows, columns) = self._frames[0], self._frames[-1], frame.pixels.shape
        measured_hz = max((last.index - first.index) / max(last.time_s - first.time_s, 1e-3), 1.0)
        return create_film(
            self._folder / f"{secrets.token_hex(16)}.h5",
            width=columns,
            height=rows,
            rate_hz=min(self._rate_hz or measured_hz, FASTEST_HZ),
            bits=frame.bits,
            metadata={**self._metadata, **signal_note(self.signal)},
        )
