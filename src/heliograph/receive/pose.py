"""Where the array is in the image."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Pose:
    """A similarity from LED numbers to image points, and the width of the blur.

    Attributes
    ----------
    x, y
        Centre of the array on the sensor in px; an integer is a pixel's centre.
    pitch
        Distance of neighbouring LEDs in px.
    roll
        Rotation in rad, clockwise in the image.
    blur
        Standard deviation in px of one LED's image, emitter and lens together.
    """

    x: float
    y: float
    pitch: float
    roll: float = 0.0
    blur: float = 0.6

    def vector(self) -> NDArray[np.float64]:
        """(x, y, ln pitch, roll, ln blur)."""
        return np.array([self.x, self.y, np.log(self.pitch), self.roll, np.log(self.blur)])

    @staticmethod
    def of(vector: NDArray[np.float64]) -> "Pose":
        """The pose of a vector (x, y, ln pitch, roll, ln blur)."""
        x, y, log_pitch, roll, log_blur = (float(v) for v in vector[:5])
        return Pose(x, y, float(np.exp(log_pitch)), roll, float(np.exp(log_blur)))

    def leds(self, side: int) -> NDArray[np.float64]:
        """Image points (x, y) of all LEDs, (side, side, 2), row u from top to bottom, column v from left to right."""
        grid = (np.arange(side) - (side - 1) / 2) * self.pitch
        v, u = np.meshgrid(grid, grid)
        c, s = np.cos(self.roll), np.sin(self.roll)
        return np.stack([self.x + c * v - s * u, self.y + s * v + c * u], axis=-1)

    def moved(self, dx: float, dy: float) -> "Pose":
        """The same pose dx, dy px further."""
        return Pose(self.x + dx, self.y + dy, self.pitch, self.roll, self.blur)
