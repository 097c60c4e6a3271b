"""Frame sources in place of films: iterables, and messages from a browser camera."""

import struct
import threading
import time
from collections import deque
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from math import inf

import numpy as np

from heliograph.base.errors import MediaError
from heliograph.base.frames import Frame

HEAD = struct.Struct("<dIHH")
"""Head of a message: time in s, frame number including skipped frames, columns, rows. Pixels follow."""

MIN_SIDE, MAX_SIDE = 32, 2048
"""Range of columns and rows; the message size limits the product."""

MAX_WAITING = 96  # waiting frames: three seconds. Regular pages have fewer frames in flight


@dataclass(frozen=True, slots=True)
class Frames:
    """Frames in place of a film."""

    path: str
    frames: Iterable[Frame]
    rate_hz: float = 30.0
    frame_count: int | None = None

    def __iter__(self) -> Iterator[Frame]:
        yield from self.frames


class CameraFrames:
    """Queue of frames from the event loop to the thread of a receiver.

    After `end`, the receiver may take waiting frames for some seconds: tracking three seconds of frames takes one
    second; a failing search takes 0.1 s a frame and more.
    """

    def __init__(self, grace_s: float = 8.0) -> None:
        self._grace_s, self._deadline_s = grace_s, inf
        self._frames: deque[Frame] = deque()
        self._changed = threading.Condition()
        self._shape: tuple[int, int] | None = None
        self._last_s = -inf
        self.taken = self.dropped = 0

    @property
    def waiting(self) -> int:
        """Number of waiting frames."""
        return len(self._frames)

    @property
    def ended(self) -> bool:
        """True after `end`."""
        return self._deadline_s < inf

    @property
    def late(self) -> bool:
        """True after the deadline for the last frames."""
        return time.monotonic() > self._deadline_s

    def put(self, message: bytes) -> None:
        """Append the frame of a message; drop the frame if the queue is full."""
        frame = self._frame(message)
        with self._changed:
            if self.waiting >= MAX_WAITING:
                self.dropped += 1
            elif not self.ended:
                self._frames.append(frame)
                self._changed.notify()

    def end(self, grace_s: float | None = None) -> None:
        """Close the queue."""
        with self._changed:
            deadline_s = time.monotonic() + (self._grace_s if grace_s is None else grace_s)
            self._deadline_s = min(self._deadline_s, deadline_s)
            self._changed.notify()

    def __iter__(self) -> Iterator[Frame]:
        """Yield frames until the end."""
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._frames or self.ended)
                if not self._frames or self.late:
                    return
                self.taken += 1
                frame = self._frames.popleft()
            yield frame

    def _frame(self, message: bytes) -> Frame:
        if len(message) < HEAD.size:
            raise MediaError("the message of a frame is too short")
        time_s, number, columns, rows = HEAD.unpack_from(message)
        if not (MIN_SIDE <= columns <= MAX_SIDE and MIN_SIDE <= rows <= MAX_SIDE):
            raise MediaError(f"a frame has {MIN_SIDE} to {MAX_SIDE} columns and rows, not {columns} x {rows}")
        if len(message) != HEAD.size + columns * rows:
            raise MediaError(f"a frame of {columns} x {rows} has {columns * rows} bytes")
        if self._shape not in (None, (rows, columns)):
            raise MediaError("all frames have the same size: start again after rotating the camera")
        if not max(0, self._last_s) <= time_s < 1e9 or time_s == self._last_s:  # False for NaN
            raise MediaError("the times of frames must increase")
        self._shape, self._last_s = (rows, columns), time_s
        return Frame(number, time_s, np.frombuffer(message, np.uint8, offset=HEAD.size).reshape(rows, columns))
