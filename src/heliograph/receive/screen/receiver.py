"""Receiver "screen": locates the array of a screen, tracks the array and decodes the packets row by row."""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from heliograph.base.errors import SettingsError
from heliograph.base.frames import Frame, check_next, check_order
from heliograph.base.threads import in_one_thread
from heliograph.receive.decode.codeword import Decoding
from heliograph.receive.detect.detection import Detection
from heliograph.receive.events import (
    DecodeEvent,
    DetectEvent,
    ExtractEvent,
    LostEvent,
    Observer,
    TrackEvent,
    UnseenEvent,
)
from heliograph.receive.geometry.fit import Fit
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.geometry.window import window_around
from heliograph.receive.packet import Packet, packet_status
from heliograph.receive.screen.cells import CellTracker, Place, Sample, SearchBudget
from heliograph.receive.screen.locate import ArraySearch
from heliograph.receive.screen.packets import CurrentPacket, PacketAssembler, ScreenHeader, ScreenPacket
from heliograph.receive.settings import ReceiveSettings
from heliograph.receive.track.kalman import MotionModel, PoseState
from heliograph.receive.track.track import Track, TrackedPair
from heliograph.signal.settings import SignalSettings

STILL = MotionModel(1.0, 0.0)
"""Motion model of the events, without rates."""


@dataclass(frozen=True)
class ScreenParameters:
    """Parameters of the receiver "screen"."""

    # Margin of the frames in events, in sides of the array
    margin_sides: float = 0.25
    # Seconds for which these frames are kept: a pair of 1 pattern/s lasts 2 s
    kept_s: float = 2.5
    # Seconds of a lost array before a new search
    max_lost_s: float = 1.0
    # The same for gaps between frames, in packets, if longer
    max_gap_packets: float = 0.5
    # Seconds and patterns without a clock after which no screen is visible, if both have passed
    unseen_s: float = 5.0
    unseen_patterns: int = 15
    # Frames for the median of the frame period
    period_frames: int = 64


PARAMETERS = ScreenParameters()


@dataclass(frozen=True)
class _Window:
    """Part of a frame around the array."""

    frame: Frame
    pose: Pose
    gain: float  # gray levels with all cells white
    score: float


class EventEmitter:
    """Emits the events of a tracked array."""

    def __init__(self, signal: SignalSettings, observe: Observer):
        self._signal, self._observe = signal, observe
        self._windows: deque[_Window] = deque()
        self._last: Frame | None = None
        self._track: Track | None = None
        self._identity: int | None = None
        self._packet_s = -np.inf
        self._next_pair = 0

    def add_frame(self, frame: Frame, sample: Sample | None, current: CurrentPacket | None) -> None:
        """Emit the events of a frame."""
        if sample is not None:
            self._add_window(frame, sample)
        self._last = frame
        if current is not None:
            self.add_header(current.header, current.start_s)
            self._add_pairs(current, frame.time_s)
        if self._identity is not None:
            self._add_track(self._identity, frame, sample is not None)

    def add_header(self, header: ScreenHeader, start_s: float) -> None:
        """Emit the detection of an array with a new identity."""
        if header.identity == self._identity or not self._windows or self._last is None:
            return
        self.end_array(self._last.time_s)
        newest, n = self._windows[-1], self._signal.side
        fit = Fit(newest.pose.full_vector(), np.eye(7), newest.gain, header.score)
        at, ones = newest.frame.time_s, np.ones((n, n))
        detection = Detection(header.identity, start_s, fit, at, header.score, 1.0, ones, header.orientation)
        self._observe(DetectEvent(detection, (self._last,)))
        self._identity = header.identity

    def end_array(self, time_s: float) -> None:
        """Emit the loss of a detected array."""
        if self._identity is not None:
            self._observe(LostEvent(self._identity, time_s))
        self._identity = self._track = None

    def _add_window(self, frame: Frame, sample: Sample) -> None:
        """Keep the part of a frame around the array."""
        pose = pose_of(sample.fit.place, self._signal.side)
        margin_px = PARAMETERS.margin_sides * self._signal.side * pose.pitch
        x, y, width, height = window_around(pose, self._signal.side, margin_px)
        x, y, right, low = max(x, 0), max(y, 0), max(x + width, 1), max(y + height, 1)
        part = replace(frame, pixels=frame.pixels[y:low, x:right].copy(), origin=(x, y))
        # data are half white on average
        gain = 2 * float(sample.fit.light.mean()) * frame.full_scale
        self._windows.append(_Window(part, pose, gain, 1 - sample.fit.misfit))
        while self._windows[0].frame.time_s < frame.time_s - PARAMETERS.kept_s:
            self._windows.popleft()

    def _add_track(self, identity: int, frame: Frame, seen: bool) -> None:
        """Emit the pose of the array."""
        newest, before = self._windows[-1], self._track
        fit = Fit(newest.pose.full_vector(), np.zeros((7, 7)), newest.gain, newest.score)
        track = before
        if seen or track is None:
            state = PoseState.start(newest.frame.time_s, fit.vector, fit.covariance, STILL)
            ones, count = np.ones((self._signal.side,) * 2), before.pairs + 1 if before is not None else 1
            track = Track(state, fit.gain, fit.gain, ones, newest.frame.time_s, ones, fit.score, count)
        self._track = track
        self._observe(TrackEvent(identity, frame.index, TrackedPair(before or track, track, fit, seen)))

    def _add_pairs(self, current: CurrentPacket, now_s: float) -> None:
        """Emit the completed data pairs."""
        assert self._identity is not None
        if abs(current.start_s - self._packet_s) > current.period_s:
            self._packet_s, self._next_pair = current.start_s, 0
        while self._next_pair < current.data_pairs:
            times_s = current.times_s(self._next_pair)
            if now_s < times_s[1] + current.period_s / 2:
                return
            pattern, inverse = (self._nearest_window(time_s) for time_s in times_s)
            errors_s = [abs(w.frame.time_s - at) for w, at in zip((pattern, inverse), times_s, strict=True)]
            # frames from before the detection may be missing
            if max(errors_s) < current.period_s / 2:
                frames, poses = (pattern.frame, inverse.frame), (pattern.pose, inverse.pose)
                self._observe(ExtractEvent(self._identity, frames, poses, number=self._next_pair))
            self._next_pair += 1

    def _nearest_window(self, time_s: float) -> _Window:
        """Return the window nearest to a time."""
        return min(self._windows, key=lambda window: abs(window.frame.time_s - time_s))


def pose_of(place: Place, side: int) -> Pose:
    """Return the affine pose at the middle of an array."""
    middle = np.array([side / 2, side / 2])
    x, y = place.at(middle)
    right, down = (place.at(middle + d) - place.at(middle - d) for d in np.eye(2) / 2)
    a = np.column_stack([right, down])
    u, sizes, vt = np.linalg.svd(a)
    turn, stretch = u @ vt, vt.T @ np.diag(sizes / sizes.mean()) @ vt
    roll = float(np.arctan2(turn[1, 0], turn[0, 0]))
    return Pose(float(x), float(y), float(sizes.mean()), roll, 0.6, float(stretch[0, 0] - 1), float(stretch[0, 1]))


def screen_receiver(signal: SignalSettings, settings: ReceiveSettings, observe: Observer) -> "ScreenReceiver":
    """Make the receiver "screen"."""
    if signal.modulation != "haar" or signal.header != "m_sequence":
        raise SettingsError('the receiver screen reads signal.modulation = "haar" with signal.header = "m_sequence"')
    return ScreenReceiver(signal, settings, observe)


class ScreenReceiver:
    """Receiver of one screen array; see `packets.Receiver`."""

    def __init__(self, signal: SignalSettings, settings: ReceiveSettings, observe: Observer):
        self._signal, self._settings, self._observe = signal, settings, observe
        self._options = Decoding(settings.decode.algorithm or "log-map", settings.decode.iterations)
        self._budget = SearchBudget.for_light(signal.pattern_period_s)
        self._search = ArraySearch(signal.side, settings.screen.gamma, self._budget)
        self._events = EventEmitter(signal, observe)
        self._last: Frame | None = None
        # tracker and assembler of the array
        self._array: tuple[CellTracker, PacketAssembler] | None = None
        self._unseen_since: float | None = None
        self._periods: deque[float] = deque(maxlen=PARAMETERS.period_frames)

    def push(self, frame: Frame) -> Iterator[Packet]:
        """Add the next frame; yield the completed packets; see `Receiver`."""
        return in_one_thread(self._receive(frame))

    def finish(self) -> Iterator[Packet]:
        """End the film: yield the packet in progress if most of the packet was visible."""
        return in_one_thread(self._finish())

    def _finish(self) -> Iterator[Packet]:
        """See `finish`."""
        if self._array is None and (acquired := self._search.find()) is not None:
            yield from self._start_array(*acquired)
        if self._array is None and self._last is not None:
            self._emit_unseen(self._last.time_s, 0.0)
        yield from self._end_array()

    def _receive(self, frame: Frame) -> Iterator[Packet]:
        """See `push`."""
        check_next(frame, self._last)
        last = self._last
        if last is None:
            self._unseen_since = frame.time_s
        if last is not None:
            # skip repeated frames
            if frame.pixels.shape == last.pixels.shape and np.array_equal(frame.pixels, last.pixels):
                return
            check_order(frame, last)
            gap_s = frame.time_s - last.time_s
            self._budget.earn(gap_s)
            self._periods.append(gap_s / max(frame.index - last.index, 1))
            if gap_s > max(PARAMETERS.max_lost_s, PARAMETERS.max_gap_packets * self._signal.packet_s):
                yield from self._end_array()
        # frames are kept, but the caller may reuse the pixels
        self._last = frame = frame.copied()
        if self._array is not None:
            yield from self._track(frame, *self._array)
        if self._array is None and (acquired := self._search.push(frame)) is not None:
            yield from self._start_array(*acquired)
        patterns_s = PARAMETERS.unseen_patterns * self._signal.pattern_period_s
        self._emit_unseen(frame.time_s, max(PARAMETERS.unseen_s, patterns_s))

    def _emit_unseen(self, time_s: float, least_s: float) -> None:
        """Emit once the absence of a screen since the start of the film."""
        if self._array is not None and self._array[1].has_clock:
            self._unseen_since = None
        if self._unseen_since is not None and time_s - self._unseen_since >= least_s:
            self._observe(UnseenEvent(time_s - self._unseen_since))
            self._unseen_since = None

    def _start_array(self, tracker: CellTracker, tracked: list[tuple[Frame, Sample | None]]) -> Iterator[Packet]:
        """Start an acquired array, and decode the frames so far."""
        self._search.forget()
        frame_s, shape = float(np.median(self._periods)), tracked[-1][0].pixels.shape
        screen = self._settings.screen
        assembler = PacketAssembler(self._signal, self._options, frame_s, shape, screen, self._budget)
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
        elif assembler.has_header:
            self._budget.fill()
        elif self._budget.is_overdrawn:
            yield from self._end_array()

    def _decode(self, frame: Frame, sample: Sample | None, assembler: PacketAssembler) -> Iterator[Packet]:
        """Decode the packets completed by a frame."""
        self._events.add_frame(frame, sample, assembler.current)
        if sample is not None:
            for packet in assembler.push(sample):
                yield self._packet(packet, assembler.samples_of(packet))

    def _end_array(self) -> Iterator[Packet]:
        """End the array with the packet in progress."""
        if self._array is not None:
            assembler = self._array[1]
            for packet in assembler.finish():
                yield self._packet(packet, assembler.samples_of(packet))
        if self._last is not None:
            self._events.end_array(self._last.time_s)
        self._array = None
        self._search.forget()

    def _packet(self, decoded: ScreenPacket, samples: list[Sample]) -> Packet:
        """Convert a decoded packet, and emit the events."""
        self._events.add_header(decoded.header, decoded.start_s)
        first, calibration = samples[0], self._settings.calibration
        pose = pose_of(first.fit.place, self._signal.side)
        packet = Packet(
            identity=decoded.header.identity,
            status=packet_status(decoded.words, decoded.header.score, float(np.mean(decoded.seen))),
            start_time_s=decoded.start_s,
            first_frame=first.index,
            last_frame=samples[-1].index,
            pose=pose,
            distance_m=calibration.distance_m(pose),
            header_score=decoded.header.score,
            track_score=float(np.clip(1 - first.fit.misfit**2, 0, 1)),
            pairs_seen=float(np.mean(decoded.seen)),
            layers=decoded.words,
            format=decoded.form,
            orientation=decoded.header.orientation,
            reason=decoded.reason,
        )
        self._observe(DecodeEvent(packet.identity, packet, luminances=decoded.change))
        return packet
