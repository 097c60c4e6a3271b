"""Detection of slips: frames lost without a gap in the frame times.

After a slip, pattern and inverse swap places. With r~_i, frame i at the LED positions less the mean frame,

    epsilon_ij = |r~_i + r~_j|^2 / (|r~_i|^2 + |r~_j|^2)

is near 0 for a pattern and the inverse, and near 1 for patterns of different pairs. After an uneven pair, the watch
collects more frames and pairs these frames at the least cost: epsilon for each pair, `slip_cost` for each single frame.
A lost pair leaves all pairs even, but the next header comes two patterns early.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import hypot

import numpy as np

from heliograph.base.arrays import TINY, Floats
from heliograph.base.frames import Frame
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.sync import kernels
from heliograph.receive.sync.pairing import PoseAt, is_data
from heliograph.signal.header import header_levels
from heliograph.signal.settings import SignalSettings


@dataclass(frozen=True)
class SlipParameters:
    """Parameters of the slip detection."""

    # Maximum epsilon of an even pair: 4 standard deviations below epsilon of 60 independent LEDs
    max_even: float = 0.4
    # The same for a repeated frame that explains a gap
    max_even_copy: float = 0.2
    # Cost of a single frame: two slips must cost less than an uneven pair
    slip_cost: float = 0.45
    # Minimum number of even pairs after a slip
    min_even_pairs: int = 2
    # Slips among the pending frames from which on a pairing is rejected
    max_slips: int = 2
    # Change of the pose in pitches above which a pending frame is measured again
    max_pose_change: float = 0.25
    # Pending frames that decide on a slip: four pairs with the first frame, and four without
    decision_frames: int = 9
    # Minimum correlation of each frame of a header: 5 standard deviations of random data
    min_header_correlation: float = 0.7
    # Minimum ratio of the powers of two patterns, and of the variance of a pattern to the power
    min_power_ratio: float = 0.25
    # LEDs at each side of an array that are ignored, as a divisor of the side: bright backgrounds leak in
    rim_divisor: int = 8
    # Weight of a pair in the mean frame
    mean_rate: float = 0.1
    # Maximum deviation from a synchronous frame time in T_b: epsilon is then 0.08 or less
    max_time_error: float = 0.2
    # Lengths of a header during which frames are compared with the header
    header_spans: int = 3
    # Margin in px that motion adds to the square of an LED
    blur_margin_px: float = 0.5


@dataclass(slots=True, eq=False)
class _PendingFrame:
    """A frame without a final number."""

    frame: Frame
    # Number by the frame time
    number: int
    # Pose of the array when the frame was measured
    pose: Pose
    # Light at the LED positions, and the same less the mean frame
    light: Floats
    contrast: Floats | None
    # Power of `contrast`
    power: float
    # True if `contrast` may be a pattern
    is_pattern: bool
    # Memo: the frame of the last comparison, and epsilon of both
    partner: "_PendingFrame | None" = None
    epsilon: float | None = None


# Pairing of the pending frames: cost, epsilon of each pair, and number of slips
_Pairs = tuple[float, tuple[float, ...], int]


class SlipWatch:
    """Corrects the frame times of an array for lost frames."""

    def __init__(self, identity: int, signal: SignalSettings, parameters: SlipParameters = SlipParameters()):
        self._parameters = parameters
        self.lost = 0
        self._signal, self._period_s, self._packet_patterns = signal, signal.pattern_period_s, signal.packet_patterns
        self._header_patterns = 2 * signal.header_pairs
        self._rim = signal.side // parameters.rim_divisor
        inner = slice(self._rim, signal.side - self._rim)
        self._signs = (header_levels(identity, signal.side) / 2.0 - 1.0)[inner, inner].ravel()
        self._pending: list[_PendingFrame] = []
        self._mean: Floats | None = None
        self._headers: dict[int, float] = {}
        self._last_s: float | None = None
        self._number = 0
        self._even_before = True

    def push(self, frame: Frame, origin_s: float, pose_at: PoseAt, paired: bool) -> Iterator[Frame]:
        """Add the next frame; yield the frames with final times."""
        period_s, last_s = self._period_s, self._last_s
        self._last_s = frame.time_s
        place = (frame.time_s + self.lost * period_s - origin_s) / period_s
        number = round(place) - self.lost
        is_step = last_s is None or frame.time_s - last_s > (1 - self._parameters.max_time_error) * period_s
        if not (paired and is_step and place > -0.5 and abs(place - round(place)) < self._parameters.max_time_error):
            yield from self.flush()
            yield self._with_time(frame)
            return
        # newer frames may have corrected the poses
        for k, pending in enumerate(self._pending):
            pose = pose_at(pending.frame.time_s + self.lost * period_s)
            off_px = hypot(pose.x - pending.pose.x, pose.y - pending.pose.y)
            if off_px >= self._parameters.max_pose_change * pose.pitch:
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
        if not self.lost:
            return frame
        return replace(frame, time_s=frame.time_s + self.lost * self._period_s)

    def _measure(self, frame: Frame, number: int, pose: Pose) -> _PendingFrame:
        """Measure the light of a frame at the LED positions of a pose."""
        side, x, y = self._signal.side, pose.x - frame.origin[0], pose.y - frame.origin[1]
        # average over the square of an LED: motion shifts the light
        width = 2 * int((pose.pitch + self._parameters.blur_margin_px) / 2) + 1
        light = kernels.means_at_leds(frame.pixels, x, y, pose.axes, width, self._rim, side)
        if self._mean is None:
            return _PendingFrame(frame, number, pose, light, None, 0.0, False)
        contrast = np.empty(light.shape)
        power, mean = kernels.subtract_mean(light, self._mean, contrast)
        is_pattern = power - contrast.size * mean**2 > self._parameters.min_power_ratio * power
        return _PendingFrame(frame, number, pose, light, contrast, power, is_pattern)

    def _is_ready(self) -> bool:
        """Return True if the pending frames suffice to release the first frame."""
        first = self._pending[0]
        if (first.number + self.lost) % 2 or len(self._pending) >= self._parameters.decision_frames:
            return len(self._pending) > 1 or not self._follows_gap(first)
        return len(self._pending) > 1 and (self._gap(0) > 1 or not self._is_uneven(0))

    def _release(self) -> Iterator[Frame]:
        """Yield the first frame or pair, or drop the first frame after a slip."""
        first = self._pending[0]
        if len(self._pending) == 1:
            yield self._pop()
        elif (first.number + self.lost) % 2:
            if self._follows_gap(first) and self._gap(0) == 1 and self._is_even(0, self._parameters.max_even_copy):
                # the gap was a repeated frame that the clock dropped
                self.lost -= 1
            else:
                yield self._pop()
        elif self._gap(0) > 1:
            is_copy = self._gap(0) == 2 and self._is_even(0, self._parameters.max_even_copy)
            yield self._pop()
            self.lost -= is_copy
        elif not (self._is_uneven(0) and self._has_slipped()):
            self._even_before = self._mean is None or self._is_even(0)
            mean = 0.5 * (first.light + self._pending[1].light)
            self._mean = mean if self._mean is None else self._mean + self._parameters.mean_rate * (mean - self._mean)
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
        near = (
            number + self._header_patterns
        ) % self._packet_patterns < self._parameters.header_spans * self._header_patterns
        if near and first.contrast is not None:
            self._headers[number] = (
                float(first.contrast @ self._signs) / max(first.power * self._signs.size, TINY) ** 0.5
            )
            self._follow_header(number)
        return out

    def _follow_header(self, number: int) -> None:
        """Correct the count of lost frames by a header that ends early, or late after a false slip."""
        patterns, length = self._packet_patterns, self._header_patterns
        early = (length - 1 - number + patterns // 2) % patterns - patterns // 2
        last = [self._headers.get(number - k, 0.0) for k in range(length)]
        least = self._parameters.min_header_correlation
        if 0 < abs(early) <= length and all((-1) ** (k + 1) * h > least for k, h in enumerate(last)):
            self.lost += early
        self._headers = {k: h for k, h in self._headers.items() if k > number - length}

    def shows_header(self, pair: int) -> bool:
        """Return True if the frames of a data pair show a header: an earlier pair was lost."""
        up, down = (self._headers.get(2 * pair + k, 0.0) for k in range(2))
        return min(up, -down) > self._parameters.min_header_correlation

    def _gap(self, place: int) -> int:
        """Return the number of frame periods from a pending frame to the next."""
        return self._pending[place + 1].number - self._pending[place].number

    def _follows_gap(self, first: _PendingFrame) -> bool:
        """Return True for an inverse of data after a gap."""
        number = first.number + self.lost
        return number % 2 == 1 and first.number > self._number + 1 and is_data(number // 2, self._signal)

    def _epsilon(self, place: int) -> float | None:
        """Return epsilon of a pending frame and the next, at most 1; None for frames of no pattern."""
        first, second = self._pending[place], self._pending[place + 1]
        if first.partner is not second:
            first.partner, first.epsilon = second, None
            u, v, p, q = first.contrast, second.contrast, first.power, second.power
            is_similar = min(p, q) >= self._parameters.min_power_ratio * max(p, q)
            if u is not None and v is not None and first.is_pattern and second.is_pattern and is_similar:
                first.epsilon = min(1 + 2 * float(u @ v) / max(p + q, TINY), 1.0)
        return first.epsilon

    def _is_even(self, place: int, limit: float | None = None) -> bool:
        """Return True if a pending frame and the next are certainly a pair."""
        e = self._epsilon(place)
        return e is not None and e < (self._parameters.max_even if limit is None else limit)

    def _is_uneven(self, place: int) -> bool:
        """Return True if a pending frame and the next are certainly no pair."""
        e = self._epsilon(place)
        return e is not None and e >= self._parameters.max_even

    def _has_slipped(self) -> bool:
        """Return True if the frames after the first form even pairs, at a lower cost than with the first frame.

        If the previous pair was uneven as well, poses may be wrong or the array occluded. A header is even at any
        place, so every pair must then improve.
        """
        parameters, memo = self._parameters, dict[tuple[int, int], _Pairs]()
        cost, _, _ = self._pair_regularly(0, self.lost, memo)
        slip_cost, epsilons, slips = self._pair(1, self.lost + 1, memo)
        has_even = len(epsilons) >= parameters.min_even_pairs and max(epsilons) < parameters.max_even
        has_even &= slips < parameters.max_slips
        if not self._even_before:
            starts = range(0, len(self._pending) - 2, 2)
            has_even &= all(self._is_even(k + 1) and self._is_uneven(k) for k in starts)
        return has_even and parameters.slip_cost + slip_cost < cost

    def _pair(self, place: int, lost: int, memo: dict[tuple[int, int], _Pairs]) -> _Pairs:
        """Pair the pending frames from a place on at the least cost; `memo` holds the results by place and parity."""
        key = place, lost % 2
        if key not in memo:
            memo[key] = self._pair_regularly(place, lost, memo)
            if self._begins_pair(place, lost):
                cost, epsilons, slips = self._pair(place + 1, lost + 1, memo)
                slipped = self._parameters.slip_cost + cost, epsilons, slips + 1
                memo[key] = min(memo[key], slipped, key=lambda pairs: pairs[0])
        return memo[key]

    def _pair_regularly(self, place: int, lost: int, memo: dict[tuple[int, int], _Pairs]) -> _Pairs:
        """Pair the pending frames from a place on, without a slip of the first frame."""
        if place >= len(self._pending) - 1:
            return 0.0, (), 0
        if not self._begins_pair(place, lost):
            return self._pair(place + 1, lost, memo)
        e, (cost, epsilons, slips) = self._epsilon(place), self._pair(place + 2, lost, memo)
        return (cost, epsilons, slips) if e is None else (e + cost, (e, *epsilons), slips)

    def _begins_pair(self, place: int, lost: int) -> bool:
        """Return True if a pending frame is a pattern directly before the next frame."""
        if place >= len(self._pending) - 1:
            return False
        return (self._pending[place].number + lost) % 2 == 0 and self._gap(place) <= 1
