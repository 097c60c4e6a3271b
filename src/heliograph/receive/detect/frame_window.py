"""Frames of successive patterns as a search holds them: a frame that is missing leaves its slot empty."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import TINY
from heliograph.base.frames import Frame
from heliograph.receive.geometry.fit import header_amplitudes
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.geometry.window import common

FrameWindow = Sequence[Frame | None]
"""Frames of successive patterns, None for those that are missing."""

FAR_PAST_S = 1e9
"""Seconds by which each frame that fills up the slots before the film lies before the next one.

It is 30 years, so that no clock takes these for frames of the film.
"""

MISSING_FRAMES = 0.25
"""Largest fraction of a header's frames that may be missing: one of four.

Were two missing, frames of data before or after might pass for a header.
"""

SLACK = 2
"""Frames by which the start of the header may differ from the window searched, either way: every second is searched."""

Shown = TypeVar("Shown")


@dataclass(frozen=True, slots=True)
class SearchJob:
    """Frames that are to be searched now."""

    # Frames of successive patterns, of one size and place; None stands for those that are missing
    slots: FrameWindow
    # Whether turned headers are due too, in every other search: a header that one search alone sees is found by the
    # other ones a packet later
    turned: bool


def find_header_start(
    slots: FrameWindow, pose: Pose, weights: NDArray[np.float64], header: int
) -> tuple[int, float] | None:
    """Where a header begins: the start at which its frames alternate most."""
    amplitudes = iter(header_amplitudes([frame for frame in slots if frame is not None], pose, weights).tolist())
    shown = [None if frame is None else next(amplitudes) for frame in slots]
    sign = 1 - 2 * (np.arange(header) % 2)
    windows = [filled(shown[k : k + header]) for k in range(len(slots) - header + 1)]
    sums = [-np.inf if window is None else float(sign @ window) for window in windows]
    start = int(np.argmax(sums))
    seen = windows[start]
    if start >= len(sums) - SLACK or seen is None:
        return None
    change = -np.diff(seen) * sign[:-1]
    return start, float(change.min() / max(change.mean(), TINY))


def filled(header: Sequence[Shown | None]) -> list[Shown] | None:
    """What a header's frames show, a missing one as the nearest before or after that shows the same."""
    missing = [k for k, one in enumerate(header) if one is None]
    if len(missing) > MISSING_FRAMES * len(header):
        return None
    out = [*header]
    for k in missing:
        alike = [header[j] for j in sorted(range(k % 2, len(header), 2), key=lambda j: abs(j - k))]
        out[k] = next((one for one in alike if one is not None), None)
    return None if None in out else [one for one in out if one is not None]


def crop_to_common(slots: FrameWindow) -> list[Frame | None]:
    """Cut the frames that are there to the part of the sensor that all of them show."""
    shown = iter(common([frame for frame in slots if frame is not None]))
    return [None if frame is None else next(shown) for frame in slots]


def before(frame: Frame, count: int) -> list[Frame]:
    """Copies of a frame with earlier, negative times and numbers."""
    return [replace(frame, index=frame.index - k, time_s=frame.time_s - FAR_PAST_S * k) for k in range(count, 0, -1)]


def alike(last: Frame, frame: Frame) -> bool:
    """Whether two frames have the same kind of pixels."""
    return last.pixels.dtype == frame.pixels.dtype and last.bits == frame.bits


def first_present(slots: FrameWindow) -> Frame:
    """The first frame that is not missing."""
    return next(frame for frame in slots if frame is not None)


class FrameWindowBuffer:
    """The last frames of a stream of one frame per pattern, as many as hold a header wherever it begins."""

    def __init__(self, header: int, span: int, packet_patterns: int):
        self.every = 2 if header >= 4 else 1
        self._span, self._window, self._packet = span, header + 2 * SLACK, packet_patterns // self.every
        self._frames: deque[Frame | None] = deque(maxlen=self._window)
        self._next = self._searches = 0

    @property
    def there(self) -> list[Frame]:
        """Those that are not missing, oldest first."""
        return [frame for frame in self._frames if frame is not None]

    def push(self, frame: Frame) -> list[SearchJob]:
        """Take the next frame; give the last ones as often as they are to be searched now."""
        lost = frame.index - self._next
        last = self._frames[-1] if self._frames else None
        if last is not None and not (alike(last, frame) and 0 <= lost <= self._window):
            self._frames.clear()
        if not self._frames:
            lost = self._searches = 0
            # a header may begin with the first frame: let that frame stand for those before it
            self._frames.extend(before(frame, SLACK))
        out = list[SearchJob]()
        for one in [*([None] * lost), frame]:
            self._frames.append(one)
            self._next = frame.index + 1 if one is frame else self._next + 1
            if len(self._frames) < self._window:
                continue
            # every second place is enough, but not where frames are missing
            due = (self._next - 1) % self.every == 0 or any(kept is None for kept in self._frames)
            if due and self.header_of(self._frames) is not None:
                out.append(SearchJob(crop_to_common(self._frames), self._turned()))
        return out

    def header_of(self, slots: FrameWindow) -> list[Frame] | None:
        """The frames that are to show a header's beginning; None where too many are missing."""
        return filled([*slots][SLACK : SLACK + self._span])

    def _turned(self) -> bool:
        """Whether turned headers are due in the search that begins now."""
        self._searches += 1
        # not the same ones of each packet: of some phases one alone sees all of a header
        packets = self._searches // self._packet if self._packet % 2 == 0 else 0
        return (self._searches + packets) % 2 == 1
