"""Pose filter against filterpy's Kalman filter."""

from dataclasses import replace

import numpy as np
import pytest
from filterpy.common import Q_continuous_white_noise
from filterpy.kalman import KalmanFilter

from heliograph.base.arrays import Floats
from heliograph.receive.track import kalman
from heliograph.receive.track.kalman import POSE, MotionModel, Observation, PoseState, sum_observation

PERIOD_S, ACCELERATION_PX = 1e-3, 0.1
MODEL = MotionModel(PERIOD_S, ACCELERATION_PX)

# model assumptions, in patterns
ACCELERATION_PATTERNS, EXPANSION = 4.0, 5e-7
ROLL_WALK, BLUR_WALK, TILT_WALK, SUM_WALKS = 0.03, 0.1, 0.01, (0.01, 0.2)
WALK_PATTERNS = 1000.0


def random_covariance(rng: np.random.Generator, scale: float = 0.1) -> Floats:
    root = rng.normal(0, scale, (5, 5))
    return np.asarray(root @ root.T + 1e-3 * np.eye(5))


def predict(other: KalmanFilter, dt: float, period_s: float) -> None:
    other.F, other.Q = np.eye(10), np.zeros((10, 10))
    for k, spread in enumerate([ACCELERATION_PX, ACCELERATION_PX, EXPANSION]):
        other.F[k, 5 + k] = dt
        density = 2 * (spread / period_s**2) ** 2 * ACCELERATION_PATTERNS * period_s
        other.Q[np.ix_([k, 5 + k], [k, 5 + k])] = Q_continuous_white_noise(2, dt, density)
    walks = np.array([ROLL_WALK, BLUR_WALK, *SUM_WALKS])
    other.Q[[3, 4, 8, 9], [3, 4, 8, 9]] = walks**2 * dt / (WALK_PATTERNS * period_s)
    # the closing speed is constant: Z = Z_0 - v t, ln pitch = const - ln Z, and the rate is v / Z
    part = dt * other.x[7, 0]
    other.predict()
    other.x[2, 0] -= np.log(1 - part) + part
    other.x[7, 0] /= 1 - part


def updated(state: PoseState, z: Floats, noise: Floats, observation: Observation = POSE) -> PoseState:
    """Condition a state on a linear fit to z with the expected pose as prior."""
    mean, spread = state.expected(observation)
    prior = np.linalg.inv(spread)
    covariance = np.linalg.inv(prior + np.linalg.inv(noise))
    return state.condition(covariance @ (prior @ mean + np.linalg.solve(noise, z)), covariance, observation)


@pytest.mark.parametrize("period_s", [1e-5, PERIOD_S, 0.1])
@pytest.mark.parametrize("observation", [POSE, sum_observation(-2e-4), kalman.HEADER_OBSERVATION])
def test_filter_equals_filterpy_at_any_rate_of_the_light(observation: Observation, period_s: float) -> None:
    rng, model = np.random.default_rng(1), MotionModel(period_s, ACCELERATION_PX)
    state = PoseState.start(0.0, rng.normal(size=5), random_covariance(rng), model)
    other = KalmanFilter(dim_x=10, dim_z=5)
    other.x, other.P = state.mean.reshape(-1, 1).copy(), state.covariance.copy()
    for step in range(1, 40):
        time_s = (2 * step + 0.5 * rng.random()) * period_s
        predict(other, time_s - state.time_s, period_s)
        state = state.predict(time_s, model)
        z, noise = rng.normal(size=5), random_covariance(rng)
        # model error acts as additional measurement noise
        other.update(z.reshape(-1, 1), R=noise + observation[1], H=observation[0])
        state = updated(state, z, noise, observation)
        assert state.time_s == time_s
        assert state.mean == pytest.approx(other.x.ravel(), rel=1e-6, abs=1e-6)
        assert state.covariance == pytest.approx(other.P, rel=1e-6, abs=1e-9)


def test_covariance_stays_symmetric_and_positive() -> None:
    rng = np.random.default_rng(2)
    state = PoseState.start(0.0, np.zeros(5), np.eye(5), MODEL)
    for step in range(1, 400):
        state = state.predict(0.002 * step, MODEL)
        noise = np.diag(10.0 ** rng.uniform(-10, 2, 5))
        state = updated(state, rng.normal(size=5), noise)
        assert np.array_equal(state.covariance, state.covariance.T)
        scale = np.sqrt(np.diag(state.covariance))
        assert np.linalg.eigvalsh(state.covariance / np.outer(scale, scale)).min() > 0


def test_a_sum_shows_the_pose_late_and_with_a_bias() -> None:
    mean = np.array([50.0, 40.0, 0.1, 0.02, -0.6, 300.0, -150.0, 0.4, 0.03, 0.2])
    moving = PoseState(0.0, mean, PoseState.start(0.0, mean[:5], 1e-4 * np.eye(5), MODEL).covariance)
    shown, _ = moving.expected(sum_observation(2e-4))
    assert shown == pytest.approx([50.06, 39.97, 0.1 + 8e-5 + 0.03, 0.02, -0.6 + 0.2])
    # headers have no bias
    assert moving.expected(kalman.HEADER_OBSERVATION)[0] == pytest.approx(mean[:5])
    assert moving.pose_at(1e-3).vector() == pytest.approx([50.3, 39.85, 0.1004, 0.02, -0.6])


def test_the_size_grows_as_at_a_constant_speed() -> None:
    depth_m, speed_m_s = 50.0, 100.0
    mean = np.zeros(10)
    mean[2], mean[7] = -np.log(depth_m), speed_m_s / depth_m
    state = PoseState(0.0, mean, 1e-6 * np.eye(10))
    for step in range(1, 151):
        state = state.predict(0.002 * step, MODEL)
    assert 1 / state.pose.pitch == pytest.approx(20.0, rel=1e-9)


def test_the_tilt_is_separate_and_grows_uncertain() -> None:
    covariance = np.diag([1e-4] * 5 + [1e-5, 2e-5])
    vector = np.array([50.0, 40.0, 0.1, 0.02, -0.6, -0.1, 0.05])
    later = PoseState.start(0.0, vector, covariance, MODEL).predict(0.5, MODEL)
    assert later.tilt.tolist() == [later.pose.stretch, later.pose.shear] == [-0.1, 0.05]
    assert later.tilt_covariance == pytest.approx(np.diag([1e-5, 2e-5]) + 0.5 * TILT_WALK**2 * np.eye(2))
    # a passing array rotates; 100 patterns T_b at 0.3 / f times its speed
    passing = PoseState.start(0.0, vector, covariance, MODEL, (300.0, -400.0))
    turned = passing.predict(0.5, replace(MODEL, focal_px=3000.0)).tilt_covariance - later.tilt_covariance
    assert turned == pytest.approx((0.3 * 500 / 3000) ** 2 * 0.5 * 100 * PERIOD_S * np.eye(2))
    upright = PoseState.start(0.0, vector[:5], covariance[:5, :5], MODEL)
    assert (upright.pose.stretch, upright.pose.shear) == (0, 0)
    assert upright.tilt_covariance == pytest.approx(1e-6 * np.eye(2))
