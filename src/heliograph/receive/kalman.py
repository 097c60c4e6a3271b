"""Constant-velocity Kalman filter of the array's pose in the image."""

from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from heliograph.receive.pose import Pose
from heliograph.receive.settings import TrackSettings

SHOWN, RATES, STATES = 5, slice(5, 8), 10
"""The state: the pose vector (x, y, ln pitch, roll, ln blur); the rates of its first three; and the systematic errors
of ln pitch and ln blur in sums, where the panel's rim looks like another size of the array."""

SUM_ERROR = np.array([0.05, 0.5])
"""Standard deviations of those errors at first."""

SUM_WALK = np.array([0.01, 0.2])
"""Their random walks per square root of a second: what is behind the array changes."""

ROLL_WALK = 0.03
BLUR_WALK = 0.1
"""Random walks of roll (rad) and ln blur, per square root of a second."""

TILT_WALK = 0.01
"""Random walk of stretch and shear per square root of a second: a car passes the array."""

START_RATES = np.array([900.0, 900.0, 0.15])
"""Standard deviations of the first rates: px/s, px/s, 1/s; 900 px/s is hard shake, 0.3 rad/s at 35 mm and 12 um."""


@dataclass(frozen=True, slots=True)
class View:
    """What a kind of look shows of the state.

    Attributes
    ----------
    shows
        (5, 10): H, the state to what a look shows.
    error
        (5,) variances of systematic errors that differ from look to look.
    """

    shows: NDArray[np.float64]
    error: NDArray[np.float64]


SUM_SPREAD = np.array([0.0, 0.0, 0.002, 0.0, 0.02])
"""Standard deviations of the errors of sums that differ from one to the next."""


def sum_view(late_s: float) -> View:
    """What the sum of a pattern and its inverse shows, its light on average `late_s` after the state's time."""
    shows = np.eye(SHOWN, STATES)
    shows[:3, RATES] = late_s * np.eye(3)
    shows[2, 8] = shows[4, 9] = 1.0
    return View(shows, SUM_SPREAD**2)


DIFFERENCE = View(np.eye(SHOWN, STATES), np.array([0.5, 0.5, 0.0, 0.0, 0.0]) ** 2)
"""A header minus its inverse: the background cancels, but it moves between the two, hence x and y."""

PLAIN = View(np.eye(SHOWN, STATES), np.zeros(SHOWN))
"""The pose itself."""


@dataclass(frozen=True, slots=True)
class Tilt:
    """Mean (2,) and covariance (2, 2) of stretch and shear.

    They change slowly and only headers tell them, so that they stay apart from the rest of the state.
    """

    mean: NDArray[np.float64] = field(default_factory=partial(np.zeros, 2))
    covariance: NDArray[np.float64] = field(default_factory=lambda: 1e-6 * np.eye(2))

    def later(self, dt: float) -> "Tilt":
        """The same after a time in seconds."""
        return Tilt(self.mean, self.covariance + TILT_WALK**2 * dt * np.eye(2))


@dataclass(frozen=True, slots=True)
class PoseState:
    """Mean (10,) and covariance (10, 10) of pose, rates and the sums' errors at a time in seconds; and the tilt."""

    time_s: float
    mean: NDArray[np.float64]
    covariance: NDArray[np.float64]
    tilt: Tilt = field(default_factory=Tilt)

    @staticmethod
    def start(time_s: float, vector: NDArray[np.float64], covariance: NDArray[np.float64]) -> "PoseState":
        """State of a pose (5,) or (7,) just found, its rates and the sums' errors unknown."""
        mean, full = np.zeros(STATES), np.zeros((STATES, STATES))
        mean[:SHOWN], full[:SHOWN, :SHOWN] = vector[:SHOWN], covariance[:SHOWN, :SHOWN]
        full[SHOWN:, SHOWN:] = np.diag(np.concatenate([START_RATES, SUM_ERROR]) ** 2)
        tilt = Tilt(vector[SHOWN:], covariance[SHOWN:, SHOWN:]) if len(covariance) > SHOWN else Tilt()
        return PoseState(time_s, mean, full, tilt)

    def predict(self, time_s: float, settings: TrackSettings) -> "PoseState":
        """The state at a later time: x = F x, P = F P F^T + Q."""
        dt = time_s - self.time_s
        f = np.eye(STATES)
        f[:3, RATES] = dt * np.eye(3)
        covariance = f @ self.covariance @ f.T + _process_noise(dt, settings)
        return PoseState(time_s, f @ self.mean, covariance, self.tilt.later(dt))

    def expected(self, view: View) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Mean (5,) and covariance (5, 5) of what a look will show."""
        return view.shows @ self.mean, view.shows @ self.covariance @ view.shows.T + np.diag(view.error)

    def condition(self, vector: NDArray[np.float64], covariance: NDArray[np.float64], view: View) -> "PoseState":
        """The state once what a look shows is known to be `vector` with `covariance`.

        The fit took `expected(view)` as its prior, so its result is the posterior of what is shown (an iterated Kalman
        update); the state follows by regression on it.
        """
        # S = H P H^T + B, G = P H^T S^-1; x += G (z - H x); P += G (C - S) G^T
        mean, shown = self.expected(view)
        gain = np.linalg.solve(shown, view.shows @ self.covariance).T
        full = self.covariance + gain @ (covariance - shown) @ gain.T
        return replace(self, mean=self.mean + gain @ (vector - mean), covariance=0.5 * (full + full.T))

    @property
    def pose(self) -> Pose:
        """The pose alone."""
        return Pose.of(np.append(self.mean[:SHOWN], self.tilt.mean))

    def pose_at(self, time_s: float) -> Pose:
        """The pose a little earlier or later, at constant rates."""
        vector = self.mean[:SHOWN].copy()
        vector[:3] += (time_s - self.time_s) * self.mean[RATES]
        return Pose.of(np.append(vector, self.tilt.mean))


def _process_noise(dt: float, settings: TrackSettings) -> NDArray[np.float64]:
    """Q of a white acceleration of density q = 2 a^2 tau: q [[dt^3 / 3, dt^2 / 2], [dt^2 / 2, dt]]."""
    q = 2 * settings.acceleration_s * np.array([settings.acceleration_px_s2**2] * 2 + [settings.expansion_s2**2])
    noise = np.zeros((STATES, STATES))
    noise[[0, 1, 2], [0, 1, 2]] = q * dt**3 / 3
    noise[[0, 1, 2], [5, 6, 7]] = noise[[5, 6, 7], [0, 1, 2]] = q * dt**2 / 2
    noise[[5, 6, 7], [5, 6, 7]] = q * dt
    noise[3, 3], noise[4, 4] = ROLL_WALK**2 * dt, BLUR_WALK**2 * dt
    noise[[8, 9], [8, 9]] = SUM_WALK**2 * dt
    return noise
