"""Pairs that lack a frame: which sums stand for theirs, the pose between others, and what the frame left shows."""

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from properties import examples
from scenes import ALL_ON, SIDE, draw, pitch_at
from scipy.interpolate import CubicHermiteSpline

from heliograph.base.frames import Frame
from heliograph.receive import Pose
from heliograph.receive.observe.cutout import Cutout, take_cutout
from heliograph.receive.sync.pairing import FramePair, UnpairedFrame
from heliograph.receive.track.kalman import PoseState
from heliograph.receive.track.unpaired_frames import interpolate_state, nearest_pairs, unpaired_cutout

Floats = NDArray[np.float64]

GAIN = 150.0


@pytest.mark.parametrize(
    ("place", "seen", "want"),
    [
        (10, [7, 12, 9, 30], [9, 12, 7, 30]),
        # of two that are as near the earlier one first
        (10, [12, 11, 9, 8], [9, 11, 8, 12]),
        (10, range(20), [10, 9, 11, 8, 12, 7]),
        # the nearest tells whether any does
        (10, [4], [4]),
        (10, [16, 40], [16, 40]),
        (10, [3, 17], []),
        (10, [], []),
    ],
)
def test_sums_are_those_of_the_nearest_pairs(place: int, seen: Sequence[int], want: list[int]) -> None:
    assert nearest_pairs(place, dict.fromkeys(seen)) == want


def state_at(time_s: float, vector: Floats, rates: Floats, tilt: tuple[float, float] = (0.0, 0.0)) -> PoseState:
    errors = np.array([0.03, -0.2])
    covariance = np.diag(np.arange(1.0, 11.0))
    return PoseState(time_s, np.concatenate([vector, rates, errors]), covariance, np.array(tilt), np.eye(2))


def cubic(coefficients: Floats, t: float) -> tuple[Floats, Floats]:
    """x, y and ln pitch along cubics in time, with roll and blur along straight lines; and the rates of the first."""
    powers, slopes = t ** np.arange(4), np.array([0, 1, 2 * t, 3 * t**2])
    return coefficients @ powers, (coefficients @ slopes)[:3]


NUMBERS = st.lists(st.floats(-1, 1), min_size=20, max_size=20)


@examples(60)
@given(numbers=NUMBERS, begin=st.floats(0, 1), span=st.floats(0.002, 0.02), part=st.floats(0, 1))
def test_between_two_states_the_pose_follows_the_cubic_of_both(
    numbers: list[float], begin: float, span: float, part: float
) -> None:
    coefficients = np.array(numbers).reshape(5, 4)
    coefficients[3:, 2:] = 0  # roll and blur have no rates
    one, other, between = (cubic(coefficients, t) for t in (0, 1, part))
    # times in spans
    states = {3: state_at(begin, one[0], one[1] / span), 8: state_at(begin + span, other[0], other[1] / span)}
    time_s = begin + part * span
    found = interpolate_state(time_s, states, 5)
    assert found.time_s == time_s
    assert found.mean[:5] == pytest.approx(between[0], abs=1e-6)
    assert span * found.mean[5:8] == pytest.approx(between[1], abs=1e-6)


def test_it_is_the_two_states_beside_it_that_tell() -> None:
    """Of a motion that no cubic is."""
    times = np.array([0.0, 0.006, 0.008, 0.014, 0.018])
    x, rate = 20 * np.sin(300 * times), 6000 * np.cos(300 * times)
    states = {
        round(500 * t): state_at(t, np.array([x[k], -x[k], 0.0, 0.0, 0.0]), np.array([rate[k], -rate[k], 0.0]))
        for k, t in enumerate(times)
    }
    found = interpolate_state(0.011, states, 5)
    want = float(CubicHermiteSpline(times[2:4], x[2:4], rate[2:4])(0.011))
    assert found.mean[:2] == pytest.approx([want, -want])
    # what is not of the motion is as it was before
    assert found.mean[8:] == pytest.approx(states[4].mean[8:])
    assert found.covariance is states[4].covariance


@pytest.mark.parametrize(("place", "near"), [(1, 4), (20, 9)])
def test_beyond_all_states_the_nearest_goes_on_evenly(place: int, near: int) -> None:
    rates = np.array([100.0, -200.0, 0.5])
    states = {
        k: state_at(0.002 * k, np.array([k, 2.0 * k, 0.1, 0.02, -0.6]), k * rates, (0.03, -0.01)) for k in (4, 6, 9)
    }
    found = interpolate_state(0.002 * place, states, place)
    dt = 0.002 * (place - near)
    want = np.array([near, 2.0 * near, 0.1, 0.02, -0.6]) + dt * near * np.append(rates, [0, 0])
    assert found.time_s == 0.002 * place
    assert found.mean[:5] == pytest.approx(want)
    assert found.mean[5:8] == pytest.approx(near * rates)
    assert (found.pose.stretch, found.pose.shear) == (0.03, -0.01)


def scenery(motion: tuple[float, float]) -> Floats:
    """Half of a smooth bright background, moved."""
    y, x = np.mgrid[:70, :70].astype(float)
    return np.asarray(40 + 25 * np.sin((x - motion[0]) / 4) * np.cos((y - motion[1]) / 5))


class Film:
    """Pairs of random data of an array that moves with its background by a step a pair, taken without noise.

    The data's light and the mean of all levels come so many seconds after the middle of an exposure.
    """

    def __init__(self, step: tuple[float, float], lone: int, late_s: float = 0.0, mean_late_s: float = 0.0):
        rng, self.lone, self.step = np.random.default_rng(1), lone, step
        self.late_s, self.mean_late_s = late_s, mean_late_s
        self.levels = rng.binomial(4, 0.5, (9, SIDE, SIDE)) / 4
        self.seen = {k: (self.state(k), self.cutout(k)) for k in range(9) if k != lone}

    def pose(self, k: int, late_s: float = 0.0) -> Pose:
        pairs = k + late_s / 0.002
        return Pose(33.3, 34.8, pitch_at(60.0), 0.02, 0.53).moved(pairs * self.step[0], pairs * self.step[1])

    def state(self, k: int) -> PoseState:
        rates = np.array([*self.step, 0.0]) / 0.002
        return state_at(0.002 * k, self.pose(k).vector(), rates)

    def frame(self, k: int, inverted: bool) -> Frame:
        data = (0.5 - self.levels[k]) * (1 if inverted else -1)
        light = scenery((k * self.step[0], k * self.step[1]))
        for at, weights in ((self.pose(k, self.mean_late_s), 0.5 * ALL_ON), (self.pose(k, self.late_s), data)):
            light += GAIN * draw(at, weights, (0, 0), light.shape)
        return Frame(2 * k + inverted, 0.002 * k, np.clip(np.round(light), 0, 255).astype(np.uint8))

    def cutout(self, k: int) -> Cutout:
        pose = self.pose(k, self.late_s)
        return take_cutout(FramePair(self.frame(k, False), self.frame(k, True)), (pose, pose), SIDE)

    def left(self, inverted: bool) -> UnpairedFrame:
        return UnpairedFrame(self.frame(self.lone, inverted), inverted, self.mean_late_s)


@pytest.mark.parametrize("inverted", [False, True])
@pytest.mark.parametrize("late_s", [(0.0, 0.0), (0.0005, -0.0006), (0.0, 0.0006)])
@pytest.mark.parametrize("step", [(0.0, 0.0), (1.3, -0.8)])
def test_a_frame_left_shows_the_difference_of_its_pair(
    step: tuple[float, float], late_s: tuple[float, float], inverted: bool
) -> None:
    film = Film(step, 4, *late_s)
    found = unpaired_cutout(film.left(inverted), 4, film.seen, late_s[0], GAIN, ALL_ON)
    want = film.cutout(4)
    assert found is not None
    assert (found.corner, found.shape) == (want.corner, want.shape)
    # frames are rounded to gray levels
    np.testing.assert_allclose(found.difference, want.difference, atol=0.02 * GAIN + 1)
    np.testing.assert_allclose(found.total, want.total, atol=0.02 * GAIN + 1)
    assert found.poses[0].full_vector() == pytest.approx(want.poses[0].full_vector())
    assert found.covered is None


@pytest.mark.parametrize(("places", "noise"), [([3], 3.0), ([0, 2], 2.5), (range(8), 2 + 1 / 6)])
def test_its_noise_is_that_of_twice_a_frame_and_of_the_sums(places: Sequence[int], noise: float) -> None:
    film = Film((0.0, 0.0), 8)
    seen = {k: film.seen[k] for k in places}
    # in units of the 2 s^2 of a difference, 2 r has 2, and the mean of k sums 1/k
    found = unpaired_cutout(film.left(False), 4, seen, 0.0, GAIN, ALL_ON)
    assert found is not None
    assert found.noise == pytest.approx(noise)


def test_without_a_pair_near_it_nothing_is_said() -> None:
    film = Film((0.0, 0.0), 8)
    assert unpaired_cutout(film.left(False), 8, {0: film.seen[0], 1: film.seen[1]}, 0.0, GAIN, ALL_ON) is None
    assert unpaired_cutout(film.left(False), 8, {}, 0.0, GAIN, ALL_ON) is None


@pytest.mark.parametrize("level", [0, 255])
def test_something_before_the_array_is_not_taken_for_data(level: int) -> None:
    film = Film((0.0, 0.0), 4)
    covered = Frame(8, 0.008, np.full((70, 70), level, np.uint8))
    assert unpaired_cutout(UnpairedFrame(covered, False, 0.0), 4, film.seen, 0.0, GAIN, ALL_ON) is None
