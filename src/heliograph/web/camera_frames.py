"""Frames from a browser's camera: checked, queued for one reader, and the last ones kept."""

import struct
import threading
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from math import isfinite
from pathlib import Path

import numpy as np

from heliograph.base.errors import HeliographError, MediaError
from heliograph.base.frames import Frame
from heliograph.link.notes import signal_note
from heliograph.media import create_film
from heliograph.signal.settings import SignalSettings

HEAD = struct.Struct("<dIHH")
"""Start of a message: time in s, number of the frame with those that were not sent, columns, rows. Pixels follow."""

LEAST_SIDE, MOST_SIDE = 32, 2048
"""Columns and rows that are taken. Chosen: more pixels than a message may have bytes find no place anyway."""

MOST_WAITING = 96
"""Frames that wait at most; a page that follows the rules has fewer on their way. Chosen: three seconds."""

MOST_KEPT_BYTES = 64 << 20
"""Most bytes of the last frames that are kept: 9 s of 480 x 480 pixels at 30 frames a second."""


class MessageError(HeliographError):
    """A message that no page of ours sends."""


@dataclass(frozen=True, slots=True)
class KeptFrames:
    """The last frames of a camera.

    Attributes
    ----------
    frames
        In the order of time.
    rate_hz
        Frames a second.
    signal
        What the receiver looked for.
    """

    frames: tuple[Frame, ...]
    rate_hz: float
    signal: SignalSettings

    def write(self, path: Path) -> None:
        """Write them as a film without loss, with a note of the signal, so that the command reads it as it is.

        Parameters
        ----------
        path
            Where it goes; its suffix chooses the kind.

        Raises
        ------
        MediaError
            It cannot be written.
        """
        rows, columns = self.frames[0].pixels.shape
        note = signal_note(self.signal)
        with create_film(path, width=columns, height=rows, rate_hz=self.rate_hz, metadata=note) as film:
            for frame in self.frames:
                film.write(frame)


class CameraFrames:
    """Frames of a browser's camera: the server's thread puts messages in, a receiver's thread takes frames out."""

    def __init__(self) -> None:
        self._waiting: deque[Frame] = deque()
        self._kept: deque[Frame] = deque()
        self._changed = threading.Condition()
        self._ended = False
        self._shape: tuple[int, int] | None = None
        self._last_s = float("-inf")
        self.taken = self.dropped = 0

    def put(self, message: bytes) -> None:
        """Take a message; a frame that finds no place is dropped, and counted.

        Parameters
        ----------
        message
            `HEAD`, then a byte for each pixel, row by row.

        Raises
        ------
        MessageError
            It is none, or the frame does not follow those before.
        """
        frame = self._frame(message)
        with self._changed:
            if len(self._waiting) >= MOST_WAITING:
                self.dropped += 1
                return
            self._waiting.append(frame)
            self._changed.notify()

    def end(self) -> None:
        """Say that no more come; those that wait are still taken."""
        with self._changed:
            self._ended = True
            self._changed.notify()

    def __iter__(self) -> Iterator[Frame]:
        """Yield frames as they come, until the end."""
        while (frame := self._next()) is not None:
            yield frame

    def kept(self, signal: SignalSettings) -> KeptFrames:
        """Return the last frames.

        Parameters
        ----------
        signal
            What the receiver looked for.

        Raises
        ------
        MediaError
            There are too few of them.
        """
        with self._changed:
            frames = tuple(self._kept)
        if len(frames) < 2:
            raise MediaError("no frames were taken yet: start the camera")
        rate = (len(frames) - 1) / (frames[-1].time_s - frames[0].time_s)
        return KeptFrames(frames, min(max(rate, 1.0), 1000.0), signal)

    def _next(self) -> Frame | None:
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self._ended)
            if not self._waiting:
                return None
            frame = self._waiting.popleft()
            self.taken += 1
            self._kept.append(frame)
            while len(self._kept) * frame.pixels.size > MOST_KEPT_BYTES:
                self._kept.popleft()
        return frame

    def _frame(self, message: bytes) -> Frame:
        if len(message) < HEAD.size:
            raise MessageError("a frame's message is too short")
        time_s, number, columns, rows = HEAD.unpack_from(message)
        if not (LEAST_SIDE <= columns <= MOST_SIDE and LEAST_SIDE <= rows <= MOST_SIDE):
            raise MessageError(f"a frame has {LEAST_SIDE} to {MOST_SIDE} columns and rows, not {columns} x {rows}")
        if len(message) != HEAD.size + columns * rows:
            raise MessageError(f"a frame of {columns} x {rows} has {columns * rows} bytes")
        if self._shape not in (None, (rows, columns)):
            raise MessageError("all frames have the same size: start again where the camera turned")
        if not isfinite(time_s) or not 0 <= time_s < 1e9 or time_s <= self._last_s:
            raise MessageError("frames come in the order of time")
        self._shape, self._last_s = (rows, columns), time_s
        pixels = np.frombuffer(message, np.uint8, offset=HEAD.size).reshape(rows, columns)
        return Frame(number, time_s, pixels)
