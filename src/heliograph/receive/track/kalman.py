"""Constant-velocity Kalman filter of the array's pose in the image.

Times are in seconds, but all spreads are in patterns: a light ten times slower, or a film in slow motion, moves as far
from pattern to pattern as the light slows down.
"""

from dataclasses import dataclass, field
from functools import cached_property, lru_cache, partial
from math import exp, hypot, inf

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.track import kernels as kalman_kernels

POSE_SIZE, RATE_STATES, STATE_SIZE = 5, slice(5, 8), 10
"""Parts of the state: the pose vector (x, y, ln pitch, roll, ln blur); the rates per second of its first three; and the
systematic errors of ln pitch and ln blur in sums, where the panel's rim looks like another size of the array."""

UNFITTED_TILT = 1e-3
"""Standard deviation of stretch and shear that were not fitted: 0 of an upright array, 1e-3 at 2.6 degrees of yaw."""

ACCELERATION_PATTERNS = 4.0
"""Patterns over which an acceleration of the image keeps its sign: half a period of shake at 125 Hz."""

EXPANSION = 5e-7
"""Standard deviation of the second derivative of ln pitch, per pattern squared.

Closing in at a speed v from a distance Z gives (v T_b / Z)^2: at 30 km/h 1e-8 at 80 m, and 5e-7 at 12 m.
"""

SUM_ERROR = np.array([0.05, 0.5])
"""Prior standard deviations of the sums' errors of ln pitch and ln blur: a panel's rim is at most half a pitch wide."""

SUM_SPREAD = np.array([0.0, 0.0, 0.002, 0.0, 0.02])
"""Standard deviations of errors of sums that differ from one sum to the next, in the pose vector.

They are about the steps below which a fit ends: 0.02 of ln blur (`CLOSE_BLUR` of `fit`), and 0.02 px of the rim
(`CLOSE_PX`). At a pitch of 1 px the rim is 8 px from the middle, so that is 0.0025 of ln pitch. Half and twice of
it lose none of 192 codewords.
"""

WALK_PATTERNS = 1000.0
"""Patterns over which the random walks below have the standard deviations given."""

SUM_WALK = np.array([0.01, 0.2])
"""Random walks of the sums' errors: the background changes.

An error has walked as far as its prior (`SUM_ERROR`) after (0.05 / 0.01)^2 = 25 and (0.5 / 0.2)^2 = 6 of
`WALK_PATTERNS`: 25 s and 6 s at 1000 patterns/s. Half and twice of it lose none of 192 codewords.
"""

ROLL_WALK, BLUR_WALK, TILT_WALK = 0.03, 0.1, 0.01
"""Random walks of roll (rad), ln blur, and of stretch and shear.

A car rolls by a degree or two, and passes the array.
"""

TURN, TURNING_PATTERNS = 0.3, 100.0
"""Stretch and shear that a turn of the array by 1 rad adds, at most, and patterns over which a turn goes on.

A camera that passes an array sees it turn as fast as it sees it move, by v / f. cos(yaw) changes by sin(yaw): the
stretch, half of it, by 0.3 at 35 degrees. Headers, which show it, are 100 patterns apart.
"""

START_RATES = np.array([0.9, 0.9, 1.5e-4])
"""Prior standard deviations of the rates: px, px and ln pitch per pattern.

0.9 px per pattern is hard shake, 0.3 rad/s with 35 mm and 12 um at 1000 patterns/s; 1.5e-4 is 30 km/h at 55 m.
"""


@dataclass(frozen=True, slots=True)
class MotionModel:
    """How an array may move in the image."""

    # Pattern period T_b in seconds
    period_s: float
    # Standard deviation of the image's acceleration by shake, in px per pattern squared
    acceleration_px: float
    # Focal length in px: what moves by so much as the camera passes it has turned by 1 rad. Of an array that only ever
    # moves with the camera's own turns it is infinite
    focal_px: float = inf

    def process_noise(self, dt: float) -> Floats:
        """Q, (10, 10): what the motion adds to the state's covariance as time goes by.

        White accelerations of density q = 2 a^2 tau give q [[dt^3 / 3, dt^2 / 2], [dt^2 / 2, dt]].
        """
        linear, quadratic, cubic = self.noise_by_powers
        return np.asarray(dt * linear + dt**2 * quadratic + dt**3 * cubic)

    @property
    def noise_by_powers(self) -> tuple[Floats, Floats, Floats]:
        """What Q has in proportion to dt, dt^2 and dt^3, (10, 10) each."""
        return _noise_by_powers(self)

    def walked(self, dt: float) -> float:
        """A time in units of `WALK_PATTERNS`."""
        return dt / (WALK_PATTERNS * self.period_s)

    @property
    def start_rates(self) -> Floats:
        """Prior standard deviations of the rates per second, (3,)."""
        return START_RATES / self.period_s


@lru_cache(maxsize=8)  # arrays of one film move by one model
def _noise_by_powers(model: MotionModel) -> tuple[Floats, Floats, Floats]:
    """What Q has in proportion to dt, dt^2 and dt^3, (10, 10) each."""
    a = np.array([model.acceleration_px, model.acceleration_px, EXPANSION]) / model.period_s**2
    q, place, rate = 2 * ACCELERATION_PATTERNS * model.period_s * a**2, [0, 1, 2], [5, 6, 7]
    linear, quadratic, cubic = np.zeros((3, STATE_SIZE, STATE_SIZE))
    cubic[place, place] = q / 3
    quadratic[place, rate] = quadratic[rate, place] = q / 2
    linear[rate, rate] = q
    linear[[3, 4, 8, 9], [3, 4, 8, 9]] = np.array([ROLL_WALK, BLUR_WALK, *SUM_WALK]) ** 2 * model.walked(1.0)
    return linear, quadratic, cubic


@dataclass(frozen=True, slots=True)
class Observation:
    """Which part of the state a fit observes."""

    # H, (5, 10): the state to the pose vector that the fit shows
    matrix: Floats
    # (5,) of errors of the fit's model that differ from one fit to the next
    variances: Floats

    def __post_init__(self) -> None:
        # all alike: kernels are compiled anew for arrays that may be written to
        self.matrix.setflags(write=False)


@lru_cache(maxsize=8)  # in step all sums have one lateness
def sum_observation(late_s: float) -> Observation:
    """What the sum of a pattern and its inverse shows."""
    matrix = np.eye(POSE_SIZE, STATE_SIZE)
    matrix[:3, RATE_STATES] = late_s * np.eye(3)
    matrix[2, 8] = matrix[4, 9] = 1.0
    return Observation(matrix, SUM_SPREAD**2)


HEADER_OBSERVATION = Observation(np.eye(POSE_SIZE, STATE_SIZE), np.array([0.5, 0.5, 0.0, 0.0, 0.0]) ** 2)
"""A header less its inverse: the background cancels, but the array moves between the two, hence x and y.

0.5 px is about half of what hard shake moves it from one pattern to the next (`START_RATES`).
"""

POSE = Observation(np.eye(POSE_SIZE, STATE_SIZE), np.zeros(POSE_SIZE))
"""The pose itself."""


_EYE = np.eye(2)


@dataclass(frozen=True, slots=True)
class Tilt:
    """Stretch and shear, which change slowly and only headers show, apart from the rest of the state."""

    # (2,) stretch and shear
    mean: Floats = field(default_factory=partial(np.zeros, 2))
    # (2, 2) covariance of stretch and shear
    covariance: Floats = field(default_factory=lambda: UNFITTED_TILT**2 * np.eye(2))

    def later(self, dt: float, x_rate: float, y_rate: float, model: MotionModel) -> "Tilt":
        """The tilt at a later time."""
        # a turn that goes on for a time tau adds its square, tau^2, as a walk of the variance tau dt
        turn = TURN * hypot(x_rate, y_rate) / model.focal_px
        variance = TILT_WALK**2 * model.walked(dt) + turn**2 * TURNING_PATTERNS * model.period_s * dt
        return Tilt(self.mean, self.covariance + variance * _EYE)


@dataclass(frozen=True)  # without slots, which leave no room for what is cached
class PoseState:
    """State of the filter."""

    # Its time in seconds
    time_s: float
    # (10,) pose vector, rates per second of its first three, errors of ln pitch and ln blur in sums
    mean: Floats
    # (10, 10) covariance of `mean`
    covariance: Floats
    # Stretch and shear of the image
    tilt: Tilt = field(default_factory=Tilt)
    _numbers: list[float] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        known = self.__dict__
        known["mean"], known["covariance"] = _for_kernels(self.mean), _for_kernels(self.covariance)
        # number by number: poses are asked for several times a frame, and NumPy takes longer than their sums
        known["_numbers"] = [*self.mean[:8].tolist(), *self.tilt.mean.tolist()]

    @staticmethod
    def start(
        time_s: float,
        vector: Floats,
        covariance: Floats,
        model: MotionModel,
        drift: tuple[float, float] = (0.0, 0.0),
    ) -> "PoseState":
        """State of a pose just found; its pitch's rate and the sums' errors are unknown."""
        mean, full = np.zeros(STATE_SIZE), np.zeros((STATE_SIZE, STATE_SIZE))
        mean[:POSE_SIZE], mean[5:7] = vector[:POSE_SIZE], drift
        full[:POSE_SIZE, :POSE_SIZE] = covariance[:POSE_SIZE, :POSE_SIZE]
        full[POSE_SIZE:, POSE_SIZE:] = np.diag(np.concatenate([model.start_rates, SUM_ERROR]) ** 2)
        tilted = len(covariance) > POSE_SIZE
        tilt = Tilt(vector[POSE_SIZE:], covariance[POSE_SIZE:, POSE_SIZE:]) if tilted else Tilt()
        return PoseState(time_s, mean, full, tilt)

    def predict(self, time_s: float, model: MotionModel) -> "PoseState":
        """State at a later time: x = F x, P = F P F^T + Q."""
        dt = time_s - self.time_s
        mean, covariance = kalman_kernels.predict(self.mean, self.covariance, dt, *model.noise_by_powers)
        return PoseState(time_s, mean, covariance, self.tilt.later(dt, self._numbers[5], self._numbers[6], model))

    def expected(self, observation: Observation) -> tuple[Floats, Floats]:
        """Mean (5,) and covariance (5, 5) of what a fit will show: H x, H P H^T + R."""
        shown = observation.matrix, observation.variances
        mean, covariance, _ = kalman_kernels.expected(self.mean, self.covariance, *shown)
        return mean, covariance

    def condition(self, vector: Floats, covariance: Floats, observation: Observation) -> "PoseState":
        """State given the result of a fit.

        The fit took `expected` as its prior, so its result is the posterior of what is observed (an iterated Kalman
        update); the state follows by regression on it.
        """
        shown = observation.matrix, observation.variances, _for_kernels(vector), _for_kernels(covariance)
        mean, full = kalman_kernels.condition(self.mean, self.covariance, *shown)
        return PoseState(self.time_s, mean, full, self.tilt)

    @cached_property
    def pose(self) -> Pose:
        """The pose alone."""
        return self.pose_at(self.time_s)

    def pose_at(self, time_s: float) -> Pose:
        """The pose a little earlier or later, at constant rates."""
        x, y, log_pitch, roll, log_blur, x_rate, y_rate, pitch_rate, stretch, shear = self._numbers
        dt = time_s - self.time_s
        pitch = exp(log_pitch + dt * pitch_rate)
        return Pose(x + dt * x_rate, y + dt * y_rate, pitch, roll, exp(log_blur), stretch, shear)


def _for_kernels(values: Floats) -> Floats:
    """Values in the order that kernels are compiled for."""
    return np.ascontiguousarray(values, np.float64)
