"""A partially known tracking pattern, section IV.B.1: some LEDs are always lit, each single frame is fitted.

The known LEDs are four blocks in the corners. The Haar code puts four data into each square of 2 x 2 LEDs, so the side
of a block is even: known LEDs take whole squares and leave the other data as they are.
"""

from collections.abc import Iterator
from itertools import count

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import Floats
from heliograph.base.frames import Frame
from heliograph.link.settings import LinkSettings
from heliograph.receive import Pose
from heliograph.receive.detect.detection import Detection
from heliograph.receive.geometry.kernels import FIT
from heliograph.receive.geometry.window import cut_out, window_around
from heliograph.receive.track.kalman import POSE, POSE_SIZE, MotionModel, PoseState
from heliograph.receive.track.tracker import widen_covariance
from heliograph.signal import haar
from heliograph.signal.header import header_levels
from heliograph.signal.pwm import SLOTS

KNOWN_BLOCK_PX = 4
"""Side of a block of known LEDs."""

KNOWN_SPREAD = 0.25
"""Rms of a data LED's luminance about its mean, 1/2: levels 0 to 4 with probabilities 1, 4, 6, 4, 1 of 16."""

GROWTH = (0.5, 5.0)
"""Least and largest pitch, by the one found, of an array that is not lost; in a drive it grows by less than 4."""

KNOWN_MARGIN_PX = 3.0
KNOWN_STEPS = 3


def known_leds(side: int) -> NDArray[np.bool_]:
    """Which LEDs are known, (side, side)."""
    near = (np.arange(side) < KNOWN_BLOCK_PX) | (np.arange(side) >= side - KNOWN_BLOCK_PX)
    return near[:, None] & near


def known_light(settings: LinkSettings, identity: int, seed: int) -> Iterator[NDArray[np.uint8]]:
    """Endless patterns: headers as in the signal, and random data without inverses, the known LEDs lit."""
    signal, rng = settings.signal, np.random.default_rng(seed)
    header, known = header_levels(identity, signal.side), known_leds(signal.side)
    for number in count():
        place = number % signal.packet_patterns
        if place < 2 * signal.header_pairs:
            yield header if place % 2 == 0 else (SLOTS - header).astype(np.uint8)
        else:
            data = haar.encode(rng.choice(np.array([-1, 1], np.int8), (signal.side, signal.side)))
            yield np.where(known, SLOTS, data).astype(np.uint8)


class KnownPattern:
    """Fits the expected image to each frame: known LEDs lit, data LEDs at their mean with a large variance.

    Once its fit has left the frame, or has a size the array cannot have, it is lost and stays where it was: only a
    header could find the array again, and its window, as large as its array, would grow without end.
    """

    sized = True

    def __init__(self, settings: LinkSettings):
        self._settings = settings
        self._side = settings.signal.side
        self._model = MotionModel(settings.signal.pattern_period_s, settings.receive.track.acceleration_px)

    def start(self, found: Detection, pattern: Frame, inverted: Frame) -> None:  # noqa: ARG002 - as all trackers
        """Begin at the detection; see `Follower`."""
        wider = widen_covariance(found.fit.covariance)[:POSE_SIZE, :POSE_SIZE]
        self._state = PoseState.start(found.time_s, found.fit.vector[:POSE_SIZE], wider, self._model)
        self._start_s, self._gain = found.start_time_s, found.fit.gain
        self._pitch, self._lost = found.fit.pose.pitch, False
        known, header = known_leds(self._side), header_levels(found.identity, self._side) / SLOTS
        none = np.zeros(known.shape)
        self._expected = [(header, none), (1 - header, none), (np.where(known, 1.0, 0.5), np.where(known, 0.0, 1.0))]

    def update(self, pattern: Frame, inverted: Frame) -> Pose:
        """Fit both frames by themselves: there is no inverse; see `Follower`."""
        first, second = self._frame_pose(pattern), self._frame_pose(inverted)
        return Pose.from_vector(0.5 * (first + second))

    def _frame_pose(self, frame: Frame) -> Floats:
        if not self._lost:
            self._follow(frame)
        return self._state.mean[:5].copy()

    def _follow(self, frame: Frame) -> None:
        before = self._state
        if frame.time_s > before.time_s:
            self._state = before.predict(frame.time_s, self._model)
        mean, data = self._expected[self._kind(frame.time_s - self._start_s)]
        vector, covariance = self._fit(frame, mean, data)
        self._lost = not self._possible(frame, Pose.from_vector(vector))
        self._state = before if self._lost else self._state.condition(vector, covariance, POSE)

    def _possible(self, frame: Frame, pose: Pose) -> bool:
        """Whether the array may be there: its centre in the frame, its size about what it was."""
        rows, cols = frame.pixels.shape
        inside = 0 <= pose.x - frame.origin[0] < cols and 0 <= pose.y - frame.origin[1] < rows
        return bool(inside and GROWTH[0] <= pose.pitch / self._pitch <= GROWTH[1])

    def _kind(self, since_s: float) -> int:
        signal = self._settings.signal
        place = round(since_s / signal.pattern_period_s) % signal.packet_patterns
        return place % 2 if place < 2 * signal.header_pairs else 2

    def _fit(self, frame: Frame, mean: Floats, data: Floats) -> tuple[Floats, Floats]:
        """Posterior pose and covariance by Gauss-Newton; noise and light of data LEDs weight the pixels."""
        start, prior = self._state.mean[:5], np.linalg.inv(self._state.covariance[:5, :5])
        window = window_around(self._state.pose, self._side, KNOWN_MARGIN_PX)
        (x0, y0), image = window[:2], cut_out(frame, window)
        trust, scene = self._trust(image, data, (x0, y0)), _ArrayImages(image.shape, (x0, y0))
        vector = start.copy()
        for _ in range(KNOWN_STEPS):
            shapes = scene.place(vector, mean)
            linear = self._light(image, shapes, trust)
            slopes = np.tensordot(linear[:-3], shapes[:-3, 1:], 1)
            columns = np.concatenate([slopes, shapes[:, 0]]).reshape(5 + len(linear), -1)
            matrix, rhs = _normal(columns, trust, image - np.tensordot(linear, shapes[:, 0], 1))
            matrix[:5, :5] += prior
            rhs[:5] += prior @ (start - vector)
            matrix += 1e-9 * np.diag(np.diag(matrix) + 1e-3)
            vector = vector + np.clip(np.linalg.solve(matrix, rhs)[:5], -0.5, 0.5)
        self._gain += 0.02 * (float(linear[0]) - self._gain)
        return vector, np.asarray(np.linalg.inv(matrix)[:5, :5], np.float64)

    def _trust(self, image: Floats, data: Floats, corner: tuple[int, int]) -> Floats:
        """One over the variance of each pixel."""
        from heliograph.receive.geometry import kernels  # Numba is slow to import

        shape = np.empty((6, *image.shape))
        kernels.render(self._state.mean[:5].copy(), data, float(corner[0]), float(corner[1]), shape, 0.0, 0.0)
        noise = 1.0 + self._gain * np.maximum(image, 0) / 15000
        return np.asarray(1 / (noise + (KNOWN_SPREAD * self._gain * shape[0]) ** 2))

    def _light(self, image: Floats, shapes: Floats, trust: Floats) -> Floats:
        """Gain, panel and background at a pose, the gain near what it was."""
        columns = shapes[:, 0].reshape(len(shapes), -1)
        matrix, rhs = _normal(columns, trust, image)
        weight = (0.1 * self._gain) ** -2
        matrix[0, 0] += weight
        rhs[0] += weight * self._gain
        return np.asarray(np.linalg.solve(matrix + 1e-9 * np.diag(np.diag(matrix) + 1e-3), rhs))


class _ArrayImages:
    """Images of the array, the panel's two squares and a plane, with their derivatives: (6, 6, rows, columns)."""

    def __init__(self, shape: tuple[int, ...], corner: tuple[int, int]):
        rows, cols = shape
        self._corner = float(corner[0]), float(corner[1])
        self._shapes = np.zeros((4 + len(FIT.panel_margins), 6, rows, cols))
        self._shapes[-3, 0] = 1
        self._shapes[-2, 0] = np.linspace(-0.5, 0.5, cols)
        self._shapes[-1, 0] = np.linspace(-0.5, 0.5, rows)[:, None]

    def place(self, vector: Floats, mean: Floats) -> Floats:
        from heliograph.receive.geometry import kernels

        kernels.render(vector, mean, *self._corner, self._shapes[0], 0.0, 0.0)
        for shape, margin in zip(self._shapes[1:-3], FIT.panel_margins, strict=True):
            kernels.render_box(vector, 0.5 * len(mean) + margin, *self._corner, shape, 0.0, 0.0)
        return self._shapes


def _normal(columns: Floats, trust: Floats, image: Floats) -> tuple[Floats, Floats]:
    """Weighted normal equations."""
    weighted = columns * trust.ravel()
    return weighted @ columns.T, weighted @ image.ravel()
