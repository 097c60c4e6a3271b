"""Oriented views: frames and poses in an array's coordinates."""

import numpy as np
import pytest
from scenes import ALL_ON, draw

from heliograph.base.frames import Frame
from heliograph.receive import Pose
from heliograph.receive.geometry.fit import Fit, fit_array
from heliograph.receive.geometry.pose import ORIENTATIONS, Orientation
from heliograph.receive.geometry.view import CAMERA, View

POSE = Pose(60.3, 51.8, 4.4, 0.03, 0.55, 0.02, -0.015)


def drawn(pose: Pose, weights: np.ndarray = ALL_ON) -> Frame:
    pixels = 10 + 2000 * draw(pose, weights, (0, 0), (110, 121))
    return Frame(0, 0.0, pixels.astype(np.uint16), bits=12)


@pytest.mark.parametrize("orientation", ORIENTATIONS, ids=str)
@pytest.mark.parametrize("level", [0, 1, 2])
def test_a_pose_comes_back_as_it_was(orientation: Orientation, level: int) -> None:
    view = View(level, orientation)
    back = view.pose_out(view.pose_in(POSE)).full_vector()
    np.testing.assert_allclose(back, POSE.full_vector(), atol=1e-9)


@pytest.mark.parametrize("orientation", ORIENTATIONS, ids=str)
@pytest.mark.parametrize("level", [0, 1])
def test_frames_show_the_array_where_its_pose_is(orientation: Orientation, level: int) -> None:
    rng = np.random.default_rng(5)
    upright = rng.integers(0, 2, (16, 16)).astype(float)
    view = View(level, orientation)
    frame, expected = view.frame(drawn(POSE, orientation.turned(upright)), POSE, 16), view.pose_in(POSE)
    spread = np.diag(np.array([0.5, 0.5, 0.05, 0.02, 0.2, 0.01, 0.01]) ** 2)
    fit = fit_array(frame.pixels.astype(float), frame.origin, Fit(expected.full_vector(), spread), upright, 8)
    assert fit.score > 0.995
    np.testing.assert_allclose(fit.vector[:4], expected.full_vector()[:4], atol=0.02)
    assert fit.pose.blur == pytest.approx(expected.blur, rel=0.05)


def test_the_reference_links_blur_is_the_same_on_all_levels() -> None:
    assert [View(k).pose_in(Pose(0, 0, 20, 0, 0.5)).blur for k in range(4)] == pytest.approx([0.5] * 4)


def test_a_far_array_is_read_in_the_cameras_frames() -> None:
    frame = drawn(POSE)
    assert View.of(Pose(0, 0, 2.9)) == CAMERA
    assert CAMERA.frame(frame, POSE, 16) is frame


def test_the_nearest_arrays_are_not_reduced_further() -> None:
    view = View.of(Pose(0, 0, 31.0))
    assert view.pose_in(Pose(0, 0, 31.0)).pitch == pytest.approx(31.0 / 8)
    assert view.suits(view.pose_in(Pose(0, 0, 40.0)))
    assert not view.suits(view.pose_in(Pose(0, 0, 10.0)))


@pytest.mark.parametrize("pitch", [3.5, 7.0, 9.0])
def test_the_view_chosen_suits(pitch: float) -> None:
    pose = Pose(0, 0, pitch)
    view = View.of(pose)
    assert view.suits(view.pose_in(pose))
    assert not view.suits(view.pose_in(Pose(0, 0, 2.5 * pitch)))
    assert not view.suits(view.pose_in(Pose(0, 0, pitch / 2.5)))
