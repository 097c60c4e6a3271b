"""Tracking: the sum of a pattern and the inverse shows every LED, so each pair gives a new pose."""

from dataclasses import dataclass, replace
from functools import partial
from math import sqrt

import cv2
import numpy as np

from heliograph.base.arrays import Floats
from heliograph.receive.detect.detection import Detection
from heliograph.receive.geometry.fit import Fit, Prior, fit_array
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.geometry.window import Window, cut_out, window_around
from heliograph.receive.sync.pairing import AnyFrame, FramePair
from heliograph.receive.track.kalman import (
    HEADER_OBSERVATION,
    POSE_SIZE,
    RATE_STATES,
    MotionModel,
    PoseState,
    Tilt,
    sum_observation,
)
from heliograph.receive.track.track import (
    Track,
    TrackedPair,
    average_around_leds,
    dark_zone,
    estimate_noise,
    is_visible,
    preview_pair,
    visible_pixels,
)


@dataclass(frozen=True)
class TrackerParameters:
    """Parameters of the tracker; lengths in pitches unless stated."""

    # Width of the fitted surroundings, and an additional width in px
    margin: float = 1.5
    margin_px: float = 1.5
    # Minimum correlation of a header that refines the pose; a half hidden header has more
    min_header_score: float = 0.6
    # Maximum number of Gauss-Newton steps per pair
    pair_steps: int = 3
    # Pitch in px above which single LEDs are resolved
    resolved_px: float = 1.0
    # Standard deviation of the prediction above which LEDs may be confused with neighbours
    max_spread: float = 0.2
    # Maximum distance of a fit from the prediction: the steps of a fit approach slowly
    max_step: float = 0.05
    # Maximum loss of correlation against recent sums; an offset by a column of LEDs loses 0.06 or more
    max_score_loss: float = 0.02
    # Blur that hides single LEDs
    unresolved_blur: float = 0.5
    # Maximum smear of a sum by motion in px; faster motion is an error of the filter
    max_smear_px: float = 2.0
    # Minimum fraction of visible LEDs for a fit
    min_visible: float = 0.25
    # Weight of a pair in gain and score
    gain_rate: float = 0.1
    # Maximum ratio of the gains of sums and headers: the rim of the panel changes the light
    max_gain_ratio: float = 1.5
    # Maximum difference of ln blur between sums and headers: the edge of the panel looks like blur
    max_sum_blur: float = 0.3
    # Variances added to the pose of a detection for the motion since then: 1 px, 3 % of the pitch, 0.01 rad, 0.1
    detection_variances: tuple[float, ...] = (1.0, 1.0, 1e-3, 1e-4, 1e-2)


_PARAMETERS = TrackerParameters()


class Tracker:
    """Tracker of arrays from pair to pair; the state is in the `Track` values."""

    def __init__(self, side: int, model: MotionModel):
        self._side, self._model = side, model

    def start(self, detection: Detection) -> Track:
        """Start the track of a detected array."""
        fit = detection.fit
        state = PoseState.start(
            detection.time_s, fit.vector, widen_covariance(fit.covariance), self._model, detection.drift
        )
        change = average_around_leds(detection.led_gains, fit.pose)
        # static cells are hidden or dead
        return Track(state, fit.gain, fit.gain, detection.led_gains, detection.time_s, change)

    def follow(self, track: Track, pair: FramePair, header: Floats | None = None) -> TrackedPair:
        """Fit the array in the sum of a pair and update the filter; coast while the array is hidden."""
        predicted = self.predict(track, pair.time_s)
        pose = predicted.pose
        corner, up, down = _cut(pair, track.render_cache.window(pose, self._side, _margin(pose)))
        before = track
        difference, total, noise, track = preview_pair(track, up, down, corner, pose)
        uncovered, is_occluded = track.uncovered, track.is_occluded
        open_pixels = None
        if is_occluded or not track.led_gains.all():
            open_pixels = self._open_pixels(track, uncovered, pose, corner, up.shape)
        is_hidden = is_occluded and uncovered.mean() < _PARAMETERS.min_visible
        if is_hidden or (open_pixels is not None and not open_pixels.any()):
            return _coast(before, replace(track, state=predicted))
        # (pattern) + (inverse) = every LED on, Fig. 9
        observation = sum_observation(pair.late_s)
        mean, covariance = predicted.expected(observation)
        prior = Prior(np.concatenate([mean, predicted.tilt.mean]), covariance, track.gain)
        shining = track.shining
        if header is not None and pair.combination is None:
            left = self._header_residue(predicted, pair, corner, total.shape, header * shining)
            total = total - track.data_gain * left
        fit_sum = partial(
            fit_array,
            total,
            corner,
            prior,
            shining,
            panel=True,
            open_pixels=open_pixels,
            smear=self._smear(predicted),
        )
        fit = fit_sum(_PARAMETERS.pair_steps, drawn=track.render_cache)
        if self._is_unsure(predicted) and (is_occluded or not _is_as_expected(track, pose, fit)):
            # a separate start saves a step
            start = self._unresolved_start(total, corner, prior, shining, open_pixels)
            fit = fit_sum(_PARAMETERS.pair_steps - 1, start=start)
        pose, gain = fit.pose, track.gain
        seen = _is_inside(pose, pair.pattern) and is_visible(difference, noise, pose, corner, self._side, gain)
        if not seen:
            return TrackedPair(before, replace(track, state=predicted), fit, seen)
        vector = fit.vector[:POSE_SIZE].copy()
        blur = float(predicted.mean[4])
        vector[4] = min(max(vector[4], blur - _PARAMETERS.max_sum_blur), blur + _PARAMETERS.max_sum_blur)
        if not is_occluded:
            # an occluder has light too
            gain += _PARAMETERS.gain_rate * (fit.gain - gain)
            ratio = _PARAMETERS.max_gain_ratio
            gain = min(max(gain, track.data_gain / ratio), track.data_gain * ratio)
        after = replace(
            track,
            state=predicted.condition(vector, fit.covariance, observation),
            gain=gain,
            score=track.score + _PARAMETERS.gain_rate * (fit.score - track.score),
            last_seen_s=predicted.time_s,
        )
        return TrackedPair(before, after, fit, seen)

    def refine(self, track: Track, pair: FramePair, weights: Floats) -> Track:
        """Refine pitch, roll, blur and tilt by a header, after the fit of the sum."""
        state, tilt = track.state, track.state.tilt
        corner, up, down = _cut(pair, window_around(state.pose, self._side, _margin(state.pose)))
        mean, covariance = state.expected(HEADER_OBSERVATION)
        both = np.zeros((POSE_SIZE + 2, POSE_SIZE + 2))
        both[:POSE_SIZE, :POSE_SIZE], both[POSE_SIZE:, POSE_SIZE:] = covariance, tilt.covariance
        prior = Prior(np.append(mean, tilt.mean), both)
        fit = fit_array(
            up - down, corner, prior, weights * track.shining, _PARAMETERS.pair_steps, smear=self._smear(state)
        )
        if fit.score < _PARAMETERS.min_header_score:
            return track
        state = state.condition(fit.vector[:POSE_SIZE], fit.covariance[:POSE_SIZE, :POSE_SIZE], HEADER_OBSERVATION)
        state = replace(state, tilt=Tilt(fit.vector[POSE_SIZE:], fit.covariance[POSE_SIZE:, POSE_SIZE:]))
        return replace(track, state=state, data_gain=fit.gain)

    def is_visible(self, track: Track, pair: FramePair, fit: Fit) -> bool:
        """Return True if two frames with different patterns show the array at the pose of a fit."""
        corner, up, down = _cut(pair, window_around(track.state.pose, self._side, _margin(track.state.pose)))
        noise = estimate_noise(up - down, track.state.pose, corner, self._side)
        pose = fit.pose
        return _is_inside(pose, pair.pattern) and is_visible(up - down, noise, pose, corner, self._side, track.gain)

    def predict(self, track: Track, time_s: float) -> PoseState:
        """Predict the state at a time; earlier times keep the state."""
        if time_s <= track.state.time_s:
            return replace(track.state, time_s=time_s)
        return track.state.predict(time_s, self._model)

    def _header_residue(
        self, predicted: PoseState, pair: FramePair, corner: tuple[int, int], shape: tuple[int, int], header: Floats
    ) -> Floats:
        """Return the residue of a header in the sum of a moving array, for a gain of 1."""
        # A_1 Y + A_2 (1 - Y) = (A_1 + A_2) / 2 + (A_1 - A_2) (Y - 1/2), Y being the header
        from heliograph.receive.geometry import kernels  # Numba is slow to import

        images = np.empty((2, 6, *shape))
        for frame, image in zip((pair.pattern, pair.inverted), images, strict=True):
            pose = predicted.pose_at(frame.time_s)
            kernels.render(pose.full_vector(), header, float(corner[0]), float(corner[1]), image, 0.0, 0.0)
        return np.asarray(0.5 * (images[0, 0] - images[1, 0]))

    def _smear(self, state: PoseState) -> tuple[float, float]:
        """Return the standard deviations in px of the motion during a pair: uniform over two patterns."""
        # (2 v T_b)^2 / 12, v by the filter
        x, y, *_ = state.mean[RATE_STATES].tolist()
        spread = 2 * self._model.period_s / sqrt(12)
        return min(spread * abs(x), _PARAMETERS.max_smear_px), min(spread * abs(y), _PARAMETERS.max_smear_px)

    def _is_unsure(self, predicted: PoseState) -> bool:
        """Return True if resolved LEDs may be confused with neighbours, as the prediction may err by a pitch."""
        spread = sqrt(max(predicted.covariance[0, 0], predicted.covariance[1, 1]))
        pitch = predicted.pose.pitch
        return pitch > _PARAMETERS.resolved_px and spread > _PARAMETERS.max_spread * pitch

    def _unresolved_start(
        self, total: Floats, corner: tuple[int, int], prior: Prior, led_gains: Floats, open_pixels: Floats | None
    ) -> Floats:
        """Find the start of a fit on blurred pixels, which resolve no LEDs."""
        pose = Pose.from_vector(prior.vector)
        sigma = _PARAMETERS.unresolved_blur * pose.pitch
        vector, covariance = prior.vector.copy(), prior.covariance.copy()
        vector[4] = np.log(np.hypot(pose.blur, sigma))
        covariance[[0, 1], [0, 1]] += pose.pitch**2
        smooth = np.asarray(cv2.GaussianBlur(total, (0, 0), sigma), np.float64)
        # an even square represents an array with all LEDs on
        failed = bool((led_gains < 1).any())
        wide = Prior(vector, covariance, prior.gain)
        # one step suffices for a start
        fit = fit_array(smooth, corner, wide, led_gains, 1, panel=True, resolved=failed, open_pixels=open_pixels)
        start = fit.vector.copy()
        start[4] = prior.vector[4]
        return start

    def _open_pixels(
        self, track: Track, uncovered: Floats, pose: Pose, corner: tuple[int, int], shape: tuple[int, int]
    ) -> Floats | None:
        """Return a mask of the valid pixels (rows, columns) of a sum, 1 or 0; None for all pixels."""
        # a zone hidden in the header may be visible by now, dead LEDs stay dark
        dark = track.led_gains == 0
        zone = dark_zone(dark, pose) if dark.any() else dark
        is_open = np.where(zone, 0.0, uncovered) if zone.any() else uncovered
        if is_open.mean() < _PARAMETERS.min_visible:
            is_open = uncovered
        return None if is_open.all() else visible_pixels(is_open, pose, corner, shape)


def _margin(pose: Pose) -> float:
    """Return the width in px of the fitted surroundings."""
    return _PARAMETERS.margin * pose.pitch + _PARAMETERS.margin_px


def _cut(pair: FramePair, window: Window) -> tuple[tuple[int, int], Floats, Floats]:
    """Cut a window out of both frames; return the corner and the two cut-outs."""
    return (window[0], window[1]), cut_out(pair.pattern, window), cut_out(pair.inverted, window)


def _is_as_expected(track: Track, predicted: Pose, fit: Fit) -> bool:
    """Return True if a fit is near the prediction and as good as recent fits: no LED is confused with a neighbour."""
    x, y, *_ = fit.vector.tolist()
    away = max(abs(x - predicted.x), abs(y - predicted.y))
    return away < _PARAMETERS.max_step * predicted.pitch and fit.score > track.score - _PARAMETERS.max_score_loss


def widen_covariance(covariance: Floats) -> Floats:
    """Widen the covariance of a detection by the motion since then."""
    wider = covariance.copy()
    wider[np.arange(5), np.arange(5)] += _PARAMETERS.detection_variances
    return wider


def _coast(before: Track, track: Track) -> TrackedPair:
    """Return a pair with a hidden array at the predicted pose."""
    state = track.state
    vector = np.append(state.mean[:POSE_SIZE], state.tilt.mean)
    fit = Fit(vector, state.covariance[:POSE_SIZE, :POSE_SIZE], track.gain, 0.0)
    return TrackedPair(before, track, fit, seen=False)


def _is_inside(pose: Pose, frame: AnyFrame) -> bool:
    """Return True if the centre of the array is in the frame."""
    x, y = pose.x - frame.origin[0], pose.y - frame.origin[1]
    return 0 <= x < frame.pixels.shape[1] and 0 <= y < frame.pixels.shape[0]
