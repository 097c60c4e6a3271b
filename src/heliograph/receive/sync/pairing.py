"""Pairing of the frames of an array to patterns and inverses.

A synchronous camera takes a frame per pattern. For any other camera, the light clock times the patterns, and frames
are combined. Pairs are numbered from the header of the detection.
"""

from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.geometry.window import window_around
from heliograph.receive.sync.combine import Combination, SlotLight, combine_header, combine_pair
from heliograph.receive.sync.frame_clock import frame_period
from heliograph.receive.sync.light_clock import (
    PATTERNS_AROUND,
    HeaderAmplitudes,
    LightClock,
    LightClockParameters,
    measure_amplitudes,
)
from heliograph.signal.header import header_levels
from heliograph.signal.pwm import light_centroids
from heliograph.signal.settings import SignalSettings

PoseAt = Callable[[float], Pose]
"""Predicted pose of the array at a time in seconds."""


@dataclass(frozen=True, slots=True)
class CombinedFrame:
    """Frames combined to a pattern or to an inverse around an array."""

    # Number of the first or the last camera frame
    index: int
    # Time in seconds, half a pattern before the mean time of the light, as for a camera frame
    time_s: float
    # (rows, columns) float32 gray levels
    pixels: NDArray[np.float32]
    # Position (x, y) of the first pixel on the sensor
    origin: tuple[int, int]
    # Largest gray level of the camera
    full_scale: int


AnyFrame = Frame | CombinedFrame


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
class UnpairedFrame:
    """Remaining frame of a synchronous data pair after the loss of the other frame."""

    # Camera frame, with the start of the exposure as time
    frame: Frame
    # True if the frame shows the inverse
    inverted: bool
    # Delay in seconds of the mean light of the array after the middle of the exposure
    late_s: float


@dataclass(frozen=True, slots=True)
class HeaderFrames:
    """Frames of a header filmed by an asynchronous camera."""

    # (frames, rows, columns) gray levels around the array
    images: NDArray[np.float32]
    # (x, y) on the sensor of the first pixel
    corner: tuple[int, int]
    # Pose of the array in the middle of the header
    pose: Pose
    # (2, frames) amplitude of the header less the inverse, -1 to 1: of full cells and of dimmed cells
    alternation: NDArray[np.float64]
    # (2, frames) mean light of both, 0 to 1
    light: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class MeasuredHeader:
    """A complete header filmed by an asynchronous camera."""

    # Gray levels of the array with all LEDs on
    gain: float
    # Combination of all header frames to a pair with an even sum; None if impossible
    pair: FramePair | None = None
    # The frames for the format; None as `pair`
    frames: HeaderFrames | None = None


def is_data(number: int, signal: SignalSettings) -> bool:
    """Return True if a pair holds data."""
    return number % (signal.packet_patterns // 2) >= signal.header_pairs


def sum_late_s(signal: SignalSettings) -> float:
    """Return the delay in seconds of the mean light of a sum after the middle of the exposures, due to PWM."""
    mean, _ = light_centroids(signal.slot_order)
    return (mean - 0.5) * signal.pattern_period_s


class SynchronousPairing:
    """Pairs of a synchronous camera: frame 2 k shows a pattern, frame 2 k + 1 the inverse."""

    def __init__(self, start_s: float, time_s: float, signal: SignalSettings):
        self.lost = False
        self.first_gain: float | None = None
        # start of pair 0, and time of the last frame
        self.origin_s, self.now_s, self._signal = start_s, time_s, signal
        # a frame shows a single pattern at any exposure
        self.exposure_range = None
        self._late_s = sum_late_s(signal)
        self._next = 0
        self._frames: dict[int, Frame] = {}

    def push(self, frame: Frame) -> Iterator[int]:
        """Add the next frame; yield the numbers of the complete pairs."""
        self.now_s = max(self.now_s, frame.time_s)
        number = round((frame.time_s - self.origin_s) / self._signal.pattern_period_s)
        if number < 0:
            return
        self._frames[number] = frame
        while 2 * self._next + 1 <= number:
            pair = self._next
            self._next += 1
            yield pair
            self._frames = {k: f for k, f in self._frames.items() if k >= 2 * self._next}

    def flush(self) -> Iterator[int]:
        """Return an empty iterator: no pair is pending."""
        yield from ()

    def measure_header(
        self, pair: int, poses: Mapping[int, PoseAt], pose_at: PoseAt, led_gains: NDArray[np.float64]
    ) -> None:
        """Return None: a synchronous pairing has no clock to correct."""

    def get_pair(self, number: int, pose_at: PoseAt, single: bool) -> FramePair | UnpairedFrame | None:  # noqa: ARG002 - as in `AsynchronousPairing`
        """Return the frames of a pair, or the remaining frame of a data pair."""
        first, second = self._frames.get(2 * number), self._frames.get(2 * number + 1)
        data = is_data(number, self._signal)
        if first is not None and second is not None:
            return FramePair(first, second, self._late_s if data else 0.0)
        left = second if first is None else first
        return UnpairedFrame(left, first is None, self._late_s) if left is not None and data and not single else None


@dataclass(frozen=True)
class PairingParameters:
    """Parameters of the asynchronous pairing; times in pattern periods T_b."""

    # Time before and after a pair in which frames may overlap the pair
    margin: float = 1.0
    # Tolerance of time stamps: a pair may be complete that much earlier
    tolerance: float = 0.02
    # Part of an exposure that may exceed the header
    overhang: float = 0.04
    # Departure from pattern and inverse of a synchronous pair; 0.035 costs a quarter of a dB
    max_departure: float = 0.035
    # Standard deviations of the clock that are added to `max_departure`: 87 % of the errors are smaller
    departure_deviations: float = 1.5
    # Resolution of first start and exposure, so that equal pairs share a cached combination
    tick: float = 0.002
    # Resolution of the steps between starts
    step_tick: float = 5e-4
    # Margin of combined frames around the array, as a fraction of the side, and the minimum in px: room for motion
    window_margin: float = 0.5
    min_window_margin_px: float = 8.0


class AsynchronousPairing:
    """Pairs of a camera of any timing, by the light clock."""

    def __init__(
        self,
        start_s: float,
        time_s: float,
        pose: Pose,
        identity: int,
        led_gains: NDArray[np.float64],
        signal: SignalSettings,
        exposure_s: float | None,
        drift: tuple[float, float] = (0.0, 0.0),
        parameters: PairingParameters = PairingParameters(),
    ):
        self._parameters, self._clock_parameters = parameters, LightClockParameters()
        self.lost = False
        self.first_gain: float | None = None
        self._start_s, self._time_s, self._pose, self._drift = start_s, time_s, pose, drift
        self._identity = identity
        self._led_gains, self._signal, self._exposure_s = led_gains, signal, exposure_s
        self._late_s = sum_late_s(signal)
        self._light = SlotLight(signal.slot_order)
        self._signs = header_levels(identity, signal.side) / 2.0 - 1.0
        self._header = 2 * signal.header_pairs
        self._frames: deque[Frame] = deque()
        self._clock: LightClock | None = None
        self._next = 0

    @property
    def now_s(self) -> float:
        """Time in seconds of the last complete pair."""
        if self._clock is None or not self._next:
            return self._time_s
        return self._clock.time_s(2 * self._next - 1)

    @property
    def origin_s(self) -> float:
        """Start in seconds of pair 0, extrapolated from the last pair with the nominal period."""
        if self._clock is None or not self._next:
            return self._start_s
        place = 2 * (self._next - 1)
        return self._clock.time_s(place) - place * self._signal.pattern_period_s

    @property
    def exposure_range(self) -> tuple[float, float] | None:
        """95 % interval of the exposure in T_b; None before the first header."""
        return None if self._clock is None else self._clock.exposure_range

    def push(self, frame: Frame) -> Iterator[int]:
        """Add the next frame; yield the numbers of the complete pairs."""
        self._frames.append(frame)
        if self._clock is None:
            awaited = self._header + PATTERNS_AROUND + 1
            if frame.time_s < self._start_s + awaited * self._signal.pattern_period_s:
                return
            self._clock = self._start_clock()
        yield from self._due_pairs(self._clock, self._clock.pattern_at(frame.time_s) - self._parameters.margin)

    def flush(self) -> Iterator[int]:
        """Yield the numbers of the last pairs at the end of the film."""
        if self._clock is None and len(self._frames) > self._header:
            self._clock = self._start_clock()
        if self._clock is not None and self._frames:
            end = self._clock.pattern_at(self._frames[-1].time_s) + self._clock.exposure
            yield from self._due_pairs(self._clock, end)

    def measure_header(
        self, pair: int, poses: Mapping[int, PoseAt], pose_at: PoseAt, led_gains: NDArray[np.float64]
    ) -> MeasuredHeader | None:
        """Correct the clock by the header before a pair; return the header of an asynchronous camera."""
        clock, pattern = self._started_clock, 2 * pair - self._header
        near = self._frames_between(clock, pattern - PATTERNS_AROUND, pattern + self._header + PATTERNS_AROUND)
        if not poses or len(near) <= self._header:
            return None
        known, pairs = np.array(sorted(poses)), 0.5 * (_starts(clock, near) - 0.5)
        nearest = known[np.abs(known - pairs[:, None]).argmin(1)].tolist()
        predicted = [poses[k](frame.time_s) for k, frame in zip(nearest, near, strict=True)]
        is_measured = clock.measure(self._amplitudes(near, predicted, led_gains), pattern, again=pattern == 0)
        if not is_measured or self._is_synchronous(clock, self._combination(clock, near, pattern)):
            return None
        inside, combination = self._header_combination(clock, pattern, (0, self._header))
        middle = pose_at(clock.time_s(pattern + self._header / 2))
        window = self._window(inside, middle) if combination else None
        if combination is None or window is None:
            return MeasuredHeader(clock.gain)
        combined = self._combine(clock, pattern, combination, inside, window)
        starts = _starts(clock, inside) - pattern
        amplitudes, lights = zip(clock.predict_header(starts, 0.0), clock.predict_header(starts, 1.0), strict=True)
        images = _cut(inside, window)
        frames = HeaderFrames(images, (window[0], window[1]), middle, np.stack(amplitudes), np.stack(lights))
        return MeasuredHeader(clock.gain, combined, frames)

    def get_pair(self, number: int, pose_at: PoseAt, single: bool) -> FramePair | UnpairedFrame | None:
        """Return the frames of a pair, combined unless synchronous, or the remaining frame of a data pair."""
        clock, place = self._started_clock, 2 * number
        in_packet, data = number % (self._signal.packet_patterns // 2), is_data(number, self._signal)
        unpaired = self._unpaired(clock, place) if data and not single else None
        if unpaired is not None:
            return unpaired
        near = self._frames_between(clock, place - self._parameters.margin, place + 2 + self._parameters.margin)
        combination = self._combination(clock, near, place)
        is_synchronous = self._is_synchronous(clock, combination)
        if single and data:
            # data without inverses need two frames, combined or not
            is_synchronous |= combination is not None and bool(np.isfinite(combination.departure))
        first = place if data else place - 2 * in_packet
        if not data and not is_synchronous:
            near, combination = self._header_combination(clock, first, (2 * in_packet, 2 * in_packet + 2))
        if combination is None:
            return None
        frames = [near[k] for k in combination.frames]
        if is_synchronous:
            return FramePair(frames[0], frames[1], self._late_s if data else 0.0)
        window = self._window(frames, pose_at(clock.time_s(place + 1)))
        return self._combine(clock, first, combination, frames, window) if window else None

    def _unpaired(self, clock: LightClock, place: int) -> UnpairedFrame | None:
        """Return the only frame of a pair that begins with a pattern, if synchronous; else None."""
        inside = self._frames_between(clock, place - 0.5, place + 1.5)
        if len(inside) != 1:
            return None
        start = self._rounded(clock.pattern_at(inside[0].time_s) - place)
        inverted = start > 0.5
        # test the combination with a frame in place of the missing frame
        starts = (start - 1, start) if inverted else (start, start + 1)
        combination = _pair_combination(starts, self._rounded_exposure(clock), self._light)
        is_synchronous = self._is_synchronous(clock, combination)
        return UnpairedFrame(inside[0], inverted, self._late_s) if is_synchronous else None

    @property
    def _started_clock(self) -> LightClock:
        assert self._clock is not None  # pairs are due only after the start
        return self._clock

    def _start_clock(self) -> LightClock:
        """Start the clock with the header of the detection."""
        frames, light_s, start_s = list(self._frames), self._signal.pattern_period_s, self._start_s
        period = frame_period(np.diff([f.time_s for f in frames]))
        clock = LightClock(start_s, period, self._signal, self._identity, self._exposure_s, self._clock_parameters)
        end = start_s + (self._header + PATTERNS_AROUND) * light_s
        near = [f for f in frames if start_s - PATTERNS_AROUND * light_s <= f.time_s <= end]
        if len(near) < self._header:
            # the header began before the film
            self.lost = True
            return clock
        delays = [frame.time_s - self._time_s for frame in near]
        poses = [self._pose.moved(dt * self._drift[0], dt * self._drift[1]) for dt in delays]
        clock.measure(self._amplitudes(near, poses, self._led_gains), 0)
        self.lost = clock.explained < self._clock_parameters.min_explained
        if not self._is_synchronous(clock, self._combination(clock, near, 0)):
            # the detection assumed a synchronous camera and so measured too weak a header
            self.first_gain = clock.gain
        return clock

    def _due_pairs(self, clock: LightClock, end: float) -> Iterator[int]:
        """Yield the numbers of the pairs that end before a pattern."""
        while not self.lost and 2 * (self._next + 1) <= end + self._parameters.tolerance:
            pair = self._next
            self._next += 1
            yield pair
            self._forget(clock.time_s(2 * pair - self._header - 2 * PATTERNS_AROUND))

    def _combination(self, clock: LightClock, frames: list[Frame], pattern: int) -> Combination | None:
        """Combine frames to the pair that begins with a pattern."""
        starts = clock.patterns_at([f.time_s for f in frames])
        if not starts:
            return None
        # round the first start and the steps: starts rounded separately would differ from pair to pair
        first, tick = self._rounded(starts[0] - pattern), self._parameters.step_tick
        rounded = tuple(first + round((start - starts[0]) / tick) * tick for start in starts)
        return _pair_combination(rounded, self._rounded_exposure(clock), self._light)

    def _rounded(self, patterns: float) -> float:
        """Round a time in patterns to the nearest tick."""
        return round(patterns / self._parameters.tick) * self._parameters.tick

    def _rounded_exposure(self, clock: LightClock) -> float:
        """Round the exposure of a clock to the nearest positive tick."""
        return self._rounded(max(clock.exposure, self._parameters.tick))

    def _is_synchronous(self, clock: LightClock, combination: Combination | None) -> bool:
        """Return True if two frames show pattern and inverse, within the error of the clock."""
        limit = self._parameters.max_departure + self._parameters.departure_deviations * clock.deviation
        return combination is not None and combination.departure < limit

    def _amplitudes(self, frames: list[Frame], poses: list[Pose], led_gains: NDArray[np.float64]) -> HeaderAmplitudes:
        """Measure the header amplitudes of frames."""
        return measure_amplitudes(frames, poses, self._signs * led_gains, self._clock_parameters)

    def _header_combination(
        self, clock: LightClock, first: int, part: tuple[int, int]
    ) -> tuple[list[Frame], Combination | None]:
        """Combine the frames within a part of the header that starts with pattern `first`."""
        overhang = self._parameters.overhang
        low, high = max(part[0] - 1 + overhang, -overhang), min(part[1], self._header + overhang)
        near = self._frames_between(clock, first + low, first + high)
        starts = _starts(clock, near) - first
        within = starts + clock.exposure <= self._header + overhang
        within &= (starts + clock.exposure > part[0] + overhang) & (starts < part[1] - overhang)
        near = [f for f, is_within in zip(near, within, strict=True) if is_within]
        starts = starts[within]
        amplitudes, _ = clock.predict_header(starts, 0.0)
        return near, combine_header(starts, clock.exposure, amplitudes, clock.predict_header(starts, 1.0))

    def _frames_between(self, clock: LightClock, first: float, last: float) -> list[Frame]:
        """Return the frames that start between two patterns."""
        low, high = clock.time_s(first), clock.time_s(last)
        return [f for f in self._frames if low <= f.time_s <= high]

    def _window(self, frames: list[Frame], pose: Pose) -> tuple[int, int, int, int] | None:
        """Return the part of the sensor around the array that all frames share: left, top, right, low."""
        side = self._signal.side
        x, y, width, height = window_around(
            pose, side, max(self._parameters.min_window_margin_px, self._parameters.window_margin * side * pose.pitch)
        )
        left, top = max(x, *(f.origin[0] for f in frames)), max(y, *(f.origin[1] for f in frames))
        right = min(x + width, *(f.origin[0] + f.pixels.shape[1] for f in frames))
        low = min(y + height, *(f.origin[1] + f.pixels.shape[0] for f in frames))
        return (left, top, right, low) if right > left and low > top else None

    def _combine(
        self,
        clock: LightClock,
        place: int,
        combination: Combination,
        frames: list[Frame],
        window: tuple[int, int, int, int],
    ) -> FramePair:
        """Combine frames to pattern and inverse; the times of the combination count from pattern `place`."""
        weights = np.stack([combination.total + combination.difference, combination.total - combination.difference]) / 2
        first, second = np.tensordot(weights, _cut(frames, window), 1).astype(np.float32)
        # the time of a frame is half a pattern before the middle of the light
        time_s, corner = clock.time_s(place + combination.sum_time - 0.5), (window[0], window[1])
        full = frames[0].full_scale
        return FramePair(
            CombinedFrame(frames[0].index, time_s, first, corner, full),
            CombinedFrame(frames[-1].index, time_s, second, corner, full),
            combination=combination,
        )

    def _forget(self, time_s: float) -> None:
        """Drop frames older than a time."""
        while self._frames and self._frames[0].time_s < time_s:
            self._frames.popleft()


@lru_cache(maxsize=64)  # the pairs of a packet have few different timings
def _pair_combination(starts: tuple[float, ...], exposure: float, light: SlotLight) -> Combination | None:
    """Call `combine_pair` with rounded starts and exposures."""
    return combine_pair(np.array(starts), exposure, light)


def _cut(frames: list[Frame], window: tuple[int, int, int, int]) -> NDArray[np.float32]:
    """Cut a window out of frames, (frames, rows, columns)."""
    left, top, right, low = window
    return np.stack(
        [f.pixels[top - f.origin[1] : low - f.origin[1], left - f.origin[0] : right - f.origin[0]] for f in frames]
    ).astype(np.float32)


def _starts(clock: LightClock, frames: list[Frame]) -> NDArray[np.float64]:
    """Return the starts of exposures in patterns."""
    return np.array(clock.patterns_at([f.time_s for f in frames]))


Pairing = SynchronousPairing | AsynchronousPairing
"""Pairing of the frames of an array."""
