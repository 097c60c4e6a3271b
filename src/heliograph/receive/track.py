"""Tracking: the sum of a pattern and its inverse shows every LED, so each pair gives the pose anew."""

from dataclasses import dataclass, replace
from math import erf, exp, pi, sqrt

import cv2
import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.receive.detect import Detection, cut_out
from heliograph.receive.fit import Fit, Prior, fit_array, spread_of, window_around
from heliograph.receive.kalman import DIFFERENCE, SHOWN, PoseState, Tilt, sum_view
from heliograph.receive.pose import Pose
from heliograph.receive.settings import TrackSettings

Floats = NDArray[np.float64]

MARGIN_PITCHES, MARGIN_PX = 1.5, 1.5
"""Width of the array's surroundings that are fitted too: they hold its edge, the panel's and the background."""


PIXEL = 12**-0.5
"""Standard deviation in pixels of a pixel's own width."""

NOISY = 1.5
"""Change that noise may give, in its variance: that of some hundred pixels is known to a fifth."""

RESOLVED_PX = 1.0
"""Pitch from which on single LEDs show in a sum."""


@dataclass(frozen=True, slots=True)
class TrackedPair:
    """A pattern and its inverse with the pose found in their sum.

    Attributes
    ----------
    state
        Pose and rates in the middle of the pair.
    fit
        The fit of the sum.
    seen
        Whether the array was in sight.
    """

    state: PoseState
    fit: Fit
    seen: bool


class Tracker:
    """Follows one array from pair to pair.

    Parameters
    ----------
    detection
        Where it was found.
    side
        LEDs in a row.
    settings
        Its tunables.

    Attributes
    ----------
    shares
        (n, n) what each LED gives of its light, as far as a reading of the data has found out.
    """

    def __init__(self, detection: Detection, side: int, settings: TrackSettings):
        fit = detection.fit
        self._settings = settings
        self.shares = detection.shares
        self._side = side
        self.state = PoseState.start(detection.time_s, fit.vector, widened(fit.covariance))
        self._before = self.state
        self.last_seen_s = detection.time_s
        self.gain = fit.gain
        self.data_gain = fit.gain

    def follow(self, pattern: Frame, inverted: Frame, late_s: float = 0.0) -> TrackedPair:
        """Find the array in the sum of a pair and move the filter on; coast where it is not seen.

        Parameters
        ----------
        pattern, inverted
            The two frames.
        late_s
            By how much the light of their sum comes after the middle of the exposures: PWM lights the first slots more.
        """
        self._before = self.state
        predicted = self.predict(0.5 * (pattern.time_s + inverted.time_s))
        corner, up, down = self._cut(pattern, inverted, predicted)
        # (pattern) + (inverse) = every LED on, Fig. 9
        view = sum_view(late_s)
        mean, covariance = predicted.expected(view)
        prior = Prior(np.append(mean, predicted.tilt.mean), covariance, self.gain)
        total = up + down
        start = self._unresolved(total, corner, prior) if self._unsure(predicted) else None
        # a start of its own saves a step
        steps = self._settings.iterations - (start is not None and self._settings.iterations > 1)
        fit = fit_array(total, corner, prior, self.shares, steps, panel=True, start=start)
        seen = self._inside(fit, pattern) and self._active(up - down, fit.pose, corner)
        if seen:
            predicted = predicted.condition(fit.vector[:SHOWN], fit.covariance, view)
            self.last_seen_s = predicted.time_s
            self.gain += 0.1 * (fit.gain - self.gain)
        self.state = predicted
        return TrackedPair(predicted, fit, seen)

    def again(self, pattern: Frame, inverted: Frame) -> TrackedPair:
        """Follow the last pair anew, as if it had not been followed."""
        self.state = self._before
        return self.follow(pattern, inverted)

    def refine(self, pattern: Frame, inverted: Frame, weights: NDArray[np.float64]) -> None:
        """Sharpen pitch, rotation, blur and tilt by a header of known `weights`, after its sum was followed."""
        corner, up, down = self._cut(pattern, inverted, self.state)
        mean, covariance = self.state.expected(DIFFERENCE)
        tilt = self.state.tilt
        both = np.zeros((SHOWN + 2, SHOWN + 2))
        both[:SHOWN, :SHOWN], both[SHOWN:, SHOWN:] = covariance, tilt.covariance
        prior = Prior(np.append(mean, tilt.mean), both)
        fit = fit_array(up - down, corner, prior, weights * self.shares, self._settings.iterations)
        if fit.score >= self._settings.score:
            state = self.state.condition(fit.vector[:SHOWN], fit.covariance[:SHOWN, :SHOWN], DIFFERENCE)
            self.state = replace(state, tilt=Tilt(fit.vector[SHOWN:], fit.covariance[SHOWN:, SHOWN:]))
            self.data_gain = fit.gain

    def sees(self, first: Frame, second: Frame, fit: Fit) -> bool:
        """Whether the array is in sight where a fit has it, by two frames that show different patterns."""
        corner, up, down = self._cut(first, second, self.state)
        return self._inside(fit, first) and self._active(up - down, fit.pose, corner)

    def predict(self, time_s: float) -> PoseState:
        """The state at a time; pairs seen before the detection's own time take it as it is."""
        if time_s <= self.state.time_s:
            return replace(self.state, time_s=time_s)
        return self.state.predict(time_s, self._settings)

    def _unsure(self, predicted: PoseState) -> bool:
        """Whether the prediction may be a pitch off, so that resolved LEDs would be taken for their neighbours."""
        spread = float(np.sqrt(predicted.covariance[:2, :2].diagonal().max()))
        pitch = predicted.pose.pitch
        return pitch > RESOLVED_PX and spread > 0.2 * pitch

    def _unresolved(self, total: Floats, corner: tuple[int, int], prior: Prior) -> Floats:
        """Start of the fit found on pixels so blurred that no LED can be taken for its neighbour."""
        pose = Pose.of(prior.vector)
        sigma = 0.5 * pose.pitch
        vector, covariance = prior.vector.copy(), prior.covariance.copy()
        vector[4] = np.log(np.hypot(pose.blur, sigma))
        covariance[[0, 1], [0, 1]] += pose.pitch**2
        smooth = np.asarray(cv2.GaussianBlur(total, (0, 0), sigma), np.float64)
        # an even square stands for the array as long as all of it shines
        failed = bool((self.shares < 1).any())
        wide = Prior(vector, covariance, prior.gain)
        # it need come near only: one step
        fit = fit_array(smooth, corner, wide, self.shares, 1, panel=True, resolved=failed)
        found = fit.vector.copy()
        found[4] = prior.vector[4]
        return found

    def _cut(self, pattern: Frame, inverted: Frame, state: PoseState) -> tuple[tuple[int, int], Floats, Floats]:
        """The array's surroundings in both frames, and their corner."""
        margin = MARGIN_PITCHES * state.pose.pitch + MARGIN_PX
        x0, y0, width, height = window_around(state.pose, self._side, margin)
        return (x0, y0), cut_out(pattern, x0, y0, width, height), cut_out(inverted, x0, y0, width, height)

    def _active(self, change: Floats, pose: Pose, corner: tuple[int, int]) -> bool:
        """Whether pattern and inverse differ where the array should be: a hidden or dark array shows no change."""
        half = 0.5 * self._side * pose.pitch
        down, right = (
            np.abs(np.arange(n) + c)
            for n, c in zip(change.shape, (corner[1] - pose.y, corner[0] - pose.x), strict=True)
        )
        away = np.maximum(down[:, None], right)
        inner, around = change[away <= max(half - 1, 1) + 0.5], change[away > half + 1]
        noise = spread_of(around) if around.size else 0.0
        least = self._settings.activity * contrast(pose) * self.gain
        return bool(inner.size and np.mean(inner**2) >= least**2 + NOISY * noise**2)

    def _inside(self, fit: Fit, frame: Frame) -> bool:
        """Whether the array's centre is in the frame."""
        x, y = fit.vector[0] - frame.origin[0], fit.vector[1] - frame.origin[1]
        return bool(0 <= x < frame.pixels.shape[1] and 0 <= y < frame.pixels.shape[0])


def contrast(pose: Pose) -> float:
    """Share of the contrast of cells of 2 x 2 LEDs, the coarsest there are, that blur and pixels leave, 0 to 1."""
    # along x and y alike: int (box * Gaussian)^2 / w = erf u - (1 - exp(-u^2)) / (sqrt(pi) u), u = w / 2 s
    u = pose.pitch / float(np.hypot(pose.blur, PIXEL))
    return erf(u) - (1 - exp(-(u**2))) / (sqrt(pi) * u)


def widened(covariance: NDArray[np.float64]) -> NDArray[np.float64]:
    """A detection's covariance with room for the motion since its middle."""
    wider = covariance.copy()
    wider[np.arange(5), np.arange(5)] += [1.0, 1.0, 1e-3, 1e-4, 1e-2]
    return wider
