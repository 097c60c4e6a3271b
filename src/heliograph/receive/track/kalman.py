"""Kalman filter of the pose of an array in the image, with constant velocity.

Times are in seconds, but spreads are per pattern: the motion from pattern to pattern scales with the pattern period.
"""

from dataclasses import dataclass, field
from functools import cached_property, lru_cache, partial
from math import exp, hypot, inf

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.track import kernels

POSE_SIZE, RATE_STATES, STATE_SIZE = 5, slice(5, 8), 10
"""State: pose vector (x, y, ln pitch, roll, ln blur), rates per second of x, y and ln pitch, and systematic errors of
ln pitch and ln blur in sums, where the rim of the panel changes the apparent size."""


@dataclass(frozen=True)  # without slots, for the cached property
class MotionModel:
    """Motion of an array in the image."""

    # Pattern period T_b in seconds
    period_s: float
    # Standard deviation of the acceleration by shake, in px per pattern squared
    acceleration_px: float
    # Focal length in px; a passing array that moves by that much turns by 1 rad. Infinite for a camera that only turns
    focal_px: float = inf
    # Correlation time of the acceleration in patterns: half a period of shake at 125 Hz
    acceleration_patterns: float = 4.0
    # Standard deviation of the second derivative of ln pitch, per pattern squared: 30 km/h at 12 m
    expansion: float = 5e-7
    # Prior standard deviations of the rates of x, y and ln pitch per pattern: hard shake, and 30 km/h at 55 m
    start_rates: tuple[float, float, float] = (0.9, 0.9, 1.5e-4)
    # Prior standard deviations of the errors of ln pitch and ln blur in sums: a rim of up to half a pitch
    sum_error: tuple[float, float] = (0.05, 0.5)
    # Time in patterns in which the random walks reach the standard deviations below
    walk_patterns: float = 1000.0
    # Random walk of the errors in sums, as the background changes
    sum_walk: tuple[float, float] = (0.01, 0.2)
    # Random walks of roll in rad, of ln blur, and of stretch and shear
    roll_walk: float = 0.03
    blur_walk: float = 0.1
    tilt_walk: float = 0.01
    # Maximum change of stretch and shear for a turn by 1 rad, and patterns for which a turn goes on
    turn: float = 0.3
    turning_patterns: float = 100.0

    @cached_property
    def noise_by_powers(self) -> tuple[Floats, Floats, Floats]:
        """Terms of the process noise Q proportional to dt, dt^2 and dt^3, (10, 10) each.

        White accelerations of density q = 2 a^2 tau give q [[dt^3 / 3, dt^2 / 2], [dt^2 / 2, dt]].
        """
        a = np.array([self.acceleration_px, self.acceleration_px, self.expansion]) / self.period_s**2
        q, place, rate = 2 * self.acceleration_patterns * self.period_s * a**2, [0, 1, 2], [5, 6, 7]
        linear, quadratic, cubic = np.zeros((3, STATE_SIZE, STATE_SIZE))
        cubic[place, place] = q / 3
        quadratic[place, rate] = quadratic[rate, place] = q / 2
        linear[rate, rate] = q
        walks = np.array([self.roll_walk, self.blur_walk, *self.sum_walk])
        linear[[3, 4, 8, 9], [3, 4, 8, 9]] = walks**2 * self.walk_time(1.0)
        return linear, quadratic, cubic

    def walk_time(self, dt: float) -> float:
        """Convert a time in seconds to units of `walk_patterns`."""
        return dt / (self.walk_patterns * self.period_s)


@dataclass(frozen=True, slots=True)
class Observation:
    """Part of the state observed by a fit."""

    # H, (5, 10): state to pose vector
    matrix: Floats
    # (5,) variances of independent model errors
    variances: Floats

    def __post_init__(self) -> None:
        # uniformly read-only: Numba compiles kernels again for writable arrays
        self.matrix.setflags(write=False)


@lru_cache(maxsize=8)  # synchronous sums share one delay
def sum_observation(late_s: float) -> Observation:
    """Return the observation by the sum of a pattern and the inverse, with light delayed by `late_s`."""
    matrix = np.eye(POSE_SIZE, STATE_SIZE)
    matrix[:3, RATE_STATES] = late_s * np.eye(3)
    matrix[2, 8] = matrix[4, 9] = 1.0
    # ln pitch and ln blur err by about the last step of a fit
    return Observation(matrix, np.array([0.0, 0.0, 0.002, 0.0, 0.02]) ** 2)


# a header less the inverse: the array moves by about 0.5 px between both, hence x and y
HEADER_OBSERVATION = Observation(np.eye(POSE_SIZE, STATE_SIZE), np.array([0.5, 0.5, 0.0, 0.0, 0.0]) ** 2)
# the pose itself
POSE = Observation(np.eye(POSE_SIZE, STATE_SIZE), np.zeros(POSE_SIZE))


@dataclass(frozen=True, slots=True)
class Tilt:
    """Stretch and shear: slow, shown by headers only, and so estimated apart from the state."""

    # (2,) stretch and shear
    mean: Floats = field(default_factory=partial(np.zeros, 2))
    # (2, 2) covariance; by default of an upright array before a fit: 1e-3 at 2.6 degrees of yaw
    covariance: Floats = field(default_factory=lambda: 1e-3**2 * np.eye(2))

    def predict(self, dt: float, x_rate: float, y_rate: float, model: MotionModel) -> "Tilt":
        """Predict the tilt after a time in seconds."""
        # a turn for a time tau adds tau^2, as a walk of the variance tau dt
        turn = model.turn * hypot(x_rate, y_rate) / model.focal_px
        variance = model.tilt_walk**2 * model.walk_time(dt)
        variance += turn**2 * model.turning_patterns * model.period_s * dt
        return Tilt(self.mean, self.covariance + variance * np.eye(2))


@dataclass(frozen=True)  # without slots, for the cached properties
class PoseState:
    """State of the filter."""

    # Time in seconds
    time_s: float
    # (10,) pose vector, rates per second, errors of ln pitch and ln blur in sums
    mean: Floats
    # (10, 10) covariance of `mean`
    covariance: Floats
    # Stretch and shear of the image
    tilt: Tilt = field(default_factory=Tilt)

    @cached_property
    def _numbers(self) -> list[float]:
        """Pose vector, rates and tilt as Python floats, which are faster than NumPy for single poses."""
        return [*self.mean[:8].tolist(), *self.tilt.mean.tolist()]

    @staticmethod
    def start(
        time_s: float,
        vector: Floats,
        covariance: Floats,
        model: MotionModel,
        drift: tuple[float, float] = (0.0, 0.0),
    ) -> "PoseState":
        """Return the state of a detected pose, with unknown rate of the pitch and unknown errors of sums."""
        mean, full = np.zeros(STATE_SIZE), np.zeros((STATE_SIZE, STATE_SIZE))
        mean[:POSE_SIZE], mean[5:7] = vector[:POSE_SIZE], drift
        full[:POSE_SIZE, :POSE_SIZE] = covariance[:POSE_SIZE, :POSE_SIZE]
        full[POSE_SIZE:, POSE_SIZE:] = np.diag(
            np.concatenate([np.array(model.start_rates) / model.period_s, model.sum_error]) ** 2
        )
        has_tilt = len(covariance) > POSE_SIZE
        tilt = Tilt(vector[POSE_SIZE:], covariance[POSE_SIZE:, POSE_SIZE:]) if has_tilt else Tilt()
        return PoseState(time_s, mean, full, tilt)

    def predict(self, time_s: float, model: MotionModel) -> "PoseState":
        """Predict the state at a later time: x = F x, P = F P F^T + Q."""
        dt = time_s - self.time_s
        mean, covariance = kernels.predict(*self._arrays, dt, *model.noise_by_powers)
        return PoseState(time_s, mean, covariance, self.tilt.predict(dt, self._numbers[5], self._numbers[6], model))

    def expected(self, observation: Observation) -> tuple[Floats, Floats]:
        """Predict the mean (5,) and the covariance (5, 5) of a fit: H x, H P H^T + R."""
        mean, covariance, _ = kernels.expected(*self._arrays, observation.matrix, observation.variances)
        return mean, covariance

    def condition(self, vector: Floats, covariance: Floats, observation: Observation) -> "PoseState":
        """Update the state by a fit with the prior `expected` (an iterated Kalman update)."""
        fit = np.ascontiguousarray(vector, np.float64), np.ascontiguousarray(covariance, np.float64)
        mean, full = kernels.condition(*self._arrays, observation.matrix, observation.variances, *fit)
        return PoseState(self.time_s, mean, full, self.tilt)

    @property
    def _arrays(self) -> tuple[Floats, Floats]:
        """Mean and covariance in the memory layout of the kernels."""
        return np.ascontiguousarray(self.mean, np.float64), np.ascontiguousarray(self.covariance, np.float64)

    @cached_property
    def pose(self) -> Pose:
        """Pose at the time of the state."""
        return self.pose_at(self.time_s)

    def pose_at(self, time_s: float) -> Pose:
        """Extrapolate the pose to another time at constant rates."""
        x, y, log_pitch, roll, log_blur, x_rate, y_rate, pitch_rate, stretch, shear = self._numbers
        dt = time_s - self.time_s
        pitch = exp(log_pitch + dt * pitch_rate)
        return Pose(x + dt * x_rate, y + dt * y_rate, pitch, roll, exp(log_blur), stretch, shear)
