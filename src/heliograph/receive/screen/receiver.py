"""What an observer is told of an array: that its header is seen, where it is in each frame, and its pairs.

The receiver "screen": one array of a screen, found where everything changes, followed, and read row by row.
"""

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
from heliograph.receive.screen.cells import Follower, Place, Sample, SearchBudget, SearchLimits
from heliograph.receive.screen.locate import ArraySearch, Taken
from heliograph.receive.screen.packets import Coming, HeaderSeen, PacketReading, ReadPacket
from heliograph.receive.settings import ReceiveSettings
from heliograph.receive.track.kalman import MotionModel, PoseState
from heliograph.receive.track.track import Track, TrackedPair
from heliograph.signal.settings import SignalSettings

MARGIN_SIDES = 0.25
"""Sides of an array beside it that are kept of a frame. Chosen: page *Watch* shows 0.15."""

KEPT_S = 2.5
"""Seconds for which windows of frames are kept: a pair of 1 pattern a second lasts 2 s."""

STILL = MotionModel(1.0, 0.0)
"""Motion of a screen as the event names it: its rates are not estimated."""


@dataclass(frozen=True)
class _Shown:
    """The part of a frame about the array, and where it is."""

    frame: Frame
    pose: Pose
    gain: float  # gray levels with all cells white
    fits: float


class Telling:
    """Tells an observer of one array that is followed."""

    def __init__(self, signal: SignalSettings, observe: Observer):
        self._signal, self._observe = signal, observe
        self._windows: deque[_Shown] = deque()
        self._last: Frame | None = None
        self._track: Track | None = None
        self._identity: int | None = None
        self._packet_s = -np.inf
        self._told = 0

    def sees(self, frame: Frame, sample: Sample | None, coming: Coming | None) -> None:
        """Tell what a frame shows."""
        if sample is not None:
            self._keep(frame, sample)
        self._last = frame
        if coming is not None:
            self.named(coming.header, coming.start_s)
            self._pairs(coming, frame.time_s)
        if self._identity is not None:
            self._followed(frame, sample is not None)

    def named(self, header: HeaderSeen, start_s: float) -> None:
        """Tell that a header is seen, where it is another array's than before."""
        if header.identity == self._identity or not self._windows or self._last is None:
            return
        self.lost(self._last.time_s)
        newest, n = self._windows[-1], self._signal.side
        fit = Fit(newest.pose.full_vector(), np.eye(7), newest.gain, header.score)
        at, ones = newest.frame.time_s, np.ones((n, n))
        seen = Detection(header.identity, start_s, fit, at, header.score, 1.0, ones, header.orientation)
        self._observe(DetectEvent(seen, (self._last,)))
        self._identity = header.identity

    def lost(self, time_s: float) -> None:
        """Tell that the array is lost, if it was told of."""
        if self._identity is not None:
            self._observe(LostEvent(self._identity, time_s))
        self._identity = self._track = None

    def _keep(self, frame: Frame, sample: Sample) -> None:
        pose = pose_of(sample.seen.place, self._signal.side)
        x, y, wide, high = window_around(pose, self._signal.side, MARGIN_SIDES * self._signal.side * pose.pitch)
        x, y, right, low = max(x, 0), max(y, 0), max(x + wide, 1), max(y + high, 1)
        part = replace(frame, pixels=frame.pixels[y:low, x:right].copy(), origin=(x, y))
        # data are half white on average
        gain = 2 * float(sample.seen.light.mean()) * frame.full_scale
        self._windows.append(_Shown(part, pose, gain, 1 - sample.seen.misfit))
        while self._windows[0].frame.time_s < frame.time_s - KEPT_S:
            self._windows.popleft()

    def _followed(self, frame: Frame, seen: bool) -> None:
        assert self._identity is not None
        newest, before = self._windows[-1], self._track
        fit = Fit(newest.pose.full_vector(), np.zeros((7, 7)), newest.gain, newest.fits)
        if seen or before is None:
            state = PoseState.start(newest.frame.time_s, fit.vector, fit.covariance, STILL)
            ones, count = np.ones((self._signal.side,) * 2), before.pairs + 1 if before is not None else 1
            track = Track(state, fit.gain, fit.gain, ones, newest.frame.time_s, ones, fit.score, count)
        else:
            track = before
        self._track = track
        self._observe(TrackEvent(self._identity, frame.index, TrackedPair(before or track, track, fit, seen)))

    def _pairs(self, coming: Coming, now_s: float) -> None:
        """Tell of each pair of data that is over."""
        assert self._identity is not None
        if abs(coming.start_s - self._packet_s) > coming.period_s:
            self._packet_s, self._told = coming.start_s, 0
        while self._told < coming.data_pairs:
            middles = coming.times_s(self._told)
            if now_s < middles[1] + coming.period_s / 2:
                return
            shown = [min(self._windows, key=lambda one, at=at: abs(one.frame.time_s - at)) for at in middles]  # type: ignore[misc]
            # what was shown before the array was found is not kept for ever
            if all(abs(one.frame.time_s - at) < coming.period_s / 2 for one, at in zip(shown, middles, strict=True)):
                pattern, inverse = shown
                frames, poses = (pattern.frame, inverse.frame), (pattern.pose, inverse.pose)
                self._observe(ExtractEvent(self._identity, frames, poses, number=self._told))
            self._told += 1


def pose_of(place: Place, side: int) -> Pose:
    """Return the affine pose at an array's middle."""
    middle = np.array([side / 2, side / 2])
    x, y = place.at(middle)
    right, down = (place.at(middle + d) - place.at(middle - d) for d in np.eye(2) / 2)
    a = np.column_stack([right, down])
    u, sizes, vt = np.linalg.svd(a)
    turn, stretch = u @ vt, vt.T @ np.diag(sizes / sizes.mean()) @ vt
    roll = float(np.arctan2(turn[1, 0], turn[0, 0]))
    return Pose(float(x), float(y), float(sizes.mean()), roll, 0.6, float(stretch[0, 0] - 1), float(stretch[0, 1]))


LOST_S = 1.0
"""Seconds out of sight after which an array is looked for anew. Chosen."""

PAUSE_PACKETS = 0.5
"""Packets without a frame after which an array is looked for anew, if that is longer: half a packet is not read."""

UNSEEN_S, UNSEEN_PATTERNS = 5.0, 15
"""Seconds and patterns of a film without a light's clock from which on no screen is taken to be visible, if both are
over. A clock is found from ten patterns."""

PERIODS = 64
"""Frames of which the median period is taken. Chosen: a camera's rate hardly changes."""


def screen_receiver(signal: SignalSettings, settings: ReceiveSettings, observe: Observer) -> "ScreenReceiver":
    """Make the receiver "screen"."""
    if signal.modulation != "haar" or signal.header != "m_sequence":
        raise SettingsError('the receiver screen reads signal.modulation = "haar" with signal.header = "m_sequence"')
    return ScreenReceiver(signal, settings, observe)


@dataclass(frozen=True)
class Sight:
    """What a receiver sees of the array that it follows, for those who ask why nothing is read."""

    # Mean side of a cell in px
    cell_px: float
    # Standard deviation of the blur in px by which the cells fit best
    blur_px: float
    # Rms of what the cells do not explain, as a part of the picture's contrast
    misfit: float
    # Part of the array that is at full scale
    saturated: float
    # Whether the light's clock is known
    clocked: bool


class ScreenReceiver:
    """Finds the array of a screen in a stream of frames and yields its packets; see `packets.Receiver`."""

    def __init__(self, signal: SignalSettings, settings: ReceiveSettings, observe: Observer):
        self._signal, self._settings, self._observe = signal, settings, observe
        self._options = Decoding(settings.decode.algorithm or "log-map", settings.decode.iterations)
        self._budget = SearchBudget(SearchLimits().for_light(signal.pattern_period_s))
        self._search = ArraySearch(signal.side, settings.screen.gamma, self._budget)
        self._telling = Telling(signal, observe)
        self._last: Frame | None = None
        self._follower: Follower | None = None
        self._reading: PacketReading | None = None
        self._sample: Sample | None = None
        self._unseen_since: float | None = None
        self._periods: deque[float] = deque(maxlen=PERIODS)

    def push(self, frame: Frame) -> Iterator[Packet]:
        """Take the next frame; yield the packets it completes; see `Receiver`."""
        return in_one_thread(self._checked(frame))

    def finish(self) -> Iterator[Packet]:
        """End of the film: yield the packet in progress if enough of it was seen."""
        return in_one_thread(self._finish())

    @property
    def sight(self) -> Sight | None:
        """What is seen of the array that is followed; None where none is."""
        if self._follower is None or self._reading is None or self._sample is None:
            return None
        seen = self._sample.seen
        cell = seen.place.cell_px(self._signal.side)
        return Sight(cell, self._follower.blur_px, seen.misfit, seen.saturated, self._reading.clocked)

    def _finish(self) -> Iterator[Packet]:
        if self._follower is None and (taken := self._search.find()) is not None:
            yield from self._take_up(taken)
        if self._follower is None and self._last is not None:
            self._note_unseen(self._last.time_s, 0.0)
        yield from self._give_up()

    def _checked(self, frame: Frame) -> Iterator[Packet]:
        check_next(frame, self._last)
        last = self._last
        if last is None:
            self._unseen_since = frame.time_s
        if last is not None:
            # a copy of the frame before shows nothing new
            if frame.pixels.shape == last.pixels.shape and np.array_equal(frame.pixels, last.pixels):
                return
            check_order(frame, last)
            self._budget.earn(frame.time_s - last.time_s)
            self._periods.append((frame.time_s - last.time_s) / max(frame.index - last.index, 1))
            if frame.time_s - last.time_s > max(LOST_S, PAUSE_PACKETS * self._signal.packet_s):
                yield from self._give_up()
        # the caller may fill its array again, and frames are kept
        self._last = frame = frame.copied()
        if self._follower is not None:
            yield from self._follow(frame, self._follower)
        if self._follower is None and (taken := self._search.take(frame)) is not None:
            yield from self._take_up(taken)
        self._note_unseen(frame.time_s, max(UNSEEN_S, UNSEEN_PATTERNS * self._signal.pattern_period_s))

    def _note_unseen(self, time_s: float, least_s: float) -> None:
        """Tell once that no screen was seen for so long since the film began."""
        if self._reading is not None and self._reading.clocked:
            self._unseen_since = None
        if self._unseen_since is not None and time_s - self._unseen_since >= least_s:
            self._observe(UnseenEvent(time_s - self._unseen_since))
            self._unseen_since = None

    def _take_up(self, taken: Taken) -> Iterator[Packet]:
        """Follow an array that was found, and read what the frames kept show of it."""
        self._search.forget()
        self._follower = taken.follower
        frame_s, shape = float(np.median(self._periods)), taken.seen[-1][0].pixels.shape
        self._reading = PacketReading(self._signal, self._options, frame_s, shape, self._settings.screen, self._budget)
        for frame, sample in taken.seen:
            yield from self._read(frame, sample)

    def _follow(self, frame: Frame, follower: Follower) -> Iterator[Packet]:
        sample = follower.take(frame)
        yield from self._read(frame, sample)
        if sample is None and follower.lost_since is not None and frame.time_s - follower.lost_since > LOST_S:
            yield from self._give_up()
        elif self._reading is not None and self._reading.is_named:
            self._budget.fill()
        elif self._budget.is_overdrawn:
            yield from self._give_up()

    def _read(self, frame: Frame, sample: Sample | None) -> Iterator[Packet]:
        """Read what a frame shows."""
        assert self._reading is not None
        self._telling.sees(frame, sample, self._reading.coming)
        if sample is None:
            return
        self._sample = sample
        for one in self._reading.take(sample):
            yield self._packet(one, self._reading.shown(one))

    def _give_up(self) -> Iterator[Packet]:
        """End the array that is followed with the packet in progress, if enough of it was seen."""
        if self._reading is not None:
            for one in self._reading.finish():
                yield self._packet(one, self._reading.shown(one))
        if self._last is not None:
            self._telling.lost(self._last.time_s)
        self._follower = self._reading = None
        self._search.forget()

    def _packet(self, one: ReadPacket, shown: list[Sample]) -> Packet:
        self._telling.named(one.header, one.start_s)
        first, known = shown[0], self._settings.calibration
        pose = pose_of(first.seen.place, self._signal.side)
        packet = Packet(
            identity=one.header.identity,
            status=packet_status(one.words, one.header.score, float(np.mean(one.seen))),
            start_time_s=one.start_s,
            first_frame=first.index,
            last_frame=shown[-1].index,
            pose=pose,
            distance_m=known.distance_m(pose),
            header_score=one.header.score,
            track_score=float(np.clip(1 - first.seen.misfit**2, 0, 1)),
            pairs_seen=float(np.mean(one.seen)),
            layers=one.words,
            format=one.form,
            orientation=one.header.orientation,
            reason=one.reason,
        )
        self._observe(DecodeEvent(packet.identity, packet, luminances=one.change))
        return packet
