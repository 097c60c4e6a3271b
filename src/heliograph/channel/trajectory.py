"""Trajectories of vehicles: cubic splines through points, from the axes of the file to the axes of the scene."""

from collections.abc import Callable

import numpy as np
from scipy.interpolate import CubicSpline

from heliograph.base.arrays import Floats
from heliograph.channel.settings import ChannelSettings, Points

Path = Callable[[Floats], Floats]  # times (...) in s -> (..., 4): right, down, forward in m, yaw in rad to the right


def camera_path(settings: ChannelSettings) -> CubicSpline | None:
    """Return the trajectory of the camera in the axes of the camera at time 0; None without."""
    return _spline(settings.trajectory, _start(settings)) if settings.trajectory else None


def array_paths(settings: ChannelSettings) -> list[CubicSpline | None]:
    """Return the trajectory of each array in the axes of the camera at time 0; None for an array without."""
    start = _start(settings)
    return [_spline(place.trajectory, start) if place.trajectory else None for place in settings.arrays]


def _start(settings: ChannelSettings) -> Floats:
    """Return the camera at time 0 in the axes of the file: x, y, z in m, yaw in rad."""
    if not settings.trajectory:
        return np.zeros(4)
    right, down, forward, yaw = _spline(settings.trajectory, np.zeros(4))(0.0)
    return np.array([forward, -right, -down, -yaw])


def _spline(points: Points, start: Floats) -> CubicSpline:
    """Return a trajectory relative to a start; position and velocity are continuous."""
    time_s, x, y, z, yaw_deg = np.array(points, float).T
    x, y, z, yaw = x - start[0], y - start[1], z - start[2], np.unwrap(np.radians(yaw_deg)) - start[3]
    c, s = np.cos(start[3]), np.sin(start[3])
    # axes of the file: forward, left, up, yaw to the left (ISO 8855)
    return CubicSpline(time_s, np.stack([s * x - c * y, -z, c * x + s * y, -yaw], -1))
