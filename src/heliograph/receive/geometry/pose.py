"""Pose of an array in the image, and the orientation in which the camera sees the array."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

Corner = tuple[int, int]  # position (x, y) on the sensor of the first pixel of an image

Shape = tuple[int, int]  # rows and columns of an image


@dataclass(frozen=True, slots=True)
class Orientation:
    """One of the eight orientations of a square."""

    # Quarter turns, clockwise in the image, 0 to 3
    turns: int = 0
    # True if left and right are exchanged before the turn
    mirrored: bool = False

    def __str__(self) -> str:
        """Name of the orientation in packets: "upright", "turned 90", "mirrored", "mirrored, turned 90" and so on."""
        turned = f"turned {90 * self.turns}" if self.turns else ""
        return ", ".join(filter(None, ("mirrored" if self.mirrored else "", turned))) or "upright"

    @property
    def matrix(self) -> NDArray[np.float64]:
        """Signed permutation (2, 2) that maps a vector (x, y) of the upright image to the turned image."""
        mirror = np.diag([-1.0 if self.mirrored else 1.0, 1.0])
        return np.asarray(np.linalg.matrix_power(np.array([[0.0, -1.0], [1.0, 0.0]]), self.turns) @ mirror)

    def turned(self, image: NDArray[Any]) -> NDArray[Any]:
        """Turn an upright image as the camera sees it."""
        return np.ascontiguousarray(np.rot90(image[:, ::-1] if self.mirrored else image, -self.turns))

    def upright(self, image: NDArray[Any]) -> NDArray[Any]:
        """Turn a camera image upright; the inverse of `turned`."""
        back = np.rot90(image, self.turns)
        return np.ascontiguousarray(back[:, ::-1] if self.mirrored else back)


UPRIGHT = Orientation()
ORIENTATIONS = tuple(Orientation(turns, mirrored) for mirrored in (False, True) for turns in range(4))


@dataclass(frozen=True, slots=True)
class Pose:
    """An affine map from LED numbers to image points, and the width of the blur.

    The pose neglects perspective within the array, which moves the corners by 0.07 px at 40 degrees of yaw and 25 m,
    and by 0.02 px at 50 m.

    Attributes
    ----------
    x
        Column of the array's centre on the sensor in px; an integer is a pixel's centre.
    y
        Row of the array's centre on the sensor in px.
    pitch
        Distance of neighbouring LEDs in px, above 0; of a tilted array the mean of the longest and the shortest.
    roll
        Rotation in rad, clockwise in the image.
    blur
        Standard deviation in px of an LED's image, emitter and lens together, above 0.
    stretch
        Relative excess of width over height before rotation; 0 for an array that faces the camera.
    shear
        Skew before rotation. A point (a, b) of the array lies at
        pitch R(roll) [[1 + stretch, shear], [shear, 1 - stretch]] (a, b), by the polar decomposition a general affine
        map.
    """

    x: float
    y: float
    pitch: float
    roll: float = 0.0
    blur: float = 0.6
    stretch: float = 0.0
    shear: float = 0.0

    def vector(self) -> NDArray[np.float64]:
        """Pose vector (x, y, ln pitch, roll, ln blur), (5,)."""
        return self.full_vector()[:5]

    def full_vector(self) -> NDArray[np.float64]:
        """Pose vector with the tilt, (x, y, ln pitch, roll, ln blur, stretch, shear), (7,)."""
        return np.array(
            [self.x, self.y, math.log(self.pitch), self.roll, math.log(self.blur), self.stretch, self.shear]
        )

    @staticmethod
    def from_vector(vector: NDArray[np.float64]) -> "Pose":
        """Make the pose of a vector; the inverse of `vector` and `full_vector`.

        Parameters
        ----------
        vector
            (5,) or (7,): x and y in px, ln pitch, roll in rad, ln blur, and stretch and shear, else 0.
        """
        x, y, log_pitch, roll, log_blur, *tilt = vector.tolist()
        return Pose(x, y, math.exp(log_pitch), roll, math.exp(log_blur), *tilt)

    @staticmethod
    def midway(a: "Pose", b: "Pose") -> "Pose":
        """Pose halfway from one to another.

        Parameters
        ----------
        a, b
            The two poses; pitch and blur are averaged as logarithms.
        """
        # scalars for speed: the mean of two logarithms is the logarithm of the geometric mean
        pitch, blur = math.sqrt(a.pitch * b.pitch), math.sqrt(a.blur * b.blur)
        x, y, roll = 0.5 * (a.x + b.x), 0.5 * (a.y + b.y), 0.5 * (a.roll + b.roll)
        return Pose(x, y, pitch, roll, blur, 0.5 * (a.stretch + b.stretch), 0.5 * (a.shear + b.shear))

    @property
    def axes(self) -> NDArray[np.float64]:
        """Steps between neighbouring LEDs, (2, 2) px: along a row in the first column, along a column in the second."""
        return np.array(self.steps)

    @property
    def steps(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Elements of `axes` as rows of numbers."""
        # p R(roll) ((1 + stretch, shear), (shear, 1 - stretch)), written out for speed
        c, s = self.pitch * math.cos(self.roll), self.pitch * math.sin(self.roll)
        wide, high, shear = 1 + self.stretch, 1 - self.stretch, self.shear
        return (c * wide - s * shear, c * shear - s * high), (s * wide + c * shear, s * shear + c * high)

    @property
    def frontal_pitch(self) -> float:
        """Pitch in px along the axis of the tilt: the pitch of the same array when it faces the camera."""
        # less the mean square of the tilt that noise gives a header's fit, which would always add to the pitch
        tilt = math.hypot(self.stretch, self.shear)
        return self.pitch * (1 + math.sqrt(max(tilt**2 - 0.004**2, 0.0)))

    def leds(self, side: int) -> NDArray[np.float64]:
        """Image points of all LEDs.

        Parameters
        ----------
        side
            LEDs in a row.

        Returns
        -------
        (side, side, 2) px as (x, y); row u from top to bottom, column v from left to right.
        """
        return np.asarray(_grid(side) @ self.axes.T + np.array([self.x, self.y]))

    def moved(self, dx: float, dy: float) -> "Pose":
        """Shift the array in the image.

        Parameters
        ----------
        dx, dy
            Shift in px, to the right and down.
        """
        return replace(self, x=self.x + dx, y=self.y + dy)


def pose_of(corners: Sequence[float], side: int, blur: float) -> Pose:
    """Compute the pose of an array from the corners, x and y of each."""
    points = np.asarray(corners, np.float64).reshape(4, 2)
    x, y = points.mean(axis=0).tolist()
    # clockwise in the image, the first corner between left and up
    upper_left, upper_right, lower_right, lower_left = points[
        np.argsort(np.arctan2(points[:, 1] - y, points[:, 0] - x))
    ]
    along = (upper_right - upper_left + lower_right - lower_left) / (2 * side)
    down = (lower_left - upper_left + lower_right - upper_right) / (2 * side)
    pose = pose_of_axes((x, y), np.stack([along, down], axis=1), blur)
    # with another corner first rows are columns, which turns a tilt's sign
    quarters = round(pose.roll / (np.pi / 2))
    sign = -1 if quarters % 2 else 1
    return replace(pose, roll=pose.roll - quarters * np.pi / 2, stretch=sign * pose.stretch, shear=sign * pose.shear)


def pose_of_axes(centre: tuple[float, float], axes: NDArray[np.float64], blur: float) -> Pose:
    """Compute the pose of an array from the centre and the steps between neighbouring LEDs, as in `Pose.axes`."""
    # A = R(roll) P, P = pitch ((1 + stretch, shear), (shear, 1 - stretch)): the polar decomposition
    u, sizes, vt = np.linalg.svd(axes)
    rotation, pitch = u @ vt, float(sizes.mean())
    form = vt.T @ np.diag(sizes / pitch) @ vt
    roll = float(np.arctan2(rotation[1, 0], rotation[0, 0]))
    return Pose(*centre, pitch, roll, blur, float(form[0, 0]) - 1, float(form[0, 1]))


def rim_distance(a: Pose, b: Pose, side: int) -> float:
    """Largest distance in px between the same outer LED in two poses."""
    return float(np.linalg.norm(a.leds(side) - b.leds(side), axis=-1).max())


@lru_cache(maxsize=8)  # arrays of one film have one size
def _grid(side: int) -> NDArray[np.float64]:
    """Columns and rows of LEDs from the centre, (side, side, 2), read-only."""
    steps = np.arange(side) - (side - 1) / 2
    grid = np.stack(np.meshgrid(steps, steps), axis=-1)
    grid.setflags(write=False)
    return grid
