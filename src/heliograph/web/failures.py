"""Recorder of failed packets: films for download."""

import math
import secrets
import threading
from collections import deque
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from heliograph.base.errors import MediaError
from heliograph.base.frames import Frame
from heliograph.link.truth import signal_note
from heliograph.media import FilmWriter, create_film
from heliograph.media.record import FASTEST_HZ
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.packet import Packet
from heliograph.signal.settings import SignalSettings
from heliograph.web.stores import Store, StoredFilm

BEFORE, AFTER = 1.2, 0.2
"""Recorded time before and after a failed packet, in packets; detection and tracking need the time before."""


MAX_BYTES = 48_000_000  # limit of a saved film: quick to download and to send

MIN_WINDOW_PX, WINDOW_RATIO, MIN_WINDOW_RATIO = 256, 4.0, 1.4
"""Side of the saved window: minimum, and ratio to the array's width, smaller for large arrays."""


class FailureRecorder:
    """Recorder of the frames of failed packets; one thread receives, any thread saves.

    Of large frames only a window around the array is saved, so that a film stays below `max_bytes`.

    `signal` may change between frames. Frames must not change after `add_frame`.
    """

    def __init__(
        self,
        folder: Path,
        signal: SignalSettings,
        *,
        rate_hz: float | None = None,
        metadata: dict[str, str] | None = None,
        max_bytes: int = MAX_BYTES,
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
            self._pose: Pose | None = None
            # Window of the film: first column and row, columns and rows
            self._window: tuple[int, int, int, int] | None = None

    @property
    def size(self) -> int:
        """Approximate size in bytes of the film that `save` would store."""
        with self._lock:
            if not self._frames:
                return 0
            if self._film is not None:
                return self._film.frames_written * self._frame_bytes(self._frames[-1])
            return len(self._last_frames()) * self._frame_bytes(self._frames[-1])

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
            self._pose = packet.pose
            if packet.status == "ok" or self._is_full:
                return
            self.packets += 1
            packet_s, start_s = self.signal.packet_s, packet.start_time_s
            self._end_s = max(self._end_s, start_s + (1 + AFTER) * packet_s)
            first_s = max(start_s - BEFORE * packet_s, math.nextafter(self._last_s, math.inf))
            frames = [frame for frame in self._frames if first_s <= frame.time_s <= self._end_s]
            if frames:
                self._aim(frames[-1])
                for frame in frames[-self._room(frames[-1]) :]:
                    self._write(frame)

    def save(self, films: Store[StoredFilm]) -> dict[str, Any]:
        """Store the film of failed packets, by default of the last frames; return key and size."""
        with self._lock:
            if self._film is None and self._frames:
                self._aim(self._frames[-1])
                for frame in self._last_frames():
                    self._write(frame)
            film, error = self._film, self._error
            self._film = self._error = self._window = None
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

    def _last_frames(self) -> list[Frame]:
        return list(self._frames)[-self._room(self._frames[-1]) :]

    def _room(self, frame: Frame) -> int:
        """Return the number of frames that still fit, at least 1."""
        written = 0 if self._film is None else self._film.frames_written
        return max(1, self._max_bytes // self._frame_bytes(frame) - written)

    def _frame_bytes(self, frame: Frame) -> int:
        columns, rows = self._window_size(frame) if self._window is None else self._window[2:]
        return columns * rows * frame.pixels.itemsize

    def _window_size(self, frame: Frame) -> tuple[int, int]:
        """Return columns and rows of a window around the array; the complete frame if the array is unknown."""
        rows, columns = frame.pixels.shape
        if self._pose is None:
            return columns, rows
        array_px = self._pose.pitch * self.signal.side
        period_s = max(self._frames[-1].time_s - self._frames[0].time_s, 1e-6) / max(len(self._frames) - 1, 1)
        count = (1 + BEFORE + AFTER) * self.signal.packet_s / period_s
        fitting_px = math.sqrt(self._max_bytes / (count * frame.pixels.itemsize))
        side = round(max(min(WINDOW_RATIO * array_px, fitting_px), MIN_WINDOW_RATIO * array_px, MIN_WINDOW_PX))
        return min(columns, side), min(rows, side)

    def _aim(self, frame: Frame) -> None:
        """Centre the window on the array if it is not inside; a film has one size."""
        rows, columns = frame.pixels.shape
        width, height = self._window_size(frame) if self._window is None else self._window[2:]
        if self._pose is None:
            self._window = 0, 0, width, height
            return
        margin = 0.5 * MIN_WINDOW_RATIO * self._pose.pitch * self.signal.side
        if self._window is not None:
            distances = (
                abs(self._pose.x - self._window[0] - width / 2),
                abs(self._pose.y - self._window[1] - height / 2),
            )
            if distances[0] + margin <= width / 2 and distances[1] + margin <= height / 2:
                return
        x, y = round(self._pose.x - width / 2), round(self._pose.y - height / 2)
        self._window = min(max(x, 0), columns - width), min(max(y, 0), rows - height), width, height

    def _write(self, frame: Frame) -> None:
        """Write a frame; after an error of the disk the reception continues, and `save` raises the error."""
        if frame.time_s <= self._last_s or self._is_full or self._window is None:
            return
        x, y, width, height = self._window
        pixels: Any = np.ascontiguousarray(frame.pixels[y : y + height, x : x + width])
        try:
            self._film = self._film or self._create_film(frame, width, height)
            self._film.write(replace(frame, pixels=pixels))
            self._last_s = frame.time_s
            self._is_full = (self._film.frames_written + 1) * pixels.nbytes > self._max_bytes
        except MediaError as error:
            if self._film is not None:
                self._film.abort()
            self._film, self._error, self._is_full = None, error, True

    def _create_film(self, frame: Frame, columns: int, rows: int) -> FilmWriter:
        first, last = self._frames[0], self._frames[-1]
        measured_hz = max((last.index - first.index) / max(last.time_s - first.time_s, 1e-3), 1.0)
        return create_film(
            self._folder / f"{secrets.token_hex(16)}.h5",
            width=columns,
            height=rows,
            rate_hz=min(self._rate_hz or measured_hz, FASTEST_HZ),
            bits=frame.bits,
            metadata={**self._metadata, **signal_note(self.signal)},
        )
