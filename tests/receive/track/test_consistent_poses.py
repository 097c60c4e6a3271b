"""Poses at which the differences of single pairs are such as an array gives."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scenes import SIDE, draw, frame_of, pitch_at

from heliograph.receive import Pose
from heliograph.receive.observe.cutout import Cutout, take_cutout
from heliograph.receive.observe.noise import Noise
from heliograph.receive.timing.frame_pair import FramePair
from heliograph.receive.track.consistent_poses import consistent

Floats = NDArray[np.float64]

SHAPE = (60, 60)
ALL = np.ones((SIDE, SIDE))
GAIN, NOISE = 0.8 * 255, Noise(6.0, 3.0)
PAIRS = 12


def pairs(distance_m: float, errors: dict[int, tuple[float, float]], hidden: int = 0) -> tuple[list[Cutout], Pose]:
    """Pairs of random data, some of them taken at a pose that is wrong, some columns hidden in all of them."""
    rng, pose = np.random.default_rng(4), Pose(29.6, 30.3, pitch_at(distance_m), 0.02, 0.53)
    shown, out = ALL.copy(), list[Cutout]()
    shown[:, :hidden] = 0
    for k in range(PAIRS):
        levels = rng.binomial(4, 0.5, (SIDE, SIDE)) / 4
        up, down = (frame_of(0.1 + 0.8 * draw(pose, shown * x, (0, 0), SHAPE), 0, rng) for x in (levels, 1 - levels))
        taken = pose.moved(*errors.get(k, (0.0, 0.0)))
        cutout = take_cutout(FramePair(up, down), (taken, taken), SIDE)
        seen = shown if hidden else None
        out.append(Cutout(cutout.total, cutout.difference, cutout.corner, cutout.poses, in_sight=seen))
    return out, pose


def left(cutouts: list[Cutout | None], pose: Pose) -> Floats:
    return np.array([(one.middle.x - pose.x, one.middle.y - pose.y) for one in cutouts if one is not None])


@pytest.mark.parametrize("distance_m", [30.0, 45.0, 60.0])
@pytest.mark.parametrize("axis", [0, 1])
def test_pairs_that_something_pulls_are_put_right(distance_m: float, axis: int) -> None:
    pull = {4: 0.3, 5: 0.6, 6: 0.95, 7: 0.5}
    cutouts, pose = pairs(distance_m, {k: (e, 0.0) if axis == 0 else (0.0, -e) for k, e in pull.items()})
    moved, largest = consistent(cutouts, NOISE, ALL, GAIN)
    assert np.abs(left(moved, pose)).max() < 0.12
    assert largest == pytest.approx(0.95, abs=0.12)
    for k in set(range(PAIRS)) - set(pull):
        assert moved[k] is cutouts[k]


def test_of_poses_a_led_apart_those_of_the_pairs_around_decide() -> None:
    """With a side hidden, an array moved by one LED towards it explains the light as well."""
    cutouts, pose = pairs(47.0, {k: (0.25 + 0.1 * k, 0.0) for k in range(3, 9)}, hidden=5)
    moved, _ = consistent(cutouts, NOISE, ALL, GAIN)
    assert np.abs(left(moved, pose)).max() < 0.15


def test_poses_that_are_right_stay() -> None:
    cutouts, _ = pairs(60.0, {})
    moved, largest = consistent(cutouts, NOISE, ALL, GAIN)
    assert largest == 0
    assert all(after is before for after, before in zip(moved, cutouts, strict=True))


def test_pairs_that_were_not_seen_stay_so() -> None:
    cutouts, pose = pairs(60.0, {5: (0.6, 0.0)})
    gaps: list[Cutout | None] = [*cutouts[:2], None, *cutouts[3:]]
    moved, _ = consistent(gaps, NOISE, ALL, GAIN)
    assert moved[2] is None
    assert np.abs(left(moved, pose)).max() < 0.12
    assert consistent([None] * 3, NOISE, ALL, GAIN) == ([None] * 3, 0.0)


@pytest.mark.parametrize("gain", [1e-9, 1e9])
def test_an_absurd_gain_moves_no_pose(gain: float) -> None:
    """Rounding leaves no number then: the poses stay."""
    cutouts, _ = pairs(60.0, {5: (0.6, 0.0)})
    moved, largest = consistent(cutouts, NOISE, ALL, gain)
    assert len(moved) == PAIRS
    assert largest < 2


def test_nothing_is_asked_of_pairs_without_light() -> None:
    cutouts, _ = pairs(60.0, {})
    dark = [Cutout(np.zeros_like(c.total), np.zeros_like(c.total), c.corner, c.poses) for c in cutouts]
    moved, largest = consistent(dark, NOISE, ALL, GAIN)
    assert largest == 0
    assert all(after is before for after, before in zip(moved, dark, strict=True))
