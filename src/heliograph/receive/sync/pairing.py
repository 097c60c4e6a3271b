"""Frames of one array paired: which of them show a pattern and its inverse.

A camera in step takes a pattern and its inverse one by one. Any other camera needs the light's clock, and frames
combined. Either way an array's receiver gets pairs by number, counted from the header by which the array was found.

Pairs of a camera in step: one frame per pattern, nothing to combine.

Pairs of a camera of any timing: its frames combined by the light's own clock.
"""

from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.geometry.window import window_around
from heliograph.receive.sync.combine import EXACT, Combination, SlotLight, combine_header, combine_pair
from heliograph.receive.sync.frame_clock import frame_period
from heliograph.receive.sync.light_clock import EXPLAINED, PATTERNS_AROUND, LightClock, header_amplitudes
from heliograph.signal.header import header_levels
from heliograph.signal.pwm import light_centroids
from heliograph.signal.settings import SignalSettings

PoseAt = Callable[[float], Pose]
"""The array's pose at a time in seconds, as the tracker predicts it."""


@dataclass(frozen=True, slots=True)
class CombinedFrame:
    """Frames combined to a pattern or to an inverse, about one array."""

    # Number of the first or the last camera frame in it
    index: int
    # Half a pattern before the mean time of its light, as if it were a camera frame
    time_s: float
    # (rows, columns) float32 gray levels
    pixels: NDArray[np.float32]
    # Place (x, y) of the first pixel on the sensor
    origin: tuple[int, int]
    # Largest gray level of the camera
    full_scale: int


AnyFrame = Frame | CombinedFrame


@dataclass(frozen=True, slots=True)
class FramePair:
    """What shows a pattern and its inverse; of data without inverses, two patterns."""

    # First of the two, which shows the pattern
    pattern: AnyFrame
    # Second of the two, which shows the inverse, or the next pattern of data without inverses
    inverted: AnyFrame
    # Seconds by which the mean light of their sum comes after the middle of the exposures
    late_s: float = 0.0
    # How both were combined; None for two camera frames in step
    combination: Combination | None = None

    @property
    def time_s(self) -> float:
        """Time in seconds halfway between the starts of both."""
        return 0.5 * (self.pattern.time_s + self.inverted.time_s)


@dataclass(frozen=True, slots=True)
class UnpairedFrame:
    """The frame that is left of a pair of data in step whose other frame is lost."""

    # The camera's frame, whose time is the start of its exposure
    frame: Frame
    # Whether it shows the inverse
    inverted: bool
    # Seconds by which the mean light of the array comes after the middle of the exposure
    late_s: float


@dataclass(frozen=True, slots=True)
class HeaderFrames:
    """Frames of a header by a camera out of step."""

    # (frames, rows, columns) gray levels about the array
    images: NDArray[np.float32]
    # (x, y) on the sensor of the first pixel
    corner: tuple[int, int]
    # Pose of the array in the middle of the header
    pose: Pose
    # (2, frames) amplitude of the header less its inverse, -1 to 1: of whole cells, and of dimmed ones
    alternation: NDArray[np.float64]
    # (2, frames) mean light of both, 0 to 1
    light: NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class MeasuredHeader:
    """A whole header seen by a camera out of step."""

    # Gray levels of the array with all LEDs on
    gain: float
    # All its frames combined to one pair, whose sum is even; None where they do not show it
    pair: FramePair | None = None
    # The frames themselves, for the format; None as `pair`
    frames: HeaderFrames | None = None


class Pairing(Protocol):
    """Pairs an array's frames; pairs are counted from the header of the detection."""

    # Whether what was found cannot be a header
    lost: bool
    # Gray levels of the array with all LEDs on by the first header, where the detection saw it too weak; else None
    first_gain: float | None

    @property
    def now_s(self) -> float:
        """Time in seconds up to which pairs have been read."""

    @property
    def origin_s(self) -> float:
        """Start in seconds of pair 0 by the last pair read, patterns taken to be T_b long since."""

    @property
    def exposure_range(self) -> tuple[float, float] | None:
        """Exposures in T_b between which headers put it; None where none was measured, or it makes no difference."""

    def push(self, frame: Frame) -> Iterator[int]:
        """Take the next frame; yield the numbers of the pairs that can be read by now."""

    def flush(self) -> Iterator[int]:
        """Yield the numbers of the pairs that can still be read, as there will be no more frames."""

    def header(
        self, pair: int, poses: Mapping[int, PoseAt], pose_at: PoseAt, led_gains: NDArray[np.float64]
    ) -> MeasuredHeader | None:
        """Correct the clock by the header before a pair."""

    def pair(self, number: int, pose_at: PoseAt, single: bool) -> FramePair | UnpairedFrame | None:
        """Frames of a pair."""


def is_data(number: int, signal: SignalSettings) -> bool:
    """Whether a pair holds data."""
    return number % (signal.packet_patterns // 2) >= signal.header_pairs


def sum_late_s(signal: SignalSettings) -> float:
    """Seconds by which the mean light of a data pair's sum comes after the middle of the exposures.

    PWM lights the first slots of a pattern more than the last.
    """
    mean, _ = light_centroids(signal.slot_order)
    return (mean - 0.5) * signal.pattern_period_s


class SynchronousPairing:
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

    def pair(self, number: int, pose_at: PoseAt, single: bool) -> FramePair | UnpairedFrame | None:  # noqa: ARG002 - the protocol's
        """Give the two frames of a pair, or the one that is there; see `Pairing`."""
        first, second = self._frames.get(2 * number), self._frames.get(2 * number + 1)
        data = is_data(number, self._signal)
        if first is not None and second is not None:
            return FramePair(first, second, self._late_s if data else 0.0)
        left = second if first is None else first
        return UnpairedFrame(left, first is None, self._late_s) if left is not None and data and not single else None


PATTERNS_AFTER = 1.0
"""Patterns after the end of a pair whose frames are awaited: one that straddles the end may start that late."""

PATTERNS_BEFORE = 1.0
"""Patterns before a pair's start whose frames are used, for the same reason."""

EARLY = 0.02
"""Patterns by which a pair may be read before all awaited frames have come: stamps are inexact by as much."""

OVERHANG = 0.04
"""T_b by which an exposure may exceed the header and still count as within it: that much of its light is wrong."""

STEP_DEVIATIONS = 1.5
"""Standard deviations of the clock by which frames may depart from pattern and inverse and still count as in step.

Of a camera in step 87 % of the clock's normal errors are smaller.
"""

NEAREST_PATTERNS = 0.5
"""Patterns by which a frame may start early or late and still be nearest to a pattern: frames are a pattern apart."""

TICK, STEP_TICK = 0.002, 5e-4
"""Ticks in patterns to which a pair's first start and exposure, and the steps between starts, are rounded.

Pairs that are alike then are combined alike. The clock is exact to 0.004 at best, and an even camera's steps are the
same but for its rate, 1e-5 or so.
"""

COMBINED_MARGIN, COMBINED_MARGIN_PX = 0.5, 8.0
"""Margin of combined frames about the array, as a fraction of its side, and at least in px: room for the tracker.

The fit of a sum takes 1.5 pitches and 1.5 px (`tracker`). At a pitch of 1 px that leaves 5 of the 8 px for motion:
hard shake moves that far in five patterns (`START_RATES`). Half and twice of it lose none of 192 codewords.
"""


class AsynchronousPairing:
    """Pairs of a camera of any timing, by the light's own clock."""

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
    ):
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
        """See `Pairing`."""
        if self._clock is None or not self._next:
            return self._time_s
        return self._clock.time_s(2 * self._next - 1)

    @property
    def origin_s(self) -> float:
        """See `Pairing`."""
        if self._clock is None or not self._next:
            return self._start_s
        place = 2 * (self._next - 1)
        return self._clock.time_s(place) - place * self._signal.pattern_period_s

    @property
    def exposure_range(self) -> tuple[float, float] | None:
        """See `Pairing`."""
        return None if self._clock is None else self._clock.exposure_range

    def push(self, frame: Frame) -> Iterator[int]:
        """Take the next frame; yield the numbers of the pairs that can be read by now; see `Pairing`."""
        self._frames.append(frame)
        if self._clock is None:
            awaited = self._header + PATTERNS_AROUND + 1
            if frame.time_s < self._start_s + awaited * self._signal.pattern_period_s:
                return
            self._clock = self._begin()
        yield from self._due(self._clock, self._clock.pattern_at(frame.time_s) - PATTERNS_AFTER)

    def flush(self) -> Iterator[int]:
        """Yield the numbers of the pairs that can still be read, as there will be no more frames."""
        if self._clock is None and len(self._frames) > self._header:
            self._clock = self._begin()
        if self._clock is not None and self._frames:
            end = self._clock.pattern_at(self._frames[-1].time_s) + self._clock.exposure
            yield from self._due(self._clock, end)

    def header(
        self, pair: int, poses: Mapping[int, PoseAt], pose_at: PoseAt, led_gains: NDArray[np.float64]
    ) -> MeasuredHeader | None:
        """Correct the clock by the header before a pair; see `Pairing`."""
        clock, pattern = self._started, 2 * pair - self._header
        near = self._frames_of(clock, pattern - PATTERNS_AROUND, pattern + self._header + PATTERNS_AROUND)
        if not poses or len(near) <= self._header:
            return None
        known = np.array(sorted(poses))
        pairs = 0.5 * (_starts(clock, near) - 0.5)
        there = [
            poses[int(known[np.argmin(np.abs(known - k))])](frame.time_s) for k, frame in zip(pairs, near, strict=True)
        ]
        seen = clock.measure(header_amplitudes(near, there, self._signs * led_gains), pattern, again=pattern == 0)
        if not seen or _in_step(clock, self._combination(clock, near, pattern)):
            return None
        inside, combination = self._header_combination(clock, pattern, (0, self._header))
        middle = pose_at(clock.time_s(pattern + self._header / 2))
        window = self._window(inside, middle) if combination else None
        if combination is None or window is None:
            return MeasuredHeader(clock.gain)
        pair_seen = self._combined(clock, pattern, combination, inside, window)
        return MeasuredHeader(clock.gain, pair_seen, self._header_frames(clock, pattern, inside, window, middle))

    def pair(self, number: int, pose_at: PoseAt, single: bool) -> FramePair | UnpairedFrame | None:
        """Give the frames of a pair, combined where they are not in step; see `Pairing`."""
        clock, place = self._started, 2 * number
        in_packet, data = number % (self._signal.packet_patterns // 2), is_data(number, self._signal)
        lone = self._lone(clock, place) if data and not single else None
        if lone is not None:
            return lone
        near = self._frames_of(clock, place - PATTERNS_BEFORE, place + 2 + PATTERNS_AFTER)
        combination = self._combination(clock, near, place)
        stepped = _in_step(clock, combination)
        if single and data:
            # data without inverses are read frame by frame or not at all
            stepped |= combination is not None and bool(np.isfinite(combination.departure))
        first = place if data else place - 2 * in_packet
        if not data and not stepped:
            near, combination = self._header_combination(clock, first, (2 * in_packet, 2 * in_packet + 2))
        if combination is None:
            return None
        frames = [near[k] for k in combination.frames]
        if stepped:
            return FramePair(frames[0], frames[1], self._late_s if data else 0.0)
        window = self._window(frames, pose_at(clock.time_s(place + 1)))
        return self._combined(clock, first, combination, frames, window) if window else None

    def _lone(self, clock: LightClock, place: int) -> UnpairedFrame | None:
        """The only frame of the pair that begins with a pattern, if it is in step; else None."""
        inside = self._frames_of(clock, place - NEAREST_PATTERNS, place + 1 + NEAREST_PATTERNS)
        if len(inside) != 1:
            return None
        start = _rounded(clock.pattern_at(inside[0].time_s) - place)
        inverted = start > NEAREST_PATTERNS
        # in step it would be with its other half in its place
        two = (start - 1, start) if inverted else (start, start + 1)
        combination = _pair_combination(two, _rounded(max(clock.exposure, TICK)), self._light)
        return UnpairedFrame(inside[0], inverted, self._late_s) if _in_step(clock, combination) else None

    @property
    def _started(self) -> LightClock:
        assert self._clock is not None  # no pair is due before
        return self._clock

    def _begin(self) -> LightClock:
        """The clock by the header of the detection."""
        frames, light_s, start_s = list(self._frames), self._signal.pattern_period_s, self._start_s
        period = frame_period(np.diff([f.time_s for f in frames]))
        clock = LightClock(start_s, period, self._signal, self._identity, self._exposure_s)
        end = start_s + (self._header + PATTERNS_AROUND) * light_s
        near = [f for f in frames if start_s - PATTERNS_AROUND * light_s <= f.time_s <= end]
        if len(near) < self._header:
            # the header would have begun before the film
            self.lost = True
            return clock
        there = [_moved(self._pose, self._drift, frame.time_s - self._time_s) for frame in near]
        clock.measure(header_amplitudes(near, there, self._signs * self._led_gains), 0)
        self.lost = clock.explained < EXPLAINED
        if not _in_step(clock, self._combination(clock, near, 0)):
            # the detection took frames to be in step, and so the header for weaker than it is
            self.first_gain = clock.gain
        return clock

    def _due(self, clock: LightClock, end: float) -> Iterator[int]:
        """Numbers of the pairs that end before a pattern."""
        while not self.lost and 2 * (self._next + 1) <= end + EARLY:
            pair = self._next
            self._next += 1
            yield pair
            self._forget(clock.time_s(2 * pair - self._header - 2 * PATTERNS_AROUND))

    def _combination(self, clock: LightClock, frames: list[Frame], pattern: int) -> Combination | None:
        """How frames combine for the pair that begins with a pattern."""
        starts = clock.patterns_at([f.time_s for f in frames])
        if not starts:
            return None
        # by the first and the steps from it: rounded one by one, those of an even camera would differ from pair to pair
        first = _rounded(starts[0] - pattern)
        rounded = tuple(first + _rounded(start - starts[0], STEP_TICK) for start in starts)
        return _pair_combination(rounded, _rounded(max(clock.exposure, TICK)), self._light)

    def _header_combination(
        self, clock: LightClock, first: int, part: tuple[int, int]
    ) -> tuple[list[Frame], Combination | None]:
        """Frames within a part of the header that starts with pattern `first`, and how they combine."""
        low, high = max(part[0] - 1 + OVERHANG, -OVERHANG), min(part[1], self._header + OVERHANG)
        near = self._frames_of(clock, first + low, first + high)
        starts = _starts(clock, near) - first
        within = starts + clock.exposure <= self._header + OVERHANG
        within &= (starts + clock.exposure > part[0] + OVERHANG) & (starts < part[1] - OVERHANG)
        near = [f for f, yes in zip(near, within, strict=True) if yes]
        starts = starts[within]
        shown, _ = clock.header(starts, 0.0)
        return near, combine_header(starts, clock.exposure, shown, clock.header(starts, 1.0))

    def _header_frames(
        self, clock: LightClock, pattern: int, frames: list[Frame], window: tuple[int, int, int, int], pose: Pose
    ) -> HeaderFrames:
        """Frames of the header that began with a pattern, and what they show of whole and of dimmed cells."""
        starts = _starts(clock, frames) - pattern
        (whole, even), (dimmed, uneven) = clock.header(starts, 0.0), clock.header(starts, 1.0)
        return HeaderFrames(
            _cut(frames, window), (window[0], window[1]), pose, np.stack([whole, dimmed]), np.stack([even, uneven])
        )

    def _frames_of(self, clock: LightClock, first: float, last: float) -> list[Frame]:
        """Frames that start between two patterns."""
        low, high = clock.time_s(first), clock.time_s(last)
        return [f for f in self._frames if low <= f.time_s <= high]

    def _window(self, frames: list[Frame], pose: Pose) -> tuple[int, int, int, int] | None:
        """Part of the sensor around the array that all frames have: left, top, and the right and lower end."""
        side = self._signal.side
        x, y, width, height = window_around(pose, side, max(COMBINED_MARGIN_PX, COMBINED_MARGIN * side * pose.pitch))
        left, top = max(x, *(f.origin[0] for f in frames)), max(y, *(f.origin[1] for f in frames))
        right = min(x + width, *(f.origin[0] + f.pixels.shape[1] for f in frames))
        low = min(y + height, *(f.origin[1] + f.pixels.shape[0] for f in frames))
        return (left, top, right, low) if right > left and low > top else None

    def _combined(
        self,
        clock: LightClock,
        place: int,
        combination: Combination,
        frames: list[Frame],
        window: tuple[int, int, int, int],
    ) -> FramePair:
        """Combined pattern and inverse: their sum is all LEDs on, their difference data. Times count from `place`."""
        weights = np.stack([combination.total + combination.difference, combination.total - combination.difference]) / 2
        first, second = np.tensordot(weights, _cut(frames, window), 1).astype(np.float32)
        # a frame's time is the start of its exposure, half a pattern before the middle of its light
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


def _rounded(patterns: float, tick: float = TICK) -> float:
    """A time in patterns, to the nearest tick."""
    return round(patterns / tick) * tick


@lru_cache(maxsize=64)  # in step, and at rates that repeat, the pairs of a packet are combined alike
def _pair_combination(starts: tuple[float, ...], exposure: float, light: SlotLight) -> Combination | None:
    """`combine_pair` for rounded starts and exposures."""
    return combine_pair(np.array(starts), exposure, light)


def _in_step(clock: LightClock, combination: Combination | None) -> bool:
    """Whether frames show a pair's pattern and inverse one by one, as far as the clock can tell."""
    return combination is not None and combination.departure < EXACT + STEP_DEVIATIONS * clock.deviation


def _moved(pose: Pose, drift: tuple[float, float], dt: float) -> Pose:
    """A pose some seconds later, at a motion in px per second."""
    return pose.moved(dt * drift[0], dt * drift[1])


def _cut(frames: list[Frame], window: tuple[int, int, int, int]) -> NDArray[np.float32]:
    """A window of frames, (frames, rows, columns)."""
    left, top, right, low = window
    return np.stack(
        [f.pixels[top - f.origin[1] : low - f.origin[1], left - f.origin[0] : right - f.origin[0]] for f in frames]
    ).astype(np.float32)


def _starts(clock: LightClock, frames: list[Frame]) -> NDArray[np.float64]:
    """Starts of exposures in patterns."""
    return np.array(clock.patterns_at([f.time_s for f in frames]))
