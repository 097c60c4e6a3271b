"""Pairs of a camera in step: one frame per pattern, nothing to combine."""

from collections.abc import Iterator, Mapping

import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.receive.timing.frame_pair import FramePair, LoneFrame, PoseAt, is_data, sum_late_s
from heliograph.signal.settings import SignalSettings


class SteppedPairing:
    """Pairs of a camera in step: frame 2 k shows a pattern, frame 2 k + 1 its inverse."""

    def __init__(self, start_s: float, time_s: float, signal: SignalSettings):
        self.lost = False
        self.first_gain: float | None = None
        self._origin_s, self._now_s, self._signal = start_s, time_s, signal
        self._late_s = sum_late_s(signal)
        self._next = 0
        self._frames: dict[int, Frame] = {}

    @property
    def now_s(self) -> float:
        """See `Pairing`."""
        return self._now_s

    @property
    def origin_s(self) -> float:
        """See `Pairing`."""
        return self._origin_s

    @property
    def exposure_range(self) -> None:
        """None: a frame is taken to show one pattern, whatever its exposure; see `Pairing`."""

    def push(self, frame: Frame) -> Iterator[int]:
        """Take the next frame; yield the numbers of the pairs that can be read by now; see `Pairing`."""
        self._now_s = max(self._now_s, frame.time_s)
        number = round((frame.time_s - self._origin_s) / self._signal.pattern_period_s)
        if number < 0:
            return
        self._frames[number] = frame
        while 2 * self._next + 1 <= number:
            pair = self._next
            self._next += 1
            yield pair
            self._frames = {k: one for k, one in self._frames.items() if k >= 2 * self._next}

    def flush(self) -> Iterator[int]:
        """No pair is held back."""
        yield from ()

    def header(
        self,
        pair: int,
        poses: Mapping[int, PoseAt],
        pose_at: PoseAt,
        led_gains: NDArray[np.float64],
    ) -> None:
        """Return nothing, as there is no clock to correct; see `Pairing`."""

    def pair(self, number: int, pose_at: PoseAt, single: bool) -> FramePair | LoneFrame | None:  # noqa: ARG002 - the protocol's
        """Give the two frames of a pair, or the one that is there; see `Pairing`."""
        first, second = self._frames.get(2 * number), self._frames.get(2 * number + 1)
        data = is_data(number, self._signal)
        if first is not None and second is not None:
            return FramePair(first, second, self._late_s if data else 0.0)
        left = second if first is None else first
        return LoneFrame(left, first is None, self._late_s) if left is not None and data and not single else None
