"""Pose of an array in space from the tracked image, with covariance.

The image of a small square is affine, so two poses fit: tilted by an angle theta about an axis in the plane of the
array at the angle phi, or by -theta. Seen along the line of sight, the tilt g = tan(theta / 2) (cos phi, sin phi) gives
stretch + i shear = (g_1 + i g_2)^2, and the long axis keeps the pitch f p / Z.
"""

from functools import lru_cache
from typing import Any

import numpy as np
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from heliograph.base.arrays import TINY, Floats
from heliograph.receive.geometry.fit import Fit
from heliograph.receive.geometry.pose import pose_of_axes
from heliograph.receive.packet import SpatialPose
from heliograph.receive.settings import CalibrationSettings
from heliograph.receive.track.kalman import POSE_SIZE
from heliograph.receive.track.track import PARAMETERS, Track


def spatial_poses(time_s: float, fit: Fit, calibration: CalibrationSettings) -> tuple[SpatialPose, SpatialPose]:
    """Compute the two poses of an image on the sensor; both are equally probable."""
    focal_px, errors = calibration.focal_m / calibration.pixel_m, fit.covariance
    ray = np.append((fit.vector[:2] - calibration.centre_px) / focal_px, 1.0)
    forward = ray / np.linalg.norm(ray)
    # the rotation of the axis to the line of sight
    sight = Rotation.from_quat([-forward[1], forward[0], 0.0, 1 + forward[2]])
    # the image along the axis, B [I | -v] R_sight, of the image along the line of sight
    slant = (np.eye(2, 3) - np.outer(ray[:2], [0, 0, 1])) @ sight.as_matrix()[:, :2]
    pose = pose_of_axes((0.0, 0.0), np.linalg.solve(slant, fit.pose.axes), 1.0)
    squares, weights = _squared_tilts(np.array([pose.stretch, pose.shear]), errors[5:, 5:])
    middle = np.sqrt(complex(pose.stretch, pose.shear)) or 1.0
    tilts = middle * np.sqrt(squares / middle**2)
    # pinhole: f p / Z is the pitch of the long axis
    depths = focal_px * calibration.pitch_m / (pose.pitch * (1 + np.abs(tilts) ** 2))
    depth = float(weights @ depths)
    # slopes of translation and rotation over x, y, ln pitch and roll
    slopes = np.zeros((6, 4))
    slopes[:2, :2], slopes[:3, 2], slopes[3:, 3] = depth / focal_px * np.eye(2), -depth * ray, forward
    common = slopes @ errors[:4, :4] @ slopes.T

    upright = sight * Rotation.from_rotvec([0.0, 0.0, pose.roll])

    def solution(tilts: Any) -> SpatialPose:
        turns = upright * Rotation.from_quat(
            np.column_stack([tilts.real, tilts.imag, np.zeros(tilts.size), np.ones(tilts.size)])
        )
        mean = turns.mean(weights)
        apart = np.hstack([np.outer(depths - depth, ray), (turns * mean.inv()).as_rotvec()])
        covariance = apart.T @ (weights[:, None] * apart) + common
        return SpatialPose(time_s, depth * ray, mean.as_rotvec(), covariance)

    return solution(tilts), solution(-tilts)


def fit_with_all_errors(track: Track, packet_s: float) -> Fit:
    """Return the tracked pose and the tilt, with the errors of the model."""
    state, pose = track.state, track.state.pose
    covariance = block_diag(state.covariance[:POSE_SIZE, :POSE_SIZE], state.tilt_covariance)
    unequal = np.sqrt(max(1 - track.score**2 - PARAMETERS.equal_residual, 0.0))
    # resolved LEDs show the light of each
    resolution = pose.pitch * (1 + 0.36 * (pose.pitch / pose.blur) ** 2)
    position_px = np.hypot(PARAMETERS.position_error_px, PARAMETERS.position_error * unequal)
    errors = position_px, position_px, *(unequal / resolution * np.array(PARAMETERS.shape_errors))
    covariance += np.diag(errors) ** 2
    covariance[2, 2] += (PARAMETERS.uncertain_packets * packet_s) ** 2 * state.covariance[7, 7]
    return Fit(pose.full_vector(), covariance)


def _squared_tilts(mean: Floats, covariance: Floats) -> tuple[Any, Floats]:
    """Return values of stretch + i shear with weights, for tilts of any size and direction equally probable."""
    grid, weights = _normal_grid()
    spread = np.linalg.cholesky(covariance)
    x, y = mean[:, None] + spread @ grid
    squares = x + 1j * y
    # the density over g is 4 |g|^2 times that over g^2
    weights = weights / np.maximum(np.abs(squares), 0.05 * spread[0, 0] + TINY)
    return squares, weights / weights.sum()


@lru_cache(maxsize=1)
def _normal_grid() -> tuple[Floats, Floats]:
    """Return points (2, points) and weights of the Gauss-Hermite quadrature of two standard normal variables."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(8)
    return np.stack(np.meshgrid(nodes, nodes)).reshape(2, -1), np.outer(weights, weights).ravel()
