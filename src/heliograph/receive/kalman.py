"""Constant-velocity Kalman filter of the array's pose in the image."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.receive.pose import Pose
from heliograph.receive.settings import TrackSettings

SHOWN = 5
"""The state begins with the pose vector (x, y, ln pitch, roll, ln blur); the rates of its first three follow."""

ROLL_WALK = 0.03
BLUR_WALK = 0.1
"""Random walks of roll (rad) and ln blur, per square root of a second."""

START_RATES = np.array([900.0, 900.0, 0.15])
"""Standard deviations of the first rates: px/s, px/s, 1/s; 900 px/s is hard shake, 0.3 rad/s at 35 mm and 12 um."""


@dataclass(frozen=True, slots=True)
class PoseState:
    """Mean (8,) and covariance (8, 8) of pose and rates at a time in seconds."""

    time_s: float
    mean: NDArray[np.float64]
    covariance: NDArray[np.float64]

    @staticmethod
    def start(time_s: float, vector: NDArray[np.float64], covariance: NDArray[np.float64]) -> "PoseState":
        """State of a pose just found, its rates unknown."""
        mean, full = np.zeros(8), np.zeros((8, 8))
        mean[:SHOWN], full[:SHOWN, :SHOWN] = vector, covariance
        full[SHOWN:, SHOWN:] = np.diag(START_RATES**2)
        return PoseState(time_s, mean, full)

    def predict(self, time_s: float, settings: TrackSettings) -> "PoseState":
        """The state at a later time: x = F x, P = F P F^T + Q."""
        dt = time_s - self.time_s
        f = np.eye(8)
        f[:3, SHOWN:] = dt * np.eye(3)
        return PoseState(time_s, f @ self.mean, f @ self.covariance @ f.T + _process_noise(dt, settings))

    def expected(self, bias: NDArray[np.float64]) -> NDArray[np.float64]:
        """Covariance (5, 5) of a look's pose: this state's, and the look's own systematic errors of variance `bias`."""
        return self.covariance[:SHOWN, :SHOWN] + np.diag(bias)

    def condition(
        self, vector: NDArray[np.float64], covariance: NDArray[np.float64], bias: NDArray[np.float64]
    ) -> "PoseState":
        """The state once a look's pose is known to be `vector` with `covariance`.

        The fit took `expected(bias)` as its prior, so its result is the posterior of the look's pose (an iterated
        Kalman update); the state follows by regression on it.
        """
        # S = P_ss + B, G = P_:s S^-1; x += G (z - x_s); P += G (C - S) G^T
        shown = self.expected(bias)
        gain = np.linalg.solve(shown, self.covariance[:SHOWN]).T
        mean = self.mean + gain @ (vector - self.mean[:SHOWN])
        full = self.covariance + gain @ (covariance - shown) @ gain.T
        return PoseState(self.time_s, mean, 0.5 * (full + full.T))

    @property
    def pose(self) -> Pose:
        """The pose alone."""
        return Pose.of(self.mean)

    def pose_at(self, time_s: float) -> Pose:
        """The pose a little earlier or later, at constant rates."""
        vector = self.mean[:SHOWN].copy()
        vector[:3] += (time_s - self.time_s) * self.mean[SHOWN:]
        return Pose.of(vector)


def _process_noise(dt: float, settings: TrackSettings) -> NDArray[np.float64]:
    """Q of a white acceleration of density q = 2 a^2 tau: q [[dt^3 / 3, dt^2 / 2], [dt^2 / 2, dt]]."""
    q = 2 * settings.acceleration_s * np.array([settings.acceleration_px_s2**2] * 2 + [settings.expansion_s2**2])
    noise = np.zeros((8, 8))
    noise[[0, 1, 2], [0, 1, 2]] = q * dt**3 / 3
    noise[[0, 1, 2], [5, 6, 7]] = noise[[5, 6, 7], [0, 1, 2]] = q * dt**2 / 2
    noise[[5, 6, 7], [5, 6, 7]] = q * dt
    noise[3, 3], noise[4, 4] = ROLL_WALK**2 * dt, BLUR_WALK**2 * dt
    return noise
