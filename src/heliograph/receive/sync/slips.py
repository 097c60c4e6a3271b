"""Detection of slips: frames lost without a gap in the frame times.

After a slip, pattern and inverse swap places. With r~_i, frame i at the LED positions less the mean frame,

    epsilon_ij = |r~_i + r~_j|^2 / (|r~_i|^2 + |r~_j|^2)

is near 0 for a pattern and the inverse, and near 1 for patterns of different pairs. After an uneven pair, the watch
collects more frames and pairs these frames at the least cost: epsilon for each pair, `slip_cost` for each single frame.
A lost pair leaves all pairs even, but the next header comes two patterns early.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from math import hypot, isnan, nan

import numpy as np

from heliograph.base.arrays import TINY, Floats
from heliograph.base.frames import Frame
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.sync.kernels import light_at_leds
from heliograph.signal.header import header_levels
from heliograph.signal.settings import SignalSettings

PoseAt = Callable[[float], Pose]  # predicted pose of the array at a time in seconds

MAX_EVEN = 0.4  # maximum epsilon of an even pair: 4 standard deviations below epsilon of 60 independent LEDs
MIN_CORRELATION = 0.7  # minimum correlation of each frame of a header: 5 standard deviations of random data
MAX_TIME_ERROR = 0.2  # maximum deviation from a synchronous frame time in T_b: epsilon is then 0.08 or less


def is_data(number: int, signal: SignalSettings) -> bool:
    """Return True if a pair holds data."""
    return number % (signal.packet_patterns // 2) >= signal.header_pairs


@dataclass(slots=True, eq=False)
class _PendingFrame:
    """A frame without a final number."""

    frame: Frame
    # Number by the frame time
    number: int
    # Pose of the array when the frame was measured
    pose: Pose
    # Light at the LED positions
    light: Floats
    # The same less the mean frame, and its power; None if not a pattern, or before the first mean
    contrast: Floats | None
    power: float


# Pairing of pending frames: cost, epsilon of each pair, and number of slips
_Pairs = tuple[float, tuple[float, ...], int]


class SlipWatch:
    """Corrects the frame times of an array for lost frames."""

    def __init__(self, identity: int, signal: SignalSettings):
        self.lost = 0
        self._signal, self._period_s, self._packet_patterns = signal, signal.pattern_period_s, signal.packet_patterns
        self._header_patterns = 2 * signal.header_pairs
        # bright backgrounds leak into the outer LEDs
        self._rim = signal.side // 8
        inner = slice(self._rim, signal.side - self._rim)
        self._signs = (header_levels(identity, signal.side) / 2.0 - 1.0)[inner, inner].ravel()
        self._pending: list[_PendingFrame] = []
        # mean light of ten pairs at the LEDs; unknown before the first pair, when no frame counts as a pattern
        self._mean: Floats | None = None
        self._no_mean = np.full(self._signs.size, nan)
        self._headers: dict[int, float] = {}
        self._last_s: float | None = None
        self._number = 0
        self._even_before = True

    def push(self, frame: Frame, origin_s: float, pose_at: PoseAt, single: bool) -> Iterator[Frame]:
        """Add the next frame; yield the frames with final times."""
        period_s, last_s = self._period_s, self._last_s
        self._last_s = frame.time_s
        place = (frame.time_s + self.lost * period_s - origin_s) / period_s
        number = round(place) - self.lost
        is_step = last_s is None or frame.time_s - last_s > (1 - MAX_TIME_ERROR) * period_s
        if single or not (is_step and place > -0.5 and abs(place - round(place)) < MAX_TIME_ERROR):
            yield from self.flush()
            yield self._with_time(frame)
            return
        # newer frames may have corrected the poses
        for k, pending in enumerate(self._pending):
            pose = pose_at(pending.frame.time_s + self.lost * period_s)
            if hypot(pose.x - pending.pose.x, pose.y - pending.pose.y) >= 0.25 * pose.pitch:
                self._pending[k] = self._measure(pending.frame, pending.number, pose)
        self._pending.append(self._measure(frame, number, pose_at(frame.time_s + self.lost * period_s)))
        while self._pending and self._is_ready():
            yield from self._release()

    def flush(self) -> Iterator[Frame]:
        """Yield the pending frames at the end of the film."""
        while self._pending:
            yield from self._release()

    def _with_time(self, frame: Frame) -> Frame:
        """Correct the time of a frame for the lost frames."""
        return replace(frame, time_s=frame.time_s + self.lost * self._period_s) if self.lost else frame

    def _measure(self, frame: Frame, number: int, pose: Pose) -> _PendingFrame:
        """Measure the light of a frame at the LED positions of a pose."""
        x, y = pose.x - frame.origin[0], pose.y - frame.origin[1]
        # average over the square of an LED and half a pixel, as motion shifts the light
        width = 2 * int((pose.pitch + 0.5) / 2) + 1
        mean = self._no_mean if self._mean is None else self._mean
        where = x, y, pose.axes, width, self._rim, self._signal.side
        light, contrast, power, is_pattern = light_at_leds(frame.pixels, *where, mean)
        return _PendingFrame(frame, number, pose, light, contrast if is_pattern else None, power)

    def _is_ready(self) -> bool:
        """Return True if the pending frames suffice to release the first frame."""
        first = self._pending[0]
        # nine frames decide on a slip: four pairs with the first frame, and four without
        if (first.number + self.lost) % 2 or len(self._pending) >= 9:
            return len(self._pending) > 1 or not self._follows_gap(first)
        return len(self._pending) > 1 and (self._gap(0) > 1 or not self._epsilon(0) >= MAX_EVEN)

    def _release(self) -> Iterator[Frame]:
        """Yield the first frame or pair, or drop the first frame after a slip."""
        first = self._pending[0]
        if len(self._pending) == 1:
            yield self._pop()
        elif (first.number + self.lost) % 2:
            if self._follows_gap(first) and self._gap(0) == 1 and self._epsilon(0) < MAX_EVEN / 2:
                # the gap was a repeated frame that the clock dropped
                self.lost -= 1
            else:
                yield self._pop()
        elif self._gap(0) > 1:
            is_copy = self._gap(0) == 2 and self._epsilon(0) < MAX_EVEN / 2
            yield self._pop()
            self.lost -= is_copy
        elif not ((epsilon := self._epsilon(0)) >= MAX_EVEN and self._has_slipped()):
            self._even_before = self._mean is None or epsilon < MAX_EVEN
            mean = 0.5 * (first.light + self._pending[1].light)
            self._mean = mean if self._mean is None else self._mean + 0.1 * (mean - self._mean)
            yield self._pop()
            yield self._pop()
        else:
            # pattern or inverse: half of the pair is lost
            self._number = self._pending.pop(0).number
            self.lost += 1

    def _pop(self) -> Frame:
        """Remove and return the first frame with the final time."""
        first = self._pending.pop(0)
        self._number = first.number
        out, number = self._with_time(first.frame), first.number + self.lost
        # three lengths of a header around each header
        if first.contrast is not None and (
            (number + self._header_patterns) % self._packet_patterns < 3 * self._header_patterns
        ):
            norm = float(np.linalg.norm(first.contrast)) * self._signs.size**0.5
            self._headers[number] = float(first.contrast @ self._signs) / max(norm, TINY)
            self._follow_header(number)
        return out

    def _follow_header(self, number: int) -> None:
        """Correct the count of lost frames by a header that ends early, or late after a false slip."""
        patterns, length = self._packet_patterns, self._header_patterns
        early = (length - 1 - number + patterns // 2) % patterns - patterns // 2
        last = [self._headers.get(number - k, 0.0) for k in range(length)]
        if 0 < abs(early) <= length and all((-1) ** (k + 1) * h > MIN_CORRELATION for k, h in enumerate(last)):
            self.lost += early
        self._headers = {k: h for k, h in self._headers.items() if k > number - length}

    def shows_header(self, pair: int) -> bool:
        """Return True if the frames of a data pair show a header: an earlier pair was lost."""
        up, down = (self._headers.get(2 * pair + k, 0.0) for k in range(2))
        return min(up, -down) > MIN_CORRELATION

    def _gap(self, place: int) -> int:
        """Return the number of frame periods from a pending frame to the next."""
        return self._pending[place + 1].number - self._pending[place].number

    def _follows_gap(self, first: _PendingFrame) -> bool:
        """Return True for an inverse of data after a gap."""
        number = first.number + self.lost
        return number % 2 == 1 and first.number > self._number + 1 and is_data(number // 2, self._signal)

    def _epsilon(self, place: int) -> float:
        """Return epsilon of a pending frame and the next, at most 1; NaN, neither even nor uneven, without patterns."""
        first, second = self._pending[place : place + 2]
        p, q = first.power, second.power
        if first.contrast is None or second.contrast is None or min(p, q) < 0.25 * max(p, q):
            return nan
        return min(1 + 2 * float(first.contrast @ second.contrast) / max(p + q, TINY), 1.0)

    def _has_slipped(self) -> bool:
        """Return True if the frames after the first form even pairs, at a lower cost than with the first frame.

        If the previous pair was uneven as well, poses may be wrong or the array occluded. A header is even at any
        place, so every pair must then improve.
        """
        last = len(self._pending) - 1

        @cache
        def pair(place: int, lost: int) -> _Pairs:
            """Pair the frames from a place on at the least cost."""
            return min(options(place, lost), key=lambda pairs: pairs[0])

        def options(place: int, lost: int) -> list[_Pairs]:
            """Return the pairings with the frame at a place, and without it if it begins a pair."""
            if place >= last:
                return [(0.0, (), 0)]
            if (self._pending[place].number + lost) % 2 or self._gap(place) > 1:
                return [pair(place + 1, lost)]
            e, (cost, epsilons, slips) = self._epsilon(place), pair(place + 2, lost)
            regular = (cost, epsilons, slips) if isnan(e) else (e + cost, (e, *epsilons), slips)
            cost, epsilons, slips = pair(place + 1, lost + 1)
            # two slips must cost less than an uneven pair
            return [regular, (0.45 + cost, epsilons, slips + 1)]

        (regular_cost, _, _), (cost, epsilons, slips) = options(0, self.lost)
        improves = (self._epsilon(k + 1) < MAX_EVEN <= self._epsilon(k) for k in range(0, last - 1, 2))
        if not (self._even_before or all(improves)):
            return False
        # one more slip at most
        return cost < regular_cost and len(epsilons) >= 2 and max(epsilons) < MAX_EVEN and slips <= 2
