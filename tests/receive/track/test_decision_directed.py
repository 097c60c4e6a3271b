"""Decision-directed tracking for data without inverses."""

from itertools import pairwise

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import frame_of, pitch_at
from single_frames import GAIN, framed, headers, patterns

from heliograph.receive import Pose
from heliograph.receive.equalise.single_mode import DecisionDirectedTracker
from heliograph.receive.sync.pairing import FramePair
from heliograph.receive.track.kalman import MotionModel, PoseState
from heliograph.receive.track.track import Track
from heliograph.receive.track.tracker import Tracker
from heliograph.signal.pwm import light_centroids

Floats = NDArray[np.float64]

SOUND = np.ones((16, 16))
MODEL = MotionModel(1e-3, 0.1)
SPREADS = np.array([1.0, 1.0, 0.002, 0.002, 0.02])
"""Standard deviations of the predicted pose; the position is almost unknown."""

LATE = light_centroids()[0] - 0.5, light_centroids()[1] - 0.5
"""Delay of mean light and data light after mid-exposure, in patterns."""


def tracker_of(late_s: tuple[float, float] = (0.0, 0.0)) -> DecisionDirectedTracker:
    """Create a tracker at 80 m after a header."""
    return DecisionDirectedTracker(Tracker(16, MODEL), late_s, headers(), GAIN, SOUND)


def expected(pose: Pose, time_s: float, rates: tuple[float, float] = (0.0, 0.0)) -> Track:
    """Create a track with a predicted pose and velocity in px/s."""
    state = PoseState.start(time_s, pose.full_vector()[:5], np.diag(SPREADS**2), MODEL)
    mean = state.mean.copy()
    mean[5:7] = rates
    covariance = state.covariance.copy()
    covariance[5:8, 5:8] *= 1e-6
    return Track(PoseState(time_s, mean, covariance), GAIN, GAIN, SOUND, time_s, SOUND)


def errors(motion: tuple[float, float], late: tuple[float, float] | None = None) -> tuple[Floats, Floats]:
    """Return errors (frames, 2) in px and fit scores (frames,), starting 0.07 px off.

    `late` sets the tracker's delays for mean light and data light, in patterns.
    """
    mean_late, data_late = late or LATE
    decisions = tracker_of((mean_late * 1e-3, data_late * 1e-3))
    rng, found, scores = np.random.default_rng(3), [], []
    for k, (earlier, levels) in enumerate(pairwise(patterns(13, 4))):
        # random subpixel position
        x, y = 40 + rng.uniform(-0.5, 0.5, 2)
        pose = Pose(x, y, pitch_at(80.0), 0.01, 0.53)
        before = framed(pose.moved(-motion[0], -motion[1]), earlier, 10 + 2 * k, rng, motion)
        frame = framed(pose, levels, 11 + 2 * k, rng, motion)
        rates = 1e3 * motion[0], 1e3 * motion[1]
        track = expected(pose.moved(0.06, -0.04), frame.time_s, rates)
        decided = decisions.follow(track, FramePair(before, frame))
        assert decided.seen
        found.append(decided.fit.vector[:2] - (x, y))
        scores.append(decided.fit.score)
    return np.array(found), np.array(scores)


def test_a_frame_pulls_a_wrong_pose_back() -> None:
    """Decisions at a wrong pose do not confirm this pose."""
    steps, scores = errors((0.0, 0.0))
    assert scores.min() > 0.9
    assert np.sqrt(np.mean(np.square(steps))) < 0.02
    assert np.abs(np.mean(steps, 0)).max() < 0.01


@pytest.mark.slow
def test_the_light_of_the_mean_and_that_of_the_data_come_at_their_times() -> None:
    """PWM is bright early in a pattern: in motion, mean light trails data light by 0.19 patterns."""
    motion = 1.5, -1.2
    steps, scores = errors(motion)
    assert np.sqrt(np.mean(np.square(steps))) < 0.04
    # other delays fit worse: both zero, equal, or swapped
    for late in ((0.0, 0.0), (LATE[0], LATE[0]), (LATE[1], LATE[0])):
        _, others = errors(motion, late)
        assert np.mean(others < scores) > 0.7, late


def test_cutouts_have_the_poses_of_their_light() -> None:
    mean_late_s, data_late_s = -2e-4, 1e-4
    rng, pose, levels = np.random.default_rng(6), Pose(40.2, 39.8, pitch_at(80.0), 0.01, 0.53), patterns(2, 1)
    frames = framed(pose.moved(-0.5, 0.2), levels[0], 10, rng), framed(pose, levels[1], 11, rng)
    track = expected(pose, frames[1].time_s, (500.0, -200.0))
    decided = tracker_of((mean_late_s, data_late_s)).follow(track, FramePair(*frames))
    state = decided.state
    for frame, cutout in zip(frames, decided.cutouts, strict=True):
        (data,) = cutout.poses
        assert cutout.mean_light_pose is not None
        assert (data.x, data.y) == pytest.approx(_place(state, frame.time_s + data_late_s))
        light = cutout.mean_light_pose
        assert (light.x, light.y) == pytest.approx(_place(state, frame.time_s + mean_late_s))
        # motion during 0.3 ms
        assert data.x - light.x == pytest.approx(0.15, rel=0.05)


def _place(state: PoseState, time_s: float) -> tuple[float, float]:
    x, y = state.mean[:2] + (time_s - state.time_s) * state.mean[5:7]
    return float(x), float(y)


def test_a_cutout_is_twice_the_light_above_the_background() -> None:
    rng, pose = np.random.default_rng(5), Pose(40.4, 40.3, pitch_at(80.0), 0.01, 0.53)
    even = np.full((16, 16), 2.0)
    frames = framed(pose, even, 10, rng), framed(pose, even, 11, rng)
    decided = tracker_of().follow(expected(pose, frames[1].time_s), FramePair(*frames))
    for cutout in decided.cutouts:
        rows, cols = cutout.shape
        inside = cutout.difference[rows // 2 - 2 : rows // 2 + 2, cols // 2 - 2 : cols // 2 + 2]
        assert inside.mean() == pytest.approx(2 * 0.5 * GAIN, rel=0.03)
        assert np.array_equal(cutout.difference, cutout.total)
        assert cutout.difference[0].mean() == pytest.approx(0, abs=8)


def test_what_hides_the_array_is_not_followed() -> None:
    """Tracking continues as predicted, and the next frame is unaffected."""
    rng, pose = np.random.default_rng(7), Pose(40.4, 40.3, pitch_at(80.0), 0.01, 0.53)
    first, second = patterns(2, 2)
    decisions, plain = tracker_of(), tracker_of()
    gray, more = (frame_of(np.full((80, 80), 0.8), k, rng) for k in (10, 11))
    track = expected(pose, more.time_s)
    hidden = decisions.follow(track, FramePair(gray, more))
    assert not hidden.seen
    assert hidden.track.last_seen_s == track.last_seen_s
    assert np.array_equal(hidden.state.mean, track.state.mean)
    pair = FramePair(framed(pose, first, 12, rng), framed(pose, second, 13, rng))
    after, alone = (one.follow(expected(pose, pair.inverted.time_s), pair) for one in (decisions, plain))
    assert np.array_equal(after.cutouts[1].difference, alone.cutouts[1].difference)
    assert after.seen


def test_what_is_no_array_moves_the_pose_by_bounded_steps() -> None:
    """An unbounded blur once required gigabytes of memory."""
    rng, pose, decisions = np.random.default_rng(8), Pose(40.4, 40.3, pitch_at(80.0), 0.01, 0.53), tracker_of()
    wide = expected(pose, 0.011)
    # no prior: frames determine the pose
    state = PoseState(wide.state.time_s, wide.state.mean, 1e6 * wide.state.covariance)
    for k in range(10):
        squares = [np.repeat(np.repeat(rng.uniform(0, 1, (10, 10)), 8, 0), 8, 1) for _ in range(2)]
        first, second = (frame_of(light, 10 + 2 * k + n, rng) for n, light in enumerate(squares))
        track = Track(state, GAIN, GAIN, SOUND, state.time_s, SOUND)
        step = decisions.follow(track, FramePair(first, second)).fit.vector[:5] - pose.full_vector()[:5]
        assert np.abs(step[2:]).max() <= 0.2 + 1e-9
        assert np.abs(step[:2]).max() <= 0.8 + 1e-9


def test_noise_is_that_of_twice_a_frame() -> None:
    noise = tracker_of().noise
    # photon and read noise for the reference link, in gray levels; 15000 electrons full well
    per_electron = 255 / 15000
    lit = per_electron**2 * (15000 * 0.42 + 40.0**2) + 1 / 12
    assert noise.lit == pytest.approx(4 * lit, rel=0.3)
    assert noise.dark > 2
