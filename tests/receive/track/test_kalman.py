"""Pose filter against filterpy's Kalman filter."""

from dataclasses import replace

import numpy as np
import pytest
from filterpy.common import Q_continuous_white_noise
from filterpy.kalman import KalmanFilter

from heliograph.base.arrays import Floats
from heliograph.receive.track.kalman import (
    HEADER_OBSERVATION,
    POSE,
    MotionModel,
    Observation,
    PoseState,
    sum_observation,
)

PERIOD_S, ACCELERATION_PX = 1e-3, 0.1
MODEL = MotionModel(PERIOD_S, ACCELERATION_PX)

# model assumptions, in patterns
ACCELERATION_PATTERNS, EXPANSION = 4.0, 5e-7
ROLL_WALK, BLUR_WALK, TILT_WALK, SUM_WALKS = 0.03, 0.1, 0.01, (0.01, 0.2)
WALK_PATTERNS = 1000.0


def random_covariance(rng: np.random.Generator, scale: float = 0.1) -> Floats:
    root = rng.normal(0, scale, (5, 5))
    return np.asarray(root @ root.T + 1e-3 * np.eye(5))


def predict(other: KalmanFilter, dt: float) -> None:
    other.F, other.Q = np.eye(10), np.zeros((10, 10))
    for k, spread in enumerate([ACCELERATION_PX, ACCELERATION_PX, EXPANSION]):
        other.F[k, 5 + k] = dt
        density = 2 * (spread / PERIOD_S**2) ** 2 * ACCELERATION_PATTERNS * PERIOD_S
        other.Q[np.ix_([k, 5 + k], [k, 5 + k])] = Q_continuous_white_noise(2, dt, density)
    walked = dt / (WALK_PATTERNS * PERIOD_S)
    other.Q[3, 3], other.Q[4, 4] = ROLL_WALK**2 * walked, BLUR_WALK**2 * walked
    other.Q[8, 8], other.Q[9, 9] = SUM_WALKS[0] ** 2 * walked, SUM_WALKS[1] ** 2 * walked
    other.predict()


def updated(state: PoseState, z: Floats, noise: Floats, observation: Observation = POSE) -> PoseState:
    """Condition a state on a linear fit to z with the expected pose as prior."""
    mean, spread = state.expected(observation)
    prior = np.linalg.inv(spread)
    covariance = np.linalg.inv(prior + np.linalg.inv(noise))
    return state.condition(covariance @ (prior @ mean + np.linalg.solve(noise, z)), covariance, observation)


@pytest.mark.parametrize("observation", [POSE, sum_observation(-2e-4), HEADER_OBSERVATION])
def test_same_as_filterpy(observation: Observation) -> None:
    rng = np.random.default_rng(1)
    state = PoseState.start(0.0, rng.normal(size=5), random_covariance(rng), MODEL)
    other = KalmanFilter(dim_x=10, dim_z=5)
    other.x, other.P = state.mean.reshape(-1, 1).copy(), state.covariance.copy()
    for step in range(1, 40):
        time_s = 0.002 * step + 0.0005 * rng.random()
        predict(other, time_s - state.time_s)
        state = state.predict(time_s, MODEL)
        z, noise = rng.normal(size=5), random_covariance(rng)
        # model error acts as additional measurement noise
        other.update(z.reshape(-1, 1), R=noise + observation[1], H=observation[0])
        state = updated(state, z, noise, observation)
        assert state.time_s == time_s
        assert state.mean == pytest.approx(other.x.ravel(), rel=1e-6, abs=1e-6)
        assert state.covariance == pytest.approx(other.P, rel=1e-6, abs=1e-9)


def test_model_errors_limit_the_trust_in_a_sharp_fit() -> None:
    state = PoseState.start(0.0, np.zeros(5), 0.04 * np.eye(5), MODEL)
    sharp = 1e-8 * np.eye(5)
    trusting = updated(state, np.ones(5), sharp)
    assert trusting.mean[:5] == pytest.approx(np.ones(5), abs=1e-4)
    doubtful = POSE[0], np.diag([0, 0, 0.2, 0, 0]) ** 2
    careful = updated(state, np.ones(5), sharp, doubtful)
    # equal state and model variances: half the innovation, half the variance
    assert careful.mean[:5] == pytest.approx([1, 1, 0.5, 1, 1], abs=1e-4)
    assert careful.covariance[2, 2] == pytest.approx(0.02, rel=1e-3)


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


def test_rates_of_an_even_motion_are_estimated() -> None:
    rates = np.array([300.0, -150.0, 0.4])
    start = np.array([50.0, 40.0, 0.1, 0.0, -0.6])
    state = PoseState.start(0.0, start, 1e-4 * np.eye(5), MODEL)
    for step in range(1, 60):
        state = state.predict(0.002 * step, MODEL)
        z = start.copy()
        z[:3] += rates * state.time_s
        state = updated(state, z, np.diag([1e-4, 1e-4, 1e-6, 1e-6, 1e-4]))
    assert state.mean[5:8] == pytest.approx(rates, rel=0.02)
    later = state.pose_at(state.time_s + 0.001)
    assert later.x - state.pose.x == pytest.approx(0.3, rel=0.02)
    assert later.pitch / state.pose.pitch == pytest.approx(np.exp(0.0004), rel=1e-4)


@pytest.mark.parametrize("period_s", [1e-5, 0.1])
def test_a_slower_light_gives_the_same_filter_from_pattern_to_pattern(period_s: float) -> None:
    """Spreads are per pattern: times and rates scale with the period, poses do not."""
    scale = np.ones(10)
    scale[5:8] = period_s / PERIOD_S
    states = []
    for period in (PERIOD_S, period_s):
        model = MotionModel(period, ACCELERATION_PX)
        rng = np.random.default_rng(3)
        state = PoseState.start(0.0, rng.normal(size=5), random_covariance(rng), model)
        for step in range(1, 20):
            state = state.predict(2 * step * period, model)
            state = updated(state, rng.normal(size=5), random_covariance(rng))
        states.append(state)
    fast, slow = states
    assert slow.mean * scale == pytest.approx(fast.mean, rel=1e-6, abs=1e-9)
    assert slow.covariance * np.outer(scale, scale) == pytest.approx(fast.covariance, rel=1e-6, abs=1e-12)
    assert slow.tilt_covariance == pytest.approx(fast.tilt_covariance)


def test_a_sum_shows_the_pose_late_and_with_a_bias() -> None:
    state = PoseState.start(0.0, np.array([50.0, 40.0, 0.1, 0.02, -0.6]), 1e-4 * np.eye(5), MODEL)
    mean = state.mean.copy()
    mean[5:] = [300.0, -150.0, 0.4, 0.03, 0.2]
    moving = PoseState(0.0, mean, state.covariance)
    shown, _ = moving.expected(sum_observation(2e-4))
    assert shown == pytest.approx([50.06, 39.97, 0.1 + 8e-5 + 0.03, 0.02, -0.6 + 0.2])
    # headers have no bias
    assert moving.expected(HEADER_OBSERVATION)[0] == pytest.approx(mean[:5])


def test_the_tilt_is_separate_and_grows_uncertain() -> None:
    covariance = np.diag([1e-4] * 5 + [1e-5, 2e-5])
    vector = np.array([50.0, 40.0, 0.1, 0.02, -0.6, -0.1, 0.05])
    state = PoseState.start(0.0, vector, covariance, MODEL)
    later = state.predict(0.5, MODEL)
    assert later.tilt.tolist() == [-0.1, 0.05]
    assert later.tilt_covariance == pytest.approx(np.diag([1e-5, 2e-5]) + 0.5 * TILT_WALK**2 * np.eye(2))
    assert (later.pose.stretch, later.pose.shear) == (-0.1, 0.05)
    # a passing array rotates; 100 patterns T_b at 0.3 / f times its speed
    passing = PoseState.start(0.0, vector, covariance, MODEL, (300.0, -400.0))
    turned = passing.predict(0.5, replace(MODEL, focal_px=3000.0)).tilt_covariance - later.tilt_covariance
    assert turned == pytest.approx((0.3 * 500 / 3000) ** 2 * 0.5 * 100 * PERIOD_S * np.eye(2))
    upright = PoseState.start(0.0, vector[:5], covariance[:5, :5], MODEL)
    assert (upright.pose.stretch, upright.pose.shear) == (0, 0)
    assert upright.tilt_covariance == pytest.approx(1e-6 * np.eye(2))
