"""Background of an array in single frames: a panel of unknown width and gray before an even background.

In a pair of pattern and inverse the background cancels. A single frame shows it, and the panel's rim lies within the
blur of the outer LEDs. The model is a combination of a square, whose size the headers tell, and a plane.

Data without inverses: the array followed by decisions on the data of every other frame.

A frame shows r = g A x + b + n. At the predicted pose its symbols are equalised, and those beyond doubt are taken as
known. Their light, the light of the levels' mean and the background have an image whose fit gives the pose. The light
of the undecided symbols is noise of known colour, so a guess made at a wrong pose does not confirm that pose.
"""

from dataclasses import dataclass, replace
from math import exp

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from heliograph.base.arrays import RCOND, Floats
from heliograph.base.threads import one_thread
from heliograph.receive.equalise.lmmse import equalise, products
from heliograph.receive.geometry import kernels as image_kernels
from heliograph.receive.geometry.fit import Fit, correlation
from heliograph.receive.geometry.footprint import image_of, to_grid
from heliograph.receive.geometry.kernels import LONGEST, LONGEST_PX
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.geometry.window import RIM_PX, ImagePatch, covered, cut_out, plane, window_around
from heliograph.receive.observe import kernels
from heliograph.receive.observe.cutout import RING_PX, Cutout, take_cutout
from heliograph.receive.observe.noise import BESIDE, Noise, measure_noise
from heliograph.receive.observe.statistics import PairStatistics, whiten
from heliograph.receive.sync.pairing import AnyFrame, FramePair
from heliograph.receive.track.kalman import POSE_SIZE, RATE_STATES, STATE_SIZE, Observation, PoseState
from heliograph.receive.track.track import Track, TrackedPair
from heliograph.receive.track.tracker import Tracker

IMAGE_COUNT = 4
"""Images that are combined: a square, and the three of a plane."""

MARGINS = np.arange(0.25, 3.01, 0.25)
"""Rims of a panel tried first, in pitches beyond half a pitch about the outer LEDs; the best is then refined."""

RIM_TOLERANCE = 5e-3
"""Accuracy of the rim in pitches: 0.004 px at 80 m."""


@dataclass(frozen=True, slots=True)
class SeenHeader:
    """A header pair, and the array's pose in each frame."""

    # Frames of the header and its inverse
    pair: FramePair
    # The array's pose in each of them
    poses: tuple[Pose, Pose]


@dataclass(frozen=True, slots=True)
class Background:
    """What is behind an array."""

    # Half of the panel's side, in pitches
    half: float
    # (4,) of the square and the plane, in gray levels
    coefficients: Floats
    # Variance that the model leaves beside the array, in squared gray levels
    variance: float


def surroundings(frame: ImagePatch, pose: Pose, side: int) -> tuple[tuple[int, int], Floats]:
    """Window about an array: its corner (x, y), and its pixels (rows, columns) in gray levels."""
    window = window_around(pose, side, RIM_PX + RING_PX)
    return (window[0], window[1]), cut_out(frame, window)


def background_images(pose: Pose, corner: tuple[int, int], shape: tuple[int, int], half: float) -> Floats:
    """Images of the background, with derivatives by (x, y, ln pitch, roll, ln blur)."""
    out = np.zeros((IMAGE_COUNT, 6, *shape))
    image_kernels.render_box(pose.full_vector(), half, float(corner[0]), float(corner[1]), out[0])
    out[1:, 0] = plane(*shape)
    return out


def fit_background(headers: list[SeenHeader], gain: float, led_gains: Floats) -> Background:
    """Background by header pairs.

    The sum of a header and its inverse is the array with all LEDs on: r + r' = g (A + A') 1 / 2 + 2 b. The pose is
    known from their difference, in which the panel cancels, so the sum shows how wide the panel is.
    """
    views = [_behind(header, gain, led_gains) for header in headers]

    def loss(half: float) -> float:
        return sum(float(_fitted(view, half)[1].sum()) for view in views)

    halves = 0.5 * len(led_gains) + MARGINS
    near = float(halves[int(np.argmin([loss(half) for half in halves]))])
    step = float(MARGINS[1] - MARGINS[0])
    bounds = (near - step, near + step)
    half = float(minimize_scalar(loss, bounds=bounds, method="bounded", options={"xatol": RIM_TOLERANCE}).x)
    found = [_fitted(view, half) for view in views]
    beside = np.concatenate([squares[view.beside] for view, (_, squares) in zip(views, found, strict=True)])
    variance = float(beside.mean()) if beside.size else 0.0
    return Background(half, np.mean([one for one, _ in found], axis=0), variance)


@dataclass(frozen=True, slots=True)
class _Behind:
    """A header pair less the array's light: (rows, columns), the pose, the corner, and which pixels are beside it."""

    background: Floats
    pose: Pose
    corner: tuple[int, int]
    beside: NDArray[np.bool_]


def _behind(header: SeenHeader, gain: float, led_gains: Floats) -> _Behind:
    middle, side = Pose.midway(*header.poses), len(led_gains)
    corner, up = surroundings(header.pair.pattern, middle, side)
    _, down = surroundings(header.pair.inverted, middle, side)
    rows, cols = up.shape
    lit = sum((image_of(led_gains, pose, corner, (rows, cols)) for pose in header.poses), np.zeros(up.shape))
    beside = image_of(np.ones((side, side)), middle, corner, (rows, cols)) < BESIDE
    return _Behind(0.5 * (up + down - 0.5 * gain * lit), middle, corner, beside)


def _fitted(view: _Behind, half: float) -> tuple[Floats, Floats]:
    """Least squares coefficients of the images, and the squared residuals (rows, columns)."""
    rows, cols = view.background.shape
    columns = background_images(view.pose, view.corner, (rows, cols), half)[:, 0].reshape(IMAGE_COUNT, -1).T
    coefficients = np.asarray(np.linalg.lstsq(columns, view.background.ravel(), rcond=RCOND)[0], np.float64)
    return coefficients, (view.background - (columns @ coefficients).reshape(rows, cols)) ** 2


DECIDED = Observation(np.eye(POSE_SIZE, STATE_SIZE), np.array([0.01, 0.01, 0.002, 0.001, 0.02]) ** 2)
"""What a frame of decided data shows; the variances are those of the images' model.

Chosen: 0.01 px, and of ln pitch and ln blur what sums have (`SUM_SPREAD`).
"""

DECIDED_MEAN = 0.97
"""Least mean of a decided symbol, in magnitude: it is wrong in 1.5 % of cases."""

FRAME_GAIN_SPREAD = 0.01
"""Standard deviation of a frame's gain, as a fraction of it; the light of LEDs is steady, and the sensor linear.

It is a tolerance: a third of the 3 % by which random data change an array's light (`DEVIATION` of `light_clock`), so
that bright data are not taken for a larger gain. Half and twice of it lose none of 192 codewords.
"""

BACKGROUND_SPREAD = 5.0
"""Standard deviation in gray levels by which the background may differ from that of the frames before.

A background that brightens by one level a frame is 1 / `BACKGROUND_WEIGHT` = 5 levels above its mean of the frames
before. Half and twice of it lose none of 192 codewords.
"""

BACKGROUND_WEIGHT = 0.2
"""Weight of a frame in the background: five frames of a changing scene count."""


class DecisionDirectedTracker:
    """Follows an array through the data of a packet without inverses."""

    def __init__(
        self, tracker: Tracker, late_s: tuple[float, float], headers: list[SeenHeader], gain: float, led_gains: Floats
    ):
        self._tracker, self._late_s, self._gain, self._led_gains = tracker, late_s, gain, led_gains
        self._side = len(led_gains)
        found = fit_background(headers, gain, led_gains)
        self._half, self._background = found.half, found.coefficients
        # motion changes headers alike in successive sums, unlike random data: with gain 0 nothing is taken off for it
        cutouts = [take_cutout(header.pair, header.poses, self._side) for header in headers]
        seen = measure_noise(cutouts, 0.0, self._side, led_gains)
        # a single frame's cut-out is twice the frame: twice the variance of a difference of two
        self.noise = Noise(2 * seen.lit, max(2 * seen.dark, 4 * found.variance))

    @one_thread()
    def follow(self, track: Track, pair: FramePair) -> TrackedPair:
        """Find the array in two frames and move the filter on; coast where it is not seen."""
        background = self._background
        # fitting the first frame too would take as long again, and as many bits are wrong with it as without
        fit, state = self._step(track, pair.inverted)
        after = replace(track, state=state)
        seen = self._tracker.is_visible(after, pair, fit)
        if seen:
            after = replace(after, last_seen_s=state.time_s)
        else:
            # what passes before the array is not its background
            self._background = background
            after = replace(track, state=self._tracker.predict(track, pair.inverted.time_s))
        # the earlier pose too is known better now
        cutouts = self._cutout(pair.pattern, after.state), self._cutout(pair.inverted, after.state)
        return TrackedPair(track, after, fit, seen, cutouts)

    def _step(self, track: Track, frame: AnyFrame) -> tuple[Fit, PoseState]:
        """Find the array in a frame; the state given it."""
        state = self._tracker.predict(track, frame.time_s)
        fit = self._fit(frame, state)
        return fit, state.condition(fit.vector[:POSE_SIZE], fit.covariance, DECIDED)

    def _cutout(self, frame: AnyFrame, state: PoseState) -> Cutout:
        """A frame less its background, the array where `state` has it."""
        # the background shines all through the exposure
        middle = state.pose_at(frame.time_s)
        mean_light, data = (state.pose_at(frame.time_s + late_s) for late_s in self._late_s)
        corner, image = surroundings(frame, middle, self._side)
        rows, cols = image.shape
        background = background_images(middle, corner, (rows, cols), self._half)[:, 0]
        above = image - np.tensordot(self._background, background, 1)
        return _single_cutout(frame, above, corner, data, mean_light)

    def _fit(self, frame: AnyFrame, state: PoseState) -> Fit:
        """Most probable pose, gain and background.

        One Gauss-Newton step from what was expected, with covariance P: (P^-1 + D^T C^-1 D)^-1 D^T C^-1 e, with e, D
        and C as in `_equations`. A frame's prediction is near enough that a second changes nothing.
        """
        expected, covariance = state.expected(DECIDED)
        start = np.concatenate([expected, [self._gain], self._background])
        precision = np.zeros((start.size, start.size))
        precision[:POSE_SIZE, :POSE_SIZE] = np.linalg.inv(covariance)
        spreads = np.append(FRAME_GAIN_SPREAD * self._gain, np.full(IMAGE_COUNT, BACKGROUND_SPREAD))
        precision[range(POSE_SIZE, start.size), range(POSE_SIZE, start.size)] = spreads**-2
        matrix, rhs, score = self._equations(frame, state, start)
        step = np.linalg.solve(matrix + precision, rhs)
        # what is no array gives steps of any length
        longest = [max(LONGEST_PX, 0.5 * exp(expected[2]))] * 2 + [*LONGEST[: POSE_SIZE - 2]]
        step[:POSE_SIZE] = np.clip(step[:POSE_SIZE], np.negative(longest), longest)
        found = start + step
        self._background = self._background + BACKGROUND_WEIGHT * (found[POSE_SIZE + 1 :] - self._background)
        after = np.asarray(np.linalg.inv(matrix + precision)[:POSE_SIZE, :POSE_SIZE], np.float64)
        vector = np.append(found[:POSE_SIZE], state.tilt.mean)
        return Fit(vector, after, float(found[POSE_SIZE]), score)

    def _equations(self, frame: AnyFrame, state: PoseState, at: Floats) -> tuple[Floats, Floats, float]:
        """D^T C^-1 D, D^T C^-1 e and the correlation of frame and image; `state` gives rates and tilt, which are held.

        e is twice the frame less the image of everything known, D the image's derivatives and C = g^2 B B^T + s^2 the
        noise, to which the light of the undecided symbols belongs.
        """
        middle, gain = Pose.from_vector(np.append(at[:POSE_SIZE], state.tilt.mean)), float(at[POSE_SIZE])
        mean_light, data = (middle.moved(*(late_s * state.mean[RATE_STATES][:2])) for late_s in self._late_s)
        corner, image = surroundings(frame, middle, self._side)
        rows, cols = image.shape
        background = background_images(middle, corner, (rows, cols), self._half)
        above = image - np.tensordot(at[POSE_SIZE + 1 :], background[:, 0], 1)
        cutout = _single_cutout(frame, above, corner, data, mean_light)
        whitened = whiten(cutout, self.noise, self._side, self._led_gains)
        pair = whitened.statistics()
        known, unknown = self._decided(pair, gain)
        lit = self._images(known, mean_light, data, corner, (rows, cols))
        slopes = gain * lit[1:] + np.tensordot(at[POSE_SIZE + 1 :], background[:, 1:], 1)
        left = whitened.difference - 2 * gain * whitened.root * lit[0]
        columns = 2 * whitened.root * np.concatenate([slopes, lit[:1], background[:, 0]])
        every = np.concatenate([columns, left[None]])
        part = products(whitened, pair, every, unknown, gain**2 / self.noise.lit) / self.noise.lit
        score = correlation(whitened.difference, whitened.root * 2 * gain * lit[0])
        return part[:-1, :-1], part[:-1, -1], score

    def _decided(self, pair: PairStatistics, gain: float) -> tuple[Floats, NDArray[np.intp]]:
        """Means of the symbols, 0 where they are not decided, and the numbers of these."""
        size = self._side**2
        # LLR = 2 eta_cavity: with the others as Gaussian fewer symbols are decided than with disturbers drawn from +-1
        mean = np.tanh(equalise(pair, gain, self.noise.lit, np.zeros(size), np.ones(size)).extrinsic[1])
        decided = np.abs(mean) > DECIDED_MEAN
        return np.where(decided, mean, 0.0), np.flatnonzero(~decided)

    def _images(
        self, known: Floats, mean_light: Pose, data: Pose, corner: tuple[int, int], shape: tuple[int, int]
    ) -> Floats:
        """Image of the known symbols and of the levels' mean, and its derivatives by the pose, (6, rows, columns)."""
        x, y = float(corner[0]), float(corner[1])
        levels = to_grid(0.5 * kernels.leds_of(known))
        varied, mean = np.empty((6, *shape)), np.empty((6, *shape))
        image_kernels.render(data.full_vector(), levels * self._led_gains, x, y, varied)
        image_kernels.render(mean_light.full_vector(), 0.5 * self._led_gains, x, y, mean)
        return np.asarray(varied + mean)


def _single_cutout(frame: AnyFrame, above: Floats, corner: tuple[int, int], data: Pose, mean_light: Pose) -> Cutout:
    """A cut-out of a single frame, by what it shows above the background."""
    rows, cols = above.shape
    inside = covered((frame,), corner, (rows, cols))
    return Cutout(2 * above, 2 * above, corner, (data,), mean_light, covered=inside)
