"""Views: frames reduced to a pyramid level if LEDs are large, and turned upright.

A level of a binomial pyramid makes a near array look like a far array: each level halves rows and columns after
smoothing by (1 4 6 4 1) / 16, of variance 1 px^2. A blur of variance s^2, in pixels of variance 1/12, becomes

    s'^2 + 1/12 = (s^2 + 1/12 + 1) / 4,

so the blur of 0.5 px of the reference link is the same on all levels. Pixel (2 x, 2 y) becomes (x, y).
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from math import ceil, exp, log, log2, sqrt

import cv2
import numpy as np

from heliograph.base.arrays import Floats
from heliograph.base.frames import Frame, Pixels
from heliograph.receive.geometry.fit import Fit
from heliograph.receive.geometry.pose import UPRIGHT, Orientation, Pose
from heliograph.receive.geometry.window import Window, window_around


@dataclass(frozen=True, slots=True)
class View:
    """Pyramid level and orientation in which an array is read."""

    # Level of the pyramid, at least 0: rows and columns are divided by 2**level
    level: int = 0
    # Orientation of the array in the camera image
    orientation: Orientation = UPRIGHT

    @staticmethod
    def of(pose: Pose, orientation: Orientation = UPRIGHT) -> "View":
        """Choose the view for an array."""
        # LEDs nearer than 2.5 m are at full scale, and further reduction mixes clipped light with other light
        return View(min(max(0, ceil(log2(pose.pitch / 3))), 3), orientation)

    def suits(self, pose: Pose) -> bool:
        """True if an array may stay in this view: to a tenth beyond the pitches at which another is chosen."""
        return (self.level == 3 or pose.pitch <= 3.3) and (self.level == 0 or pose.pitch >= 1.35)

    def frame(self, frame: Frame, pose: Pose, side: int) -> Frame:
        """Transform a frame to this view; except in the camera's view, crop it to an array and half a side around."""
        if self == CAMERA:
            return frame
        frame = _part(frame, window_around(pose, side, 0.5 * side * pose.pitch), 2**self.level)
        for _ in range(self.level):
            frame = halved(frame)
        return frame if self.orientation == UPRIGHT else _upright(frame, self.orientation)

    def pose_in(self, pose: Pose) -> Pose:
        """Transform a pose on the sensor to the view."""
        return pose if self == CAMERA else Pose.from_vector(self._map(pose.full_vector(), inverse=False))

    def pose_out(self, pose: Pose) -> Pose:
        """Transform a pose in the view to the sensor; the inverse of `pose_in`."""
        return pose if self == CAMERA else Pose.from_vector(self._map(pose.full_vector(), inverse=True))

    def map_motion(self, motion: tuple[float, float], inverse: bool = False) -> tuple[float, float]:
        """Transform a motion on the sensor to the view, or back."""
        x, y = _linear(self, inverse)[:2, :2] @ motion
        return float(x), float(y)

    def map_fit(self, fit: Fit, inverse: bool = False) -> Fit:
        """Transform a fit on the sensor to the view, or back."""
        if self == CAMERA:
            return fit
        linear = _linear(self, inverse)[: len(fit.vector), : len(fit.vector)]
        return replace(fit, vector=self._map(fit.vector, inverse), covariance=linear @ fit.covariance @ linear.T)

    def _map(self, pose: Floats, inverse: bool) -> Floats:
        """Map a pose vector, (5,) or (7,), from the sensor to the view, or back."""
        vector = _linear(self, inverse)[: len(pose), : len(pose)] @ pose
        vector[2] += (1 if inverse else -1) * self.level * log(2)
        vector[4] = log((_enlarged_blur if inverse else reduced_blur)(exp(pose[4]), self.level))
        return vector


CAMERA = View()


@lru_cache
def _linear(view: View, inverse: bool = False) -> Floats:
    """Linear part of the map of pose vectors to a view, or back, (7, 7)."""
    back = view.orientation.matrix.T
    out = np.eye(7)
    # LED -> sensor is c + A, LED -> view is M^T c + M^T A M: M^T R(w) M = R(det M w), M^T S M by elements
    out[:2, :2] = back / 2**view.level
    out[3, 3] = np.linalg.det(back)
    for column, form in ((5, np.diag([1.0, -1.0])), (6, np.array([[0.0, 1.0], [1.0, 0.0]]))):
        turned = back @ form @ back.T
        out[5, column], out[6, column] = turned[0, 0], turned[0, 1]
    return np.asarray(np.linalg.inv(out) if inverse else out)


def halved(frame: Frame) -> Frame:
    """Reduce a frame to the next level of the pyramid."""
    x, y = frame.origin
    pixels = frame.pixels[y % 2 :, x % 2 :]
    reduced: Pixels = cv2.pyrDown(np.ascontiguousarray(pixels))  # type: ignore[assignment]  # OpenCV keeps the dtype
    reduced.setflags(write=False)
    return replace(frame, pixels=reduced, origin=((x + 1) // 2, (y + 1) // 2))


def reduced_blur(blur: float, level: int) -> float:
    """Blur in px on a level, from the blur on the sensor."""
    # 1/12 is the variance of a pixel's width, (4^k - 1) / 3 of the smoothing
    return sqrt((blur**2 + 1 / 12 + (4**level - 1) / 3) / 4**level - 1 / 12)


def _enlarged_blur(blur: float, level: int) -> float:
    """Blur in px on the sensor, from the blur on a level; below 0.2 px it is the error of the fit."""
    return sqrt(max(4**level * (blur**2 + 1 / 12) - (4**level - 1) / 3 - 1 / 12, 0.2**2))


def _part(frame: Frame, window: Window, grid: int) -> Frame:
    """Crop a frame to a window that begins at a multiple of a grid and holds a grid pixel at least."""
    x0, y0, width, height = window
    (left, top), (rows, columns) = frame.origin, frame.pixels.shape
    x = min(max(x0 // grid * grid - left, 0), max(columns - 2 * grid, 0))
    y = min(max(y0 // grid * grid - top, 0), max(rows - 2 * grid, 0))
    x1, y1 = max(x0 + width - left, x + 2 * grid), max(y0 + height - top, y + 2 * grid)
    return replace(frame, pixels=frame.pixels[y:y1, x:x1], origin=(left + x, top + y))


def _upright(frame: Frame, orientation: Orientation) -> Frame:
    """Turn a frame upright about the position (0, 0) of the sensor."""
    rows, columns = frame.pixels.shape
    corners = np.array([[0, 0], [columns - 1, rows - 1]]) + frame.origin
    x, y = (corners @ orientation.matrix).min(0)  # M^T of each
    return replace(frame, pixels=orientation.upright(frame.pixels), origin=(int(x), int(y)))
