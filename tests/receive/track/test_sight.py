"""Visible LEDs, and fits excluding occluded pixels."""

import numpy as np
import occlusion_oracle as reference
import pytest
from numpy.typing import NDArray
from scenes import SIDE, draw, frame_of, pitch_at

from heliograph.receive import Pose
from heliograph.receive.geometry.fit import Fit, fit_array
from heliograph.receive.sync.pairing import FramePair
from heliograph.receive.track import kernels
from heliograph.receive.track.track import TrackParameters, square_leds, visible_pixels

Floats = NDArray[np.float64]

SHAPE, PARAMETERS = (60, 60), TrackParameters()


def pose_at(distance_m: float) -> Pose:
    return Pose(29.6, 30.3, pitch_at(distance_m), 0.02, 0.53)


def data(rng: np.random.Generator) -> Floats:
    return rng.binomial(4, 0.5, (SIDE, SIDE)) / 4


def pair_of(pose: Pose, rng: np.random.Generator, post: slice | None = None, level: float = 0.3) -> FramePair:
    """Return a random data pair with pixel columns hidden by a post."""
    levels, frames = data(rng), []
    for k, x in enumerate((levels, 1 - levels)):
        light = 0.1 + 0.8 * draw(pose, x, (0, 0), SHAPE)
        if post is not None:
            light[:, post] = level
        frames.append(frame_of(light, k, rng))
    return FramePair(frames[0], frames[1])


def change_of(pair: FramePair) -> Floats:
    return np.asarray(pair.pattern.pixels, np.float64) - pair.inverted.pixels


def changed(before: Floats, pair: FramePair, pose: Pose) -> Floats:
    """Update the recent LED change with one pair; noise is 2 gray levels, visible LEDs change by 5."""
    out, bright = np.empty_like(before), int(PARAMETERS.bright_quantile * (SIDE**2 - 1))
    taken = 25.0, bright, PARAMETERS.max_change, PARAMETERS.change_rate
    kernels.recent_change(before, change_of(pair), 2.0, pose.x, pose.y, pose.axes, square_leds(pose, SIDE), *taken, out)
    return out


@pytest.mark.parametrize("distance_m", [25.0, 50.0, 95.0])
def test_what_a_post_hides_does_not_change(distance_m: float) -> None:
    rng, pose = np.random.default_rng(3), pose_at(distance_m)
    post = slice(0, round(pose.x))
    change = np.ones((SIDE, SIDE))
    for _ in range(30):
        change = changed(change, pair_of(pose, rng, post), pose)
    seen = change >= PARAMETERS.min_visible
    assert not seen[:, :4].any()
    assert seen[:, 9:].all()
    clear = visible_pixels(seen.astype(np.float64), pose, (0, 0), SHAPE)
    assert not clear[:, : round(pose.x) - 4].any()
    assert clear[:, round(pose.x + 3 * pose.pitch) :].all()


def test_an_array_in_clear_sight_stays_in_sight() -> None:
    rng, pose = np.random.default_rng(4), pose_at(95.0)
    change = np.ones((SIDE, SIDE))
    least = np.inf
    for _ in range(200):
        change = changed(change, pair_of(pose, rng), pose)
        least = min(least, float(change.min()))
    assert least >= PARAMETERS.min_visible


def test_pixels_that_something_hides_do_not_move_a_fit() -> None:
    rng, pose = np.random.default_rng(5), pose_at(50.0)
    pair = pair_of(pose, rng, slice(0, 25), 0.9)
    total = np.asarray(pair.pattern.pixels, np.float64) + pair.inverted.pixels
    seen = np.ones((SIDE, SIDE))
    seen[:, :5] = 0
    spread = np.diag(np.array([1.0, 1.0, 0.05, 0.02, 0.1]) ** 2)
    prior = Fit(pose.full_vector() + np.array([0.3, -0.2, 0.01, 0, 0, 0, 0]), spread, 0.8 * 255)
    clear = visible_pixels(seen, pose, (0, 0), SHAPE)
    found = fit_array(total, (0, 0), prior, seen, 6, panel=True, open_pixels=clear)
    pulled = fit_array(total, (0, 0), prior, np.ones((SIDE, SIDE)), 6, panel=True)
    assert abs(found.pose.x - pose.x) < 0.1
    assert abs(found.pose.x - pose.x) < 0.2 * abs(pulled.pose.x - pose.x)


@pytest.mark.parametrize("seed", range(4))
def test_kernels_do_what_the_reference_does(seed: int) -> None:
    rng = np.random.default_rng(seed)
    change, pose = rng.normal(0, 20, (31, 33)), Pose(16.3, 14.8, 1.2 + 0.4 * seed, 0.05, 0.5, 0.02, -0.01)
    place = pose.x, pose.y
    for distance in (3.0, 11.5, 90.0):
        got = kernels.noise_outside(change, *place, distance)
        assert got == pytest.approx(reference.noise_outside(change, *place, distance), rel=1e-12)
        assert kernels.power_within(change, *place, distance) == pytest.approx(
            reference.power_within(change, *place, distance), rel=1e-12
        )
    for width in (5, 9, 15):
        around = np.empty((SIDE, SIDE))
        kernels.power_around(change, 5.0, *place, pose.axes, width, around)
        want = reference.power_around(change, 5.0, *place, pose.axes, width, SIDE)
        assert around == pytest.approx(want, rel=1e-4)
        # thresholds near and far above the typical power
        for least in (1.0, 1e4):
            before, got = rng.uniform(0, 2, (SIDE, SIDE)), np.empty((SIDE, SIDE))
            kernels.recent_change(before, change, 5.0, *place, pose.axes, width, least, 204, 2.0, 0.25, got)
            assert got == pytest.approx(reference.recent_change(before, around, least, 204, 2.0, 0.25), rel=1e-12)
