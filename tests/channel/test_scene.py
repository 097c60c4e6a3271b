"""Pinhole geometry against SciPy rotations, a pointwise pinhole camera and numerical derivatives."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from properties import examples
from scipy.spatial.transform import Rotation

from heliograph.channel import ChannelSettings, Placement
from heliograph.channel.scene import CameraPose, centre_scale, homography, project, rotation, square

Floats = NDArray[np.float64]

CAMERA = ChannelSettings().camera
TIME = np.array([0.5])
ANGLES = st.tuples(*[st.floats(-7.0, 7.0)] * 3)
SMALL_ANGLES = st.tuples(*[st.floats(-0.3, 0.3)] * 3)
METRES = st.floats(-3.0, 3.0)
DISTANCES = st.floats(15.0, 300.0)

POSES = st.builds(
    lambda travelled, heave, turn: pose_of(travelled, heave, *turn), st.floats(0.0, 5.0), st.floats(-1, 1), SMALL_ANGLES
)
PLACEMENTS = st.builds(
    Placement,
    x_m=METRES,
    y_m=METRES,
    z_offset_m=METRES,
    yaw_deg=st.floats(-70, 70),
    pitch_deg=st.floats(-70, 70),
    roll_deg=st.floats(-180, 180),
    vx_m_s=METRES,
    vy_m_s=METRES,
    vz_m_s=METRES,
)
POINTS: st.SearchStrategy[Floats] = st.lists(st.tuples(*[st.floats(-0.5, 0.5)] * 2), min_size=1, max_size=4).map(
    np.array
)


def pose_of(travelled: float, heave: float, *turn: float) -> CameraPose:
    return CameraPose(*(np.array([value]) for value in (travelled, heave, *turn)))


def turned(pitch: float, yaw: float, roll: float) -> Rotation:
    """Rotate with SciPy: about down, then the new right, then the new forward axis."""
    return Rotation.from_euler("YXZ", (yaw, pitch, roll))


def in_space(pose: CameraPose, placement: Placement, distance_m: float, points: Floats) -> tuple[Floats, Rotation]:
    """Return array points relative to the camera at `TIME` in world axes, and the array rotation."""
    p, t = placement, TIME[0]
    turn = turned(*np.radians((p.pitch_deg, p.yaw_deg, p.roll_deg)))
    centre = np.array([p.x_m, p.y_m, distance_m + p.z_offset_m]) + t * np.array([p.vx_m_s, p.vy_m_s, p.vz_m_s])
    eye = np.array([0, -pose.heave_m[0], pose.travelled_m[0]])
    return centre + turn.apply(np.column_stack([points, np.zeros(len(points))])) - eye, turn


def camera_turn(pose: CameraPose) -> Rotation:
    return turned(pose.pitch_rad[0], pose.yaw_rad[0], pose.roll_rad[0])


@examples(100)
@given(angles=ANGLES)
def test_a_rotation_keeps_lengths_and_handedness(angles: tuple[float, float, float]) -> None:
    turn = rotation(*angles)
    assert turn @ turn.T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(turn) == pytest.approx(1, abs=1e-12)


@examples(100)
@given(angles=ANGLES)
def test_a_rotation_is_yaw_after_pitch_after_roll(angles: tuple[float, float, float]) -> None:
    pitch, yaw, roll = angles
    assert rotation(*angles) == pytest.approx(turned(*angles).as_matrix(), abs=1e-12)
    assert rotation(0, yaw, 0) @ rotation(pitch, 0, 0) @ rotation(0, 0, roll) == pytest.approx(
        rotation(*angles), abs=1e-12
    )


@examples(50)
@given(one=ANGLES, other=ANGLES)
def test_many_rotations_at_once_are_those_one_by_one(one: tuple[float, ...], other: tuple[float, ...]) -> None:
    both = rotation(*np.transpose([one, other]))
    assert np.array_equal(both, [rotation(*one), rotation(*other)])


@examples(50)
@given(pose=POSES, placement=PLACEMENTS, distance_m=DISTANCES, points=POINTS)
def test_projection_is_a_pinholes(pose: CameraPose, placement: Placement, distance_m: float, points: Floats) -> None:
    maps, eye = homography(pose, TIME, placement, distance_m, CAMERA)
    image, depth = project(maps, points)
    world, tilt = in_space(pose, placement, distance_m, points)
    for k, (right, down, forward) in enumerate(camera_turn(pose).inv().apply(world)):
        x = CAMERA.focal_px * right / forward + (CAMERA.width - 1) / 2
        y = CAMERA.focal_px * down / forward + (CAMERA.height - 1) / 2
        assert image[0, k] == pytest.approx([x, y], abs=1e-6)
        assert depth[0, k] == pytest.approx(forward)
    centre, _ = in_space(pose, placement, distance_m, np.zeros((1, 2)))
    assert eye[0] == pytest.approx(tilt.inv().apply(-centre[0]))


@examples(50)
@given(placement=PLACEMENTS, distance_m=DISTANCES, points=POINTS, angles=SMALL_ANGLES)
def test_camera_and_array_turned_together_give_the_same_image(
    placement: Placement, distance_m: float, points: Floats, angles: tuple[float, float, float]
) -> None:
    still, _ = homography(pose_of(0, 0, 0, 0, 0), TIME, placement, distance_m, CAMERA)
    centre, tilt = in_space(pose_of(0, 0, 0, 0, 0), placement, distance_m, np.zeros((1, 2)))
    turn = turned(*angles)
    (x, y, z), (yaw, pitch, roll) = turn.apply(centre[0]), np.degrees((turn * tilt).as_euler("YXZ"))
    if abs(yaw) >= 90 or abs(pitch) >= 90:
        return
    carried = Placement(x_m=x, y_m=y, yaw_deg=yaw, pitch_deg=pitch, roll_deg=roll)
    moved, _ = homography(pose_of(0, 0, *angles), TIME, carried, z, CAMERA)
    assert project(moved, points)[0] == pytest.approx(project(still, points)[0], abs=1e-6)


@examples(50)
@given(pose=POSES, placement=PLACEMENTS, distance_m=DISTANCES, way_m=st.floats(-3, 3))
def test_a_camera_driving_and_an_array_coming_are_the_same(
    pose: CameraPose, placement: Placement, distance_m: float, way_m: float
) -> None:
    ahead = replace(pose, travelled_m=pose.travelled_m + way_m)
    nearer = replace(placement, z_offset_m=placement.z_offset_m - way_m)
    driven, from_there = homography(ahead, TIME, placement, distance_m, CAMERA)
    come, from_here = homography(pose, TIME, nearer, distance_m, CAMERA)
    assert driven == pytest.approx(come, rel=1e-9, abs=1e-6)
    assert from_there == pytest.approx(from_here, abs=1e-9)


@examples(100)
@given(pose=POSES, placement=PLACEMENTS, distance_m=DISTANCES)
def test_scale_is_the_slope_of_the_map(pose: CameraPose, placement: Placement, distance_m: float) -> None:
    maps, _ = homography(pose, TIME, placement, distance_m, CAMERA)
    step = 1e-4
    (right, left, below, above), _ = project(maps[0], step * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]]))
    slopes = np.column_stack([right - left, below - above]) / (2 * step)
    assert centre_scale(maps)[0] == pytest.approx(slopes, rel=1e-5, abs=1e-5 * CAMERA.focal_px / distance_m)


@examples(50)
@given(half_m=st.floats(0.0, 1.0))
def test_a_square_goes_round_its_centre(half_m: float) -> None:
    corners = square(half_m)
    assert np.abs(corners) == pytest.approx(np.full((4, 2), half_m))
    # adjacent corners differ by a quarter turn
    assert np.roll(corners, -1, 0) == pytest.approx(corners @ np.array([[0.0, 1.0], [-1.0, 0.0]]))


def test_an_array_in_the_cameras_plane_has_an_image_far_off() -> None:
    maps, eye = homography(pose_of(50, 0, 0, 0, 0), np.zeros(1), Placement(), 50.0, CAMERA)
    image, depth = project(maps, np.zeros((1, 2)))
    assert np.isfinite(image).all()
    assert depth > 0
    assert np.isfinite(eye).all()


def test_array_moves_by_itself() -> None:
    time = np.array([0.0, 2.0])
    pose = CameraPose(*[np.zeros(2)] * 5)
    maps, eye = homography(pose, time, Placement(x_m=0, vx_m_s=0.5, vy_m_s=-0.25), 50.0, CAMERA)
    image, _ = project(maps, np.zeros((1, 2)))
    assert image[1, 0] - image[0, 0] == pytest.approx(np.array([1, -0.5]) * 0.035 / 12e-6 / 50)
    assert eye[1] == pytest.approx([-1, 1.5, -50])


def test_turns_move_the_image_as_they_are_named() -> None:
    small = 1e-3

    def image(pitch: float = 0, yaw: float = 0, roll: float = 0, heave: float = 0) -> Floats:
        one, _ = homography(pose_of(0, heave, pitch, yaw, roll), np.zeros(1), Placement(), 50.0, CAMERA)
        return np.asarray(project(one[0], np.zeros((1, 2)))[0][0])

    rest = image()
    assert image(pitch=small) - rest == pytest.approx([0, 2.917], abs=0.01)  # nose up: the array moves down
    assert image(yaw=small) - rest == pytest.approx([-2.917, 0], abs=0.01)
    assert image(roll=small) - rest == pytest.approx([-58.3e-3, -87.5e-3], abs=1e-3)  # counterclockwise rotation
    assert image(heave=0.01) - rest == pytest.approx([0, 0.583], abs=1e-3)
