"""Occlusion from the side, and poses unaffected by the occluder's light."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import ALL_ON, SIDE, draw, frame_of, pitch_at

from heliograph.receive import Pose
from heliograph.receive.sync.pairing import FramePair
from heliograph.receive.track import kernels
from heliograph.receive.track.kalman import MotionModel, PoseState
from heliograph.receive.track.kernels import COVERED_LINE_RATE, LINE_RATE
from heliograph.receive.track.track import Track, TrackParameters, line_distance
from heliograph.receive.track.tracker import Tracker

Floats = NDArray[np.float64]

SHAPE, GAIN, PARAMETERS = (70, 70), 204.0, TrackParameters()


def pose_at(distance_m: float) -> Pose:
    return Pose(34.6, 35.3, pitch_at(distance_m), 0.02, 0.53)


def scene(pose: Pose, reach: float | None = None, level: float = 1.0, side: str = "left") -> Floats:
    """Render an array with all LEDs at a quarter of full light; a post covers `reach` pitches from one side."""
    light = 0.1 + 0.2 * draw(pose, ALL_ON, (0, 0), SHAPE)
    if reach is None:
        return light
    turns = {"left": 0, "top": 1, "right": 2, "bottom": -1}[side]
    turned = np.rot90(light, turns).copy()
    middle = {"left": pose.x, "top": pose.y, "right": 69 - pose.x, "bottom": 69 - pose.y}[side]
    edge = middle + (reach - 0.5 * SIDE) * pose.pitch
    hides = np.clip(edge + 0.5 - np.arange(70), 0, 1)
    return np.asarray(np.rot90(turned + hides * (level - turned), -turns), np.float64)


def cleared(
    pose: Pose, light: Floats, usual: Floats | None, in_sight: Floats = ALL_ON, gain: float = GAIN
) -> tuple[Floats, Floats]:
    """Return uncovered LEDs and the updated line baselines."""
    clear, lines = np.ones((SIDE, SIDE)), np.full((2, SIDE + 2), np.nan) if usual is None else usual.copy()
    middle, away = np.array([pose.x, pose.y]), line_distance(pose, SIDE)
    kernels.uncover(2 * 255 * light, middle, pose.axes, away, PARAMETERS.min_line_change * gain, in_sight, lines, clear)
    return clear, lines


@pytest.mark.parametrize("distance_m", [20.0, 50.0, 95.0])
@pytest.mark.parametrize("level", [0.0, 1.0])
@pytest.mark.parametrize("side", ["left", "top", "right", "bottom"])
def test_leds_are_covered_from_the_side_on(distance_m: float, level: float, side: str) -> None:
    pose = pose_at(distance_m)
    clear, usual = cleared(pose, scene(pose), None)
    assert clear.all()
    found, _ = cleared(pose, scene(pose, 5.0, level, side), usual)
    lines = np.rot90(found, {"left": 0, "top": 1, "right": 2, "bottom": -1}[side]).mean(0)
    # lines are covered completely; blur extends by about a pixel
    assert set(lines) <= {0.0, 1.0}
    covered = int((lines == 0).sum())
    assert not lines[:covered].any()
    assert 4 <= covered <= 6 + 1.5 / pose.pitch


@pytest.mark.parametrize("distance_m", [20.0, 50.0, 95.0])
def test_a_post_is_seen_before_it_hides_an_led(distance_m: float) -> None:
    pose = pose_at(distance_m)
    _, usual = cleared(pose, scene(pose), None)
    clear, _ = cleared(pose, scene(pose, -0.5), usual)
    assert not clear[:, 0].any()
    assert clear[:, 1 + int(2 / pose.pitch) :].all()


@pytest.mark.parametrize("offset", [(0.6, 0.0), (-0.6, 0.5), (0.0, -0.6)])
@pytest.mark.parametrize("distance_m", [20.0, 50.0, 95.0])
def test_an_array_off_its_place_is_not_covered(offset: tuple[float, float], distance_m: float) -> None:
    pose = pose_at(distance_m)
    _, usual = cleared(pose, scene(pose), None)
    clear, _ = cleared(pose.moved(*offset), scene(pose), usual)
    assert clear.all()


def test_what_changes_everywhere_covers_nothing() -> None:
    """If all lines counted as covered, no LED would fix the pose."""
    pose = pose_at(50.0)
    _, usual = cleared(pose, scene(pose), None)
    clear, _ = cleared(pose, 0.3 + scene(pose), usual)
    assert clear.all()


def test_what_stays_beside_the_array_belongs_to_its_surroundings() -> None:
    pose, post = pose_at(50.0), 0
    _, usual = cleared(pose, scene(pose), None)
    for pairs in range(400):
        clear, usual = cleared(pose, scene(pose, -0.3), usual)
        if clear.all():
            post = pairs
            break
    # ln(change / threshold) / rate
    assert 0.5 / COVERED_LINE_RATE < post < 3.5 / COVERED_LINE_RATE


def test_lines_follow_slow_changes() -> None:
    pose = pose_at(50.0)
    _, before = cleared(pose, scene(pose), None)
    _, after = cleared(pose, scene(pose) + 0.01, before)
    assert after - before == pytest.approx(LINE_RATE * 2 * 255 * 0.01, abs=1e-6)


def test_hidden_leds_come_back_as_they_were() -> None:
    pose, in_sight = pose_at(50.0), ALL_ON.copy()
    in_sight[:, :7] = 0
    _, before = cleared(pose, scene(pose), None)
    after = before
    for _ in range(300):
        clear, after = cleared(pose, scene(pose, 7.0), after, in_sight)
    assert not clear[:, :7].any()
    assert np.array_equal(after[0, :8], before[0, :8])
    clear, _ = cleared(pose, scene(pose), after)
    assert clear.all()


def test_of_an_array_just_found_it_is_not_known_what_is_usual() -> None:
    """A post may be present at detection; LEDs appearing later must not count as covered."""
    pose = pose_at(50.0)
    _, usual = cleared(pose, scene(pose, -0.5), None, gain=np.inf)
    clear, after = cleared(pose, scene(pose), usual, gain=np.inf)
    assert clear.all()
    assert after[0, 0] - usual[0, 0] == pytest.approx(-LINE_RATE * 2 * 255 * 0.9, rel=0.05)


@pytest.mark.parametrize("level", [0.02, 0.6, 0.95])
@pytest.mark.parametrize("distance_m", [41.0, 60.0])
def test_a_post_does_not_pull_the_pose(distance_m: float, level: float) -> None:
    """A post with 146 of 255 gray levels shifted an array at 41 m by 1.2 px before hiding an LED, then by 20 px."""
    pose, rng, model = pose_at(distance_m), np.random.default_rng(8), MotionModel(1e-3, 0.1)
    tracker = Tracker(SIDE, model)
    state = PoseState.start(0.0, pose.full_vector()[:5], np.diag([0.05, 0.05, 1e-3, 1e-3, 0.05]) ** 2, model)
    track, worst = Track(state, GAIN, GAIN, ALL_ON, 0.0, ALL_ON, pairs=PARAMETERS.learning_pairs), 0.0
    for k in range(150):
        reach = -5 + 0.1 * k
        levels = rng.choice([0.0, 0.25, 0.5, 0.75, 1.0], (SIDE, SIDE), p=np.array([1, 4, 6, 4, 1]) / 16)
        post = scene(pose, reach, level)
        hides = post != scene(pose)
        frames = [
            frame_of(np.where(hides, post, 0.1 + 0.8 * draw(pose, x, (0, 0), SHAPE)), 2 * k + j, rng)
            for j, x in enumerate((levels, 1 - levels))
        ]
        track = tracker.follow(track, FramePair(frames[0], frames[1])).track
        worst = max(worst, abs(track.state.pose.x - pose.x))
    assert worst < 0.25 * pose.pitch
