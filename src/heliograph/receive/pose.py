"""Where the array is in the image."""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

TILT_NOISE = 0.004
"""Tilt, as stretch and shear together, that is not told from none; without it noise would always add to the pitch."""


@dataclass(frozen=True, slots=True)
class Pose:
    """An affine map from LED numbers to image points, and the width of the blur.

    Of a tilted array's image the perspective within the array is left out: at 40 degrees and 25 m it moves the corners
    by 0.07 px, at 50 m by 0.02 px.

    Attributes
    ----------
    x, y
        Centre of the array on the sensor in px; an integer is a pixel's centre.
    pitch
        Distance of neighbouring LEDs in px; where the array is tilted, the mean of the longest and the shortest.
    roll
        Rotation in rad, clockwise in the image.
    blur
        Standard deviation in px of one LED's image, emitter and lens together.
    stretch, shear
        How much wider than high the array appears, before it is rotated: a point (a, b) of the array lies at
        pitch R(roll) [[1 + stretch, shear], [shear, 1 - stretch]] (a, b). By the polar decomposition that is any map.
    """

    x: float
    y: float
    pitch: float
    roll: float = 0.0
    blur: float = 0.6
    stretch: float = 0.0
    shear: float = 0.0

    def vector(self) -> NDArray[np.float64]:
        """(x, y, ln pitch, roll, ln blur)."""
        return self.full_vector()[:5]

    def full_vector(self) -> NDArray[np.float64]:
        """(x, y, ln pitch, roll, ln blur, stretch, shear)."""
        return np.array(
            [self.x, self.y, math.log(self.pitch), self.roll, math.log(self.blur), self.stretch, self.shear]
        )

    @staticmethod
    def of(vector: NDArray[np.float64]) -> "Pose":
        """The pose of a vector (x, y, ln pitch, roll, ln blur) or (..., stretch, shear)."""
        x, y, log_pitch, roll, log_blur, *tilt = vector.tolist()
        return Pose(x, y, math.exp(log_pitch), roll, math.exp(log_blur), *tilt)

    @staticmethod
    def between(a: "Pose", b: "Pose") -> "Pose":
        """The pose midway."""
        return Pose.of(0.5 * (a.full_vector() + b.full_vector()))

    @property
    def axes(self) -> NDArray[np.float64]:
        """From one LED to the next along a row and along a column, as columns (2, 2) in px."""
        c, s = math.cos(self.roll), math.sin(self.roll)
        form = np.array([[1 + self.stretch, self.shear], [self.shear, 1 - self.stretch]])
        return np.asarray(self.pitch * np.array([[c, -s], [s, c]]) @ form)

    @property
    def frontal_pitch(self) -> float:
        """The pitch that the array would have if it faced the camera: along the axis about which it is tilted."""
        tilt = math.hypot(self.stretch, self.shear)
        return self.pitch * (1 + math.sqrt(max(tilt**2 - TILT_NOISE**2, 0.0)))

    def leds(self, side: int) -> NDArray[np.float64]:
        """Image points (x, y) of all LEDs, (side, side, 2), row u from top to bottom, column v from left to right."""
        grid = np.arange(side) - (side - 1) / 2
        v, u = np.meshgrid(grid, grid)
        return np.asarray(np.stack([v, u], axis=-1) @ self.axes.T + np.array([self.x, self.y]))

    def moved(self, dx: float, dy: float) -> "Pose":
        """The same pose dx, dy px further."""
        return replace(self, x=self.x + dx, y=self.y + dy)
