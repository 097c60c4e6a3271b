"""Tracking: the sum of a pattern and the inverse shows every LED, so each pair gives a new pose."""

from dataclasses import replace
from functools import partial
from math import sqrt

import cv2
import numpy as np
from scipy.linalg import block_diag

from heliograph.base.arrays import Floats
from heliograph.receive.detect.detection import Detection
from heliograph.receive.geometry.fit import Fit, fit_array
from heliograph.receive.geometry.footprint import image_of
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.geometry.window import AnyFrame, Window, cut_out, window_around
from heliograph.receive.sync.pairing import FramePair
from heliograph.receive.track import kalman
from heliograph.receive.track.kalman import POSE_SIZE, MotionModel, PoseState
from heliograph.receive.track.track import (
    PARAMETERS,
    Track,
    TrackedPair,
    average_around_leds,
    dark_zone,
    estimate_noise,
    is_visible,
    preview_pair,
    visible_pixels,
)


class Tracker:
    """Tracker of arrays from pair to pair; the state is in the `Track` values."""

    def __init__(self, side: int, model: MotionModel):
        self._side, self._model = side, model

    def start(self, detection: Detection) -> Track:
        """Start the track of a detected array."""
        fit = detection.fit
        covariance = widen_covariance(fit.covariance)
        state = PoseState.start(detection.time_s, fit.vector, covariance, self._model, detection.drift)
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
        is_occluded, open_pixels = track.is_occluded, None
        if is_occluded or not track.led_gains.all():
            open_pixels = self._open_pixels(track, pose, corner, up.shape)
        is_hidden = is_occluded and track.uncovered.mean() < PARAMETERS.min_visible_part
        if is_hidden or (open_pixels is not None and not open_pixels.any()):
            return _coast(before, replace(track, state=predicted))
        # (pattern) + (inverse) = every LED on, Fig. 9
        observation = kalman.sum_observation(pair.late_s)
        mean, covariance = predicted.expected(observation)
        prior = Fit(np.concatenate([mean, predicted.tilt]), covariance, track.gain)
        shining = track.shining
        if header is not None and pair.combination is None:
            total = total - track.data_gain * self._half_change(predicted, pair, corner, total.shape, header * shining)
        fit_sum = partial(
            fit_array, total, corner, prior, shining, panel=True, open_pixels=open_pixels, smear=self._smear(predicted)
        )
        fit = fit_sum(PARAMETERS.pair_steps, drawn=track.render_cache)
        if self._is_unsure(predicted) and (is_occluded or not _is_as_expected(track, pose, fit)):
            # a separate start saves a step
            start = self._unresolved_start(total, corner, prior, shining, open_pixels)
            fit = fit_sum(PARAMETERS.pair_steps - 1, start=start)
        pose, gain = fit.pose, track.gain
        seen = _is_inside(pose, pair.pattern) and is_visible(difference, noise, pose, corner, self._side, gain)
        if not seen:
            return TrackedPair(before, replace(track, state=predicted), fit, seen)
        vector = fit.vector[:POSE_SIZE].copy()
        blur = float(predicted.mean[4])
        # the edge of the panel looks like blur
        vector[4] = min(max(vector[4], blur - 0.3), blur + 0.3)
        if not is_occluded:
            # an occluder has light too, and so has the rim of the panel
            gain += 0.1 * (fit.gain - gain)
            gain = min(max(gain, track.data_gain / 1.5), track.data_gain * 1.5)
        state = predicted.condition(vector, fit.covariance, observation)
        score = track.score + 0.1 * (fit.score - track.score)
        after = replace(track, state=state, gain=gain, score=score, last_seen_s=predicted.time_s)
        return TrackedPair(before, after, fit, seen)

    def refine(self, track: Track, pair: FramePair, weights: Floats) -> Track:
        """Refine pitch, roll, blur and tilt by a header, after the fit of the sum."""
        state = track.state
        corner, up, down = _cut(pair, window_around(state.pose, self._side, _margin(state.pose)))
        mean, covariance = state.expected(kalman.HEADER_OBSERVATION)
        prior = Fit(np.append(mean, state.tilt), block_diag(covariance, state.tilt_covariance))
        lit, smear, difference, open_pixels = weights * track.shining, self._smear(state), up - down, None
        if pair.combination is None:
            difference = difference - track.data_gain * self._half_change(state, pair, corner, up.shape, track.shining)
            # saturated pixels flatten the array and would enlarge the pitch; an overexposed array has few others
            is_full = np.maximum(up, down) >= pair.pattern.full_scale
            open_pixels = np.where(is_full, 0.0, 1.0) if 0.0 < is_full.mean() < 0.5 else None
        fit = fit_array(difference, corner, prior, lit, PARAMETERS.pair_steps, smear=smear, open_pixels=open_pixels)
        # a half hidden header has more
        if fit.score < 0.6:
            return track
        vector, errors = fit.vector, fit.covariance
        state = state.condition(vector[:POSE_SIZE], errors[:POSE_SIZE, :POSE_SIZE], kalman.HEADER_OBSERVATION)
        state = replace(state, tilt=vector[POSE_SIZE:], tilt_covariance=errors[POSE_SIZE:, POSE_SIZE:])
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

    def _half_change(
        self, state: PoseState, pair: FramePair, corner: tuple[int, int], shape: tuple[int, int], light: Floats
    ) -> Floats:
        """Return half the change of an image of LEDs from the first frame to the second, for a gain of 1.

        With images A_1 and A_2 of the LEDs, a header w = 2 y - 1 has the sum (A_1 + A_2) / 2 + (A_1 - A_2) w / 2
        and the difference (A_1 + A_2) w / 2 + (A_1 - A_2) / 2.
        """
        first, second = (
            image_of(light, state.pose_at(frame.time_s), corner, shape) for frame in (pair.pattern, pair.inverted)
        )
        return 0.5 * (first - second)

    def _smear(self, state: PoseState) -> tuple[float, float]:
        """Return the standard deviations in px of the motion during a pair: uniform over two patterns."""
        # (2 v T_b)^2 / 12, v by the filter; more than 2 px is an error of the filter
        x, y, *_ = state.mean[kalman.RATE_STATES].tolist()
        spread = 2 * self._model.period_s / sqrt(12)
        return min(spread * abs(x), 2.0), min(spread * abs(y), 2.0)

    def _is_unsure(self, predicted: PoseState) -> bool:
        """Return True if resolved LEDs may be confused with neighbours, as the prediction may err by a pitch."""
        spread = sqrt(max(predicted.covariance[0, 0], predicted.covariance[1, 1]))
        pitch = predicted.pose.pitch
        return pitch > 1 and spread > 0.2 * pitch

    def _unresolved_start(
        self, total: Floats, corner: tuple[int, int], prior: Fit, led_gains: Floats, open_pixels: Floats | None
    ) -> Floats:
        """Find the start of a fit on blurred pixels, which resolve no LEDs."""
        pose = Pose.from_vector(prior.vector)
        sigma = 0.5 * pose.pitch
        vector, covariance = prior.vector.copy(), prior.covariance.copy()
        vector[4] = np.log(np.hypot(pose.blur, sigma))
        covariance[[0, 1], [0, 1]] += pose.pitch**2
        smooth = np.asarray(cv2.GaussianBlur(total, (0, 0), sigma), np.float64)
        # an even square represents an array with all LEDs on
        failed = bool((led_gains < 1).any())
        wide = Fit(vector, covariance, prior.gain)
        # one step suffices for a start
        fit = fit_array(smooth, corner, wide, led_gains, 1, panel=True, resolved=failed, open_pixels=open_pixels)
        start = fit.vector.copy()
        start[4] = prior.vector[4]
        return start

    def _open_pixels(self, track: Track, pose: Pose, corner: tuple[int, int], shape: tuple[int, int]) -> Floats | None:
        """Return a mask of the valid pixels (rows, columns) of a sum, 1 or 0; None for all pixels."""
        # a zone hidden in the header may be visible by now, dead LEDs stay dark
        uncovered, dark = track.uncovered, track.led_gains == 0
        zone = dark_zone(dark, pose) if dark.any() else dark
        is_open = np.where(zone, 0.0, uncovered) if zone.any() else uncovered
        if is_open.mean() < PARAMETERS.min_visible_part:
            is_open = uncovered
        return None if is_open.all() else visible_pixels(is_open, pose, corner, shape)


def _margin(pose: Pose) -> float:
    """Return the width in px of the fitted surroundings."""
    return 1.5 * pose.pitch + 1.5


def _cut(pair: FramePair, window: Window) -> tuple[tuple[int, int], Floats, Floats]:
    """Cut a window out of both frames; return the corner and the two cut-outs."""
    return (window[0], window[1]), cut_out(pair.pattern, window), cut_out(pair.inverted, window)


def _is_as_expected(track: Track, predicted: Pose, fit: Fit) -> bool:
    """Return True if a fit is near the prediction and as good as recent fits: no LED is confused with a neighbour."""
    x, y, *_ = fit.vector.tolist()
    away = max(abs(x - predicted.x), abs(y - predicted.y))
    # the steps of a fit approach slowly; an offset by a column of LEDs loses 0.06 or more
    return away < 0.05 * predicted.pitch and fit.score > track.score - 0.02


def widen_covariance(covariance: Floats) -> Floats:
    """Widen the covariance of a detection by the motion since then."""
    wider = covariance.copy()
    # 1 px, 3 % of the pitch, 0.01 rad, 10 % of the blur
    wider[np.arange(5), np.arange(5)] += [1.0, 1.0, 1e-3, 1e-4, 1e-2]
    return wider


def _coast(before: Track, track: Track) -> TrackedPair:
    """Return a pair with a hidden array at the predicted pose."""
    state = track.state
    fit = Fit(np.append(state.mean[:POSE_SIZE], state.tilt), state.covariance[:POSE_SIZE, :POSE_SIZE], track.gain, 0.0)
    return TrackedPair(before, track, fit, seen=False)


def _is_inside(pose: Pose, frame: AnyFrame) -> bool:
    """Return True if the centre of the array is in the frame."""
    x, y = pose.x - frame.origin[0], pose.y - frame.origin[1]
    return 0 <= x < frame.pixels.shape[1] and 0 <= y < frame.pixels.shape[0]
