"""The frames as an array's receiver sees them: reduced where LEDs are large, and turned upright.

A near array shows more than it takes to read it. It is read on a level of a binomial pyramid, on which it looks like a
farther one: each level halves rows and columns after smoothing by (1 4 6 4 1) / 16, of the variance 1 px^2. A blur of
the variance s^2, seen through pixels of the variance 1/12, becomes

    s'^2 + 1/12 = (s^2 + 1/12 + 1) / 4,

so that a blur of 0.5 px stays one of 0.5 px on all levels: exactly that of the reference link. The pixel (2 x, 2 y)
becomes (x, y), so that places are halved.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from math import exp, log, log2, sqrt

import cv2
import numpy as np

from heliograph.base.arrays import Floats
from heliograph.base.frames import Frame, Pixels
from heliograph.receive.geometry.fit import Fit
from heliograph.receive.geometry.pose import UPRIGHT, Orientation, Pose
from heliograph.receive.geometry.window import Window, window_around

READ_PITCH_PX = 3.0
"""Largest pitch in px that an array has on its level when it is found.

Half of it, the smallest, is that of 39 m in the reference link, up to which the plain receiver reads without an error.
"""

MOST_LEVEL = 3
"""Coarsest level on which arrays are read.

LEDs of arrays nearer than 2.5 m are at full scale, and reducing mixes what is cut off with what is not. On level 4 the
plain receiver lost half of the codewords of an array of 500 px, on level 3 none.
"""

KEPT_PITCH_PX = (1.35, 3.3)
"""Pitches in px between which an array's level is kept: a tenth beyond those at which it would be chosen anew."""

PIXEL_VARIANCE_PX2 = 1 / 12
"""Variance of a pixel's own width in squared px: that of an even light over it."""

SURROUNDINGS_SIDES = 0.5
"""Sides of an array about it that are reduced or turned with it: as far as frames are combined (`clocked_pairing`)."""

LEAST_BLUR_PX = 0.2
"""Least blur of a reduced image undone, in px: what is below is noise, as an array is found to some percent of blur."""


@dataclass(frozen=True, slots=True)
class View:
    """Where an array's receiver looks."""

    # Level of the pyramid, at least 0: rows and columns are fewer by 2**level
    level: int = 0
    # How the camera sees the array
    orientation: Orientation = UPRIGHT

    @staticmethod
    def of(pose: Pose, orientation: Orientation = UPRIGHT) -> "View":
        """The view in which an array is read."""
        return View(min(max(0, int(np.ceil(log2(pose.pitch / READ_PITCH_PX)))), MOST_LEVEL), orientation)

    def suits(self, pose: Pose) -> bool:
        """Whether an array is still to be read in this view."""
        least, most = KEPT_PITCH_PX
        return (self.level == MOST_LEVEL or pose.pitch <= most) and (self.level == 0 or pose.pitch >= least)

    def frame(self, frame: Frame, pose: Pose, side: int) -> Frame:
        """A frame in this view; where the view is another than the camera's, its part about an array."""
        if self == CAMERA:
            return frame
        frame = _part(frame, window_around(pose, side, SURROUNDINGS_SIDES * side * pose.pitch), 2**self.level)
        for _ in range(self.level):
            frame = halved(frame)
        return frame if self.orientation == UPRIGHT else _upright(frame, self.orientation)

    def fit_in(self, fit: Fit) -> Fit:
        """A fit on the sensor, as it is in the view."""
        if self == CAMERA:
            return fit
        moved = _linear(self)[: len(fit.vector), : len(fit.vector)]
        return replace(fit, vector=self._vector_in(fit.vector), covariance=moved @ fit.covariance @ moved.T)

    def fit_out(self, fit: Fit) -> Fit:
        """A fit in the view, as it is on the sensor; the inverse of `fit_in`."""
        if self == CAMERA:
            return fit
        moved = _linear(self, inverse=True)[: len(fit.vector), : len(fit.vector)]
        return replace(fit, vector=self._vector_out(fit.vector), covariance=moved @ fit.covariance @ moved.T)

    def pose_in(self, pose: Pose) -> Pose:
        """A pose on the sensor, as it is in the view."""
        return pose if self == CAMERA else Pose.from_vector(self._vector_in(pose.full_vector()))

    def pose_out(self, pose: Pose) -> Pose:
        """A pose in the view, as it is on the sensor; the inverse of `pose_in`."""
        return pose if self == CAMERA else Pose.from_vector(self._vector_out(pose.full_vector()))

    def motion_in(self, motion: tuple[float, float]) -> tuple[float, float]:
        """A motion on the sensor, as it is in the view."""
        x, y = _linear(self)[:2, :2] @ motion
        return float(x), float(y)

    def motion_out(self, motion: tuple[float, float]) -> tuple[float, float]:
        """A motion in the view, as it is on the sensor; the inverse of `motion_in`."""
        x, y = _linear(self, inverse=True)[:2, :2] @ motion
        return float(x), float(y)

    def _vector_in(self, pose: Floats) -> Floats:
        """A pose vector on the sensor, (5,) or (7,), as it is in the view."""
        vector = _linear(self)[: len(pose), : len(pose)] @ pose
        vector[2] -= self.level * log(2)
        vector[4] = log(reduced_blur(exp(pose[4]), self.level))
        return vector

    def _vector_out(self, pose: Floats) -> Floats:
        """A pose vector in the view, (5,) or (7,), as it is on the sensor."""
        vector = _linear(self, inverse=True)[: len(pose), : len(pose)] @ pose
        vector[2] += self.level * log(2)
        vector[4] = log(_enlarged_blur(exp(pose[4]), self.level))
        return vector


CAMERA = View()
"""The camera's own: frames as they are."""


@lru_cache  # there are few views
def _linear(view: View, inverse: bool = False) -> Floats:
    """Linear part of the map of pose vectors into a view, or back, (7, 7)."""
    back = view.orientation.matrix.T
    out = np.eye(7)
    # LED -> sensor is c + A, in the view it is M^T c + M^T A M: M^T R(w) M = R(det M w), M^T S M by its entries
    out[:2, :2] = back / 2**view.level
    out[3, 3] = np.linalg.det(back)
    for column, form in ((5, np.diag([1.0, -1.0])), (6, np.array([[0.0, 1.0], [1.0, 0.0]]))):
        turned = back @ form @ back.T
        out[5, column], out[6, column] = turned[0, 0], turned[0, 1]
    return np.asarray(np.linalg.inv(out) if inverse else out)


def halved(frame: Frame) -> Frame:
    """A frame on the next level of the pyramid."""
    x, y = frame.origin
    pixels = frame.pixels[y % 2 :, x % 2 :]
    reduced: Pixels = cv2.pyrDown(np.ascontiguousarray(pixels))  # type: ignore[assignment]
    return replace(frame, pixels=reduced, origin=((x + 1) // 2, (y + 1) // 2))


def reduced_blur(blur: float, level: int) -> float:
    """Blur in px of a level."""
    added = (4**level - 1) / 3
    return sqrt((blur**2 + PIXEL_VARIANCE_PX2 + added) / 4**level - PIXEL_VARIANCE_PX2)


def _enlarged_blur(blur: float, level: int) -> float:
    """Blur on the sensor in px, of that on a level."""
    added = (4**level - 1) / 3
    return sqrt(max(4**level * (blur**2 + PIXEL_VARIANCE_PX2) - added - PIXEL_VARIANCE_PX2, LEAST_BLUR_PX**2))


def _part(frame: Frame, window: Window, grid: int) -> Frame:
    """The part of a frame in a window, from a multiple of a grid on; at least a pixel of the grid."""
    x0, y0, width, height = window
    (left, top), (rows, columns) = frame.origin, frame.pixels.shape
    x = min(max(x0 // grid * grid - left, 0), max(columns - 2 * grid, 0))
    y = min(max(y0 // grid * grid - top, 0), max(rows - 2 * grid, 0))
    x1, y1 = max(x0 + width - left, x + 2 * grid), max(y0 + height - top, y + 2 * grid)
    return replace(frame, pixels=frame.pixels[y:y1, x:x1], origin=(left + x, top + y))


def _upright(frame: Frame, orientation: Orientation) -> Frame:
    """A frame turned about the place (0, 0) of the sensor."""
    rows, columns = frame.pixels.shape
    corners = np.array([[0, 0], [columns - 1, rows - 1]]) + frame.origin
    x, y = (corners @ orientation.matrix).min(0)  # M^T of each
    return replace(frame, pixels=orientation.upright(frame.pixels), origin=(int(x), int(y)))
