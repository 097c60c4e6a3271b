"""The truth of a film. The receiver must not see it; the error counter compares with it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from heliograph.channel.settings import SensorSettings


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """Noise of a pixel by EMVA 1288."""

    # Settings of the sensor, of which full well, dark noise and bits are used
    sensor: SensorSettings

    def sigma(self, level: ArrayLike) -> NDArray[np.float64]:
        """Return the rms noise in full scales, with clipping left out."""
        s = self.sensor
        # EMVA 1288: sigma_y^2 = K^2 (sigma_d^2 + mu_e) + 1/12 DN^2
        electrons = np.asarray(level, float) * s.full_well_e
        return np.sqrt(s.gain_dn_per_e**2 * (s.dark_noise_e**2 + electrons) + 1 / 12) / s.full_scale


@dataclass(frozen=True, slots=True)
class ArrayTruth:
    """One array in one frame, at the middle of the exposure."""

    # Image of its centre on the sensor in px, rightward
    x: float
    # Image of its centre on the sensor in px, downward
    y: float
    # Distance between LEDs in the image in px: the root of the area of a square of the LEDs' grid
    pitch_px: float
    # Direction of the LED rows in the image in rad, clockwise (from x towards y)
    roll_rad: float
    # (3, 3) float64: (right, down, 1) from the array's centre in m -> (x, y, 1) Z in px, Z the depth in m
    homography: NDArray[np.float64]
    # Depth of its centre along the optical axis in m
    distance_m: float
    # Whether it lies ahead of the camera and faces it, with all LEDs on the sensor
    visible: bool
    # Numbers of the patterns shown within the exposure, in the order of time; empty where it shows none
    patterns: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Truth:
    """The truth of one frame."""

    # Number of the frame, from 0; dropped frames count
    index: int
    # True start of the exposure in s (the frame itself has the time of the camera's clock)
    time_s: float
    # The truth of each array, in the order of ``channel.arrays``
    arrays: tuple[ArrayTruth, ...]
    # Noise of the sensor at any light
    noise: NoiseModel
