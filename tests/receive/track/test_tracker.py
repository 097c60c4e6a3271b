"""Tracker: arrays at rest and in strong shake, and visibility from contrast."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from recorder import Recorder
from scenes import ALL_ON, SIDE, Floats, at_rest, draw, drawn_film, frame_of, link, pitch_at, received, statuses
from scipy.ndimage import gaussian_filter1d
from search_scenes import shown_patterns

from heliograph.base.frames import Frame
from heliograph.receive import Packet, Pose, ReceiveSettings, make_receiver
from heliograph.receive.detect.detection import Detection
from heliograph.receive.geometry.fit import Fit
from heliograph.receive.sync.pairing import FramePair
from heliograph.receive.track.kalman import MotionModel, PoseState
from heliograph.receive.track.track import Track, average_around_leds, contrast
from heliograph.receive.track.tracker import Tracker
from heliograph.signal.header import header_levels
from heliograph.signal.settings import SignalSettings

MODEL = MotionModel(1e-3, 0.1)
HEADER = header_levels(7, SIDE) / 4.0


def shaking(t: Floats) -> Floats:
    """At most 0.9 px/ms, 40 Hz."""
    reach = 900 / (2 * np.pi * 40)
    return np.stack([47.3 + reach * np.sin(2 * np.pi * 40 * t), 48.8 + 0.5 * reach * np.cos(2 * np.pi * 40 * t)], -1)


@pytest.mark.parametrize(("path", "distance_m", "error_px"), [
    (shaking, 25.0, 0.1), (shaking, 80.0, 0.1), (at_rest, 40.0, 0.02), (at_rest, 80.0, 0.02),
])  # fmt: skip
@pytest.mark.slow
def test_an_array_is_followed_at_rest_and_in_strong_shake(
    path: Callable[[Floats], Floats], distance_m: float, error_px: float
) -> None:
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
    assert contrast(Pose(0, 0, pitch, 0, blur)) == pytest.approx(np.sqrt(left), rel=1e-2)


def pair_of(lights: tuple[Floats, Floats], rng: np.random.Generator, first: int = 0) -> FramePair:
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
    pair = pair_of((lights[0], lights[1]), rng)
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
        track = tracker.follow(track, pair_of((up, down), rng, 2 * k)).track
    assert abs(track.state.mean[9]) < 0.35
    assert np.hypot(track.state.pose.x - SKY.x, track.state.pose.y - SKY.y) < 0.1


def new_array(gain: float) -> tuple[Tracker, Track, FramePair]:
    """Return a tracker, a new array with an expected gain of 160, and header frames with another gain."""
    tracker, pose = Tracker(SIDE, MODEL), Pose(40.2, 39.7, pitch_at(50.0), 0.01, 0.53)
    up, down = (0.1 + gain / 255 * draw(pose, x, (0, 0), (80, 80)) for x in (HEADER, 1 - HEADER))
    fit = Fit(pose.full_vector(), 1e-6 * np.eye(7), 160.0, 1.0)
    track = tracker.start(Detection(7, 0.0, fit, 1.5e-3, 1.0, 1.0, ALL_ON))
    return tracker, track, pair_of((up, down), np.random.default_rng(0), 2)


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
    assert (refined.gain, refined.data_gain) == (160, pytest.approx(180, rel=0.02))
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
    """The tracker follows thirty random data pairs with the gains of a header."""
    rng, pose = np.random.default_rng(2), Pose(40.2, 39.7, pitch_at(47.0), 0.0, 0.52)
    tracker, state = Tracker(SIDE, MODEL), PoseState.start(0.0, pose.full_vector(), np.eye(7) * 1e-3, MODEL)
    track = Track(state, 204.0, 204.0, assumed, 0.0, average_around_leds(assumed, pose))
    for k in range(30):
        x = rng.binomial(4, 0.5, (SIDE, SIDE)) / 4
        up, down = (0.1 + 0.8 * draw(pose, shown * levels, (0, 0), (80, 80)) for levels in (x, 1 - x))
        tracked = tracker.follow(track, pair_of((up, down), rng, 2 * k))
        track = tracked.track
        assert tracked.seen
        assert np.hypot(track.state.pose.x - pose.x, track.state.pose.y - pose.y) < error_px
