"""Trackers: none, that of the receiver, background motion, OpenCV trackers, and a partially known pattern."""

from collections.abc import Iterator
from itertools import count
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import Floats, Gray
from heliograph.base.frames import Frame
from heliograph.link.settings import LinkSettings
from heliograph.receive.detect.detection import Detection
from heliograph.receive.geometry import kernels
from heliograph.receive.geometry.kernels import FIT
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.geometry.window import cut_out, window_around
from heliograph.receive.sync.pairing import FramePair, sum_late_s
from heliograph.receive.track.kalman import POSE, POSE_SIZE, MotionModel, PoseState
from heliograph.receive.track.tracker import Tracker, widen_covariance
from heliograph.signal import haar
from heliograph.signal.header import header_levels
from heliograph.signal.pwm import SLOTS


class Follower:
    """Tracker of an array over pairs of frames, from the last pair of the detected header on; by default, no tracking.

    The base class keeps the pose of the detection.
    """

    # True if the tracker estimates the pitch
    sized = False

    def __init__(self, settings: LinkSettings, found: Detection, pattern: Frame, inverted: Frame):  # noqa: ARG002 - for subclasses
        self._settings, self._pose = settings, found.fit.pose

    def update(self, pattern: Frame, inverted: Frame) -> Pose:  # noqa: ARG002 - for subclasses
        """Estimate the pose in the middle of the next pair."""
        return self._pose


class InvertedSignals(Follower):
    """Tracker of the receiver and the paper: the sum of a pattern and the inverse shows every LED."""

    sized = True

    def __init__(self, settings: LinkSettings, found: Detection, pattern: Frame, inverted: Frame):
        super().__init__(settings, found, pattern, inverted)
        side = settings.signal.side
        model = MotionModel(settings.signal.pattern_period_s, settings.receive.track.acceleration_px)
        self._tracker = Tracker(side, model)
        self._weights = header_levels(found.identity, side) / 2.0 - 1.0
        self._track = self._tracker.start(found)
        self._start_s = found.start_time_s

    def update(self, pattern: Frame, inverted: Frame) -> Pose:
        """Follow a pair; pairs of a header refine the track."""
        header = is_in_header(self._settings, pattern.time_s - self._start_s)
        pair = FramePair(pattern, inverted, 0.0 if header else sum_late_s(self._settings.signal))
        tracked = self._tracker.follow(self._track, pair)
        self._track = tracked.track
        if tracked.seen and header:
            self._track = self._tracker.refine(self._track, pair, self._weights)
        return tracked.state.pose


def is_in_header(settings: LinkSettings, since_s: float) -> bool:
    """True if the pattern at a time belongs to a header."""
    signal = settings.signal
    return round(since_s / signal.pattern_period_s) % signal.packet_patterns < 2 * signal.header_pairs


REACH_PX = 3  # search range in px from pair to pair; the motion in these drives is at most 2 px


class BackgroundMotion(Follower):
    """Background motion, section IV.B.2: the position of the array follows the median motion of background features.

    Pyramidal Lucas-Kanade from a key pair to the following pairs, on the sums of pairs, scaled to 8 bits. A mask
    excludes the array and the panel. The tracker estimates neither the size of the array nor drift, and assumes that a
    near array moves like the far background.
    """

    _old: NDArray[np.float32]
    _key: Gray
    _way: tuple[float, float]

    def __init__(self, settings: LinkSettings, found: Detection, pattern: Frame, inverted: Frame):
        super().__init__(settings, found, pattern, inverted)
        self._side = 16 * self._pose.pitch
        self._renew(_sum(pattern, inverted))

    def update(self, pattern: Frame, inverted: Frame) -> Pose:
        """Move with the background."""
        both = _sum(pattern, inverted)
        self._age += 1
        if len(self._old):
            self._follow(self._stretched(both))
        # choose new features after 10 pairs
        if self._age >= 10 or not len(self._old):
            self._renew(both)
        return self._pose

    def _follow(self, image: Gray) -> None:
        guess = self._old + np.array(self._way, np.float32)
        flags = cv2.OPTFLOW_USE_INITIAL_FLOW
        new, good, _ = cv2.calcOpticalFlowPyrLK(
            self._key, image, self._old, guess, winSize=(21, 21), maxLevel=1, flags=flags
        )
        kept = good.ravel() == 1
        if kept.any():
            x, y = np.median((new - self._old).reshape(-1, 2)[kept], axis=0)
            self._way = float(x), float(y)
            self._pose = self._at.moved(*self._way)

    def _renew(self, both: NDArray[np.float32]) -> None:
        """Choose a new key pair and new features."""
        self._age, self._at, self._way = 0, self._pose, (0.0, 0.0)
        self._alpha = 255 / max(float(np.quantile(both[::8, ::8], 0.995)), 16.0)
        self._key = self._stretched(both)
        mask, half = np.full(self._key.shape, 255, np.uint8), self._side + 4
        rows, cols = (slice(max(0, int(c - half)), max(0, int(c + half))) for c in (self._pose.y, self._pose.x))
        mask[rows, cols] = 0
        found = cv2.goodFeaturesToTrack(self._key, 120, 0.02, 12, mask=mask)
        self._old = np.zeros((0, 1, 2), np.float32) if found is None else np.asarray(found, np.float32)

    def _stretched(self, both: NDArray[np.float32]) -> Gray:
        return np.asarray(cv2.convertScaleAbs(both, alpha=self._alpha), np.uint8)


class MultipleInstance(Follower):
    """OpenCV TrackerMIL on the sums: the only general tracker of OpenCV 5 that needs no trained model.

    The box is twice as wide as the array, with a fixed size and integer coordinates. The random generator of the
    features has no seed.
    """

    def __init__(self, settings: LinkSettings, found: Detection, pattern: Frame, inverted: Frame):
        super().__init__(settings, found, pattern, inverted)
        opencv: Any = cv2  # the type hints lack this tracker
        params = opencv.TrackerMIL_Params()
        params.samplerSearchWinSize = float(REACH_PX)
        cv2.setRNGSeed(0)
        self._tracker: Any = opencv.TrackerMIL_create(params)
        side = round(32 * self._pose.pitch)
        left, top = round(self._pose.x - side / 2), round(self._pose.y - side / 2)
        # distance of the array from the corner of the box
        self._offset = self._pose.x - left, self._pose.y - top
        self._tracker.init(_half_sum(pattern, inverted), (left, top, side, side))

    def update(self, pattern: Frame, inverted: Frame) -> Pose:
        """Move to the box of OpenCV, if found."""
        found, (left, top, _, _) = self._tracker.update(_half_sum(pattern, inverted))
        if found:
            dx, dy = self._offset
            self._pose = self._pose.moved(left + dx - self._pose.x, top + dy - self._pose.y)
        return self._pose


def _half_sum(pattern: Frame, inverted: Frame) -> Gray:
    """Half of the sum in colour."""
    gray = cv2.addWeighted(pattern.pixels, 0.5, inverted.pixels, 0.5, 0)
    return np.asarray(cv2.cvtColor(gray, cv2.COLOR_GRAY2BGR), np.uint8)


class TemplateMatch(Follower):
    """OpenCV template matching on the sums: normalised correlation with a parabolic peak between pixels.

    The template is twice as wide as the array and adapts by a tenth per pair, so it grows with the array.
    """

    def __init__(self, settings: LinkSettings, found: Detection, pattern: Frame, inverted: Frame):
        super().__init__(settings, found, pattern, inverted)
        self._side = 2 * round(16 * self._pose.pitch) + 1
        self._template = self._patch(_sum(pattern, inverted), self._side)

    def update(self, pattern: Frame, inverted: Frame) -> Pose:
        """Move to the best match."""
        both = _sum(pattern, inverted)
        area = self._patch(both, self._side + 2 * REACH_PX)
        match = np.asarray(cv2.matchTemplate(area, self._template, cv2.TM_CCOEFF_NORMED), np.float32)
        _, _, _, (j, i) = cv2.minMaxLoc(match)
        self._pose = self._pose.moved(j - REACH_PX + _peak(match[i], j), i - REACH_PX + _peak(match[:, j], i))
        self._template = np.float32(0.9) * self._template + np.float32(0.1) * self._patch(both, self._side)
        return self._pose

    def _patch(self, both: NDArray[np.float32], side: int) -> NDArray[np.float32]:
        return np.asarray(cv2.getRectSubPix(both, (side, side), (self._pose.x, self._pose.y)), np.float32)


def _sum(pattern: Frame, inverted: Frame) -> NDArray[np.float32]:
    return np.asarray(cv2.add(pattern.pixels, inverted.pixels, dtype=cv2.CV_32F), np.float32)


def _peak(values: NDArray[np.float32], k: int) -> float:
    """Offset of the peak of a parabola from sample k."""
    if not 0 < k < len(values) - 1:
        return 0.0
    left, middle, right = (float(values[k + d]) for d in (-1, 0, 1))
    bend = left - 2 * middle + right
    return 0.5 * (left - right) / bend if bend < 0 else 0.0


KNOWN_SPREAD = 0.25
"""Rms deviation of a data LED from the mean luminance 1/2: levels 0 to 4 with probabilities 1, 4, 6, 4, 1 of 16."""

GROWTH = (0.5, 5.0)
"""Range of the pitch of a tracked array, relative to the detection; the pitch grows by less than 4 in a drive."""


def known_leds(side: int) -> NDArray[np.bool_]:
    """Known LEDs: blocks of 4 x 4 in the corners, (side, side)."""
    near = (np.arange(side) < 4) | (np.arange(side) >= side - 4)
    return near[:, None] & near


def known_light(settings: LinkSettings, identity: int, seed: int) -> Iterator[NDArray[np.uint8]]:
    """Endless patterns: headers, and random data with the known LEDs lit and no inverses."""
    signal, rng = settings.signal, np.random.default_rng(seed)
    header, known = header_levels(identity, signal.side), known_leds(signal.side)
    for number in count():
        place = number % signal.packet_patterns
        if place < 2 * signal.header_pairs:
            yield header if place % 2 == 0 else (SLOTS - header).astype(np.uint8)
        else:
            data = haar.encode(rng.choice(np.array([-1, 1], np.int8), (signal.side, signal.side)))
            yield np.where(known, SLOTS, data).astype(np.uint8)


class KnownPattern(Follower):
    """Fit of the expected image to each frame: known LEDs lit, data LEDs at the mean with a large variance.

    The tracker is lost and stops when the fit leaves the frame or has an implausible size.
    """

    sized = True

    def __init__(self, settings: LinkSettings, found: Detection, pattern: Frame, inverted: Frame):
        super().__init__(settings, found, pattern, inverted)
        self._side = settings.signal.side
        self._model = MotionModel(settings.signal.pattern_period_s, settings.receive.track.acceleration_px)
        wider = widen_covariance(found.fit.covariance)[:POSE_SIZE, :POSE_SIZE]
        self._state = PoseState.start(found.time_s, found.fit.vector[:POSE_SIZE], wider, self._model)
        self._start_s, self._gain = found.start_time_s, found.fit.gain
        self._pitch, self._lost = found.fit.pose.pitch, False
        known, header = known_leds(self._side), header_levels(found.identity, self._side) / SLOTS
        none = np.zeros(known.shape)
        self._expected = [(header, none), (1 - header, none), (np.where(known, 1.0, 0.5), np.where(known, 0.0, 1.0))]

    def update(self, pattern: Frame, inverted: Frame) -> Pose:
        """Fit the two frames separately, as there is no inverse."""
        return Pose.from_vector(0.5 * (self._follow(pattern) + self._follow(inverted)))

    def _follow(self, frame: Frame) -> Floats:
        """Pose vector in a frame; a lost array keeps the last pose."""
        before = self._state
        if not self._lost:
            if frame.time_s > before.time_s:
                self._state = before.predict(frame.time_s, self._model)
            mean, data = self._expected[self._kind(frame.time_s - self._start_s)]
            vector, covariance = self._fit(frame, mean, data)
            self._lost = not self._is_plausible(frame, Pose.from_vector(vector))
            self._state = before if self._lost else self._state.condition(vector, covariance, POSE)
        return self._state.mean[:5].copy()

    def _is_plausible(self, frame: Frame, pose: Pose) -> bool:
        """True if the centre lies in the frame and the size is in range."""
        rows, cols = frame.pixels.shape
        inside = 0 <= pose.x - frame.origin[0] < cols and 0 <= pose.y - frame.origin[1] < rows
        return bool(inside and GROWTH[0] <= pose.pitch / self._pitch <= GROWTH[1])

    def _kind(self, since_s: float) -> int:
        signal = self._settings.signal
        place = round(since_s / signal.pattern_period_s) % signal.packet_patterns
        return place % 2 if place < 2 * signal.header_pairs else 2

    def _fit(self, frame: Frame, mean: Floats, data: Floats) -> tuple[Floats, Floats]:
        """Posterior pose and covariance by Gauss-Newton, with pixels weighted by noise and light of data LEDs."""
        start, prior = self._state.mean[:5], np.linalg.inv(self._state.covariance[:5, :5])
        window = window_around(self._state.pose, self._side, 3.0)
        (x0, y0), image = window[:2], cut_out(frame, window)
        weights, vector = self._weights(image, data, (x0, y0)), start.copy()
        # images of array, panel squares and a plane, with derivatives
        shapes = np.zeros((4 + len(FIT.panel_margins), 6, *image.shape))
        shapes[-3, 0] = 1
        shapes[-2, 0] = np.linspace(-0.5, 0.5, image.shape[1])
        shapes[-1, 0] = np.linspace(-0.5, 0.5, image.shape[0])[:, None]
        for _ in range(3):
            kernels.render(vector, mean, float(x0), float(y0), shapes[0], 0.0, 0.0)
            for shape, margin in zip(shapes[1:-3], FIT.panel_margins, strict=True):
                kernels.render_box(vector, 0.5 * len(mean) + margin, float(x0), float(y0), shape, 0.0, 0.0)
            linear = self._light(image, shapes, weights)
            slopes = np.tensordot(linear[:-3], shapes[:-3, 1:], 1)
            columns = np.concatenate([slopes, shapes[:, 0]]).reshape(5 + len(linear), -1)
            matrix, rhs = _normal(columns, weights, image - np.tensordot(linear, shapes[:, 0], 1))
            matrix[:5, :5] += prior
            rhs[:5] += prior @ (start - vector)
            matrix += 1e-9 * np.diag(np.diag(matrix) + 1e-3)
            vector = vector + np.clip(np.linalg.solve(matrix, rhs)[:5], -0.5, 0.5)
        self._gain += 0.02 * (float(linear[0]) - self._gain)
        return vector, np.asarray(np.linalg.inv(matrix)[:5, :5], np.float64)

    def _weights(self, image: Floats, data: Floats, corner: tuple[int, int]) -> Floats:
        """Inverse variance of each pixel."""
        shape = np.empty((6, *image.shape))
        kernels.render(self._state.mean[:5].copy(), data, float(corner[0]), float(corner[1]), shape, 0.0, 0.0)
        noise = 1.0 + self._gain * np.maximum(image, 0) / 15000
        return np.asarray(1 / (noise + (KNOWN_SPREAD * self._gain * shape[0]) ** 2))

    def _light(self, image: Floats, shapes: Floats, weights: Floats) -> Floats:
        """Gain, panel and background at a pose, with the previous gain as prior."""
        matrix, rhs = _normal(shapes[:, 0].reshape(len(shapes), -1), weights, image)
        weight = (0.1 * self._gain) ** -2
        matrix[0, 0] += weight
        rhs[0] += weight * self._gain
        return np.asarray(np.linalg.solve(matrix + 1e-9 * np.diag(np.diag(matrix) + 1e-3), rhs))


def _normal(columns: Floats, weights: Floats, image: Floats) -> tuple[Floats, Floats]:
    """Weighted normal equations."""
    weighted = columns * weights.ravel()
    return weighted @ columns.T, weighted @ image.ravel()
