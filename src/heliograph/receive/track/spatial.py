"""Pose of an array in space from the tracked image, with covariance.

The image of a small square is affine, so two poses fit: tilted by an angle theta about an axis in the plane of the
array at the angle phi, or by -theta. Seen along the line of sight, the tilt g = tan(theta / 2) (cos phi, sin phi) gives
stretch + i shear = (g_1 + i g_2)^2, and the long axis keeps the pitch f p / Z.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from heliograph.base.arrays import TINY, Floats
from heliograph.receive.geometry.fit import Fit
from heliograph.receive.geometry.pose import pose_of_axes
from heliograph.receive.geometry.view import View
from heliograph.receive.packet import SpatialPose
from heliograph.receive.settings import CalibrationSettings
from heliograph.receive.track.kalman import POSE_SIZE
from heliograph.receive.track.track import Track


@dataclass(frozen=True)
class ModelErrors:
    """Errors of the tracked pose beyond the noise of pixels, from simulations at other seeds than those of tests."""

    # Response time of the tracked size in packets, as the headers show the size once a packet, and uncertain part
    response_packets: float = 0.85
    uncertain_packets: float = 0.45
    # Part of 1 - correlation^2 of the sums that equal LEDs leave
    residual: float = 6e-4
    # Errors of x and y in px, by perspective and by combined frames
    position_px: float = 0.02
    # Errors of x and y in px, and of ln pitch, roll, stretch and shear, relative to the light of unequal LEDs
    position: float = 0.2
    shape: tuple[float, ...] = (0.03, 0.06, 0.0, 0.025, 0.025)

    def fit(self, track: Track, packet_s: float) -> Fit:
        """Return the tracked pose and the tilt with all errors."""
        state, pose = track.state, track.state.pose
        covariance = block_diag(state.covariance[:POSE_SIZE, :POSE_SIZE], state.tilt_covariance)
        unequal = np.sqrt(max(1 - track.score**2 - self.residual, 0.0))
        # resolved LEDs show the light of each
        shape = unequal / (pose.pitch * (1 + 0.36 * (pose.pitch / pose.blur) ** 2)) * np.array(self.shape)
        covariance += np.diag(np.append(np.full(2, np.hypot(self.position_px, self.position * unequal)), shape) ** 2)
        covariance[2, 2] += (self.uncertain_packets * packet_s) ** 2 * state.covariance[7, 7]
        vector = pose.full_vector()
        # at a constant speed v the rate r = v / Z of ln pitch rises by r^2 per second
        vector[2] += 0.5 * (self.response_packets * packet_s * state.mean[7]) ** 2
        return Fit(vector, covariance)


MODEL_ERRORS = ModelErrors()


def spatial_poses(
    track: Track, view: View, packet_s: float, calibration: CalibrationSettings
) -> tuple[SpatialPose, SpatialPose]:
    """Compute the two poses of a tracked array; both are equally probable."""
    fit = view.map_fit(MODEL_ERRORS.fit(track, packet_s), inverse=True)
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

    def solution(tilts: Any) -> SpatialPose:
        turns = Rotation.from_quat(np.stack([tilts.real, tilts.imag, 0 * tilts.real, 0 * tilts.real + 1], axis=-1))
        turns = sight * Rotation.from_rotvec([0.0, 0.0, pose.roll]) * turns
        mean = turns.mean(weights)
        apart = np.hstack([np.outer(depths - depth, ray), (turns * mean.inv()).as_rotvec()])
        return SpatialPose(
            track.state.time_s, depth * ray, mean.as_rotvec(), apart.T @ (weights[:, None] * apart) + common
        )

    return solution(tilts), solution(-tilts)


def _squared_tilts(mean: Floats, covariance: Floats) -> tuple[Any, Floats]:
    """Return values of stretch + i shear with weights, for tilts of any size and direction equally probable."""
    nodes, weights = np.polynomial.hermite_e.hermegauss(8)
    spread = np.linalg.cholesky(covariance)
    x, y = mean[:, None] + spread @ np.stack(np.meshgrid(nodes, nodes)).reshape(2, -1)
    squares = x + 1j * y
    # the density over g is 4 |g|^2 times that over g^2
    weights = np.outer(weights, weights).ravel() / np.maximum(np.abs(squares), 0.05 * spread[0, 0] + TINY)
    return squares, weights / weights.sum()
