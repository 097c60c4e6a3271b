"""Kalman filter of the pose of an array in the image, at constant velocity in the image and constant closing speed.

Times are in seconds, but spreads are per pattern: the motion from pattern to pattern scales with the pattern period.
"""

from dataclasses import dataclass, field
from functools import cached_property, lru_cache, partial
from math import exp, hypot, inf, isfinite

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.track import kernels

# state: pose vector (x, y, ln pitch, roll, ln blur), rates per second of x, y and ln pitch, and systematic errors of
# ln pitch and ln blur in sums, where the rim of the panel changes the apparent size
POSE_SIZE, RATE_STATES, STATE_SIZE = 5, slice(5, 8), 10


@dataclass(frozen=True)  # without slots, for the cached property
class MotionModel:
    """Motion of an array in the image."""

    # Pattern period T_b in seconds
    period_s: float
    # Standard deviation of the acceleration by shake, in px per pattern squared
    acceleration_px: float
    # Focal length in px; a passing array that moves by that much turns by 1 rad. Infinite for a camera that only turns
    focal_px: float = inf

    @cached_property
    def noise_by_powers(self) -> tuple[Floats, Floats, Floats]:
        """Terms of the process noise Q proportional to dt, dt^2 and dt^3, (10, 10) each.

        White accelerations of density q = 2 a^2 tau give q [[dt^3 / 3, dt^2 / 2], [dt^2 / 2, dt]].
        """
        # the second derivative of ln pitch is 5e-7 per pattern squared by braking at 6 m/s^2 at 12 m; tau, 4 patterns,
        # is half a period of shake at 125 Hz
        a = np.array([self.acceleration_px, self.acceleration_px, 5e-7]) / self.period_s**2
        q, place, rate = 2 * 4 * self.period_s * a**2, [0, 1, 2], [5, 6, 7]
        linear, quadratic, cubic = np.zeros((3, STATE_SIZE, STATE_SIZE))
        cubic[place, place] = q / 3
        quadratic[place, rate] = quadratic[rate, place] = q / 2
        linear[rate, rate] = q
        # random walks of roll, ln blur and the errors in sums, as the background changes, in 1000 patterns
        walks = np.array([0.03, 0.1, 0.01, 0.2])
        linear[[3, 4, 8, 9], [3, 4, 8, 9]] = walks**2 / (1000 * self.period_s)
        return linear, quadratic, cubic


# part of the state that a fit observes: H (5, 10), the state to the pose vector, and R (5, 5), errors of the model
Observation = tuple[Floats, Floats]


@lru_cache(maxsize=8)  # synchronous sums share one delay
def sum_observation(late_s: float) -> Observation:
    """Return the observation by the sum of a pattern and the inverse, with light delayed by `late_s`."""
    matrix = np.eye(POSE_SIZE, STATE_SIZE)
    matrix[:3, RATE_STATES] = late_s * np.eye(3)
    matrix[2, 8] = matrix[4, 9] = 1.0
    # ln pitch and ln blur err by about the last step of a fit
    return matrix, np.diag([0.0, 0.0, 0.002, 0.0, 0.02]) ** 2


# a header less the inverse: the array moves by about 0.5 px between both, hence x and y
HEADER_OBSERVATION = np.eye(POSE_SIZE, STATE_SIZE), np.diag([0.5, 0.5, 0.0, 0.0, 0.0]) ** 2
# the pose itself
POSE = np.eye(POSE_SIZE, STATE_SIZE), np.zeros((POSE_SIZE, POSE_SIZE))


@dataclass(frozen=True)  # without slots, for the cached properties
class PoseState:
    """State of the filter."""

    # Time in seconds
    time_s: float
    # (10,) pose vector, rates per second, errors of ln pitch and ln blur in sums
    mean: Floats
    # (10, 10) covariance of `mean`
    covariance: Floats
    # (2,) stretch and shear of the image: slow, shown by headers only, and so estimated apart from the state
    tilt: Floats = field(default_factory=partial(np.zeros, 2))
    # (2, 2) covariance of `tilt`; by default of an upright array before a fit: 1e-3 at 2.6 degrees of yaw
    tilt_covariance: Floats = field(default_factory=lambda: 1e-3**2 * np.eye(2))

    @cached_property
    def _numbers(self) -> list[float]:
        """Pose vector, rates and tilt as Python floats, which are faster than NumPy for single poses."""
        return [*self.mean[:8].tolist(), *self.tilt.tolist()]

    @staticmethod
    def start(
        time_s: float, vector: Floats, covariance: Floats, model: MotionModel, drift: tuple[float, float] = (0.0, 0.0)
    ) -> "PoseState":
        """Return the state of a detected pose, with unknown rate of the pitch and unknown errors of sums."""
        mean, full = np.zeros(STATE_SIZE), np.zeros((STATE_SIZE, STATE_SIZE))
        mean[:POSE_SIZE], mean[5:7] = vector[:POSE_SIZE], drift
        full[:POSE_SIZE, :POSE_SIZE] = covariance[:POSE_SIZE, :POSE_SIZE]
        # rates per pattern of hard shake, and of 30 km/h at 55 m; the rim of the panel is up to half a pitch wide
        spreads = np.append(np.array([0.9, 0.9, 1.5e-4]) / model.period_s, [0.05, 0.5])
        full[POSE_SIZE:, POSE_SIZE:] = np.diag(spreads**2)
        has_tilt = len(covariance) > POSE_SIZE
        tilt = (vector[POSE_SIZE:], covariance[POSE_SIZE:, POSE_SIZE:]) if has_tilt else ()
        return PoseState(time_s, mean, full, *tilt)

    def predict(self, time_s: float, model: MotionModel) -> "PoseState":
        """Predict the state at a later time."""
        dt = time_s - self.time_s
        mean, covariance = kernels.predict(self.mean, self.covariance, dt, *model.noise_by_powers)
        # stretch and shear walk by 0.01 in 1000 patterns, and change by up to 0.3 for a turn by 1 rad. A turn goes on
        # for tau = 100 patterns: it adds tau^2, as a walk of the variance tau dt
        turn = 0.3 * hypot(self._numbers[5], self._numbers[6]) / model.focal_px
        variance = 0.01**2 * dt / (1000 * model.period_s) + turn**2 * 100 * model.period_s * dt
        tilt_covariance = self.tilt_covariance + np.array([[variance, 0.0], [0.0, variance]])
        return PoseState(time_s, mean, covariance, self.tilt, tilt_covariance)

    def expected(self, observation: Observation) -> tuple[Floats, Floats]:
        """Predict the mean (5,) and the covariance (5, 5) of a fit."""
        mean, covariance, _ = kernels.project(self.mean, self.covariance, *observation)
        return mean, covariance

    def condition(self, vector: Floats, covariance: Floats, observation: Observation) -> "PoseState":
        """Update the state by a fit whose prior was `expected` (an iterated Kalman update)."""
        covariance = np.ascontiguousarray(covariance)
        mean, full = kernels.condition(self.mean, self.covariance, *observation, vector, covariance)
        if not isfinite(full[0, 0]):
            raise np.linalg.LinAlgError("the covariance of an array's pose is not positive definite")
        return PoseState(self.time_s, mean, full, self.tilt, self.tilt_covariance)

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
