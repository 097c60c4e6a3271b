"""The truth of a film. The receiver must not see it; the error counter compares with it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from heliograph.channel.settings import SensorSettings


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """Noise of a pixel by EMVA 1288.

    Attributes
    ----------
    sensor
        Settings of the sensor, of which full well, dark noise and bits are used.
    """

    sensor: SensorSettings

    def sigma(self, level: ArrayLike) -> NDArray[np.float64]:
        """Return the rms noise in full scales, with clipping left out.

        Parameters
        ----------
        level
            (...) mean light in full scales, of any shape, at least 0.
        """
        s = self.sensor
        # EMVA 1288: sigma_y^2 = K^2 (sigma_d^2 + mu_e) + 1/12 DN^2
        electrons = np.asarray(level, float) * s.full_well_e
        return np.sqrt(s.gain_dn_per_e**2 * (s.dark_noise_e**2 + electrons) + 1 / 12) / s.full_scale


@dataclass(frozen=True, slots=True)
class ArrayTruth:
    """One array in one frame, at the middle of the exposure.

    Attributes
    ----------
    x
        Image of its centre on the sensor in px, rightward.
    y
        Image of its centre on the sensor in px, downward.
    pitch_px
        Distance between LEDs in the image in px: the root of the area of a square of the LEDs' grid.
    roll_rad
        Direction of the LED rows in the image in rad, clockwise (from x towards y).
    homography
        (3, 3) float64: (right, down, 1) from the array's centre in m -> (x, y, 1) Z in px, Z the depth in m.
    distance_m
        Depth of its centre along the optical axis in m.
    visible
        Whether it lies ahead of the camera and faces it, with all LEDs on the sensor.
    patterns
        Numbers of the patterns shown within the exposure, in the order of time; empty where it shows none.
    """

    x: float
    y: float
    pitch_px: float
    roll_rad: float
    homography: NDArray[np.float64]
    distance_m: float
    visible: bool
    patterns: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Truth:
    """The truth of one frame.

    Attributes
    ----------
    index
        Number of the frame, from 0; dropped frames count.
    time_s
        True start of the exposure in s (the frame itself has the time of the camera's clock).
    arrays
        The truth of each array, in the order of ``channel.arrays``.
    noise
        Noise of the sensor at any light.
    """

    index: int
    time_s: float
    arrays: tuple[ArrayTruth, ...]
    noise: NoiseModel
