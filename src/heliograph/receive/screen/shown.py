"""What an observer is told of an array: that its header is seen, where it is in each frame, and its pairs."""

from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from heliograph.base.frames import Frame
from heliograph.receive.acquire.detection import Detection
from heliograph.receive.events import DetectEvent, ExtractEvent, LostEvent, Observer, TrackEvent
from heliograph.receive.image.fit import Fit
from heliograph.receive.image.pose import Pose
from heliograph.receive.image.window import window_around
from heliograph.receive.screen.follow import Sample
from heliograph.receive.screen.grid import Place
from heliograph.receive.screen.headers import HeaderSeen
from heliograph.receive.screen.reader import Coming
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
