"""Pinhole geometry against SciPy rotations, a pointwise pinhole camera and numerical derivatives."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from properties import examples
from scipy.spatial.transform import Rotation

from heliograph.base.arrays import Floats
from heliograph.channel.scene import CameraPose, centre_scale, homography, project, rotation
from heliograph.channel.settings import ChannelSettings, Placement

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
    Placement, x_m=METRES, y_m=METRES, z_offset_m=METRES, vx_m_s=METRES, vy_m_s=METRES, vz_m_s=METRES,
    yaw_deg=st.floats(-70, 70), pitch_deg=st.floats(-70, 70), roll_deg=st.floats(-180, 180),
)  # fmt: skip
COORDINATES = st.tuples(*[st.floats(-0.5, 0.5)] * 2)
POINTS: st.SearchStrategy[Floats] = st.lists(COORDINATES, min_size=1, max_size=4).map(np.array)


def pose_of(travelled: float, heave: float, *turn: float) -> CameraPose:
    return CameraPose(*(np.array([value]) for value in (travelled, heave, *turn, 0.0)))


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


@examples(30)
@given(angles=ANGLES)
def test_a_rotation_is_yaw_after_pitch_after_roll(angles: tuple[float, float, float]) -> None:
    pitch, yaw, roll = angles
    found = pytest.approx(rotation(*angles), abs=1e-12)
    assert turned(*angles).as_matrix() == found
    assert rotation(0, yaw, 0) @ rotation(pitch, 0, 0) @ rotation(0, 0, roll) == found


@examples(20)
@given(pose=POSES, placement=PLACEMENTS, distance_m=DISTANCES, points=POINTS)
def test_projection_is_a_pinholes(pose: CameraPose, placement: Placement, distance_m: float, points: Floats) -> None:
    maps, eye = homography(pose, TIME, placement, distance_m, CAMERA)
    image, depth = project(maps, points)
    world, tilt = in_space(pose, placement, distance_m, points)
    camera = turned(pose.pitch_rad[0], pose.yaw_rad[0], pose.roll_rad[0])
    for k, (right, down, forward) in enumerate(camera.inv().apply(world)):
        x = CAMERA.focal_px * right / forward + (CAMERA.width - 1) / 2
        y = CAMERA.focal_px * down / forward + (CAMERA.height - 1) / 2
        assert (image[0, k], depth[0, k]) == (pytest.approx([x, y], abs=1e-6), pytest.approx(forward))
    centre, _ = in_space(pose, placement, distance_m, np.zeros((1, 2)))
    assert eye[0] == pytest.approx(tilt.inv().apply(-centre[0]))


@examples(30)
@given(pose=POSES, placement=PLACEMENTS, distance_m=DISTANCES)
def test_scale_is_the_slope_of_the_map(pose: CameraPose, placement: Placement, distance_m: float) -> None:
    maps, _ = homography(pose, TIME, placement, distance_m, CAMERA)
    step = 1e-4
    (right, left, below, above), _ = project(maps[0], step * np.array([[1, 0], [-1, 0], [0, 1], [0, -1]]))
    slopes = np.column_stack([right - left, below - above]) / (2 * step)
    assert centre_scale(maps)[0] == pytest.approx(slopes, rel=1e-5, abs=1e-5 * CAMERA.focal_px / distance_m)


def test_an_array_in_the_cameras_plane_has_an_image_far_off() -> None:
    maps, eye = homography(pose_of(50, 0, 0, 0, 0), np.zeros(1), Placement(), 50.0, CAMERA)
    image, depth = project(maps, np.zeros((1, 2)))
    assert np.isfinite(image).all()
    assert depth > 0
    assert np.isfinite(eye).all()


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
