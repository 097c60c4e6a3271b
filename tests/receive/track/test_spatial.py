"""The poses in space of a tracked array: both tilts, and covariances that hold the errors."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import chdtri

from heliograph.link.settings import load_settings
from heliograph.measure.bench import run_block
from heliograph.receive.geometry.pose import pose_of_axes
from heliograph.receive.packet import SpatialPose
from heliograph.receive.settings import CalibrationSettings
from heliograph.receive.track.kalman import PoseState
from heliograph.receive.track.spatial import fit_with_all_errors, spatial_poses
from heliograph.receive.track.track import Track

CALIBRATION = CalibrationSettings(focal_m=0.016, pixel_m=5e-6, pitch_m=0.03, centre_px=(640.0, 360.0))
PLACE = np.array([4.0, -2.0, 30.0])


def image_vector(turn: Rotation) -> np.ndarray:
    """Return the pose vector of an array at `PLACE`, from the projection of two small steps in its plane."""
    focal = CALIBRATION.focal_m / CALIBRATION.pixel_m
    points = PLACE + 1e-6 * turn.as_matrix()[:, :2].T
    x, y = (CALIBRATION.centre_px + focal * PLACE[:2] / PLACE[2]).tolist()
    steps = (CALIBRATION.centre_px + focal * points[:, :2] / points[:, 2:] - (x, y)) / 1e-6 * CALIBRATION.pitch_m
    return pose_of_axes((x, y), np.asarray(steps).T, 0.6).full_vector()


def poses_of(vector: np.ndarray, covariance: np.ndarray) -> tuple[SpatialPose, SpatialPose]:
    state = PoseState(0.5, np.append(vector[:5], np.zeros(5)), np.zeros((10, 10)), vector[5:], covariance[5:, 5:])
    state.covariance[:5, :5] = covariance[:5, :5]
    ones = np.ones((16, 16))
    fit = fit_with_all_errors(Track(state, 200.0, 200.0, ones, 0.5, ones), 0.112)
    return spatial_poses(state.time_s, fit, CALIBRATION)


def errors_of(pose: SpatialPose, turn: Rotation) -> np.ndarray:
    rest = turn * Rotation.from_rotvec(pose.rotation_rad).inv()
    return np.append(PLACE - pose.translation_m, rest.as_rotvec())


@pytest.mark.parametrize("degrees", [(35.0, -8.0, 3.0), (-20.0, 15.0, -40.0)])
def test_one_of_both_poses_is_true_and_the_other_tilts_the_opposite_way(degrees: tuple[float, float, float]) -> None:
    turn = Rotation.from_euler("YXZ", degrees, degrees=True)
    poses = poses_of(image_vector(turn), 1e-5**2 * np.eye(7))
    errors = [errors_of(pose, turn) for pose in poses]
    true, other = np.argsort([np.abs(error).max() for error in errors])
    assert np.abs(errors[true]).max() < 1e-3
    # the normals of both lie symmetric about the line of sight
    normals = [Rotation.from_rotvec(pose.rotation_rad).as_matrix()[:, 2] for pose in poses]
    middle = normals[0] + normals[1]
    assert middle / np.linalg.norm(middle) == pytest.approx(PLACE / np.linalg.norm(PLACE), abs=1e-3)
    assert np.abs(errors[other][3:]).max() > 0.3


@pytest.mark.parametrize("yaw", [30.0, 3.0])
def test_stated_region_holds_95_percent_of_errors_of_the_stated_size(yaw: float) -> None:
    """Tilts that noise hides have a wider region: two ellipsoids about a distribution that is not normal."""
    turn, rng = Rotation.from_euler("YXZ", [yaw, 5.0, 2.0], degrees=True), np.random.default_rng(7)
    spread = np.array([0.02, 0.02, 2e-3, 4e-3, 0.02, 2e-3, 2e-3])
    within = []
    for noise in rng.normal(size=(400, 7)):
        poses = poses_of(image_vector(turn) + spread * noise, np.diag(spread**2))
        squares = [error @ np.linalg.solve(p.covariance, error) for p in poses for error in [errors_of(p, turn)]]
        within.append(min(squares) < chdtri(6, 0.05))
    # 95 % and three standard deviations of the count
    assert np.mean(within) > 0.917
    if yaw == 30.0:
        assert np.mean(within) < 0.983


@pytest.mark.parametrize("focal_m", [0.035, 0.036])
def test_bench_counts_the_packets_whose_region_holds_the_truth(focal_m: float) -> None:
    """A focal length off by 3 % moves the stated position out of the region."""
    changes = ["channel.distance_m=45", "channel.arrays.0.yaw_deg=-25", f"receive.calibration.focal_m={focal_m}"]
    counts = run_block(load_settings("static", None, changes), 9)
    is_right = focal_m == 0.035
    assert (counts.posed, counts.covered_positions, counts.covered_poses) == (1, is_right, is_right)


@pytest.mark.slow
@pytest.mark.parametrize("speed_m_s", [6.94, -6.94])
def test_tilt_of_a_crossing_array_is_right(speed_m_s: float) -> None:
    """Half of the motion between a header and its inverse would look like a tilt of 2 to 5 degrees."""
    array = {"x_m": -speed_m_s / 2, "vx_m_s": speed_m_s, "yaw_deg": 20.0}
    counts = run_block(load_settings("crossing", {"channel": {"arrays": [array], "duration_s": 0.5}}), 9)
    assert counts.posed >= 3
    assert counts.covered_poses >= counts.posed - 1


def test_saturated_pixels_do_not_enlarge_an_array() -> None:
    """A low sun saturates the brightest pixels, which would bring the array 1 to 2 % closer."""
    settings = load_settings("static", {"channel": {"distance_m": 60.0, "weather": {"glare": 0.3}}})
    counts = run_block(settings, 9, max_packets=2)
    assert counts.covered_positions == counts.posed == 2
