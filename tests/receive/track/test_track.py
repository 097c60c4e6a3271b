"""Visibility and plausible poses, and the tracker: arrays at rest, in strong shake and behind posts."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import occlusion_oracle as reference
import pytest
from recorder import Recorder
from scenes import ALL_ON, SIDE, Floats, at_rest, draw, drawn_film, frame_of, link, pitch_at, received, statuses
from scipy.ndimage import gaussian_filter1d
from search_scenes import shown_patterns

from heliograph.base.frames import Frame
from heliograph.receive.api import make_receiver
from heliograph.receive.detect.detection import Detection
from heliograph.receive.geometry.fit import Fit
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.packet import Packet
from heliograph.receive.settings import ReceiveSettings
from heliograph.receive.sync.pairing import FramePair
from heliograph.receive.track import kernels
from heliograph.receive.track import track as visibility
from heliograph.receive.track.kalman import MotionModel, PoseState
from heliograph.receive.track.kernels import COVERED_LINE_RATE, LINE_RATE
from heliograph.receive.track.track import Track, TrackParameters
from heliograph.receive.track.tracker import Tracker
from heliograph.signal.header import header_levels
from heliograph.signal.settings import SignalSettings

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
        visibility.check_pose(replace(pose, **changes), 16, (96, 128))
    for changes in ({"blur": 170_000.0}, {"blur": 12.5}, {"pitch": 20.0}, {"blur": np.nan}, {"pitch": np.nan}):
        with pytest.raises(np.linalg.LinAlgError, match="none of an array"):
            visibility.check_pose(replace(pose, **changes), 16, (96, 128))


def changed(before: Floats, pair: list[Floats], pose: Pose) -> Floats:
    """Update the recent LED change with one pair; noise is 2 gray levels, visible LEDs change by 5."""
    bright, square = int(PARAMETERS.bright_quantile * 255), visibility.square_leds(pose, SIDE)
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
    clear = visibility.visible_pixels(seen.astype(np.float64), pose, (0, 0), SHAPE)
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
    # all LEDs at a quarter of full light, as the mean of a pair with a smaller gain
    light = 0.1 + 0.2 * draw(pose, ALL_ON, (0, 0), SHAPE)
    return light if reach is None else light + post_at(pose, reach, side) * (level - light)


def cleared(
    pose: Pose, light: Floats, usual: Floats | None = None, visible: Floats = ALL_ON, gain: float = GAIN
) -> tuple[Floats, Floats]:
    """Return uncovered LEDs and the updated line baselines."""
    lines = np.full((2, SIDE + 2), np.nan) if usual is None else usual.copy()
    middle, away = np.array([pose.x, pose.y]), visibility.line_distance(pose, SIDE)
    least = PARAMETERS.min_line_change * gain
    clear, covers = kernels.uncover(2 * 255 * light, middle, pose.axes, away, least, visible, 0.5, lines)
    assert covers == (not clear.all())
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
        difference, total, noise, after = visibility.preview_pair(track, up, down, corner, place)
        assert np.array_equal(difference, up - down)
        assert np.array_equal(total, up + down)
        assert noise == visibility.estimate_noise(up - down, place, corner, SIDE)
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


HEADER = header_levels(7, SIDE) / 4.0


def shaking(t: Floats) -> Floats:
    """At most 0.9 px/ms, 40 Hz."""
    reach = 900 / (2 * np.pi * 40)
    return np.stack([47.3 + reach * np.sin(2 * np.pi * 40 * t), 48.8 + 0.5 * reach * np.cos(2 * np.pi * 40 * t)], -1)


@pytest.mark.parametrize(("path", "distance_m", "error_px"), [
    (shaking, 25.0, 0.1), (shaking, 80.0, 0.1), (at_rest, 40.0, 0.02), (at_rest, 80.0, 0.02),
])  # fmt: skip
@pytest.mark.slow
def test_an_array_is_followed_in_shake(path: Callable[[Floats], Floats], distance_m: float, error_px: float) -> None:
    settings, recorder = link("signal.data_pairs=16"), Recorder()
    packets = received(drawn_film(settings, 72, path, distance_m=distance_m), settings, recorder)
    assert [all(word.status == "ok" for word in p.layers["high"]) for p in packets] == [True, True]
    assert recorder.lost_s == []
    assert all(pair.seen for pair in recorder.tracked)
    states = [pair.state for pair in recorder.tracked]
    # timestamps mark the start of a 1 ms exposure
    places = path(np.array([state.time_s for state in states]) + 0.5e-3)
    errors = np.array([(state.pose.x, state.pose.y) for state in states]) - places
    assert np.sqrt(np.mean(errors[3:] ** 2)) < error_px


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["plain", "soft"])
def test_an_array_with_undecodable_data_stays_tracked(kind: str) -> None:
    """Random data fail the CRC in each packet; the next header is due and does not start another array."""
    recorder, rng, packets = Recorder(), np.random.default_rng(6), list[Packet]()
    receiver = make_receiver(SignalSettings(data_pairs=24), ReceiveSettings(receiver=kind), recorder)
    for k, shown in zip(range(170), shown_patterns(lambda k: (k - 10) % 52 < 4, rng), strict=False):
        pixels = rng.integers(40, 44, (96, 96)).astype(np.uint8)
        pixels[32:64, 32:64] = 40 + (100 * shown).astype(np.uint8)
        packets += receiver.push(Frame(k, 1e-3 * k, pixels))
    packets += receiver.finish()
    assert statuses(packets) == ["crc_fail"] * 3
    assert recorder.found_s == pytest.approx([0.01])


@pytest.mark.parametrize(("pitch", "blur"), [(0.3, 0.5), (0.7, 0.5), (4.0, 0.2)])
def test_contrast_is_the_power_of_a_blurred_square_of_leds(pitch: float, blur: float) -> None:
    x = np.linspace(-20, 20, 40001)
    sharp = (np.abs(x) < pitch).astype(float)
    sigma = np.hypot(blur, 12**-0.5)
    blurred = gaussian_filter1d(sharp, sigma / (x[1] - x[0]), mode="constant")
    # along x and along y
    left = ((blurred**2).sum() / (sharp**2).sum()) ** 2
    assert visibility.contrast(Pose(0, 0, pitch, 0, blur)) == pytest.approx(np.sqrt(left), rel=1e-2)


def frame_pair(lights: tuple[Floats, Floats], rng: np.random.Generator, first: int = 0) -> FramePair:
    up, down = (frame_of(light, first + k, rng) for k, light in enumerate(lights))
    return FramePair(up, down)


SKY = Pose(30.2, 29.7, 0.61, 0.0, 0.5)  # far, in front of a bright sky; a dark panel hides the sky around the LEDs


def track_in_the_sky(time_s: float, drift: float = 0.0) -> Track:
    """Return the track of an array with a drift in px per frame."""
    spread = np.diag([0.1, 0.1, 0.01, 0.01, 0.05]) ** 2
    state = PoseState.start(time_s, SKY.vector(), spread, MODEL, (0.0, drift / 1e-3))
    return Track(state, 204.0, 204.0, ALL_ON, 0.0, ALL_ON)


@pytest.mark.parametrize("drift", [-0.8, -0.4, 0.0, 0.4, 0.8])
def test_a_moving_header_gives_an_unbiased_pose(drift: float) -> None:
    """Header motion leaves a residual in the sum, which resembled blur and biased the filter under a bright sky."""
    lights, rng = [], np.random.default_rng(4)
    for k, shown in enumerate((HEADER, 1 - HEADER)):
        pose = SKY.moved(0.0, drift * (k - 0.5))
        # the panel is half a pitch wider than the LEDs
        panel = draw(replace(pose, pitch=0.61 * 17 / 16), ALL_ON, (0, 0), (60, 60))
        lights.append(0.78 * (1 - panel) + 0.8 * draw(pose, shown, (0, 0), (60, 60)))
    pair = frame_pair((lights[0], lights[1]), rng)
    found = Tracker(SIDE, MODEL).follow(track_in_the_sky(0.5e-3, drift), pair, 2 * HEADER - 1)
    assert found.fit.score > 0.995
    assert found.state.pose.y == pytest.approx(SKY.y, abs=0.03)
    assert abs(found.state.mean[9]) < 0.25


def test_a_blurred_sum_does_not_mislead_the_tracker() -> None:
    """In strong shake in front of a bright sky, the estimated blur grew until the track was lost."""
    tracker, track, rng = Tracker(SIDE, MODEL), track_in_the_sky(0.0), np.random.default_rng(4)
    panel = draw(replace(SKY, pitch=0.66), ALL_ON, (0, 0), (60, 60))
    panel = gaussian_filter1d(gaussian_filter1d(panel, 0.9, 0), 0.9, 1)
    for k in range(60):
        x = rng.binomial(4, 0.5, (SIDE, SIDE)) / 4
        up, down = (0.78 * (1 - panel) + 0.8 * draw(SKY, shown, (0, 0), (60, 60)) for shown in (x, 1 - x))
        track = tracker.follow(track, frame_pair((up, down), rng, 2 * k)).track
    assert abs(track.state.mean[9]) < 0.35
    assert np.hypot(track.state.pose.x - SKY.x, track.state.pose.y - SKY.y) < 0.1


def new_array(gain: float) -> tuple[Tracker, Track, FramePair]:
    """Return a tracker, a new array with an expected gain of 160, and header frames with another gain."""
    tracker, pose = Tracker(SIDE, MODEL), Pose(40.2, 39.7, pitch_at(50.0), 0.01, 0.53)
    up, down = (0.1 + gain / 255 * draw(pose, x, (0, 0), (80, 80)) for x in (HEADER, 1 - HEADER))
    fit = Fit(pose.full_vector(), 1e-6 * np.eye(7), 160.0, 1.0)
    track = tracker.start(Detection(7, 0.0, fit, 1.5e-3, 1.0, 1.0, ALL_ON))
    return tracker, track, frame_pair((up, down), np.random.default_rng(0), 2)


def test_sums_correct_the_gain_by_a_tenth_and_a_header_gives_the_gain_of_the_data() -> None:
    tracker, track, pair = new_array(180.0)
    assert (track.gain, track.data_gain, track.last_seen_s) == (160.0, 160.0, 1.5e-3)
    tracked = tracker.follow(track, pair)
    assert tracked.before is track
    assert tracked.fit.gain == pytest.approx(180, rel=0.03)
    assert tracked.track.gain - 160 == pytest.approx(0.1 * (tracked.fit.gain - 160))
    # header pairs have a separate gain
    assert (tracked.seen, tracked.track.data_gain, tracked.track.last_seen_s) == (True, 160, pair.time_s)
    refined = tracker.refine(track, pair, 2 * HEADER - 1)
    assert refined.gain == 160
    assert refined.data_gain == pytest.approx(180, rel=0.02)
    # a header from another array has no effect
    assert tracker.refine(track, pair, header_levels(20) / 2.0 - 1.0) is track


def test_a_hidden_array_keeps_the_gain() -> None:
    tracker, track, pair = new_array(0.0)
    tracked = tracker.follow(track, pair)
    after = tracked.track
    assert (tracked.seen, after.gain, after.last_seen_s, after.state.time_s) == (False, 160, 1.5e-3, pair.time_s)


DEAD = (np.random.default_rng(5).random((SIDE, SIDE)) > 0.15).astype(np.float64)


@pytest.mark.parametrize(
    ("assumed", "shown", "error_px"),
    [(np.where(np.arange(SIDE) < columns, 0.0, ALL_ON), ALL_ON, 0.15) for columns in (2, 5)] + [(DEAD, DEAD, 0.1)],
    ids=["2 columns", "5 columns", "dead LEDs"],
)
def test_hidden_and_dead_leds_do_not_pull_the_pose(assumed: Floats, shown: Floats, error_px: float) -> None:
    rng, pose = np.random.default_rng(2), Pose(40.2, 39.7, pitch_at(47.0), 0.0, 0.52)
    tracker, state = Tracker(SIDE, MODEL), PoseState.start(0.0, pose.full_vector(), np.eye(7) * 1e-3, MODEL)
    track = Track(state, 204.0, 204.0, assumed, 0.0, visibility.average_around_leds(assumed, pose))
    for k in range(30):
        x = rng.binomial(4, 0.5, (SIDE, SIDE)) / 4
        up, down = (0.1 + 0.8 * draw(pose, shown * levels, (0, 0), (80, 80)) for levels in (x, 1 - x))
        tracked = tracker.follow(track, frame_pair((up, down), rng, 2 * k))
        track = tracked.track
        assert tracked.seen
        assert np.hypot(track.state.pose.x - pose.x, track.state.pose.y - pose.y) < error_px
