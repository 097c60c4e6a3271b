"""Data without inverses: background estimated from headers, and decision-directed tracking."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scenes import ALL_ON, Floats, draw, frame_of, pitch_at
from scipy.special import erf

from heliograph.base.frames import Frame
from heliograph.receive.equalise import single_mode
from heliograph.receive.equalise.single_mode import DecisionDirectedTracker, HeaderPair, fit_background
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.sync.pairing import FramePair
from heliograph.receive.track.kalman import MotionModel, PoseState
from heliograph.receive.track.track import Track
from heliograph.receive.track.tracker import Tracker
from heliograph.signal import haar
from heliograph.signal.header import header_levels
from heliograph.signal.polarity import balance
from heliograph.signal.pwm import light_centroids, lit_slots

GAIN = 0.8 * 255
PANEL = 9.0
"""Half side of the panel in pitches; the blur of the outer LEDs reaches the rim."""


def framed(
    pose: Pose, levels: Floats, index: int, rng: np.random.Generator, motion: tuple[float, float] = (0.0, 0.0)
) -> Frame:
    """Render a frame with LED levels 0 to 4, centred at a pose; `motion` is px during the pattern exposure."""
    light = np.zeros((80, 80))
    # each slot covers a quarter of the motion
    slots = lit_slots(levels.astype(np.uint8)) if any(motion) else levels[None] / 4.0
    for k, lit in enumerate(slots):
        part = (k + 0.5) / len(slots) - 0.5
        at = pose.moved(part * motion[0], part * motion[1])
        edge, grid = PANEL * at.pitch, np.arange(80)
        across, down = (0.5 * (erf((edge - abs(grid - c)) / 0.75) + 1) for c in (at.x, at.y))
        shown = 0.45 - 0.43 * down[:, None] * across
        # slots have equal length, hence equal weights
        light += (shown + 0.8 * draw(at, lit.astype(float), (0, 0), light.shape)) / len(slots)
    return frame_of(light, index, rng)


def headers() -> list[HeaderPair]:
    """Return the two header pairs for identity 7 at 80 m."""
    rng, levels = np.random.default_rng(0), header_levels(7).astype(float)
    pose = Pose(40.2, 39.7, pitch_at(80.0), 0.01, 0.53)
    up, down, again, inverse = (framed(pose, abs(4 * (k % 2) - levels), k, rng) for k in range(4))
    return [(FramePair(up, down), (pose, pose)), (FramePair(again, inverse), (pose, pose))]


def patterns(count: int, seed: int) -> list[Floats]:
    rng = np.random.default_rng(seed)
    d = rng.choice(np.array([-1, 1], np.int8), (count, 16, 16))
    d[:, :8, :8] = balance(d[:, :8, 1:8])
    return [one.astype(float) for one in haar.encode(d)]


MODEL = MotionModel(1e-3, 0.1)
POSE = Pose(40.4, 40.3, pitch_at(80.0), 0.01, 0.53)
# delay of mean light and data light after mid-exposure, in patterns
LATE = light_centroids()[0] - 0.5, light_centroids()[1] - 0.5


def test_noise_and_background_are_estimated_from_headers() -> None:
    noise = tracker_of().noise
    # photon and read noise for the reference link, in gray levels, of twice a frame; 15000 electrons full well
    lit = (255 / 15000) ** 2 * (15000 * 0.42 + 40.0**2) + 1 / 12
    assert noise.lit == pytest.approx(4 * lit, rel=0.3)
    assert noise.dark > 2
    half, coefficients, variance = fit_background(headers(), GAIN, ALL_ON)
    # the panel extends 9 pitches from the centre; an error of half a pitch would bias the pitch by 5 %
    assert half == pytest.approx(PANEL, abs=0.15)
    # half the noise variance of a sum is 1.6 outside the array
    assert variance < 6
    corner, image = single_mode.surroundings(framed(POSE, np.zeros((16, 16)), 50, np.random.default_rng(5)), POSE, 16)
    rows, cols = image.shape
    left = image - np.tensordot(coefficients, single_mode.background_images(POSE, corner, (rows, cols), half)[:, 0], 1)
    # of a dark array: background 114 gray levels, panel 5
    assert np.abs(left).mean() < 4
    assert np.abs(image).mean() > 40


def tracker_of(late_s: tuple[float, float] = (0.0, 0.0)) -> DecisionDirectedTracker:
    return DecisionDirectedTracker(Tracker(16, MODEL), late_s, headers(), GAIN, ALL_ON)


def expected(pose: Pose, time_s: float, rates: tuple[float, float] = (0.0, 0.0)) -> Track:
    """Create a track with a predicted pose of almost unknown position, and a known velocity in px/s."""
    spreads = np.array([1.0, 1.0, 0.002, 0.002, 0.02])
    state = PoseState.start(time_s, pose.vector(), np.diag(spreads**2), MODEL)
    mean, covariance = state.mean.copy(), state.covariance.copy()
    mean[5:7] = rates
    covariance[5:8, 5:8] *= 1e-6
    return Track(PoseState(time_s, mean, covariance), GAIN, GAIN, ALL_ON, time_s, ALL_ON)


def errors(motion: tuple[float, float], late: tuple[float, float] = LATE) -> tuple[Floats, Floats]:
    """Return errors (frames, 2) in px and fit scores (frames,), starting 0.07 px off.

    `late` sets the tracker's delays for mean light and data light, in patterns.
    """
    decisions = tracker_of((late[0] * 1e-3, late[1] * 1e-3))
    rng, found, scores = np.random.default_rng(3), [], []
    for k, (earlier, levels) in enumerate(pairwise(patterns(13, 4))):
        # random subpixel position
        x, y = 40 + rng.uniform(-0.5, 0.5, 2)
        pose = Pose(x, y, pitch_at(80.0), 0.01, 0.53)
        before = framed(pose.moved(-motion[0], -motion[1]), earlier, 10 + 2 * k, rng, motion)
        frame = framed(pose, levels, 11 + 2 * k, rng, motion)
        track = expected(pose.moved(0.06, -0.04), frame.time_s, (1e3 * motion[0], 1e3 * motion[1]))
        decided = decisions.follow(track, FramePair(before, frame))
        assert decided.seen
        found.append(decided.fit.vector[:2] - (x, y))
        scores.append(decided.fit.score)
    return np.array(found), np.array(scores)


def test_a_frame_corrects_a_wrong_pose() -> None:
    """Decisions at a wrong pose do not confirm this pose, and the square of the panel follows the pose."""
    steps, scores = errors((0.0, 0.0))
    assert scores.min() > 0.9
    assert np.sqrt(np.mean(np.square(steps))) < 0.02
    assert np.abs(np.mean(steps, 0)).max() < 0.01


@pytest.mark.slow
def test_mean_light_and_data_light_have_separate_delays() -> None:
    """PWM is bright early in a pattern: in motion, mean light trails data light by 0.19 patterns."""
    motion = 1.5, -1.2
    steps, scores = errors(motion)
    assert np.sqrt(np.mean(np.square(steps))) < 0.04
    # other delays fit worse: both zero, equal, or swapped
    for late in ((0.0, 0.0), (LATE[0], LATE[0]), (LATE[1], LATE[0])):
        _, others = errors(motion, late)
        assert np.mean(others < scores) > 0.7, late


def test_cutouts_have_the_poses_of_mean_light_and_data_light() -> None:
    mean_late_s, data_late_s = -2e-4, 1e-4
    rng, levels = np.random.default_rng(6), patterns(2, 1)
    frames = framed(POSE.moved(-0.5, 0.2), levels[0], 10, rng), framed(POSE, levels[1], 11, rng)
    track = expected(POSE, frames[1].time_s, (500.0, -200.0))
    decided = tracker_of((mean_late_s, data_late_s)).follow(track, FramePair(*frames))
    state = decided.state
    for frame, cutout in zip(frames, decided.cutouts, strict=True):
        (data,), light = cutout.poses, cutout.mean_light_pose
        assert light is not None
        for shown, late_s in ((data, data_late_s), (light, mean_late_s)):
            place = state.mean[:2] + (frame.time_s + late_s - state.time_s) * state.mean[5:7]
            assert (shown.x, shown.y) == pytest.approx(place)
        # motion during 0.3 ms
        assert data.x - light.x == pytest.approx(0.15, rel=0.05)


def test_a_cutout_is_twice_the_light_above_the_background() -> None:
    rng, even = np.random.default_rng(5), np.full((16, 16), 2.0)
    frames = framed(POSE, even, 10, rng), framed(POSE, even, 11, rng)
    decided = tracker_of().follow(expected(POSE, frames[1].time_s), FramePair(*frames))
    for cutout in decided.cutouts:
        rows, cols = (slice(size // 2 - 2, size // 2 + 2) for size in cutout.shape)
        assert cutout.difference[rows, cols].mean() == pytest.approx(2 * 0.5 * GAIN, rel=0.03)
        assert np.array_equal(cutout.difference, cutout.total)
        assert cutout.difference[0].mean() == pytest.approx(0, abs=8)


def test_a_hidden_array_keeps_the_predicted_pose() -> None:
    """The next frame is unaffected."""
    rng, (first, second) = np.random.default_rng(7), patterns(2, 2)
    decisions, plain = tracker_of(), tracker_of()
    gray, more = (frame_of(np.full((80, 80), 0.8), k, rng) for k in (10, 11))
    track = expected(POSE, more.time_s)
    hidden = decisions.follow(track, FramePair(gray, more))
    assert not hidden.seen
    assert hidden.track.last_seen_s == track.last_seen_s
    assert np.array_equal(hidden.state.mean, track.state.mean)
    pair = FramePair(framed(POSE, first, 12, rng), framed(POSE, second, 13, rng))
    after, unaffected = (one.follow(expected(POSE, pair.inverted.time_s), pair) for one in (decisions, plain))
    assert np.array_equal(after.cutouts[1].difference, unaffected.cutouts[1].difference)
    assert after.seen


def test_clutter_moves_the_pose_by_bounded_steps() -> None:
    """An unbounded blur once required gigabytes of memory."""
    rng, decisions, wide = np.random.default_rng(8), tracker_of(), expected(POSE, 0.011)
    # no prior: frames determine the pose
    track = replace(wide, state=PoseState(0.011, wide.state.mean, 1e6 * wide.state.covariance))
    for k in range(10):
        squares = [rng.uniform(0, 1, (10, 10)).repeat(8, 0).repeat(8, 1) for _ in range(2)]
        first, second = (frame_of(light, 10 + 2 * k + n, rng) for n, light in enumerate(squares))
        step = np.abs(decisions.follow(track, FramePair(first, second)).fit.vector[:5] - POSE.vector())
        assert (step <= np.array([0.8, 0.8, 0.2, 0.2, 0.2]) + 1e-9).all()
