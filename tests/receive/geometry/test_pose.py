"""Pose, orientation and oriented views of an array, windows around an array, and frame cut-outs."""

from dataclasses import astuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from properties import examples, poses
from scenes import draw

from heliograph.base.frames import Frame
from heliograph.receive.geometry.fit import Fit, fit_array
from heliograph.receive.geometry.pose import ORIENTATIONS, UPRIGHT, Orientation, Pose, rim_distance
from heliograph.receive.geometry.view import CAMERA, View
from heliograph.receive.geometry.window import common, covered, cut_out, plane, window_around


@examples(100)
@given(pose=poses())
def test_a_vector_and_back(pose: Pose) -> None:
    full, values = pose.full_vector(), np.array(astuple(pose))
    assert astuple(Pose.from_vector(full)) == pytest.approx(values, rel=1e-12, abs=1e-12)
    assert astuple(Pose.from_vector(pose.vector())) == pytest.approx([*values[:5], 0.0, 0.0], rel=1e-12, abs=1e-12)
    assert np.array_equal(pose.vector(), full[:5])
    values[[2, 4]] = np.log(values[[2, 4]])
    assert full == pytest.approx(values)


@examples(100)
@given(pose=poses(), side=st.sampled_from([4, 8, 16, 32]))
def test_leds_are_an_axis_apart_about_the_centre(pose: Pose, side: int) -> None:
    leds = pose.leds(side)
    assert leds.shape == (side, side, 2)
    assert leds.mean((0, 1)) == pytest.approx([pose.x, pose.y], abs=1e-9)
    # v increases along rows, u along columns
    assert np.allclose(np.diff(leds, axis=1), pose.axes[:, 0])
    assert np.allclose(np.diff(leds, axis=0), pose.axes[:, 1])


@examples(100)
@given(pose=poses())
def test_axes_are_a_rotated_symmetric_map(pose: Pose) -> None:
    # pitch R(roll) [[1 + stretch, shear], [shear, 1 - stretch]], R clockwise with y down
    c, s = np.cos(pose.roll), np.sin(pose.roll)
    form = np.array([[c, s], [-s, c]]) @ pose.axes / pose.pitch
    assert form == pytest.approx(np.array([[1 + pose.stretch, pose.shear], [pose.shear, 1 - pose.stretch]]), abs=1e-12)
    # pitch is the mean of the extreme singular values
    longest, shortest = np.linalg.svd(pose.axes, compute_uv=False)
    assert 0.5 * (longest + shortest) == pytest.approx(pose.pitch)


@examples(100)
@given(pose=poses())
def test_the_frontal_pitch_is_the_longest_step_less_its_bias(pose: Pose) -> None:
    longest = np.linalg.svd(pose.axes, compute_uv=False)[0]
    # header fits have a tilt bias of 0.004
    assert pose.pitch <= pose.frontal_pitch <= longest + 1e-12
    assert longest - pose.frontal_pitch <= 0.0041 * pose.pitch
    assert Pose(0, 0, 2.0, stretch=0.003, shear=0.002).frontal_pitch == 2.0


@examples(100)
@given(a=poses(), b=poses(), dx=st.floats(-9, 9), dy=st.floats(-9, 9))
def test_moved_and_midway(a: Pose, b: Pose, dx: float, dy: float) -> None:
    moved, middle = a.moved(dx, dy), Pose.midway(a, b)
    assert moved.leds(4) == pytest.approx(a.leds(4) + np.array([dx, dy]), abs=1e-9)
    assert moved.pitch == a.pitch
    assert rim_distance(a, moved, 4) == pytest.approx(np.hypot(dx, dy), abs=1e-9)
    assert (middle.x, middle.y) == pytest.approx(((a.x + b.x) / 2, (a.y + b.y) / 2), abs=1e-9)
    # geometric means
    assert (middle.pitch**2, middle.blur**2) == pytest.approx((a.pitch * b.pitch, a.blur * b.blur))
    for one, same in ((middle, Pose.midway(b, a)), (Pose.midway(a, a), a)):
        assert astuple(one) == pytest.approx(astuple(same), rel=1e-12, abs=1e-12)


ANY = st.sampled_from(ORIENTATIONS)
IMAGE = np.arange(12).reshape(3, 4)


def test_there_are_eight_orientations_with_names_and_upright_comes_first() -> None:
    assert len({one.matrix.tobytes() for one in ORIENTATIONS}) == len(set(ORIENTATIONS)) == 8
    assert ORIENTATIONS[0] == UPRIGHT == Orientation(0, False)
    assert np.array_equal(UPRIGHT.turned(IMAGE), IMAGE)
    assert [str(one) for one in ORIENTATIONS[:3]] == ["upright", "turned 90", "turned 180"]
    assert [str(one) for one in ORIENTATIONS[4:6]] == ["mirrored", "mirrored, turned 90"]


def test_turns_are_clockwise_and_come_after_the_mirror() -> None:
    for way, expected in (((1,), [[0, 1], [0, 2]]), ((0, True), [[2, 1], [0, 0]]), ((1, True), [[0, 2], [0, 1]])):
        assert Orientation(*way).turned(np.array([[1, 2], [0, 0]])).tolist() == expected
    # y points down: a clockwise rotation moves right to below
    assert (Orientation(1).matrix @ [1, 0]).tolist() == [0, 1]


@examples(60)
@given(one=ANY, other=ANY)
def test_orientations_are_a_group(one: Orientation, other: Orientation) -> None:
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
def test_a_view_maps_leds_to_the_camera_and_back(orientation: Orientation, level: int, pose: Pose) -> None:
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
    assert view.map_motion(step, inverse=True) == pytest.approx((after.x - before.x, after.y - before.y))
    assert view.map_motion(view.map_motion(step, inverse=True)) == pytest.approx(step)


POSE = Pose(60.3, 51.8, 4.4, 0.03, 0.55, 0.02, -0.015)


def shot(pose: Pose, weights: np.ndarray) -> Frame:
    pixels = 10 + 2000 * draw(pose, weights, (0, 0), (110, 121))
    return Frame(0, 0.0, pixels.astype(np.uint16), bits=12)


@pytest.mark.parametrize("orientation", ORIENTATIONS, ids=str)
@pytest.mark.parametrize("level", [0, 1])
def test_frames_of_a_view_show_the_array_at_its_pose(orientation: Orientation, level: int) -> None:
    upright, view = np.random.default_rng(5).integers(0, 2, (16, 16)).astype(float), View(level, orientation)
    frame, expected = view.frame(shot(POSE, orientation.turned(upright)), POSE, 16), view.pose_in(POSE)
    spread = np.diag(np.array([0.5, 0.5, 0.05, 0.02, 0.2, 0.01, 0.01]) ** 2)
    fit = fit_array(frame.pixels.astype(float), frame.origin, Fit(expected.full_vector(), spread), upright, 8)
    assert fit.score > 0.995
    np.testing.assert_allclose(fit.vector[:4], expected.full_vector()[:4], atol=0.02)
    assert fit.pose.blur == pytest.approx(expected.blur, rel=0.05)


@pytest.mark.parametrize("pitch", [3.5, 7.0, 9.0])
def test_the_view_chosen_suits(pitch: float) -> None:
    view = View.of(Pose(0, 0, pitch))
    assert [view.suits(view.pose_in(Pose(0, 0, r * pitch))) for r in (1, 2.5, 1 / 2.5)] == [True, False, False]


def test_far_arrays_are_not_reduced_and_the_nearest_not_further() -> None:
    frame, nearest = shot(POSE, np.ones((16, 16))), View.of(Pose(0, 0, 31.0))
    assert View.of(Pose(0, 0, 2.9)) == CAMERA
    assert CAMERA.frame(frame, POSE, 16) is frame
    assert nearest.pose_in(Pose(0, 0, 31.0)).pitch == pytest.approx(31.0 / 8)
    assert [nearest.suits(nearest.pose_in(Pose(0, 0, pitch))) for pitch in (40.0, 10.0)] == [True, False]
    # the reference blur is the same on all levels
    assert [View(k).pose_in(Pose(0, 0, 20, 0, 0.5)).blur for k in range(4)] == pytest.approx([0.5] * 4)


SENSOR = np.random.default_rng(0).integers(0, 256, (60, 70)).astype(np.uint8)  # frames are windows


@st.composite
def frames(draw: st.DrawFn) -> Frame:
    """Draw a sensor window with at least 3 x 3 pixels."""
    left, top = draw(st.integers(0, 40)), draw(st.integers(0, 40))
    right, low = draw(st.integers(left + 3, 70)), draw(st.integers(top + 3, 60))
    return Frame(0, 0.0, SENSOR[top:low, left:right], 8, (left, top))


WINDOWS = st.tuples(st.integers(-20, 80), st.integers(-20, 70), st.integers(1, 30), st.integers(1, 30))


@examples(100)
@given(pose=poses(), side=st.sampled_from([4, 8, 16]), margin=st.floats(0, 9))
def test_a_window_holds_the_leds_and_the_margin_only(pose: Pose, side: int, margin: float) -> None:
    x, y, cols, rows = window_around(pose, side, margin)
    # outer LED cells extend half a step beyond the LED centres
    corners = pose.leds(side)[[0, 0, -1, -1], [0, -1, 0, -1]] - (pose.x, pose.y)
    corners = corners * side / (side - 1) + (pose.x, pose.y)
    first, last = np.array([x, y]), np.array([x + cols - 1, y + rows - 1])
    # of less than a pixel beyond the margin
    for beyond in (corners.min(0) - margin - first, last - corners.max(0) - margin):
        assert (beyond > -1e-9).all()
        assert (beyond < 1 + 1e-9).all()


@examples(100)
@given(frame=frames(), window=WINDOWS)
def test_a_cut_out_is_a_copied_slice_with_a_repeated_border(frame: Frame, window: tuple[int, int, int, int]) -> None:
    x, y, cols, rows = window
    got = cut_out(frame, window)
    assert got.shape == (rows, cols)
    assert got.dtype == np.float64
    (left, top), (height, width) = frame.origin, frame.pixels.shape
    right, low = left + width - 1, top + height - 1
    for i, j in ((0, 0), (rows - 1, cols - 1), (rows // 2, cols // 3), (0, cols - 1)):
        assert got[i, j] == SENSOR[min(max(y + i, top), low), min(max(x + j, left), right)]
    if x >= left and y >= top and x + cols <= left + width and y + rows <= top + height:
        assert np.array_equal(got, SENSOR[y : y + rows, x : x + cols])
        # a copy: receivers may write to cut-outs
        assert not np.shares_memory(got, frame.pixels)


@pytest.mark.slow
@examples(100)
@given(several=st.lists(frames(), min_size=1, max_size=3), window=WINDOWS)
def test_covered_pixels_are_inside_all_frames(several: list[Frame], window: tuple[int, int, int, int]) -> None:
    x, y, cols, rows = window
    there = np.ones((rows, cols), bool)
    for frame in several:
        (left, top), (height, width) = frame.origin, frame.pixels.shape
        v, u = np.arange(x, x + cols), np.arange(y, y + rows)
        there &= ((u >= top) & (u < top + height))[:, None] & ((v >= left) & (v < left + width))
    found = covered(several, (x, y), (rows, cols))
    if found is None:
        assert there.all()
    else:
        assert not there.all()
        assert np.array_equal(np.outer(found[1], found[0]) > 0, there)


@examples(100)
@given(several=st.lists(frames(), min_size=1, max_size=4))
def test_common_parts_show_the_same_part_of_the_sensor(several: list[Frame]) -> None:
    left, top = np.max([f.origin for f in several], axis=0)
    right, low = np.min([np.add(f.origin, f.pixels.shape[::-1]) for f in several], axis=0)
    for one in common(several):
        assert one.origin == (left, top)
        assert one.pixels.shape == (max(low - top, 0), max(right - left, 0))
        assert not one.pixels.size or np.array_equal(one.pixels, SENSOR[top:low, left:right])


@pytest.mark.parametrize("shape", [(1, 1), (5, 8), (30, 26)])
def test_the_plane_is_a_constant_and_two_slopes(shape: tuple[int, int]) -> None:
    constant, x, y = plane(*shape)
    assert (constant == 1).all()
    for slope, axis in ((x, 1), (y, 0)):
        assert slope.mean() == pytest.approx(0)
        assert np.allclose(np.diff(slope, axis=axis), 1 / shape[axis])
        assert np.ptp(slope, axis=1 - axis) == pytest.approx(0)
    with pytest.raises(ValueError, match="read-only"):
        constant[0, 0] = 2.0
