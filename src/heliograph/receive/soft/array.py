"""One array's reception by a camera that is not in step: virtual pairs of frames by the light's own clock."""

from collections import deque
from collections.abc import Iterator
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.receive.array import ArrayReceiver
from heliograph.receive.detect import Detection
from heliograph.receive.fit import window_around
from heliograph.receive.packets import Packet
from heliograph.receive.pose import Pose
from heliograph.receive.reading import Reading, Setup
from heliograph.receive.soft.clock import AROUND, EXPLAINED, Clock, view_header
from heliograph.receive.soft.mix import EXACT, Mix, SlotLight, VirtualFrame, mix_header, mix_of, mix_pair
from heliograph.receive.soft.naming import HeaderFrames
from heliograph.receive.soft.reading import SoftReading
from heliograph.signal.header import dimmed_leds, header_levels

AHEAD = 1.0
"""Patterns after the end of a pair whose frames are awaited: some hold of the pair still."""

BEHIND = 1.0
"""Patterns before its start whose frames are used."""

OVERHANG = 0.04
"""Share of T_b by which an exposure may exceed the header and still be taken for one of it."""

DOUBT = 1.5
"""Standard deviations of the clock by which frames may be off and still be taken for those of a camera in step."""

TICKS = 3
"""Decimal places of a frame's start in patterns: its clock is not righter than that."""

MARGIN = 0.5
"""Margin of virtual frames about the array, as a share of its side, and at least `MARGIN_PX`."""

MARGIN_PX = 8.0


class TimedArray(ArrayReceiver):
    """Follows an array by its own clock, which it finds and keeps by the headers; see `ArrayReceiver`."""

    def __init__(self, detection: Detection, setup: Setup, reading: Reading):
        super().__init__(detection, setup, reading)
        signal = setup.form.settings
        self._frames: deque[Frame] = deque()
        self._clock: Clock | None = None
        self._light = SlotLight(signal.slot_order)
        self._next = 0
        self._poses: dict[int, Pose] = {}
        self._header = 2 * signal.header_pairs
        self._signs = header_levels(detection.identity, signal.side) / 2.0 - 1.0

    def push(self, frame: Frame) -> Iterator[Packet]:
        """Take a frame; yield the packet it completes."""
        self._frames.append(frame)
        if self._clock is None:
            awaited = self._header + AROUND + 1
            if frame.time_s < self._start_s + awaited * self._form.settings.pattern_period_s:
                return
            self._clock = self._start()
        if self._failed:
            return
        yield from self._pairs_before(self._clock, float(self._clock.place(frame.time_s)) - AHEAD)

    def flush(self) -> Iterator[Packet]:
        """Yield the packet in progress if at least half of its data was seen."""
        if self._clock is None and len(self._frames) > self._header:
            self._clock = self._start()
        if self._clock is not None and self._frames and not self._failed:
            end = float(self._clock.place(self._frames[-1].time_s)) + self._clock.exposure
            yield from self._pairs_before(self._clock, end)
        yield from super().flush()

    def _start(self) -> Clock:
        """The clock by the header of the detection."""
        frames, light_s = list(self._frames), self._form.settings.pattern_period_s
        # the median passes over frames that were dropped
        period = float(np.median(np.diff([f.time_s for f in frames])))
        exposure_s = self._settings.calibration.exposure_s
        clock = Clock(self._start_s, period, self._form.settings, self.identity, exposure_s)
        end = self._start_s + (self._header + AROUND) * light_s
        near = [f for f in frames if self._start_s - AROUND * light_s <= f.time_s <= end]
        if len(near) <= self._header:
            # the header would have begun before the film
            self._failed = True
            return clock
        pose = self.found.fit.pose
        clock.measure(view_header(near, [pose] * len(near), self._signs * self.tracker.shares), 0)
        self._failed = clock.explained < EXPLAINED
        if not _in_step(clock, self._mix(clock, near, 0)):
            # the detection saw the header as if in step: weaker than it is
            self.tracker.gain = self.tracker.data_gain = clock.gain
        return clock

    def _pairs_before(self, clock: Clock, place: float) -> Iterator[Packet]:
        """Read the pairs that end before a place, in patterns."""
        while 2 * (self._next + 1) <= place + 0.02:
            pair, in_packet = self._next, self._pair_in_packet(self._next)
            self._next += 1
            if in_packet == self._form.settings.header_pairs:
                self._measure(clock, 2 * (pair - in_packet))
            yield from self._advance(pair)
            self._start_s = clock.time_s(2 * pair) - 2 * pair * self._form.settings.pattern_period_s
            self._now_s = clock.time_s(2 * pair + 1)
            self._combine(clock, pair)
            if in_packet == self._pairs - 1 and self._packet.frames:
                yield self._finish()
            self._forget(clock.time_s(2 * pair - self._header - 2 * AROUND))

    def _measure(self, clock: Clock, pattern: int) -> None:
        """Correct the clock by the header that began with a pattern, and take the noise from it."""
        near = self._frames_of(clock, pattern - AROUND, pattern + self._header + AROUND)
        if not self._poses or len(near) <= self._header:
            return
        known = np.array(sorted(self._poses))
        pairs = 0.5 * (_starts(clock, near) - 0.5)
        poses = [self._poses[int(known[np.argmin(np.abs(known - k))])] for k in pairs]
        seen = clock.measure(view_header(near, poses, self._signs * self.tracker.shares), pattern, again=pattern == 0)
        if not seen or _in_step(clock, self._mix(clock, near, pattern)):
            return
        # a sum hardly tells the array's light from that of its panel
        self.tracker.gain = clock.gain
        inside, mix = self._header_mix(clock, pattern, (0, self._header))
        window = self._window(inside, clock.time_s(pattern + self._header / 2)) if mix else None
        reading = self._packet.reading
        if mix is not None and window is not None and isinstance(reading, SoftReading):
            first, second = self._virtual(clock, pattern, mix, inside, window)
            middle = self.tracker.state.pose_at(clock.time_s(pattern + self._header / 2))
            reading.take_even(first, second, middle)
            reading.take_names(self._header_frames(clock, pattern, inside, window, middle))

    def _header_frames(
        self, clock: Clock, pattern: int, frames: list[Frame], window: tuple[int, int, int, int], pose: Pose
    ) -> HeaderFrames:
        """Frames of the header that began with a pattern, and what they show of it."""
        starts = _starts(clock, frames) - pattern
        (full, even), (dimmed, uneven) = clock.header(starts, 0.0), clock.header(starts, 1.0)
        shown, light = np.stack([full, dimmed]), np.stack([even, uneven])
        return HeaderFrames(_cut(frames, window), (window[0], window[1]), pose, shown, light)

    def _combine(self, clock: Clock, pair: int) -> None:
        """Read a pair's virtual frames, if there are frames of it."""
        place, number = 2 * pair, self._pair_in_packet(pair)
        near = self._frames_of(clock, place - BEHIND, place + 2 + AHEAD)
        mix = self._mix(clock, near, place)
        # data without inverses are read frame by frame or not at all
        alone = number >= self._form.settings.header_pairs and self._packet.reading.named.mode == "single"
        stepped = _in_step(clock, mix) or (alone and mix is not None and np.isfinite(mix.departure))
        if number < self._form.settings.header_pairs and not stepped:
            near, mix = self._header_mix(clock, place - 2 * number, (2 * number, 2 * number + 2))
        if mix is None:
            return
        frames = [near[k] for k in mix.frames]
        if stepped:
            self._read(frames[0], frames[1])
        else:
            window = self._window(frames, clock.time_s(place + 1))
            if window is None:
                return
            first = place if number >= self._form.settings.header_pairs else place - 2 * number
            self._read(*self._virtual(clock, first, mix, frames, window))
        self._poses[pair] = self.tracker.state.pose

    def _mix(self, clock: Clock, frames: list[Frame], pattern: int) -> Mix | None:
        """How frames combine for the pair that begins with a pattern."""
        starts = np.round(_starts(clock, frames) - pattern, TICKS)
        return _mix(tuple(starts.tolist()), clock.exposure, self._light)

    def _late_s(self, pattern: Frame) -> float:
        """See `ArrayReceiver`; combined frames have the time of their light."""
        return super()._late_s(pattern) if mix_of(pattern) is None else 0.0

    def _header_weights(self, number: int, pattern: Frame) -> NDArray[np.float64]:
        """See `ArrayReceiver`; combined frames show dimmed cells otherwise than pattern and inverse do."""
        mix = mix_of(pattern)
        if mix is None:
            return super()._header_weights(number, pattern)
        contrast, light = mix.dimmed
        return np.where(dimmed_leds(number, len(self._signs)), contrast * self._signs + light, self._signs)

    def _header_mix(self, clock: Clock, first: int, part: tuple[int, int]) -> tuple[list[Frame], Mix | None]:
        """Frames within the header that starts with pattern `first`, of a part of it, and how they combine."""
        low, high = max(part[0] - 1 + OVERHANG, -OVERHANG), min(part[1], self._header + OVERHANG)
        near = self._frames_of(clock, first + low, first + high)
        starts = _starts(clock, near) - first
        within = starts + clock.exposure <= self._header + OVERHANG
        within &= (starts + clock.exposure > part[0] + OVERHANG) & (starts < part[1] - OVERHANG)
        near = [f for f, yes in zip(near, within, strict=True) if yes]
        starts = starts[within]
        dimmed, light = clock.header(starts, 1.0)
        return near, mix_header(starts, clock.exposure, clock.header(starts, 0.0)[0], (dimmed, light))

    def _frames_of(self, clock: Clock, first: float, last: float) -> list[Frame]:
        """Frames that start between two places, in patterns."""
        low, high = clock.time_s(first), clock.time_s(last)
        return [f for f in self._frames if low <= f.time_s <= high]

    def _window(self, frames: list[Frame], time_s: float) -> tuple[int, int, int, int] | None:
        """Columns and rows around the array that all frames have: first x and y, and those after the last."""
        pose, side = self.tracker.state.pose_at(time_s), self._form.settings.side
        margin = max(MARGIN_PX, MARGIN * side * pose.pitch)
        x, y, width, height = window_around(pose, side, margin)
        left, top = max(x, *(f.origin[0] for f in frames)), max(y, *(f.origin[1] for f in frames))
        right = min(x + width, *(f.origin[0] + f.pixels.shape[1] for f in frames))
        low = min(y + height, *(f.origin[1] + f.pixels.shape[0] for f in frames))
        return (left, top, right, low) if right > left and low > top else None

    def _virtual(
        self, clock: Clock, place: int, mix: Mix, frames: list[Frame], window: tuple[int, int, int, int]
    ) -> tuple[VirtualFrame, VirtualFrame]:
        """The virtual pattern and its inverse, such that their sum is all LEDs on and their difference D.

        `place` is the pattern from which the mix counts.
        """
        cut = _cut(frames, window)
        parts = np.tensordot(np.stack([mix.total + mix.change, mix.total - mix.change]) / 2, cut, 1)
        # a frame's time is the start of its exposure, half a pattern before the middle for which it stands
        time_s, corner = clock.time_s(place + mix.light - 0.5), (window[0], window[1])
        pattern, inverse = (
            VirtualFrame(f.index, time_s, part.astype(np.float32), f.bits, corner, mix)
            for f, part in zip((frames[0], frames[-1]), parts, strict=True)
        )
        return pattern, inverse

    def _forget(self, time_s: float) -> None:
        """Drop frames and poses older than a time."""
        while self._frames and self._frames[0].time_s < time_s:
            self._frames.popleft()
        oldest = self._next - self._form.settings.header_pairs - AROUND
        self._poses = {k: pose for k, pose in self._poses.items() if k >= oldest}


@lru_cache(maxsize=64)  # in step, and at rates that repeat, the pairs of a packet are combined alike
def _mix(starts: tuple[float, ...], exposure: float, light: SlotLight) -> Mix | None:
    """`mix_pair` for starts rounded to `TICKS` places."""
    return mix_pair(np.array(starts), exposure, light)


def _in_step(clock: Clock, mix: Mix | None) -> bool:
    """Whether frames show a pair's pattern and inverse one by one, as far as the clock can tell."""
    return mix is not None and mix.departure < EXACT + DOUBT * clock.deviation


def _cut(frames: list[Frame], window: tuple[int, int, int, int]) -> NDArray[np.float32]:
    """A window of frames, (frames, rows, columns)."""
    left, top, right, low = window
    return np.stack(
        [f.pixels[top - f.origin[1] : low - f.origin[1], left - f.origin[0] : right - f.origin[0]] for f in frames]
    ).astype(np.float32)


def _starts(clock: Clock, frames: list[Frame]) -> NDArray[np.float64]:
    """Starts of exposures in patterns."""
    return np.asarray(clock.place(np.array([f.time_s for f in frames])))
