"""The filter of the pose, beside an independent Kalman filter."""

import numpy as np
import pytest
from filterpy.common import Q_continuous_white_noise
from filterpy.kalman import KalmanFilter
from numpy.typing import NDArray

from heliograph.receive.kalman import BLUR_WALK, DIFFERENCE, PLAIN, ROLL_WALK, SUM_WALK, PoseState, View, sum_view
from heliograph.receive.settings import TrackSettings

Floats = NDArray[np.float64]

SETTINGS = TrackSettings()


def random_covariance(rng: np.random.Generator, scale: float = 0.1) -> Floats:
    root = rng.normal(0, scale, (5, 5))
    return np.asarray(root @ root.T + 1e-3 * np.eye(5))


def beside(state: PoseState) -> KalmanFilter:
    """filterpy's filter in the same state."""
    other = KalmanFilter(dim_x=10, dim_z=5)
    other.x, other.P = state.mean.reshape(-1, 1).copy(), state.covariance.copy()
    return other


def predict(other: KalmanFilter, dt: float) -> None:
    other.F, other.Q = np.eye(10), np.zeros((10, 10))
    spreads = [SETTINGS.acceleration_px_s2, SETTINGS.acceleration_px_s2, SETTINGS.expansion_s2]
    for k, spread in enumerate(spreads):
        other.F[k, 5 + k] = dt
        density = 2 * spread**2 * SETTINGS.acceleration_s
        other.Q[np.ix_([k, 5 + k], [k, 5 + k])] = Q_continuous_white_noise(2, dt, density)
    other.Q[3, 3], other.Q[4, 4] = ROLL_WALK**2 * dt, BLUR_WALK**2 * dt
    other.Q[8, 8], other.Q[9, 9] = SUM_WALK**2 * dt
    other.predict()


def look(state: PoseState, z: Floats, noise: Floats, view: View) -> tuple[Floats, Floats]:
    """What a linear fit reports of a look z: its posterior with `expected` as prior."""
    mean, spread = state.expected(view)
    prior = np.linalg.inv(spread)
    covariance = np.linalg.inv(prior + np.linalg.inv(noise))
    return covariance @ (prior @ mean + np.linalg.solve(noise, z)), covariance


@pytest.mark.parametrize("view", [PLAIN, sum_view(-2e-4), DIFFERENCE])
def test_same_as_filterpy(view: View) -> None:
    rng = np.random.default_rng(1)
    state = PoseState.start(0.0, rng.normal(size=5), random_covariance(rng))
    other = beside(state)
    for step in range(1, 40):
        time_s = 0.002 * step + 0.0005 * rng.random()
        predict(other, time_s - state.time_s)
        state = state.predict(time_s, SETTINGS)
        z, noise = rng.normal(size=5), random_covariance(rng)
        vector, covariance = look(state, z, noise, view)
        # a systematic error is noise of the look that the fit does not know of
        other.update(z.reshape(-1, 1), R=noise + np.diag(view.error), H=view.shows)
        state = state.condition(vector, covariance, view)
        assert state.time_s == time_s
        assert state.mean == pytest.approx(other.x.ravel(), rel=1e-6, abs=1e-6)
        assert state.covariance == pytest.approx(other.P, rel=1e-6, abs=1e-9)


def test_bias_keeps_the_state_from_believing_a_sharp_look() -> None:
    state = PoseState.start(0.0, np.zeros(5), 0.04 * np.eye(5))
    sharp = 1e-8 * np.eye(5)
    vector, covariance = look(state, np.ones(5), sharp, PLAIN)
    trusting = state.condition(vector, covariance, PLAIN)
    assert trusting.mean[:5] == pytest.approx(np.ones(5), abs=1e-4)
    doubtful = View(PLAIN.shows, np.array([0, 0, 0.2, 0, 0]) ** 2)
    vector, covariance = look(state, np.ones(5), sharp, doubtful)
    careful = state.condition(vector, covariance, doubtful)
    # equal variances of state and bias: half the way, half the variance
    assert careful.mean[:5] == pytest.approx([1, 1, 0.5, 1, 1], abs=1e-4)
    assert careful.covariance[2, 2] == pytest.approx(0.02, rel=1e-3)


def test_covariance_stays_symmetric_and_positive() -> None:
    rng = np.random.default_rng(2)
    state = PoseState.start(0.0, np.zeros(5), np.eye(5))
    for step in range(1, 400):
        state = state.predict(0.002 * step, SETTINGS)
        noise = np.diag(10.0 ** rng.uniform(-10, 2, 5))
        vector, covariance = look(state, rng.normal(size=5), noise, PLAIN)
        state = state.condition(vector, covariance, PLAIN)
        assert np.array_equal(state.covariance, state.covariance.T)
        scale = np.sqrt(np.diag(state.covariance))
        assert np.linalg.eigvalsh(state.covariance / np.outer(scale, scale)).min() > 0


def test_rates_of_an_even_motion_are_learnt() -> None:
    rates = np.array([300.0, -150.0, 0.4])
    start = np.array([50.0, 40.0, 0.1, 0.0, -0.6])
    state = PoseState.start(0.0, start, 1e-4 * np.eye(5))
    for step in range(1, 60):
        state = state.predict(0.002 * step, SETTINGS)
        z = start.copy()
        z[:3] += rates * state.time_s
        vector, covariance = look(state, z, np.diag([1e-4, 1e-4, 1e-6, 1e-6, 1e-4]), PLAIN)
        state = state.condition(vector, covariance, PLAIN)
    assert state.mean[5:8] == pytest.approx(rates, rel=0.02)
    later = state.pose_at(state.time_s + 0.001)
    assert later.x - state.pose.x == pytest.approx(0.3, rel=0.02)
    assert later.pitch / state.pose.pitch == pytest.approx(np.exp(0.0004), rel=1e-4)
