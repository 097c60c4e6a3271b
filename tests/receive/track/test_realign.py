"""Pose realignment by difference power."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import SIDE, draw, frame_of, pitch_at

from heliograph.receive import Pose
from heliograph.receive.equalise.pose_refinement import align_by_power
from heliograph.receive.observe.cutout import Cutout, take_cutout
from heliograph.receive.sync.pairing import FramePair

Floats = NDArray[np.float64]

SHAPE = (60, 60)
ALL = np.ones((SIDE, SIDE))


def pose_at(distance_m: float) -> Pose:
    return Pose(29.6, 30.3, pitch_at(distance_m), 0.02, 0.53)


def even(true: Pose, taken: Pose, led_gains: Floats = ALL) -> Cutout:
    """Return a cut-out at a possibly wrong pose; its difference shows all LEDs on."""
    dark = frame_of(np.zeros(SHAPE), 0, np.random.default_rng(0))
    cutout = take_cutout(FramePair(dark, dark), (taken, taken), SIDE)
    light = 90 * draw(true, led_gains, cutout.corner, cutout.shape)
    return Cutout(light, light, cutout.corner, cutout.poses)


def errors(cutouts: list[Cutout | None], true: Pose) -> Floats:
    return np.array([(one.middle.x - true.x, one.middle.y - true.y) for one in cutouts if one is not None])


@pytest.mark.parametrize("distance_m", [50.0, 95.0])
def test_poses_that_are_off_go_to_where_the_differences_have_their_power(distance_m: float) -> None:
    rng, pose = np.random.default_rng(6), pose_at(distance_m)
    wrong, cutouts = pose.moved(-1.3, 0.7), list[Cutout | None]()
    for _ in range(24):
        levels = rng.binomial(4, 0.5, (SIDE, SIDE)) / 4
        up, down = (frame_of(0.1 + 0.8 * draw(pose, x, (0, 0), SHAPE), 0, rng) for x in (levels, 1 - levels))
        cutouts.append(take_cutout(FramePair(up, down), (wrong, wrong), SIDE))
    cutouts[5] = None
    moved, largest = align_by_power(cutouts, ALL)
    assert largest == pytest.approx(np.hypot(1.3, 0.7), abs=0.4)
    assert moved[5] is None
    assert np.abs(errors(moved, pose)).max() < 0.4


@pytest.mark.parametrize("off", [(0.4, 0.0), (0.0, -0.4), (-1.4, 2.3), (3.3, -0.6), (0.0, 0.0)])
def test_errors_are_found_between_pixels(off: tuple[float, float]) -> None:
    pose = pose_at(95.0)
    moved, largest = align_by_power([even(pose, pose.moved(*off))], ALL)
    assert errors(moved, pose)[0] == pytest.approx((0, 0), abs=0.08)
    assert largest == pytest.approx(np.hypot(*off), abs=0.1)


def test_an_error_beyond_reach_goes_as_far_as_is_looked() -> None:
    pose = pose_at(95.0)
    moved, _ = align_by_power([even(pose, pose.moved(6.0, 0.0))], ALL)
    # limited to 4 px grid steps plus 1 px from the parabola
    assert 1.0 <= errors(moved, pose)[0, 0] <= 2.5


def test_each_pair_goes_by_those_about_it() -> None:
    """The smoothing window covers eight pairs on each side."""
    pose = pose_at(95.0)
    off = [pose.moved(2.0, 0.0)] * 20 + [pose.moved(-2.0, 0.0)] * 20
    moved, _ = align_by_power([even(pose, taken) for taken in off], ALL)
    found = errors(moved, pose)[:, 0]
    # pairs with a constant error inside the window
    assert found[:12] == pytest.approx(np.zeros(12), abs=0.08)
    assert found[28:] == pytest.approx(np.zeros(12), abs=0.08)
    # symmetric transition around the change
    assert (np.abs(found[12:28] - found[[11]]) > 1e-3).all()
    assert found[12:20] == pytest.approx(-found[20:28][::-1])


def test_hidden_leds_have_no_power() -> None:
    """An array with a hidden or failed left half has all power on the right, and the pose stays."""
    pose, right = pose_at(50.0), ALL.copy()
    right[:, :8] = 0
    cutout = even(pose, pose, right)
    burnt, _ = align_by_power([cutout], right)
    assert errors(burnt, pose)[0] == pytest.approx((0, 0), abs=0.08)
    hidden, _ = align_by_power(
        [Cutout(cutout.total, cutout.difference, cutout.corner, cutout.poses, in_sight=right)], ALL
    )
    assert errors(hidden, pose)[0] == pytest.approx((0, 0), abs=0.08)


def test_pairs_that_were_not_seen_weigh_nothing() -> None:
    pose = pose_at(95.0)
    seen = even(pose, pose.moved(0.0, 1.0))
    moved, largest = align_by_power([None, seen, None, None], ALL)
    assert [one is None for one in moved] == [True, False, True, True]
    assert largest == pytest.approx(1.0, abs=0.08)
    assert align_by_power([None, None], ALL) == ([None, None], 0.0)
