"""The eight orientations of a square, and poses in rotated views."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from properties import examples, poses

from heliograph.receive import Pose
from heliograph.receive.geometry.pose import ORIENTATIONS, UPRIGHT, Orientation
from heliograph.receive.geometry.view import View

ANY = st.sampled_from(ORIENTATIONS)
IMAGE = np.arange(12).reshape(3, 4)


def test_there_are_eight_and_the_upright_one_comes_first() -> None:
    assert len({one.matrix.tobytes() for one in ORIENTATIONS}) == len(set(ORIENTATIONS)) == 8
    assert ORIENTATIONS[0] == UPRIGHT == Orientation(0, False)
    assert np.array_equal(UPRIGHT.turned(IMAGE), IMAGE)


def test_turns_are_clockwise_and_come_after_the_mirror() -> None:
    corner = np.array([[1, 2], [0, 0]])
    assert Orientation(1).turned(corner).tolist() == [[0, 1], [0, 2]]
    assert Orientation(0, True).turned(corner).tolist() == [[2, 1], [0, 0]]
    assert Orientation(1, True).turned(corner).tolist() == [[0, 2], [0, 1]]
    # y points down: a clockwise rotation moves right to below
    assert (Orientation(1).matrix @ [1, 0]).tolist() == [0, 1]


def test_names() -> None:
    assert [str(one) for one in ORIENTATIONS[:3]] == ["upright", "turned 90", "turned 180"]
    assert [str(one) for one in ORIENTATIONS[4:6]] == ["mirrored", "mirrored, turned 90"]


@examples(60)
@given(one=ANY, other=ANY)
def test_they_are_a_group(one: Orientation, other: Orientation) -> None:
    (both,) = [found for found in ORIENTATIONS if np.array_equal(found.matrix, one.matrix @ other.matrix)]
    assert np.array_equal(one.turned(other.turned(IMAGE)), both.turned(IMAGE))
    # rotations add; a preceding reflection reverses the first
    turns = one.turns + (-other.turns if one.mirrored else other.turns)
    assert both == Orientation(turns % 4, one.mirrored != other.mirrored)
    (back,) = [found for found in ORIENTATIONS if np.array_equal(found.matrix @ one.matrix, np.eye(2))]
    assert np.array_equal(back.turned(IMAGE), one.upright(IMAGE))
    assert np.array_equal(one.upright(one.turned(IMAGE)), IMAGE)


@examples(100)
@given(orientation=ANY, level=st.integers(0, 2), pose=poses())
def test_a_pose_turned_out_has_its_leds_where_the_camera_sees_them(
    orientation: Orientation, level: int, pose: Pose
) -> None:
    """Vectors map from the upright to the rotated image, and LEDs permute as pixels do."""
    view = View(level, orientation)
    out = view.pose_out(pose)
    places = 2**level * pose.leds(4) @ orientation.matrix.T
    np.testing.assert_allclose(out.leds(4), orientation.turned(places), atol=1e-9)
    np.testing.assert_allclose(view.pose_in(out).leds(4), pose.leds(4), atol=1e-9)


@pytest.mark.parametrize("orientation", ORIENTATIONS, ids=str)
def test_motions_turn_with_the_poses(orientation: Orientation) -> None:
    view, pose, step = View(1, orientation), Pose(30.2, 21.7, 1.4), (0.7, -0.3)
    before, after = view.pose_out(pose), view.pose_out(pose.moved(*step))
    assert view.motion_out(step) == pytest.approx((after.x - before.x, after.y - before.y))
    assert view.motion_in(view.motion_out(step)) == pytest.approx(step)
