"""A bounded queue of frames between a camera's thread and its receiver."""

import threading
from collections import deque

from heliograph.base.frames import Frame

DRAINED = 0.5
"""Fraction of a full queue that must be taken before frames are queued again. Chosen: frames are then dropped in one
run, and come in one: what is between can hold whole packets, every second frame cannot."""


class FrameQueue:
    """Frames that wait for the receiver. Where it is full, new frames are dropped until half of it is taken."""

    def __init__(self, most: int):
        self.dropped = 0
        self._most, self._frames = most, deque[Frame]()
        self._changed = threading.Condition()
        self._full = self._ended = False

    def put(self, frame: Frame) -> None:
        """Queue a frame, or drop it."""
        with self._changed:
            waiting = len(self._frames)
            self._full = waiting >= self._most or (self._full and waiting > DRAINED * self._most)
            if self._full:
                self.dropped += 1
                return
            self._frames.append(frame)
            self._changed.notify()

    def end(self) -> None:
        """Say that no frame comes any more."""
        with self._changed:
            self._ended = True
            self._changed.notify()

    @property
    def over(self) -> bool:
        """Whether all frames are taken and none comes any more."""
        with self._changed:
            return self._ended and not self._frames

    def __len__(self) -> int:
        return len(self._frames)

    def get(self, wait_s: float) -> Frame | None:
        """Take the oldest frame; None where none comes in time."""
        with self._changed:
            if not self._frames and not self._ended:
                self._changed.wait(wait_s)
            return self._frames.popleft() if self._frames else None
