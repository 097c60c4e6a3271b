"""Tracker: arrays at rest and in strong shake, and visibility from contrast."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray
from recorder import Recorder
from scenes import ALL_ON, SIDE, draw, drawn_film, frame_of, link, pitch_at
from scipy.ndimage import gaussian_filter1d

from heliograph.receive import Pose, receive_frames
from heliograph.receive.detect.detection import Detection
from heliograph.receive.geometry.fit import Fit
from heliograph.receive.sync.pairing import FramePair
from heliograph.receive.track.kalman import MotionModel, PoseState
from heliograph.receive.track.track import Track, TrackedPair, average_around_leds, contrast
from heliograph.receive.track.tracker import Tracker
from heliograph.signal.header import header_levels

Floats = NDArray[np.float64]


def at_rest(t: Floats) -> Floats:
    return np.stack([47.3 + 0 * t, 48.8 + 0 * t], -1)


def shaking(t: Floats) -> Floats:
    """At most 0.9 px/ms, 40 Hz."""
    reach = 900 / (2 * np.pi * 40)
    return np.stack([47.3 + reach * np.sin(2 * np.pi * 40 * t), 48.8 + 0.5 * reach * np.cos(2 * np.pi * 40 * t)], -1)


def errors(tracked: list[TrackedPair], path: Callable[[Floats], Floats]) -> Floats:
    """Return position errors (pairs, 2) in px; timestamps mark the start of a 1 ms exposure."""
    times = np.array([t.state.time_s for t in tracked])
    places = np.array([(t.state.pose.x, t.state.pose.y) for t in tracked])
    return np.asarray(places - path(times + 0.5e-3), np.float64)


@pytest.mark.parametrize("distance_m", [25.0, 40.0, 80.0])
@pytest.mark.slow
def test_hard_shake_is_followed(distance_m: float) -> None:
    settings, recorder = link(), Recorder()
    frames = drawn_film(settings, 200, shaking, distance_m=distance_m)
    packets = list(receive_frames(frames, settings.signal, settings.receive, recorder))
    assert [all(word.status == "ok" for word in p.layers["high"]) for p in packets] == [True, True]
    assert recorder.lost_s == []
    assert all(t.seen for t in recorder.tracked)
    assert np.sqrt(np.mean(errors(recorder.tracked, shaking)[3:] ** 2)) < 0.1


@pytest.mark.parametrize("distance_m", [40.0, 80.0])
@pytest.mark.slow
def test_at_rest_the_position_is_sharp(distance_m: float) -> None:
    settings, recorder = link("signal.data_pairs=16"), Recorder()
    frames = drawn_film(settings, 72, at_rest, distance_m=distance_m)
    list(receive_frames(frames, settings.signal, settings.receive, recorder))
    assert np.sqrt(np.mean(errors(recorder.tracked, at_rest)[3:] ** 2)) < 0.02


@pytest.mark.parametrize(("pitch", "blur"), [(0.3, 0.5), (0.7, 0.5), (4.0, 0.2)])
def test_contrast_is_what_blur_leaves_of_a_square_of_leds(pitch: float, blur: float) -> None:
    x = np.linspace(-20, 20, 40001)
    sharp = (np.abs(x) < pitch).astype(float)
    sigma = np.hypot(blur, 12**-0.5)
    blurred = gaussian_filter1d(sharp, sigma / (x[1] - x[0]), mode="constant")
    # along x and along y
    left = ((blurred**2).sum() / (sharp**2).sum()) ** 2
    assert contrast(Pose(0, 0, pitch, 0, blur)) == pytest.approx(np.sqrt(left), rel=1e-2)


def followed(gain: float, expected: float, seed: int = 0) -> tuple[Tracker, Track, FramePair]:
    """Return a tracker, a new array with an expected gain, and header frames with another gain."""
    tracker, rng = Tracker(SIDE, MotionModel(1e-3, 0.1)), np.random.default_rng(seed)
    pose, header = Pose(40.2, 39.7, pitch_at(50.0), 0.01, 0.53), header_levels(7) / 4.0
    up, down = (
        frame_of(0.1 + gain / 255 * draw(pose, x, (0, 0), (80, 80)), 2 + k, rng)
        for k, x in enumerate((header, 1 - header))
    )
    fit = Fit(pose.full_vector(), 1e-6 * np.eye(7), expected, 1.0)
    return tracker, tracker.start(Detection(7, 0.0, fit, 1.5e-3, 1.0, 1.0, ALL_ON)), FramePair(up, down)


def moving_header(drift: float) -> tuple[FramePair, Floats]:
    """Return a moving header pair in front of a bright sky with noise 2; drift in px per frame."""
    header, rng = header_levels(7, SIDE) / 2.0 - 1.0, np.random.default_rng(4)
    frames = []
    for k, sign in enumerate((1, -1)):
        pose = Pose(30.2, 29.7 + drift * (k - 0.5), 0.61, 0.0, 0.5)
        # a dark panel, half a pitch wider than the LEDs, hides the sky
        panel = draw(replace(pose, pitch=0.61 * 17 / 16), ALL_ON, (0, 0), (60, 60))
        frames.append(
            frame_of(0.78 * (1 - panel) + 0.8 * draw(pose, 0.5 + 0.5 * sign * header, (0, 0), (60, 60)), k, rng)
        )
    return FramePair(frames[0], frames[1]), header


@pytest.mark.parametrize("drift", [-0.8, -0.4, 0.0, 0.4, 0.8])
def test_a_header_that_moves_is_where_it_is(drift: float) -> None:
    """Header motion leaves a residual in the sum, which resembled blur and biased the filter under a bright sky."""
    pair, header = moving_header(drift)
    tracker, model = Tracker(SIDE, MotionModel(1e-3, 0.1)), MotionModel(1e-3, 0.1)
    vector = np.array([30.2, 29.7, np.log(0.61), 0.0, np.log(0.5)])
    covariance = np.diag([0.1, 0.1, 0.01, 0.01, 0.05]) ** 2
    state = PoseState.start(0.5e-3, vector, covariance, model, (0.0, drift / 1e-3))
    track = Track(state, 204.0, 204.0, ALL_ON, 0.0, ALL_ON)
    found = tracker.follow(track, pair, header)
    assert found.fit.score > 0.995
    assert found.state.pose.y == pytest.approx(29.7, abs=0.03)
    assert abs(found.state.mean[9]) < 0.25


def test_a_sum_that_looks_blurred_does_not_lead_astray() -> None:
    """In strong shake in front of a bright sky, the estimated blur grew until the track was lost."""
    tracker, model = Tracker(SIDE, MotionModel(1e-3, 0.1)), MotionModel(1e-3, 0.1)
    vector = np.array([30.2, 29.7, np.log(0.61), 0.0, np.log(0.5)])
    state = PoseState.start(0.0, vector, np.diag([0.1, 0.1, 0.01, 0.01, 0.05]) ** 2, model)
    track, rng = Track(state, 204.0, 204.0, ALL_ON, 0.0, ALL_ON), np.random.default_rng(4)
    panel = gaussian_filter1d(
        gaussian_filter1d(draw(Pose(30.2, 29.7, 0.66, 0.0, 0.5), ALL_ON, (0, 0), (60, 60)), 0.9, 0), 0.9, 1
    )
    for k in range(60):
        levels = rng.choice([0.0, 0.25, 0.5, 0.75, 1.0], (SIDE, SIDE), p=np.array([1, 4, 6, 4, 1]) / 16)
        frames = [
            frame_of(
                0.78 * (1 - panel) + 0.8 * draw(Pose(30.2, 29.7, 0.61, 0.0, 0.5), shown, (0, 0), (60, 60)),
                2 * k + j,
                rng,
            )
            for j, shown in enumerate((levels, 1 - levels))
        ]
        track = tracker.follow(track, FramePair(frames[0], frames[1])).track
    assert abs(track.state.mean[9]) < 0.35
    assert np.hypot(track.state.pose.x - 30.2, track.state.pose.y - 29.7) < 0.1


def test_the_gain_goes_a_tenth_of_its_way_with_each_sum() -> None:
    tracker, track, pair = followed(180.0, 160.0)
    assert (track.gain, track.data_gain, track.last_seen_s) == (160.0, 160.0, 1.5e-3)
    tracked = tracker.follow(track, pair)
    assert tracked.seen
    assert tracked.before is track
    assert tracked.fit.gain == pytest.approx(180, rel=0.03)
    assert tracked.track.gain - 160 == pytest.approx(0.1 * (tracked.fit.gain - 160))
    # header pairs have a separate gain
    assert tracked.track.data_gain == 160
    assert tracked.track.last_seen_s == pair.time_s


def test_a_header_gives_the_gain_of_the_data() -> None:
    tracker, track, pair = followed(180.0, 160.0)
    refined = tracker.refine(track, pair, header_levels(7) / 2.0 - 1.0)
    assert refined.data_gain == pytest.approx(180, rel=0.02)
    assert refined.gain == 160
    # a header from another array has no effect
    assert tracker.refine(track, pair, header_levels(20) / 2.0 - 1.0) is track


def test_a_hidden_array_leaves_the_gain_as_it_is() -> None:
    tracker, track, pair = followed(0.0, 160.0)
    tracked = tracker.follow(track, pair)
    assert not tracked.seen
    assert (tracked.track.gain, tracked.track.last_seen_s) == (160, 1.5e-3)
    assert tracked.track.state.time_s == pair.time_s


def worst_error(led_gains: Floats, shown: Floats) -> tuple[float, bool]:
    """Return the largest error in px over thirty random data pairs, for a tracker assuming other LED gains."""
    rng, pose = np.random.default_rng(2), Pose(40.2, 39.7, pitch_at(47.0), 0.0, 0.52)
    tracker, model = Tracker(SIDE, MotionModel(1e-3, 0.1)), MotionModel(1e-3, 0.1)
    state = PoseState.start(0.0, pose.full_vector(), np.eye(7) * 1e-3, model)
    track, worst, seen = Track(state, 204.0, 204.0, led_gains, 0.0, average_around_leds(led_gains, pose)), 0.0, True
    for k in range(30):
        levels = rng.binomial(4, 0.5, (SIDE, SIDE)) / 4
        light = [0.1 + 0.8 * draw(pose, shown * x, (0, 0), (80, 80)) for x in (levels, 1 - levels)]
        frames = [frame_of(one, 2 * k + i, rng) for i, one in enumerate(light)]
        tracked = tracker.follow(track, FramePair(frames[0], frames[1]))
        track, seen = tracked.track, seen and tracked.seen
        worst = max(worst, float(np.hypot(track.state.pose.x - pose.x, track.state.pose.y - pose.y)))
    return worst, seen


@pytest.mark.parametrize("columns", [2, 3, 5])
def test_leds_that_were_hidden_in_the_header_pull_no_pose_once_they_are_in_sight(columns: int) -> None:
    taken = ALL_ON.copy()
    taken[:, :columns] = 0
    worst, seen = worst_error(taken, ALL_ON)
    assert seen
    assert worst < 0.15


def test_leds_that_are_dead_here_and_there_hide_no_others() -> None:
    dead = (np.random.default_rng(5).random((SIDE, SIDE)) > 0.15).astype(np.float64)
    worst, seen = worst_error(dead, dead)
    assert seen
    assert worst < 0.1
