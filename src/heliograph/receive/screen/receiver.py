"""Receiver "screen": locates the array of a screen, tracks the array and decodes the packets row by row."""

from collections import deque
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.base.frames import Frame
from heliograph.base.threads import in_one_thread
from heliograph.receive import events
from heliograph.receive.detect.detection import Detection
from heliograph.receive.geometry.fit import Fit
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.geometry.window import crop, window_around
from heliograph.receive.packet import Packet
from heliograph.receive.screen.cells import PARAMETERS, CellTracker, Sample, SearchBudget, fit_samples
from heliograph.receive.screen.locate import ArraySearch
from heliograph.receive.screen.packets import PacketAssembler, ScreenHeader
from heliograph.receive.settings import ReceiveSettings, check_pairs
from heliograph.receive.sync.frame_clock import check_next, check_order, owned
from heliograph.receive.track.kalman import MotionModel, PoseState
from heliograph.receive.track.track import Track, TrackedPair
from heliograph.signal.settings import SignalSettings


class EventEmitter:
    """Emits the events of a tracked array."""

    def __init__(self, signal: SignalSettings, observe: events.Observer):
        self._side, self._observe = signal.side, observe
        # recent frames around the array, and the array in the last of them
        self._windows: deque[tuple[Frame, Pose]] = deque()
        self._fit = Fit(np.zeros(7), np.eye(7), 0.0, 0.0)
        self._last: Frame | None = None
        self._identity: int | None = None
        self._packet_s = -np.inf
        self._next_pair = 0

    def add_frame(self, frame: Frame, sample: Sample | None, assembler: PacketAssembler) -> None:
        """Emit the events of a frame."""
        if sample is not None:
            self._add_window(frame, sample)
        self._last = frame
        if assembler.header is not None and assembler.start_s is not None:
            self.add_header(assembler.header, assembler.start_s)
            self._add_pairs(assembler, assembler.start_s, frame.time_s)
        if self._identity is not None:
            self._add_track(self._identity, frame, sample is not None)

    def add_header(self, header: ScreenHeader, start_s: float) -> None:
        """Emit the detection of an array with a new identity."""
        if header.identity == self._identity or not self._windows or self._last is None:
            return
        self.end_array(self._last.time_s)
        at_s, ones = self._windows[-1][0].time_s, np.ones((self._side,) * 2)
        fit = replace(self._fit, covariance=np.eye(7), score=header.score)
        detection = Detection(header.identity, start_s, fit, at_s, header.score, 1.0, ones, header.orientation)
        self._observe(events.DetectEvent(detection, (self._last,)))
        self._identity = header.identity

    def end_array(self, time_s: float) -> None:
        """Emit the loss of a detected array."""
        if self._identity is not None:
            self._observe(events.LostEvent(self._identity, time_s))
        self._identity = None

    def _add_window(self, frame: Frame, sample: Sample) -> None:
        """Keep the part of a frame around the array; places count from the first pixel."""
        pose = sample.place.pose(self._side)
        window = window_around(pose, self._side, 0.25 * self._side * pose.pitch)
        self._windows.append((crop(replace(frame, origin=(0, 0)), window).copied(), pose))
        # data are half white on average
        gain = 2 * sample.mean_light * frame.full_scale
        self._fit = Fit(pose.full_vector(), np.zeros((7, 7)), gain, 1 - sample.misfit)
        # a pair of 1 pattern/s lasts 2 s
        while self._windows[0][0].time_s < frame.time_s - 2.5:
            self._windows.popleft()

    def _add_track(self, identity: int, frame: Frame, seen: bool) -> None:
        """Emit the last pose of the array."""
        fit, at_s, ones = self._fit, self._windows[-1][0].time_s, np.ones((self._side,) * 2)
        state = PoseState.start(at_s, fit.vector, fit.covariance, MotionModel(1.0, 0.0))
        track = Track(state, fit.gain, fit.gain, ones, at_s, ones, fit.score)
        self._observe(events.TrackEvent(identity, frame.index, TrackedPair(track, track, fit, seen)))

    def _add_pairs(self, assembler: PacketAssembler, start_s: float, now_s: float) -> None:
        """Emit the completed data pairs."""
        assert self._identity is not None
        if start_s != self._packet_s:
            self._packet_s, self._next_pair = start_s, 0
        while (times_s := assembler.pair_times_s(self._next_pair)) is not None:
            half_s = (times_s[1] - times_s[0]) / 2
            if now_s < times_s[1] + half_s:
                return
            pattern, inverse = (min(self._windows, key=lambda window: abs(window[0].time_s - at)) for at in times_s)
            # frames from before the detection may be missing
            if max(abs(pattern[0].time_s - times_s[0]), abs(inverse[0].time_s - times_s[1])) < half_s:
                frames, poses = (pattern[0], inverse[0]), (pattern[1], inverse[1])
                self._observe(events.ExtractEvent(self._identity, frames, poses, number=self._next_pair))
            self._next_pair += 1


class ScreenReceiver:
    """Receiver of one screen array; see `packets.Receiver`."""

    def __init__(self, signal: SignalSettings, settings: ReceiveSettings, observe: events.Observer):
        check_pairs(signal, "screen")
        self._signal, self._settings, self._observe = signal, settings, observe
        # fits of more cells cost more, and headers below 10 patterns/s take longer
        work = max(1.0, fit_samples(signal.side) / fit_samples(16))
        first_s = work * max(1.0, 10 * signal.pattern_period_s)
        self._budget = SearchBudget(0.2 * work, first_s, debt_s=0.5 * first_s)
        self._search = ArraySearch(signal.side, settings.screen.gamma, self._budget)
        self._emitter = EventEmitter(signal, observe)
        self._last: Frame | None = None
        # tracker and assembler of the array
        self._array: tuple[CellTracker, PacketAssembler] | None = None
        self._unseen_since: float | None = None
        self._periods: deque[float] = deque(maxlen=64)

    @in_one_thread
    def finish(self) -> Iterator[Packet]:
        """End the film: yield the packet in progress if most of the packet was visible."""
        if self._array is None and (acquired := self._search.find()) is not None:
            yield from self._start_array(*acquired)
        if self._array is None and self._last is not None:
            self._emit_unseen(self._last.time_s, 0.0)
        yield from self._end_array()

    @in_one_thread
    def push(self, frame: Frame) -> Iterator[Packet]:
        """Add the next frame; yield the completed packets; see `Receiver`."""
        check_next(frame, self._last)
        last = self._last
        if last is None:
            self._unseen_since = frame.time_s
        else:
            # skip repeated frames
            if np.array_equal(frame.pixels, last.pixels):
                return
            check_order(frame, last)
            gap_s = frame.time_s - last.time_s
            self._budget.earn(gap_s)
            self._periods.append(gap_s / max(frame.index - last.index, 1))
            if gap_s > max(PARAMETERS.max_lost_s, 0.5 * self._signal.packet_s):
                yield from self._end_array()
        # frames are kept, but the caller may reuse the pixels
        self._last = frame = owned(frame)
        if self._array is not None:
            yield from self._track(frame, *self._array)
        if self._array is None and (acquired := self._search.push(frame)) is not None:
            yield from self._start_array(*acquired)
        self._emit_unseen(frame.time_s, max(5.0, 15 * self._signal.pattern_period_s))

    def _emit_unseen(self, time_s: float, min_s: float) -> None:
        """Emit once the absence of a screen since the start of the film."""
        if self._array is not None and self._array[1].clock is not None:
            self._unseen_since = None
        if self._unseen_since is not None and time_s - self._unseen_since >= min_s:
            self._observe(events.UnseenEvent(time_s - self._unseen_since))
            self._unseen_since = None

    def _start_array(self, tracker: CellTracker, tracked: list[tuple[Frame, Sample | None]]) -> Iterator[Packet]:
        """Start an acquired array, and decode the frames so far."""
        self._search.forget()
        frame_s, shape = float(np.median(self._periods)), tracked[-1][0].pixels.shape
        assembler = PacketAssembler(self._signal, self._settings, frame_s, shape, self._budget)
        self._array = tracker, assembler
        for frame, sample in tracked:
            yield from self._decode(frame, sample, assembler)

    def _track(self, frame: Frame, tracker: CellTracker, assembler: PacketAssembler) -> Iterator[Packet]:
        """Track the array into the next frame, and decode the completed packets."""
        sample = tracker.track(frame)
        yield from self._decode(frame, sample, assembler)
        lost_since = tracker.lost_since
        if sample is None and lost_since is not None and frame.time_s - lost_since > PARAMETERS.max_lost_s:
            yield from self._end_array()
        elif assembler.header is not None:
            self._budget.fill()
        elif self._budget.is_overdrawn:
            yield from self._end_array()

    def _decode(self, frame: Frame, sample: Sample | None, assembler: PacketAssembler) -> Iterator[Packet]:
        """Decode the packets completed by a frame."""
        self._emitter.add_frame(frame, sample, assembler)
        if sample is not None:
            yield from self._observed(assembler, assembler.push(sample))

    def _end_array(self) -> Iterator[Packet]:
        """End the array with the packet in progress."""
        if self._array is not None:
            yield from self._observed(self._array[1], self._array[1].finish())
        if self._last is not None:
            self._emitter.end_array(self._last.time_s)
        self._array = None
        self._search.forget()

    def _observed(self, assembler: PacketAssembler, packets: Iterator[tuple[Packet, Floats]]) -> Iterator[Packet]:
        """Emit the events of decoded packets."""
        for packet, change in packets:
            assert assembler.header is not None
            self._emitter.add_header(assembler.header, packet.start_time_s)
            self._observe(events.DecodeEvent(packet.identity, packet, luminances=change))
            yield packet
