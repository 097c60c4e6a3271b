"""Single mode, data without inverses: decisions on the data of every other frame track the array.

A frame shows r = g A x + b + n. In pairs the background b cancels; here the model is a combination of a square, the
panel with a width that the headers show, and a plane. At the predicted pose the symbols are equalised, and certain
symbols count as known. The light of these, the light of the levels' mean and the background form an image; the fit of
the image gives the pose. The light of undecided symbols is noise of known colour, so a guess made at a wrong pose does
not confirm the pose.
"""

from dataclasses import replace
from math import exp

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import block_diag
from scipy.optimize import minimize_scalar

from heliograph.base.arrays import RCOND, Floats
from heliograph.receive.equalise.lmmse import equalise, products
from heliograph.receive.geometry import kernels as geometry_kernels
from heliograph.receive.geometry.fit import Fit, correlation
from heliograph.receive.geometry.footprint import image_of, render_with_slopes, to_grid
from heliograph.receive.geometry.kernels import FIT
from heliograph.receive.geometry.pose import Corner, Pose, Shape
from heliograph.receive.geometry.window import RIM_PX, AnyFrame, covered, cut_out, plane, window_around
from heliograph.receive.observe.cutout import MAX_BACKGROUND, RING_PX, Cutout, Noise, measure_noise, take_cutout
from heliograph.receive.observe.statistics import PairStatistics, leds_of, whiten
from heliograph.receive.sync.pairing import FramePair
from heliograph.receive.track.kalman import POSE_SIZE, RATE_STATES, STATE_SIZE, PoseState
from heliograph.receive.track.track import Track, TrackedPair
from heliograph.receive.track.tracker import Tracker

# A header pair, and the pose of the array in each frame
HeaderPair = tuple[FramePair, tuple[Pose, Pose]]


# Errors of the image model in x, y (px), ln pitch, roll and ln blur
DECIDED = np.eye(POSE_SIZE, STATE_SIZE), np.diag([0.01, 0.01, 0.002, 0.001, 0.02]) ** 2


def surroundings(frame: AnyFrame, pose: Pose, side: int) -> tuple[Corner, Floats]:
    """Crop a frame around an array: corner (x, y) and pixels (rows, columns) in gray levels."""
    window = window_around(pose, side, RIM_PX + RING_PX)
    return (window[0], window[1]), cut_out(frame, window)


def background_images(pose: Pose, corner: Corner, shape: Shape, half: float) -> Floats:
    """Render the square and the plane, with derivatives by (x, y, ln pitch, roll, ln blur)."""
    out = np.zeros((4, 6, *shape))
    geometry_kernels.render_box(pose.full_vector(), half, float(corner[0]), float(corner[1]), out[0], 0.0, 0.0)
    out[1:, 0] = plane(*shape)
    return out


def fit_background(headers: list[HeaderPair], gain: float, led_gains: Floats) -> tuple[float, Floats, float]:
    """Fit the background to header pairs.

    Returns half of the panel's side in pitches, (4,) coefficients of the square and the plane in gray levels, and the
    variance of the residual around the array in squared gray levels.

    The sum of a header and the inverse is the array with all LEDs on: r + r' = g (A + A') 1 / 2 + 2 b. The pose comes
    from the difference, in which the panel cancels, so the sum shows the width of the panel.
    """
    side, views = len(led_gains), []
    for pair, poses in headers:
        middle = Pose.midway(*poses)
        corner, up = surroundings(pair.pattern, middle, side)
        _, down = surroundings(pair.inverted, middle, side)
        lit = sum((image_of(led_gains, pose, corner, up.shape) for pose in poses), np.zeros(up.shape))
        around = image_of(np.ones((side, side)), middle, corner, up.shape) < MAX_BACKGROUND
        views.append((0.5 * (up + down - 0.5 * gain * lit), middle, corner, around))

    def fit(half: float) -> list[tuple[Floats, Floats]]:
        """Fit coefficients to each header; return them with the squared residuals (rows, columns)."""
        fits = []
        for image, pose, corner, _ in views:
            columns = background_images(pose, corner, image.shape, half)[:, 0].reshape(4, -1).T
            coefficients = np.asarray(np.linalg.lstsq(columns, image.ravel(), rcond=RCOND)[0], np.float64)
            fits.append((coefficients, (image - (columns @ coefficients).reshape(image.shape)) ** 2))
        return fits

    def loss(half: float) -> float:
        return sum(float(squares.sum()) for _, squares in fit(half))

    # rims of up to three pitches beyond half a pitch around the outer LEDs
    halves = 0.5 * side + np.arange(0.25, 3.01, 0.25)
    near = float(halves[int(np.argmin([loss(half) for half in halves]))])
    bounds = (near - 0.25, near + 0.25)
    half = float(minimize_scalar(loss, bounds=bounds, method="bounded", options={"xatol": 5e-3}).x)
    fits = fit(half)
    residuals = np.concatenate([squares[around] for (*_, around), (_, squares) in zip(views, fits, strict=True)])
    variance = float(residuals.mean()) if residuals.size else 0.0
    return half, np.mean([coefficients for coefficients, _ in fits], axis=0), variance


class DecisionDirectedTracker:
    """Tracks an array through the data of a packet without inverses."""

    def __init__(
        self, tracker: Tracker, late_s: tuple[float, float], headers: list[HeaderPair], gain: float, led_gains: Floats
    ):
        self._tracker, self._late_s, self._gain, self._led_gains = tracker, late_s, gain, led_gains
        self._side = len(led_gains)
        self._half, self._background, variance = fit_background(headers, gain, led_gains)
        # motion has the same effect on successive sums of headers, unlike random data: gain 0 subtracts no such effect
        cutouts = [take_cutout(pair, poses, self._side) for pair, poses in headers]
        noise = measure_noise(cutouts, 0.0, self._side, led_gains)
        # a single frame's cut-out is twice the frame: twice the variance of a difference of two
        self.noise = Noise(2 * noise.lit, max(2 * noise.dark, 4 * variance))

    def follow(self, track: Track, pair: FramePair) -> TrackedPair:
        """Update the track by two frames; predict only if the array is not visible."""
        background = self._background
        # a fit of the first frame as well takes twice as long and does not lower the bit errors
        state = self._tracker.predict(track, pair.inverted.time_s)
        fit = self._fit_pose(pair.inverted, state)
        after = replace(track, state=state.condition(fit.vector[:POSE_SIZE], fit.covariance, DECIDED))
        is_visible = self._tracker.is_visible(after, pair, fit)
        if is_visible:
            after = replace(after, last_seen_s=after.state.time_s)
        else:
            # an occluder is not background
            self._background = background
            after = replace(track, state=state)
        cutouts = self._cut_out(pair.pattern, after.state), self._cut_out(pair.inverted, after.state)
        return TrackedPair(track, after, fit, is_visible, cutouts)

    def _cut_out(self, frame: AnyFrame, state: PoseState) -> Cutout:
        """Cut out a frame less the background at the poses of a state."""
        # the background shines during the entire exposure
        middle = state.pose_at(frame.time_s)
        mean_light, data = (state.pose_at(frame.time_s + late_s) for late_s in self._late_s)
        return self._subtract_background(frame, middle, mean_light, data, self._background)[0]

    def _subtract_background(
        self, frame: AnyFrame, middle: Pose, mean_light: Pose, data: Pose, coefficients: Floats
    ) -> tuple[Cutout, Floats]:
        """Make a cut-out of a frame less the background; return also the background's images."""
        corner, image = surroundings(frame, middle, self._side)
        images = background_images(middle, corner, image.shape, self._half)
        above = 2 * (image - np.tensordot(coefficients, images[:, 0], 1))
        inside = covered((frame,), corner, image.shape)
        return Cutout(above, above, corner, (data,), mean_light, covered=inside), images

    def _fit_pose(self, frame: AnyFrame, state: PoseState) -> Fit:
        """Fit pose, gain and background.

        A Gauss-Newton step from the prediction of covariance P: (P^-1 + D^T C^-1 D)^-1 D^T C^-1 e, with e, D and C as
        in `_build_equations`. The prediction is so near that a second step has no effect.
        """
        expected, covariance = state.expected(DECIDED)
        start = np.concatenate([expected, [self._gain], self._background])
        # a third of the change of the gain by random data; gray levels of the background about earlier frames
        spreads = np.append(0.01 * self._gain, np.full(4, 5.0))
        precision = block_diag(np.linalg.inv(covariance), np.diag(spreads**-2))
        matrix, rhs, score = self._build_equations(frame, state, start)
        step = np.linalg.solve(matrix + precision, rhs)
        # without an array, steps have any length
        longest = [max(FIT.max_step_px, 0.5 * exp(expected[2]))] * 2 + [*FIT.max_steps[: POSE_SIZE - 2]]
        step[:POSE_SIZE] = np.clip(step[:POSE_SIZE], np.negative(longest), longest)
        end = start + step
        # five frames of a changing scene count
        self._background = self._background + 0.2 * (end[POSE_SIZE + 1 :] - self._background)
        after = np.asarray(np.linalg.inv(matrix + precision)[:POSE_SIZE, :POSE_SIZE], np.float64)
        return Fit(np.append(end[:POSE_SIZE], state.tilt), after, float(end[POSE_SIZE]), score)

    def _build_equations(self, frame: AnyFrame, state: PoseState, at: Floats) -> tuple[Floats, Floats, float]:
        """Compute D^T C^-1 D, D^T C^-1 e and the correlation of frame and image; rates and tilt of the state are fixed.

        e is twice the frame less the known image, D the derivatives of the image and C = g^2 B B^T + s^2 the noise,
        which includes the light of the undecided symbols.
        """
        middle, gain = Pose.from_vector(np.append(at[:POSE_SIZE], state.tilt)), float(at[POSE_SIZE])
        mean_light, data = (middle.moved(*(late_s * state.mean[RATE_STATES][:2])) for late_s in self._late_s)
        cutout, background = self._subtract_background(frame, middle, mean_light, data, at[POSE_SIZE + 1 :])
        whitened = whiten(cutout, self.noise, self._side, self._led_gains)
        known, unknown = self._decide_symbols(whitened.statistics, gain)
        lit = self._render_known(known, mean_light, data, cutout.corner, cutout.shape)
        slopes = gain * lit[1:] + np.tensordot(at[POSE_SIZE + 1 :], background[:, 1:], 1)
        residual = whitened.difference - 2 * gain * whitened.root * lit[0]
        columns = 2 * whitened.root * np.concatenate([slopes, lit[:1], background[:, 0]])
        images = np.concatenate([columns, residual[None]])
        part = products(whitened, images, unknown, gain**2 / self.noise.lit) / self.noise.lit
        score = correlation(whitened.difference, whitened.root * 2 * gain * lit[0])
        return part[:-1, :-1], part[:-1, -1], score

    def _decide_symbols(self, pair: PairStatistics, gain: float) -> tuple[Floats, NDArray[np.intp]]:
        """Means of the symbols, 0 for undecided symbols, and the numbers of the undecided symbols."""
        size = self._side**2
        # LLR = 2 eta_cavity, with the other symbols as Gaussian
        mean = np.tanh(equalise(pair, gain, self.noise.lit, np.zeros(size), np.ones(size)).extrinsic[1])
        # wrong in 1.5 % of cases
        decided = np.abs(mean) > 0.97
        return np.where(decided, mean, 0.0), np.flatnonzero(~decided)

    def _render_known(self, known: Floats, mean_light: Pose, data: Pose, corner: Corner, shape: Shape) -> Floats:
        """Render the known symbols and the levels' mean, with derivatives by the pose, (6, rows, columns)."""
        levels = to_grid(0.5 * leds_of(known))
        varied = render_with_slopes(data, levels * self._led_gains, corner, shape)
        return np.asarray(varied + render_with_slopes(mean_light, 0.5 * self._led_gains, corner, shape))
