"""Window of the frames of successive patterns; a missing frame leaves the slot empty."""

from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from typing import TypeVar

import numpy as np

from heliograph.base.arrays import TINY, Floats
from heliograph.base.frames import Frame
from heliograph.receive.geometry.fit import header_amplitudes
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.geometry.window import common

FrameWindow = Sequence[Frame | None]  # frames of successive patterns, None if missing

SLACK = 2  # frames by which the header's start may differ from the window, either way: every second window is searched

Value = TypeVar("Value")


def find_header_start(slots: FrameWindow, pose: Pose, weights: Floats, header: int) -> tuple[int, float] | None:
    """Return the start at which the frames of a header alternate most, and the regularity."""
    measured = iter(header_amplitudes([frame for frame in slots if frame is not None], pose, weights).tolist())
    amplitudes = [None if frame is None else next(measured) for frame in slots]
    sign = 1 - 2 * (np.arange(header) % 2)
    windows = [fill_missing(amplitudes[k : k + header]) for k in range(len(slots) - header + 1)]
    sums = [-np.inf if window is None else float(sign @ window) for window in windows]
    start = int(np.argmax(sums))
    best = windows[start]
    if start >= len(sums) - SLACK or best is None:
        return None
    change = -np.diff(best) * sign[:-1]
    return start, float(change.min() / max(change.mean(), TINY))


def fill_missing(header: Sequence[Value | None]) -> list[Value] | None:
    """Replace missing values of a header by the nearest of the same sign; None if more than a quarter is missing."""
    kept = {k: value for k, value in enumerate(header) if value is not None}
    # with half of the frames missing, data might pass for a header
    if len(kept) < 0.75 * len(header):
        return None

    def nearest(place: int) -> int:
        return min(range(place % 2, len(header), 2), key=lambda k: (k not in kept, abs(k - place)))

    return [kept[k if k in kept else nearest(k)] for k in range(len(header))]


def header_frames(slots: FrameWindow, header: int) -> list[Frame] | None:
    """Return the frames of the beginning of a header in a window, up to four; None if too many are missing."""
    return fill_missing(slots[SLACK : SLACK + min(header, 4)])


def crop_to_common(slots: FrameWindow) -> list[Frame | None]:
    """Crop the frames to their common part of the sensor."""
    cropped = iter(common([frame for frame in slots if frame is not None]))
    return [None if frame is None else next(cropped) for frame in slots]


def first_present(slots: FrameWindow) -> Frame:
    """Return the first present frame."""
    return next(frame for frame in slots if frame is not None)


class FrameWindowBuffer:
    """Last frames of a stream of one frame per pattern, enough for a header with any start."""

    def __init__(self, header: int, packet_patterns: int):
        self._step = 2 if header >= 4 else 1
        self._header, self._size, self._packet = header, header + 2 * SLACK, packet_patterns // self._step
        self._frames: deque[Frame | None] = deque(maxlen=self._size)
        self._next = self._searches = 0

    def push(self, frame: Frame) -> list[tuple[FrameWindow, bool]]:
        """Add a frame; return the windows to search, of one size and place, and True if turned headers are due."""
        lost = frame.index - self._next
        if not 0 <= lost <= self._size:
            self._frames.clear()
        if not self._frames:
            lost = self._searches = 0
            # a header may begin with the first frame: copies, which do not alternate, stand for the frames before
            self._frames.extend(replace(frame, index=frame.index - k) for k in range(SLACK, 0, -1))
        windows = list[tuple[FrameWindow, bool]]()
        for slot in [*([None] * lost), frame]:
            self._frames.append(slot)
            self._next = frame.index + 1 if slot is frame else self._next + 1
            if len(self._frames) < self._size:
                continue
            # every second start is enough, but not where frames are missing
            is_due = (self._next - 1) % self._step == 0 or any(kept is None for kept in self._frames)
            if is_due and header_frames([*self._frames], self._header) is not None:
                windows.append((crop_to_common(self._frames), self._is_turned_due()))
        return windows

    def _is_turned_due(self) -> bool:
        """Return True in every other search, with another parity for each packet."""
        self._searches += 1
        packets = self._searches // self._packet if self._packet % 2 == 0 else 0
        return (self._searches + packets) % 2 == 1
