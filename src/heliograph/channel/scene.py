"""Pinhole geometry: vehicle pose and placement of an array -> homography.

Axes are right, down, forward, in the world (at rest, at time 0 with the camera at its origin) as in the camera.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from heliograph.channel.settings import CameraSettings, Placement

Floats = NDArray[np.float64]

TINY_M = 1e-9
"""Stands for a depth of 0, to divide by."""


@dataclass(frozen=True)
class Pose:
    """Where the camera is and looks, at any number of times; all arrays of one shape.

    Attributes
    ----------
    way_m, heave_m
        Distance driven along the road and height above rest.
    pitch_rad, yaw_rad, roll_rad
        Nose up, to the right, right side down.
    """

    way_m: Floats
    heave_m: Floats
    pitch_rad: Floats
    yaw_rad: Floats
    roll_rad: Floats


def rotation(pitch_rad: ArrayLike, yaw_rad: ArrayLike, roll_rad: ArrayLike) -> Floats:
    """R = R_y(yaw) R_x(pitch) R_z(roll), shape (..., 3, 3): turned axes as columns."""
    p, w, r = np.broadcast_arrays(*(np.asarray(a, float) for a in (pitch_rad, yaw_rad, roll_rad)))
    cp, sp, cw, sw, cr, sr = np.cos(p), np.sin(p), np.cos(w), np.sin(w), np.cos(r), np.sin(r)
    rows = (
        (cw * cr + sw * sp * sr, -cw * sr + sw * sp * cr, sw * cp),
        (cp * sr, cp * cr, -sp),
        (-sw * cr + cw * sp * sr, sw * sr + cw * sp * cr, cw * cp),
    )
    return np.stack([np.stack(row, -1) for row in rows], -2)


def homography(
    pose: Pose, times_s: Floats, placement: Placement, distance_m: float, camera: CameraSettings
) -> tuple[Floats, Floats]:
    """Map of an array's plane onto the sensor, and the camera seen from the array.

    Parameters
    ----------
    pose
        Of the camera at `times_s`, arrays of shape (...).

    Returns
    -------
    homography
        (..., 3, 3): (right, down, 1) in metres -> (x, y, 1) Z in px, Z the depth in metres.
    eye
        (..., 3): the camera in the array's axes (right, down, behind) in metres.
    """
    tilt = rotation(*np.radians((placement.pitch_deg, placement.yaw_deg, placement.roll_deg)))
    turn = rotation(pose.pitch_rad, pose.yaw_rad, pose.roll_rad)
    gap = _gap(pose, times_s, placement, distance_m)
    # X_camera = R^T (P + R_a (a, b, 0)^T - C); pixel = K X_camera
    columns = np.concatenate([np.broadcast_to(tilt[:, :2], (*gap.shape[:-1], 3, 2)), gap[..., None]], -1)
    lens = np.array(
        [[camera.focal_px, 0, (camera.width - 1) / 2], [0, camera.focal_px, (camera.height - 1) / 2], [0, 0, 1]]
    )
    return lens @ np.swapaxes(turn, -1, -2) @ columns, -gap @ tilt


def _gap(pose: Pose, times_s: Floats, placement: Placement, distance_m: float) -> Floats:
    """From the camera to the array's centre in the world's axes, (..., 3)."""
    x = placement.x_m + placement.vx_m_s * times_s
    y = placement.y_m + placement.vy_m_s * times_s + pose.heave_m
    z = distance_m + placement.z_offset_m + placement.vz_m_s * times_s - pose.way_m
    z = np.where(np.abs(z) < TINY_M, TINY_M, z)  # the camera in the array's plane
    return np.stack(np.broadcast_arrays(x, y, z), -1)


def project(homographies: Floats, points_m: Floats) -> tuple[Floats, Floats]:
    """Image (..., k, 2) in px and depth (..., k) in m of k points (k, 2) of the array's plane."""
    ones = np.ones((len(points_m), 1))
    image = np.hstack([points_m, ones]) @ np.swapaxes(homographies, -1, -2)
    depth = np.where(np.abs(image[..., 2]) < TINY_M, TINY_M, image[..., 2])
    return image[..., :2] / depth[..., None], depth


def centre_scale(homographies: Floats) -> Floats:
    """Jacobian (..., 2, 2) of the map at the array's centre in px/m."""
    depth = homographies[..., 2, 2, None, None]
    centre = homographies[..., :2, 2:] / depth
    return (homographies[..., :2, :2] - centre * homographies[..., 2:, :2]) / depth


def square(half_m: float) -> Floats:
    """Corners (4, 2) of a square about the array's centre."""
    return half_m * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
