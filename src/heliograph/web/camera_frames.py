"""Frames from a browser's camera: checked, and queued for one reader, which has a bounded time for the last of them."""

import struct
import threading
import time
from collections import deque
from collections.abc import Iterator
from math import isfinite

import numpy as np

from heliograph.base.errors import HeliographError
from heliograph.base.frames import Frame

HEAD = struct.Struct("<dIHH")
"""Start of a message: time in s, number of the frame with those that were not sent, columns, rows. Pixels follow."""

LEAST_SIDE, MOST_SIDE = 32, 2048
"""Columns and rows that are taken. Chosen: more pixels than a message may have bytes find no place anyway."""

MOST_WAITING = 96
"""Frames that wait at most; a page that follows the rules has fewer on their way. Chosen: three seconds."""


class MessageError(HeliographError):
    """A message that no page of ours sends."""


class CameraFrames:
    """Frames of a browser's camera: the server's thread puts messages in, a receiver's thread takes frames out."""

    def __init__(self) -> None:
        self._waiting: deque[Frame] = deque()
        self._changed = threading.Condition()
        self._until_s: float | None = None
        self._shape: tuple[int, int] | None = None
        self._last_s = float("-inf")
        self.taken = self.dropped = 0

    @property
    def waiting(self) -> int:
        """Frames that wait to be taken."""
        return len(self._waiting)

    @property
    def ended(self) -> bool:
        """Whether no more come."""
        return self._until_s is not None

    @property
    def late(self) -> bool:
        """Whether the time for the last frames is over."""
        return self._until_s is not None and time.monotonic() > self._until_s

    def put(self, message: bytes) -> None:
        """Take a message; a frame that finds no place is dropped, and counted."""
        frame = self._frame(message)
        with self._changed:
            if self.ended:
                return
            if len(self._waiting) >= MOST_WAITING:
                self.dropped += 1
                return
            self._waiting.append(frame)
            self._changed.notify()

    # Time in s for the frames that wait when a camera is stopped; what is left then is let go. Where an array is
    # followed three seconds of frames take one, while one that is looked for in vain takes a tenth of a second a frame
    # and more
    def end(self, seconds: float = 8.0) -> None:
        """Say that no more come; those that wait are still taken, as long as there is time."""
        with self._changed:
            until_s = time.monotonic() + seconds
            self._until_s = until_s if self._until_s is None else min(until_s, self._until_s)
            self._changed.notify()

    def __iter__(self) -> Iterator[Frame]:
        """Yield frames as they come, until the end."""
        while (frame := self._next()) is not None:
            yield frame

    def _next(self) -> Frame | None:
        with self._changed:
            self._changed.wait_for(lambda: self._waiting or self.ended)
            if not self._waiting or self.late:
                return None
            self.taken += 1
            return self._waiting.popleft()

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
