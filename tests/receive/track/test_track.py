"""Visibility: change of LEDs, occlusion from the side, plausible poses, and fits of visible pixels."""

from dataclasses import replace

import numpy as np
import occlusion_oracle as reference
import pytest
from scenes import ALL_ON, SIDE, Floats, draw, frame_of, pitch_at

from heliograph.base.frames import Frame
from heliograph.receive import Pose
from heliograph.receive.sync.pairing import FramePair
from heliograph.receive.track import kernels
from heliograph.receive.track.kalman import MotionModel, PoseState
from heliograph.receive.track.kernels import COVERED_LINE_RATE, LINE_RATE
from heliograph.receive.track.track import (
    Track,
    TrackParameters,
    check_pose,
    estimate_noise,
    line_distance,
    preview_pair,
    square_leds,
    visible_pixels,
)
from heliograph.receive.track.tracker import Tracker

SHAPE, GAIN, PARAMETERS, MODEL = (70, 70), 204.0, TrackParameters(), MotionModel(1e-3, 0.1)
DISTANCES = pytest.mark.parametrize("distance_m", [20.0, 50.0, 95.0])


def pose_at(distance_m: float) -> Pose:
    return Pose(34.6, 35.3, pitch_at(distance_m), 0.02, 0.53)


def pair_of(pose: Pose, rng: np.random.Generator, post: Floats | float = 0.0, level: float = 0.3) -> list[Floats]:
    """Return a random data pair in gray levels; a post hides a fraction of each pixel or column."""
    levels, frames = rng.binomial(4, 0.5, (SIDE, SIDE)) / 4, []
    for x in (levels, 1 - levels):
        light = 0.1 + 0.8 * draw(pose, x, (0, 0), SHAPE)
        frames.append(frame_of(light + post * (level - light), 0, rng).pixels.astype(np.float64))
    return frames


def test_a_pose_is_given_up_if_too_blurred_or_too_large() -> None:
    pose = Pose(40.0, 40.0, 1.5, 0.0, 0.6)
    for changes in ({}, {"blur": 8.0}, {"pitch": 15.0}):
        check_pose(replace(pose, **changes), 16, (96, 128))
    for changes in ({"blur": 170_000.0}, {"blur": 12.5}, {"pitch": 20.0}, {"blur": np.nan}, {"pitch": np.nan}):
        with pytest.raises(np.linalg.LinAlgError, match="none of an array"):
            check_pose(replace(pose, **changes), 16, (96, 128))


def changed(before: Floats, pair: list[Floats], pose: Pose) -> Floats:
    """Update the recent LED change with one pair; noise is 2 gray levels, visible LEDs change by 5."""
    bright, square = int(PARAMETERS.bright_quantile * 255), square_leds(pose, SIDE)
    around = kernels.power_around(pair[0] - pair[1], 2.0, pose.x, pose.y, pose.axes, square, SIDE)
    limits = 25.0, bright, PARAMETERS.max_change, PARAMETERS.change_rate
    return np.asarray(kernels.recent_change(before, around, *limits))


@DISTANCES
def test_leds_hidden_by_a_post_do_not_change(distance_m: float) -> None:
    rng, pose, change = np.random.default_rng(3), pose_at(distance_m), ALL_ON
    post = (np.arange(70) < round(pose.x)).astype(float)
    for _ in range(30):
        change = changed(change, pair_of(pose, rng, post), pose)
    seen = change >= PARAMETERS.min_visible
    assert not seen[:, :4].any()
    assert seen[:, 9:].all()
    clear = visible_pixels(seen.astype(np.float64), pose, (0, 0), SHAPE)
    assert not clear[:, : round(pose.x) - 4].any()
    assert clear[:, round(pose.x + 3 * pose.pitch) :].all()


def test_an_unobstructed_array_stays_visible() -> None:
    rng, pose, change = np.random.default_rng(4), pose_at(95.0), ALL_ON
    for _ in range(200):
        change = changed(change, pair_of(pose, rng), pose)
        assert change.min() >= PARAMETERS.min_visible


@pytest.mark.parametrize("seed", range(4))
def test_change_statistics_equal_the_reference(seed: int) -> None:
    rng = np.random.default_rng(seed)
    change, pose = rng.normal(0, 20, (31, 33)), Pose(16.3, 14.8, 1.2 + 0.4 * seed, 0.05, 0.5, 0.02, -0.01)
    place = pose.x, pose.y
    for distance in (3.0, 11.5, 90.0):
        for name in ("noise_outside", "power_within"):
            got, want = (getattr(module, name)(change, *place, distance) for module in (kernels, reference))
            assert got == pytest.approx(want, rel=1e-12)
    for width in (5, 9, 15):
        around = kernels.power_around(change, 5.0, *place, pose.axes, width, SIDE)
        want = reference.power_around(change, 5.0, *place, pose.axes, width, SIDE)
        assert around == pytest.approx(want, rel=1e-4)
        # thresholds near and far above the typical power
        for least in (1.0, 1e4):
            before = rng.uniform(0, 2, (SIDE, SIDE))
            got = kernels.recent_change(before, around, least, 204, 2.0, 0.25)
            assert got == pytest.approx(reference.recent_change(before, around, least, 204, 2.0, 0.25), rel=1e-12)


TURNS = {"left": 0, "top": 1, "right": 2, "bottom": -1}


def post_at(pose: Pose, reach: float, side: str = "left") -> Floats:
    """Return the fraction of each pixel hidden by a post that covers `reach` pitches from one side."""
    middle = {"left": pose.x, "top": pose.y, "right": 69 - pose.x, "bottom": 69 - pose.y}[side]
    edge = middle + (reach - 0.5 * SIDE) * pose.pitch
    return np.rot90(np.broadcast_to(np.clip(edge + 0.5 - np.arange(70), 0, 1), SHAPE), -TURNS[side])


def scene(pose: Pose, reach: float | None = None, level: float = 1.0, side: str = "left") -> Floats:
    """Render an array with a post from one side."""
    # all LEDs at a quarter of full light, as the mean of a pair with a smaller gain
    light = 0.1 + 0.2 * draw(pose, ALL_ON, (0, 0), SHAPE)
    return light if reach is None else light + post_at(pose, reach, side) * (level - light)


def cleared(
    pose: Pose, light: Floats, usual: Floats | None = None, visible: Floats = ALL_ON, gain: float = GAIN
) -> tuple[Floats, Floats]:
    """Return uncovered LEDs and the updated line baselines."""
    clear, lines = np.ones((SIDE, SIDE)), np.full((2, SIDE + 2), np.nan) if usual is None else usual.copy()
    middle, away = np.array([pose.x, pose.y]), line_distance(pose, SIDE)
    kernels.uncover(2 * 255 * light, middle, pose.axes, away, PARAMETERS.min_line_change * gain, visible, lines, clear)
    return clear, lines


@DISTANCES
@pytest.mark.parametrize("level", [0.0, 1.0])
@pytest.mark.parametrize("side", TURNS)
def test_leds_are_covered_from_the_side(distance_m: float, level: float, side: str) -> None:
    pose = pose_at(distance_m)
    clear, usual = cleared(pose, scene(pose))
    assert clear.all()
    found, _ = cleared(pose, scene(pose, 5.0, level, side), usual)
    lines = np.rot90(found, TURNS[side]).mean(0)
    # lines are covered completely; blur extends by about a pixel
    covered = int((lines == 0).sum())
    assert lines.tolist() == [0.0] * covered + [1.0] * (SIDE - covered)
    assert 4 <= covered <= 6 + 1.5 / pose.pitch


@DISTANCES
def test_a_post_is_seen_before_it_hides_an_led(distance_m: float) -> None:
    pose = pose_at(distance_m)
    _, usual = cleared(pose, scene(pose))
    clear, _ = cleared(pose, scene(pose, -0.5), usual)
    assert not clear[:, 0].any()
    assert clear[:, 1 + int(2 / pose.pitch) :].all()


@pytest.mark.parametrize(
    ("offset", "added"), [((0.6, 0.0), 0.0), ((-0.6, 0.5), 0.0), ((0.0, -0.6), 0.0), ((0.0, 0.0), 0.3)]
)
@DISTANCES
def test_wrong_places_and_even_light_hide_no_led(offset: tuple[float, float], added: float, distance_m: float) -> None:
    """If all lines counted as covered, no LED would fix the pose."""
    pose = pose_at(distance_m)
    _, usual = cleared(pose, scene(pose))
    clear, _ = cleared(pose.moved(*offset), added + scene(pose), usual)
    assert clear.all()


def test_lines_follow_slow_changes_and_a_lasting_post() -> None:
    pose, pairs, clear = pose_at(50.0), 0, np.zeros(1)
    _, usual = cleared(pose, scene(pose))
    _, after = cleared(pose, scene(pose) + 0.01, usual)
    assert after - usual == pytest.approx(LINE_RATE * 2 * 255 * 0.01, abs=1e-6)
    while not clear.all() and pairs < 400:
        clear, usual = cleared(pose, scene(pose, -0.3), usual)
        pairs += 1
    # ln(change / threshold) / rate
    assert 0.5 / COVERED_LINE_RATE < pairs - 1 < 3.5 / COVERED_LINE_RATE


def test_hidden_leds_return_as_before() -> None:
    pose, visible = pose_at(50.0), ALL_ON.copy()
    visible[:, :7] = 0
    _, before = cleared(pose, scene(pose))
    after, hidden = before, scene(pose, 7.0)
    for _ in range(300):
        clear, after = cleared(pose, hidden, after, visible)
    assert not clear[:, :7].any()
    assert np.array_equal(after[0, :8], before[0, :8])
    assert cleared(pose, scene(pose), after)[0].all()


def test_a_new_array_has_no_baseline() -> None:
    """A post may be present at detection; LEDs appearing later must not count as covered."""
    pose = pose_at(50.0)
    _, usual = cleared(pose, scene(pose, -0.5), gain=np.inf)
    clear, after = cleared(pose, scene(pose), usual, gain=np.inf)
    assert clear.all()
    assert after[0, 0] - usual[0, 0] == pytest.approx(-LINE_RATE * 2 * 255 * 0.9, rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize(("distance_m", "level"), [(41.0, 0.02), (41.0, 0.6), (41.0, 0.95), (60.0, 0.6)])
def test_a_post_does_not_pull_the_pose(distance_m: float, level: float) -> None:
    """A post with 146 of 255 gray levels shifted an array at 41 m by 1.2 px before hiding an LED, then by 20 px."""
    pose, rng, tracker = pose_at(distance_m), np.random.default_rng(8), Tracker(SIDE, MODEL)
    state = PoseState.start(0.0, pose.vector(), np.diag([0.05, 0.05, 1e-3, 1e-3, 0.05]) ** 2, MODEL)
    track, worst = Track(state, GAIN, GAIN, ALL_ON, 0.0, ALL_ON, pairs=PARAMETERS.learning_pairs), 0.0
    for k in range(150):
        shown = pair_of(pose, rng, post_at(pose, -5 + 0.1 * k), level)
        up, down = (Frame(2 * k + j, (2 * k + j) * 1e-3, x.astype(np.uint8)) for j, x in enumerate(shown))
        track = tracker.follow(track, FramePair(up, down)).track
        worst = max(worst, abs(track.state.pose.x - pose.x))
    assert worst < 0.25 * pose.pitch


def test_a_preview_equals_the_separate_kernels() -> None:
    rng, pose, corner = np.random.default_rng(2), pose_at(50.0), (100, 50)
    place = pose.moved(*corner)
    state = PoseState.start(0.0, place.vector(), np.eye(5), MODEL)
    track = Track(state, 200.0, 200.0, ALL_ON, 0.0, ALL_ON, pairs=PARAMETERS.learning_pairs)
    for k in range(12):
        # a post entering from the left
        up, down = pair_of(pose, rng, (np.arange(70) < 3 * k - 4).astype(float), 0.9)
        difference, total, noise, after = preview_pair(track, up, down, corner, place)
        assert np.array_equal(difference, up - down)
        assert np.array_equal(total, up + down)
        assert noise == estimate_noise(up - down, place, corner, SIDE)
        visible = (after.change >= PARAMETERS.min_visible).astype(float)
        assert np.array_equal(after.visible, visible)
        clear, lines = cleared(pose, total / (2 * 255), track.lines, visible, 200.0)
        assert after.lines is not None
        assert after.lines == pytest.approx(lines)
        assert np.array_equal(ALL_ON if after.clear is None else after.clear, clear)
        track = after
    assert track.pairs == PARAMETERS.learning_pairs + 12
    assert track.is_occluded
    assert track.uncovered.any()
