"""Pinhole geometry: camera pose and array placement to homography.

The axes of world and camera are right, down, forward. The world origin is the camera at rest at time 0.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from heliograph.base.arrays import Floats
from heliograph.channel.settings import CameraSettings, Placement
from heliograph.channel.trajectory import Path

TINY_M = 1e-9  # minimum depth in m for divisions


Light = NDArray[np.float32]  # light of a window of the sensor in full scales, (rows, columns)

Corner = tuple[int, int]  # sensor position (x, y) of the first pixel of a window

Pair = tuple[float, float]  # values along x and y

Box = tuple[int, int, int, int]  # first x, first y, last x, last y of pixels


@dataclass(frozen=True)
class CameraPose:
    """Position and orientation of the camera at a number of times; all fields have equal shapes."""

    # Distance along the road since time 0 in m
    travelled_m: Floats
    # Height above rest in m
    heave_m: Floats
    # Rotation in rad, positive with the nose up
    pitch_rad: Floats
    # Rotation in rad, positive to the right
    yaw_rad: Floats
    # Rotation in rad, positive with the right side down
    roll_rad: Floats
    # Distance to the right of the start in m
    right_m: Floats


def rotation(pitch_rad: ArrayLike, yaw_rad: ArrayLike, roll_rad: ArrayLike) -> Floats:
    """Return the rotation R = R_y(yaw) R_x(pitch) R_z(roll)."""
    p, w, r = np.broadcast_arrays(*(np.asarray(a, float) for a in (pitch_rad, yaw_rad, roll_rad)))
    cp, sp, cw, sw, cr, sr = np.cos(p), np.sin(p), np.cos(w), np.sin(w), np.cos(r), np.sin(r)
    rows = (
        (cw * cr + sw * sp * sr, -cw * sr + sw * sp * cr, sw * cp),
        (cp * sr, cp * cr, -sp),
        (-sw * cr + cw * sp * sr, sw * sr + cw * sp * cr, cw * cp),
    )
    return np.stack([np.stack(row, -1) for row in rows], -2)


def homography(
    pose: CameraPose,
    times_s: Floats,
    placement: Placement,
    distance_m: float,
    camera: CameraSettings,
    path: Path | None = None,
) -> tuple[Floats, Floats]:
    """Return the homography of an array plane, and the camera position relative to the array."""
    tilt = rotation(*np.radians((placement.pitch_deg, placement.yaw_deg, placement.roll_deg)))
    turn = rotation(pose.pitch_rad, pose.yaw_rad, pose.roll_rad)
    # from camera to array centre in world axes, (..., 3) in m
    if path is None:
        x = placement.x_m + placement.vx_m_s * times_s
        y = placement.y_m + placement.vy_m_s * times_s
        z = distance_m + placement.z_offset_m + placement.vz_m_s * times_s
    else:  # the vehicle turns the array about its own origin
        *origin, yaw = np.moveaxis(path(times_s), -1, 0)
        heading = rotation(0.0, yaw, 0.0)
        mounted = heading @ np.array([placement.x_m, placement.y_m, placement.z_offset_m])
        x, y, z = (at + mounted[..., axis] for axis, at in enumerate(origin))
        tilt = heading @ tilt
    x, y, z = x - pose.right_m, y + pose.heave_m, z - pose.travelled_m
    z = np.where(np.abs(z) < TINY_M, TINY_M, z)  # camera in the plane of the array
    gap = np.stack(np.broadcast_arrays(x, y, z), -1)
    # X_camera = R^T (P + R_a (a, b, 0)^T - C); pixel = K X_camera; a, b in m right and down in the plane
    columns = np.concatenate([np.broadcast_to(tilt[..., :2], (*gap.shape[:-1], 3, 2)), gap[..., None]], -1)
    eye = -gap @ tilt if path is None else -(gap[..., None, :] @ tilt)[..., 0, :]
    return lens_matrix(camera) @ np.swapaxes(turn, -1, -2) @ columns, eye


def lens_matrix(camera: CameraSettings) -> Floats:
    """Return the matrix K of the pinhole camera, (3, 3)."""
    x, y = (camera.width - 1) / 2, (camera.height - 1) / 2
    return np.array([[camera.focal_px, 0, x], [0, camera.focal_px, y], [0, 0, 1]])


def project(homographies: Floats, points_m: Floats) -> tuple[Floats, Floats]:
    """Return images and depths of points in the array plane."""
    image = np.hstack([points_m, np.ones((len(points_m), 1))]) @ np.swapaxes(homographies, -1, -2)
    depth = np.where(np.abs(image[..., 2]) < TINY_M, TINY_M, image[..., 2])
    return image[..., :2] / depth[..., None], depth


def centre_scale(homographies: Floats) -> Floats:
    """Return the Jacobian of homographies at the array centre, (..., 2, 2) in px/m."""
    depth = homographies[..., 2, 2, None, None]
    centre = homographies[..., :2, 2:] / depth
    return (homographies[..., :2, :2] - centre * homographies[..., 2:, :2]) / depth


def square(half_m: float) -> Floats:
    """Return the corners of a square around the array centre, (4, 2) in m right and down."""
    return half_m * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
