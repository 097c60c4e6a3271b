"""Tracking: the sum of a pattern and its inverse shows every LED, so each pair gives a new pose."""

from dataclasses import replace
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
    around_leds,
    dark_zone,
    is_active,
    look,
    noise_around,
    open_pixels,
)

WINDOW_MARGIN_PITCHES, WINDOW_MARGIN_PX = 1.5, 1.5
"""Width of the surroundings that are fitted with the array: they hold its edge, the panel's and the background."""

HEADER_SCORE = 0.6
"""Least correlation with which a header refines the pose: a header half hidden still has more."""

PAIR_STEPS = 3
"""Most Gauss-Newton steps per pair; from the filter's prediction a fit mostly ends after two."""

RESOLVED_PX = 1.0
"""Pitch in px from which on single LEDs show in a sum."""

UNSURE_PITCHES = 0.2
"""Standard deviation of the prediction, in pitches, from which on LEDs may be taken for their neighbours."""

AS_EXPECTED_PITCHES = 0.05
"""Pitches by which a fit may move an array from its prediction to be near enough: its steps come near slowly.

In hard shake (0.9 px per pattern) at 40 m positions erred by 0.12 px rms with 0.2, and by less than 0.1 with 0.05.
"""

LESS_ALIKE = 0.02
"""Correlation by which a sum's fit may be worse than recent ones: a column of LEDs off it is worse by 0.06 or more."""

UNRESOLVED_BLUR_PITCHES = 0.5
"""Pitches of blur that hide single LEDs, as in the detector."""

MOST_SMEAR_PX = 2.0
"""Most that motion smears a sum: at 3.5 px per pattern; what seems to be faster is an error of the filter."""

LEAST_IN_SIGHT = 0.25
"""Least fraction of the LEDs in sight by which a pose is found: with less an array's place has no hold."""

GAIN_RATE = 0.1
"""Weight of a pair's gain in the tracker's: sums of about ten pairs count."""

GAIN_RATIO = 1.5
"""Most that the gains of sums and of headers differ by: a panel's rim takes or adds a sixth of the light at 60 m."""

MOST_SUM_BLUR = 0.3
"""Most that a sum's ln blur differs from that of headers: a panel's rim makes it 0.1 at 95 m, before a bright sky.

In hard shake more and more of the panel's edge was taken for blur, until the array was lost.
"""

FOUND_SPREAD = np.array([1.0, 1.0, 1e-3, 1e-4, 1e-2])
"""Variances added to a detection's pose vector for the motion since its middle: 1 px, and 3 % of the pitch.

1 px is what hard shake moves an array by in a pattern (`START_RATES`), 3 % are a quarter of a step between the sizes
looked for (`SIDE_STEP`). Roll gets 0.01 rad, ln blur 0.1. Half and twice of it lose none of 192 codewords.
"""


class Tracker:
    """Follows arrays from pair to pair; tracks are values, and the tracker itself holds no state."""

    def __init__(self, side: int, model: MotionModel):
        self._side, self._model = side, model

    def start(self, detection: Detection) -> Track:
        """Begin to follow an array that was found."""
        fit = detection.fit
        state = PoseState.start(detection.time_s, fit.vector, widened(fit.covariance), self._model, detection.drift)
        change = around_leds(detection.led_gains, fit.pose)
        # cells without alternation may be hidden or dead
        return Track(state, fit.gain, fit.gain, detection.led_gains, detection.time_s, change)

    def follow(self, track: Track, pair: FramePair, header: Floats | None = None) -> TrackedPair:
        """Find the array in the sum of a pair and move the filter on; coast where it is not seen."""
        predicted = self.predict(track, pair.time_s)
        pose = predicted.pose
        window = track.drawn.window(pose, self._side, _margin(pose))
        corner, up, down = _cut(pair, window)
        seen = look(track, up, down, corner, pose)
        before, track, total = track, seen.track, seen.total
        open_leds, hides = track.unhidden, track.hidden
        unhidden = self._unhidden(track, open_leds, pose, corner, up.shape) if hides or not track.sound else None
        if (hides and open_leds.mean() < LEAST_IN_SIGHT) or (unhidden is not None and not unhidden.any()):
            return _coasted(before, replace(track, state=predicted))
        # (pattern) + (inverse) = every LED on, Fig. 9
        observation = sum_observation(pair.late_s)
        mean, covariance = predicted.expected(observation)
        prior = Prior(np.concatenate([mean, predicted.tilt.mean]), covariance, track.gain)
        if header is not None and pair.combination is None:
            left = self._left_by_motion(predicted, pair, corner, total.shape, header * track.shining)
            total = total - track.data_gain * left
        sums_fit = partial(
            fit_array,
            total,
            corner,
            prior,
            track.shining,
            panel=True,
            open_pixels=unhidden,
            smear=self._smear(predicted),
        )
        fit = sums_fit(PAIR_STEPS, drawn=track.drawn)
        if self._unsure(predicted) and (hides or not _as_expected(track, pose, fit)):
            # a start of its own saves a step
            fit = sums_fit(PAIR_STEPS - 1, start=self._unresolved(total, corner, prior, track.shining, unhidden))
        pose, gain = fit.pose, track.gain
        there = _inside(pose, pair.pattern) and is_active(seen.differs, seen.noise, pose, corner, self._side, gain)
        if there:
            shown = fit.vector[:POSE_SIZE].copy()
            blur = float(predicted.mean[4])
            shown[4] = min(max(shown[4], blur - MOST_SUM_BLUR), blur + MOST_SUM_BLUR)
            state = predicted.condition(shown, fit.covariance, observation)
            # what hides a part of the array has light of its own
            gain = gain if hides else self._gain(track, fit)
            score = track.score + GAIN_RATE * (fit.score - track.score)
            after = track.found(state, gain, score, predicted.time_s)
        else:
            after = replace(track, state=predicted)
        return TrackedPair(before, after, fit, there)

    def refine(self, track: Track, pair: FramePair, weights: Floats) -> Track:
        """Refine pitch, roll, blur and tilt by a header, after its sum was followed."""
        state, tilt = track.state, track.state.tilt
        corner, up, down = _cut(pair, window_around(state.pose, self._side, _margin(state.pose)))
        mean, covariance = state.expected(HEADER_OBSERVATION)
        both = np.zeros((POSE_SIZE + 2, POSE_SIZE + 2))
        both[:POSE_SIZE, :POSE_SIZE], both[POSE_SIZE:, POSE_SIZE:] = covariance, tilt.covariance
        prior = Prior(np.append(mean, tilt.mean), both)
        fit = fit_array(up - down, corner, prior, weights * track.shining, PAIR_STEPS, smear=self._smear(state))
        if fit.score < HEADER_SCORE:
            return track
        state = state.condition(fit.vector[:POSE_SIZE], fit.covariance[:POSE_SIZE, :POSE_SIZE], HEADER_OBSERVATION)
        state = replace(state, tilt=Tilt(fit.vector[POSE_SIZE:], fit.covariance[POSE_SIZE:, POSE_SIZE:]))
        return replace(track, state=state, data_gain=fit.gain)

    def sees(self, track: Track, pair: FramePair, fit: Fit) -> bool:
        """Whether the array is in sight where a fit has it, by two frames that show different patterns."""
        corner, up, down = _cut(pair, window_around(track.state.pose, self._side, _margin(track.state.pose)))
        noise = noise_around(up - down, track.state.pose, corner, self._side)
        pose = fit.pose
        return _inside(pose, pair.pattern) and is_active(up - down, noise, pose, corner, self._side, track.gain)

    def predict(self, track: Track, time_s: float) -> PoseState:
        """State at a time; before the track's own time the state is taken as it is."""
        if time_s <= track.state.time_s:
            return replace(track.state, time_s=time_s)
        return track.state.predict(time_s, self._model)

    def _left_by_motion(
        self,
        predicted: PoseState,
        pair: FramePair,
        corner: tuple[int, int],
        shape: tuple[int, int],
        header: Floats,
    ) -> Floats:
        """What a header and its inverse leave in their sum where the array moves between them, for a gain of 1."""
        # A_1 Y + A_2 (1 - Y) = (A_1 + A_2) / 2 + (A_1 - A_2) (Y - 1/2), Y being the header
        from heliograph.receive.geometry import kernels  # Numba is slow to import

        images = np.empty((2, 6, *shape))
        for frame, image in zip((pair.pattern, pair.inverted), images, strict=True):
            pose = predicted.pose_at(frame.time_s)
            kernels.render(pose.full_vector(), header, float(corner[0]), float(corner[1]), image, 0.0, 0.0)
        return np.asarray(0.5 * (images[0, 0] - images[1, 0]))

    def _smear(self, state: PoseState) -> tuple[float, float]:
        """Standard deviations in px of the array's motion while a pair's light shone: evenly over two patterns."""
        # (2 v T_b)^2 / 12, v by the filter
        x, y, *_ = state.mean[RATE_STATES].tolist()
        spread = 2 * self._model.period_s / sqrt(12)
        return min(spread * abs(x), MOST_SMEAR_PX), min(spread * abs(y), MOST_SMEAR_PX)

    def _unsure(self, predicted: PoseState) -> bool:
        """Whether the prediction may be a pitch off, so that resolved LEDs would be taken for their neighbours."""
        spread = sqrt(max(predicted.covariance[0, 0], predicted.covariance[1, 1]))
        pitch = predicted.pose.pitch
        return pitch > RESOLVED_PX and spread > UNSURE_PITCHES * pitch

    def _unresolved(
        self, total: Floats, corner: tuple[int, int], prior: Prior, led_gains: Floats, unhidden: Floats | None
    ) -> Floats:
        """Start of the fit, found on pixels so blurred that no LED can be taken for its neighbour."""
        pose = Pose.from_vector(prior.vector)
        sigma = UNRESOLVED_BLUR_PITCHES * pose.pitch
        vector, covariance = prior.vector.copy(), prior.covariance.copy()
        vector[4] = np.log(np.hypot(pose.blur, sigma))
        covariance[[0, 1], [0, 1]] += pose.pitch**2
        smooth = np.asarray(cv2.GaussianBlur(total, (0, 0), sigma), np.float64)
        # an even square stands for the array as long as all of it shines
        failed = bool((led_gains < 1).any())
        wide = Prior(vector, covariance, prior.gain)
        # it need come near only: one step
        fit = fit_array(smooth, corner, wide, led_gains, 1, panel=True, resolved=failed, open_pixels=unhidden)
        found = fit.vector.copy()
        found[4] = prior.vector[4]
        return found

    def _gain(self, track: Track, fit: Fit) -> float:
        """The sums' gain after one more, within what a panel may add to the headers' or take from it."""
        gain = track.gain + GAIN_RATE * (fit.gain - track.gain)
        return min(max(gain, track.data_gain / GAIN_RATIO), track.data_gain * GAIN_RATIO)

    def _unhidden(
        self, track: Track, open_leds: Floats, pose: Pose, corner: tuple[int, int], shape: tuple[int, int]
    ) -> Floats | None:
        """Pixels (rows, columns) that count in a sum, 1 or 0; None where all do."""
        # what a header found hidden may be in sight by now, what it found dead is not: that is no zone of its own
        dark = track.led_gains == 0
        zone = dark_zone(dark, pose) if dark.any() else dark
        sure = np.where(zone, 0.0, open_leds) if zone.any() else open_leds
        if sure.mean() < LEAST_IN_SIGHT:
            sure = open_leds
        return None if sure.all() else open_pixels(sure, pose, corner, shape)


def _margin(pose: Pose) -> float:
    """Pixels around an array that are fitted with it."""
    return WINDOW_MARGIN_PITCHES * pose.pitch + WINDOW_MARGIN_PX


def _cut(pair: FramePair, window: Window) -> tuple[tuple[int, int], Floats, Floats]:
    """The array's surroundings in both frames, and their corner."""
    return (window[0], window[1]), cut_out(pair.pattern, window), cut_out(pair.inverted, window)


def _as_expected(track: Track, predicted: Pose, fit: Fit) -> bool:
    """Whether a fit lies where it was expected and is as good as recent ones: no LED is taken for its neighbour."""
    x, y, *_ = fit.vector.tolist()
    away = max(abs(x - predicted.x), abs(y - predicted.y))
    return away < AS_EXPECTED_PITCHES * predicted.pitch and fit.score > track.score - LESS_ALIKE


def widened(covariance: Floats) -> Floats:
    """A detection's covariance with room for the motion since its middle."""
    wider = covariance.copy()
    wider[np.arange(5), np.arange(5)] += FOUND_SPREAD
    return wider


def _coasted(before: Track, track: Track) -> TrackedPair:
    """A pair in which the array is not in sight: its pose is the one predicted."""
    state = track.state
    vector = np.append(state.mean[:POSE_SIZE], state.tilt.mean)
    fit = Fit(vector, state.covariance[:POSE_SIZE, :POSE_SIZE], track.gain, 0.0)
    return TrackedPair(before, track, fit, seen=False)


def _inside(pose: Pose, frame: AnyFrame) -> bool:
    """Whether the array's centre is in the frame."""
    x, y = pose.x - frame.origin[0], pose.y - frame.origin[1]
    return 0 <= x < frame.pixels.shape[1] and 0 <= y < frame.pixels.shape[0]
