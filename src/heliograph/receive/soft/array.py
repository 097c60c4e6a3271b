"""One array's reception by a camera that is not in step: virtual pairs of frames by the light's own clock."""

from collections import deque
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.receive.array import ArrayReceiver
from heliograph.receive.detect import Detection
from heliograph.receive.fit import window_around
from heliograph.receive.packets import Observer, Packet
from heliograph.receive.pose import Pose
from heliograph.receive.reading import MakeReading
from heliograph.receive.settings import ReceiveSettings
from heliograph.receive.soft.clock import AROUND, Clock, view_header
from heliograph.receive.soft.mix import Mix, SlotLight, VirtualFrame, mix_pair
from heliograph.receive.soft.reading import SoftReading
from heliograph.signal.packet import PacketFormat
from heliograph.signal.pwm import light_centroids

AHEAD = 1.0
"""Patterns after the end of a pair whose frames are awaited: some hold of the pair still."""

BEHIND = 1.0
"""Patterns before its start whose frames are used."""

LEAST_HEADER = 0.25
"""Share of a header's light in a virtual pair below which it is not read as one."""

MARGIN = 0.5
"""Margin of virtual frames about the array, as a share of its side, and at least `MARGIN_PX`."""

MARGIN_PX = 8.0


class TimedArray(ArrayReceiver):
    """Follows an array by its own clock, which it finds and keeps by the headers; see `ArrayReceiver`."""

    def __init__(
        self,
        detection: Detection,
        form: PacketFormat,
        settings: ReceiveSettings,
        observe: Observer,
        reading: MakeReading,
    ):
        super().__init__(detection, form, settings, observe, reading)
        self._detection = detection
        self._frames: deque[Frame] = deque()
        self._clock: Clock | None = None
        self._light = SlotLight(form.settings.slot_order)
        self._mean_late = light_centroids(form.settings.slot_order)[0]
        self._next = 0
        self._poses: dict[int, Pose] = {}
        self._header = 2 * form.settings.header_pairs

    def push(self, frame: Frame) -> Iterator[Packet]:
        """Take a frame; yield the packet it completes."""
        self._frames.append(frame)
        if self._clock is None:
            awaited = self._header + AROUND + 1
            if frame.time_s < self._start_s + awaited * self._form.settings.pattern_period_s:
                return
            self._clock = self._start()
        yield from self._pairs_before(self._clock, float(self._clock.place(frame.time_s)) - AHEAD)

    def flush(self) -> Iterator[Packet]:
        """Yield the packet in progress if at least half of its data was seen."""
        if self._clock is None and len(self._frames) > self._header:
            self._clock = self._start()
        if self._clock is not None and self._frames:
            end = float(self._clock.place(self._frames[-1].time_s)) + self._clock.exposure
            yield from self._pairs_before(self._clock, end)
        yield from super().flush()

    def _start(self) -> Clock:
        """The clock by the header of the detection."""
        frames, light_s = list(self._frames), self._form.settings.pattern_period_s
        period = (frames[-1].time_s - frames[0].time_s) / (len(frames) - 1)
        clock = Clock(self._start_s, period, self._form.settings, self._settings.calibration.exposure_s)
        end = self._start_s + (self._header + AROUND) * light_s
        near = [f for f in frames if self._start_s - AROUND * light_s <= f.time_s <= end]
        pose = self._detection.fit.pose
        clock.measure(view_header(near, [pose] * len(near), self._header_weights), 0)
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
        """Correct the clock by the header that began with a pattern."""
        first, last = clock.time_s(pattern - AROUND), clock.time_s(pattern + self._header + AROUND)
        near = [f for f in self._frames if first <= f.time_s <= last]
        if len(near) <= self._header:
            return
        known = np.array(sorted(self._poses))
        numbers = [known[np.argmin(np.abs(known - 0.5 * float(clock.place(f.time_s))))] for f in near] if known.size else []
        if not numbers:
            return
        clock.measure(view_header(near, [self._poses[int(k)] for k in numbers], self._header_weights), pattern)

    def _combine(self, clock: Clock, pair: int) -> None:
        """Read a pair's virtual frames, if there are frames of it."""
        place = 2 * pair
        lowest, highest = clock.time_s(place - BEHIND), clock.time_s(place + 2 + AHEAD)
        near = [f for f in self._frames if lowest <= f.time_s <= highest]
        starts = np.asarray(clock.place(np.array([f.time_s for f in near])) - place, np.float64)
        head = self._pair_in_packet(pair) < self._form.settings.header_pairs
        shown = None
        if head:
            shown = clock.alternation(starts + place, place - 2 * self._pair_in_packet(pair))
        mix = mix_pair(starts, clock.exposure, self._light, shown)
        if mix is None or mix.header < LEAST_HEADER:
            return
        frames = [near[k] for k in mix.frames]
        window = self._window(frames, clock.time_s(place + 1))
        if window is None:
            return
        pattern, inverse = frames if mix.in_step else self._virtual(clock, place, mix, frames, window)
        self._read(pattern, inverse)
        self._poses[pair] = self.tracker.state.pose
        reading = self._packet.reading
        if head and isinstance(reading, SoftReading):
            # a header's sum is even light, if nothing of the data around is in it
            others = [q for q in (0, 2) if not 0 <= self._pair_in_packet(pair) + q - 1 < self._form.settings.header_pairs]
            uneven = max(float(np.abs(mix.slots[q]).sum()) for q in others) if others else 0.0
            reading.take_header(pattern, inverse, self.tracker.state, uneven)

    def _window(self, frames: list[Frame], time_s: float) -> tuple[int, int, int, int] | None:
        """Columns and rows around the array that all frames have: first x, first y, last x, last y, less 1."""
        pose, side = self.tracker.state.pose_at(time_s), self._form.settings.side
        margin = max(MARGIN_PX, MARGIN * side * pose.pitch)
        x, y, width, height = window_around(pose, side, margin)
        left, top = max(x, *(f.origin[0] for f in frames)), max(y, *(f.origin[1] for f in frames))
        right = min(x + width, *(f.origin[0] + f.pixels.shape[1] for f in frames))
        low = min(y + height, *(f.origin[1] + f.pixels.shape[0] for f in frames))
        return (left, top, right, low) if right > left and low > top else None

    def _virtual(
        self, clock: Clock, place: int, mix: Mix, frames: list[Frame], window: tuple[int, int, int, int]
    ) -> tuple[Frame, Frame]:
        """The virtual pattern and its inverse, such that their sum is all LEDs on and their difference D."""
        left, top, right, low = window
        cut = np.stack(
            [
                f.pixels[top - f.origin[1] : low - f.origin[1], left - f.origin[0] : right - f.origin[0]]
                for f in frames
            ]
        ).astype(np.float32)
        # P + P' = sum |w| f, P - P' = sum w f, that of a header as strong as in step
        total, change = np.abs(mix.weights), mix.weights / mix.header
        parts = np.tensordot(np.stack([total + change, total - change]) / 2, cut, 1).astype(np.float32)
        numbers = [int(f.index) for f in frames]

        def made(part: NDArray[np.float32], index: int, light: float) -> Frame:
            # a frame's time is the start of its exposure, a known time before its mean light
            time_s = clock.time_s(place + light - self._mean_late)
            return VirtualFrame(index, time_s, part, frames[0].bits, (left, top), mix)  # type: ignore[arg-type]

        return made(parts[0], min(numbers), mix.light[0]), made(parts[1], max(numbers), mix.light[1])

    def _forget(self, time_s: float) -> None:
        """Drop frames and poses older than a time."""
        while self._frames and self._frames[0].time_s < time_s:
            self._frames.popleft()
        oldest = self._next - self._form.settings.header_pairs - AROUND
        self._poses = {k: pose for k, pose in self._poses.items() if k >= oldest}
