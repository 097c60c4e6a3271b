"""Pairing of the frames of an array to patterns and inverses.

A synchronous camera takes a frame per pattern. For any other camera, the light clock times the patterns, and frames
are combined. Pairs are numbered from the header of the detection. Both pairings take frames by `push` and `flush`,
correct the times after slips, and return the complete pairs by `next_pair`, for the track after the previous pair.
"""

from abc import ABC, abstractmethod
from collections import deque
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import Floats
from heliograph.base.frames import Frame
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.geometry.window import AnyFrame, CombinedFrame, Part, shared_part, window_around
from heliograph.receive.sync.combine import Combination, combine_header, combine_pair
from heliograph.receive.sync.frame_clock import frame_period
from heliograph.receive.sync.light_clock import MIN_EXPLAINED, PATTERNS_AROUND, LightClock, measure_amplitudes
from heliograph.receive.sync.slips import PoseAt, SlipWatch, is_data
from heliograph.signal.header import header_levels
from heliograph.signal.pwm import light_centroids
from heliograph.signal.settings import SignalSettings


@dataclass(frozen=True, slots=True)
class FramePair:
    """Frames of a pattern and the inverse, or of two patterns of data without inverses."""

    # Frame of the pattern
    pattern: AnyFrame
    # Frame of the inverse, or of the next pattern of data without inverses
    inverted: AnyFrame
    # Delay in seconds of the mean light of the sum after the middle of the exposures
    late_s: float = 0.0
    # Combination of the frames; None for two synchronous camera frames
    combination: Combination | None = None

    @property
    def time_s(self) -> float:
        """Time in seconds halfway between the starts of both frames."""
        return 0.5 * (self.pattern.time_s + self.inverted.time_s)


@dataclass(frozen=True, slots=True)
class MeasuredHeader:
    """A complete header filmed by an asynchronous camera."""

    # Gray levels of the array with all LEDs on
    gain: float
    # Pose of the array in the middle of the header
    pose: Pose
    # Combination of all header frames to a pair with an even sum; None if impossible, then without the following
    pair: FramePair | None = None
    # (frames, rows, columns) gray levels around the array, and (x, y) on the sensor of the first pixel
    images: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 0, 0), np.float32))
    corner: tuple[int, int] = (0, 0)
    # (2, frames) amplitude of the header less the inverse, -1 to 1, and mean light of both, 0 to 1, each of full cells
    # and of dimmed cells
    alternation: Floats = field(default_factory=lambda: np.zeros((2, 0)))
    light: Floats = field(default_factory=lambda: np.zeros((2, 0)))


# number of a complete pair and the frames, None if missing; before the first data pair also the measured header
DuePair = tuple[int, FramePair | MeasuredHeader | None]


def sum_late_s(signal: SignalSettings) -> float:
    """Return the delay in seconds of the mean light of a sum after the middle of the exposures, due to PWM."""
    mean, _ = light_centroids(signal.slot_order)
    return (mean - 0.5) * signal.pattern_period_s


class Pairing(ABC):
    """Pairing of the frames of an array, from the start of pair 0 on."""

    def __init__(self, start_s: float, time_s: float, identity: int, signal: SignalSettings):
        self.lost, self.slips, self._signal = False, SlipWatch(identity, signal), signal
        # gray levels of the array with all LEDs on, if the detection measured another gain
        self.first_gain: float | None = None
        # start of pair 0, and time of the last frame or complete pair
        self.origin_s, self.now_s = start_s, time_s
        # 95 % interval of the exposure in T_b; None before the first header, or if a frame shows a single pattern
        self.exposure_range: tuple[float, float] | None = None
        self._late_s = sum_late_s(signal)
        # number of the next pair
        self._next = 0

    def push(self, frame: Frame, pose_at: PoseAt, single: bool) -> None:
        """Add the next frame."""
        for kept in self.slips.push(frame, self.origin_s, pose_at, single):
            self._add(kept)

    def flush(self) -> None:
        """End the film."""
        for kept in self.slips.flush():
            self._add(kept)

    @abstractmethod
    def next_pair(self, pose_at: PoseAt, led_gains: Floats, single: bool) -> DuePair | None:
        """Return the next pair, None for its frames if one is missing; None before the pair is complete."""

    @abstractmethod
    def _add(self, frame: Frame) -> None:
        """Add a frame with its final time."""


class SynchronousPairing(Pairing):
    """Pairs of a synchronous camera: frame 2 k shows a pattern, frame 2 k + 1 the inverse."""

    def __init__(self, start_s: float, time_s: float, identity: int, signal: SignalSettings):
        super().__init__(start_s, time_s, identity, signal)
        self._frames: dict[int, Frame] = {}

    def _add(self, frame: Frame) -> None:
        self.now_s = max(self.now_s, frame.time_s)
        number = round((frame.time_s - self.origin_s) / self._signal.pattern_period_s)
        if number >= 2 * self._next:
            self._frames[number] = frame

    def next_pair(self, pose_at: PoseAt, led_gains: Floats, single: bool) -> DuePair | None:  # noqa: ARG002 - as in `AsynchronousPairing`
        """Return the next pair; see `Pairing`."""
        number = self._next
        if not self._frames or max(self._frames) < 2 * number + 1:
            return None
        self._next += 1
        first, second = self._frames.pop(2 * number, None), self._frames.pop(2 * number + 1, None)
        if first is None or second is None:
            return number, None
        return number, FramePair(first, second, self._late_s if is_data(number, self._signal) else 0.0)


class AsynchronousPairing(Pairing):
    """Pairs of a camera of any timing, by the light clock; times in pattern periods."""

    def __init__(
        self,
        start_s: float,
        time_s: float,
        pose: Pose,
        identity: int,
        led_gains: Floats,
        signal: SignalSettings,
        exposure_s: float | None,
        drift: tuple[float, float] = (0.0, 0.0),
    ):
        super().__init__(start_s, time_s, identity, signal)
        self._pose, self._drift, self._identity, self._exposure_s = pose, drift, identity, exposure_s
        self._signs = header_levels(identity, signal.side) / 2.0 - 1.0
        self._lit = self._signs * led_gains
        self._header = 2 * signal.header_pairs
        self._frames: deque[Frame] = deque()
        # started by the first header and the frames around
        self._clock: LightClock
        self._has_clock = False
        # end of the frames in patterns
        self._end = 0.0
        # predicted poses after the last pairs but one, for the clock
        self._poses: deque[PoseAt] = deque(maxlen=signal.header_pairs + PATTERNS_AROUND - 1)
        self._measured = -1  # pair before which the last header was measured

    def _add(self, frame: Frame) -> None:
        self._frames.append(frame)
        if not self._has_clock:
            awaited = self._header + PATTERNS_AROUND + 1
            if frame.time_s < self.origin_s + awaited * self._signal.pattern_period_s:
                return
            self._start_clock()
        self._end = self._clock.pattern_at(frame.time_s) - 1

    def flush(self) -> None:
        """End the film."""
        super().flush()
        if not self._has_clock and len(self._frames) > self._header:
            self._start_clock()
        if self._has_clock and self._frames:
            self._end = self._clock.pattern_at(self._frames[-1].time_s) + self._clock.exposure

    def next_pair(self, pose_at: PoseAt, led_gains: Floats, single: bool) -> DuePair | None:
        """Return the next pair, combined unless synchronous; see `Pairing`.

        Before the first data pair, the header corrects the clock, and an asynchronous camera gets the measured header.
        """
        number, signal = self._next, self._signal
        # time stamps have a tolerance
        if not self._has_clock or self.lost or 2 * (number + 1) > self._end + 0.02:
            return None
        if number % (signal.packet_patterns // 2) == signal.header_pairs and self._measured != number:
            self._measured = number
            header = self._measure_header(number, pose_at, led_gains)
            self._set_times()
            if header is not None:
                return number, header
        oldest_s = self._clock.time_s(2 * (number - 1) - self._header - 2 * PATTERNS_AROUND)
        while self._frames and self._frames[0].time_s < oldest_s:
            self._frames.popleft()
        self._poses.append(pose_at)
        self._next += 1
        self._set_times()
        return number, self._get_pair(number, pose_at, single)

    def _set_times(self) -> None:
        """Set the time of the last pair, and the start of pair 0 extrapolated with the nominal period."""
        if self._next:
            place = 2 * (self._next - 1)
            self.now_s = self._clock.time_s(place + 1)
            self.origin_s = self._clock.time_s(place) - place * self._signal.pattern_period_s

    def _measure_header(self, pair: int, pose_at: PoseAt, led_gains: Floats) -> MeasuredHeader | None:
        """Correct the clock by the header before a pair; return the header of an asynchronous camera."""
        clock, pattern, poses = self._clock, 2 * pair - self._header, [*self._poses, pose_at]
        near = self._frames_between(pattern - PATTERNS_AROUND, pattern + self._header + PATTERNS_AROUND)
        if len(near) <= self._header:
            return None
        nearest = np.rint(0.5 * (clock.starts(near) - 0.5)).astype(int) - (pair - len(poses))
        places = np.clip(nearest, 0, len(poses) - 1).tolist()
        predicted = [poses[k](frame.time_s) for k, frame in zip(places, near, strict=True)]
        amplitudes = measure_amplitudes(near, predicted, self._signs * led_gains)
        is_measured = clock.measure(amplitudes, pattern, again=pattern == 0)
        self.exposure_range = clock.exposure_range
        if not is_measured or self._is_synchronous(self._combination(near, pattern)):
            return None
        inside, combination = self._header_combination(pattern, (0, self._header))
        middle = pose_at(clock.time_s(pattern + self._header / 2))
        part = self._part(inside, middle) if combination else None
        if combination is None or part is None:
            return MeasuredHeader(clock.gain, middle)
        combined = self._combine(pattern, combination, inside, part)
        starts = clock.starts(inside) - pattern
        shown, lights = zip(clock.predict_header(starts, 0.0), clock.predict_header(starts, 1.0), strict=True)
        images = _cut(inside, part)
        return MeasuredHeader(clock.gain, middle, combined, images, part[:2], np.stack(shown), np.stack(lights))

    def _get_pair(self, number: int, pose_at: PoseAt, single: bool) -> FramePair | None:
        """Return the frames of a pair, combined unless synchronous; None if they are missing."""
        place, data = 2 * number, is_data(number, self._signal)
        if data and not single and len(self._frames_between(place - 0.5, place + 1.5)) < 2:
            # neighbouring pairs would stand for the missing frame
            return None
        # frames that may overlap the pair
        near = self._frames_between(place - 1, place + 3)
        combination = self._combination(near, place)
        is_synchronous = self._is_synchronous(combination)
        if single and data:
            # data without inverses need two frames, combined or not
            is_synchronous |= combination is not None and bool(np.isfinite(combination.departure))
        first = place
        if not data and not is_synchronous:
            first -= place % self._signal.packet_patterns
            near, combination = self._header_combination(first, (place - first, place - first + 2))
        if combination is None:
            return None
        frames = [near[k] for k in combination.frames]
        if is_synchronous:
            return FramePair(frames[0], frames[1], self._late_s if data else 0.0)
        part = self._part(frames, pose_at(self._clock.time_s(place + 1)))
        return self._combine(first, combination, frames, part) if part else None

    def _start_clock(self) -> None:
        """Start the clock with the header of the detection."""
        frames, light_s, start_s = list(self._frames), self._signal.pattern_period_s, self.origin_s
        period = frame_period(np.diff([f.time_s for f in frames]))
        self._clock, self._has_clock = LightClock(start_s, period, self._signal, self._identity, self._exposure_s), True
        end = start_s + (self._header + PATTERNS_AROUND) * light_s
        near = [f for f in frames if start_s - PATTERNS_AROUND * light_s <= f.time_s <= end]
        # a header may have begun before the film
        self.lost = len(near) < self._header
        if not self.lost:
            delays = [frame.time_s - self.now_s for frame in near]
            poses = [self._pose.moved(dt * self._drift[0], dt * self._drift[1]) for dt in delays]
            self._clock.measure(measure_amplitudes(near, poses, self._lit), 0)
            self.lost = self._clock.explained < MIN_EXPLAINED
            if not self._is_synchronous(self._combination(near, 0)):
                # the detection assumed a synchronous camera and so measured too weak a header
                self.first_gain = self._clock.gain
        self.exposure_range = self._clock.exposure_range

    def _combination(self, frames: list[Frame], pattern: int) -> Combination | None:
        """Combine frames to the pair that begins with a pattern."""
        starts = self._clock.starts(frames)
        if not len(starts):
            return None
        # round the first start and the steps: starts rounded separately would differ from pair to pair
        steps = np.rint((starts - starts[0]) / 5e-4) * 5e-4
        rounded = tuple((_rounded(starts[0] - pattern) + steps).tolist())
        return _pair_combination(rounded, max(_rounded(self._clock.exposure), 0.002), self._signal.slot_order)

    def _is_synchronous(self, combination: Combination | None) -> bool:
        """Return True if two frames show pattern and inverse, within the error of the clock."""
        # 0.035 costs a quarter of a dB; 87 % of the errors are below 1.5 deviations
        return combination is not None and combination.departure < 0.035 + 1.5 * self._clock.deviation

    def _header_combination(self, first: int, part: tuple[int, int]) -> tuple[list[Frame], Combination | None]:
        """Combine the frames within a part of the header that starts with pattern `first`."""
        clock, overhang = self._clock, 0.04  # part of an exposure that may exceed the header
        low, high = max(part[0] - 1 + overhang, -overhang), min(part[1], self._header + overhang)
        near = self._frames_between(first + low, first + high)
        starts = clock.starts(near) - first
        within = starts + clock.exposure <= self._header + overhang
        within &= (starts + clock.exposure > part[0] + overhang) & (starts < part[1] - overhang)
        near = [f for f, is_within in zip(near, within, strict=True) if is_within]
        starts = starts[within]
        amplitudes, _ = clock.predict_header(starts, 0.0)
        return near, combine_header(starts, clock.exposure, amplitudes, clock.predict_header(starts, 1.0))

    def _frames_between(self, first: float, last: float) -> list[Frame]:
        """Return the frames that start between two patterns."""
        low, high = self._clock.time_s(first), self._clock.time_s(last)
        return [f for f in self._frames if low <= f.time_s <= high]

    def _part(self, frames: list[Frame], pose: Pose) -> Part | None:
        """Return the part of the sensor around the array that all frames share."""
        side = self._signal.side
        # room for motion
        x, y, width, height = window_around(pose, side, max(8.0, 0.5 * side * pose.pitch))
        left, top, right, low = shared_part(frames)
        left, top, right, low = max(x, left), max(y, top), min(x + width, right), min(y + height, low)
        return (left, top, right, low) if right > left and low > top else None

    def _combine(self, place: int, combination: Combination, frames: list[Frame], part: Part) -> FramePair:
        """Combine frames to pattern and inverse; the times of the combination count from pattern `place`."""
        weights = np.stack([combination.total + combination.difference, combination.total - combination.difference]) / 2
        first, second = np.tensordot(weights, _cut(frames, part), 1).astype(np.float32)
        # the time of a frame is half a pattern before the middle of the light
        time_s, full = self._clock.time_s(place + combination.sum_time - 0.5), frames[0].full_scale
        pattern = CombinedFrame(frames[0].index, time_s, first, part[:2], full)
        inverse = CombinedFrame(frames[-1].index, time_s, second, part[:2], full)
        return FramePair(pattern, inverse, combination=combination)


def _rounded(patterns: float) -> float:
    """Round a time in patterns, so that equal pairs share a cached combination."""
    return round(patterns / 0.002) * 0.002


@lru_cache(maxsize=64)  # the pairs of a packet have few different timings
def _pair_combination(starts: tuple[float, ...], exposure: float, order: tuple[int, ...]) -> Combination | None:
    """Call `combine_pair` with rounded starts and exposures."""
    return combine_pair(np.array(starts), exposure, order)


def _cut(frames: list[Frame], part: Part) -> NDArray[np.float32]:
    """Cut a part of the sensor out of frames, (frames, rows, columns)."""
    left, top, right, low = part
    return np.stack(
        [f.pixels[top - f.origin[1] : low - f.origin[1], left - f.origin[0] : right - f.origin[0]] for f in frames]
    ).astype(np.float32)
