"""The truth of a film: what the receiver must not see and the error counter compares with."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from heliograph.channel.settings import SensorSettings


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """Noise of a pixel by EMVA 1288, in shares of full scale."""

    sensor: SensorSettings

    def sigma(self, level: ArrayLike) -> NDArray[np.float64]:
        """Rms noise at mean levels, both as shares of full scale (clipping at 0 and 1 left out)."""
        s = self.sensor
        # EMVA 1288: sigma_y^2 = K^2 (sigma_d^2 + mu_e) + 1/12 DN^2
        electrons = np.asarray(level, float) * s.full_well_e
        return np.sqrt(s.gain_dn_per_e**2 * (s.dark_noise_e**2 + electrons) + 1 / 12) / s.full_scale


@dataclass(frozen=True, slots=True)
class ArrayTruth:
    """One array in one frame, at the middle of the exposure.

    Attributes
    ----------
    x, y
        Image of its centre on the sensor in px.
    pitch_px
        Distance between LEDs in the image (root of the area of an LED's cell).
    roll_rad
        Direction of the LED rows in the image, clockwise (from x towards y).
    homography
        (3, 3) float64: metres in the array's plane (right, down from its centre) -> px, up to the depth in m.
    distance_m
        Depth of its centre along the optical axis.
    visible
        All its LEDs lie on the sensor, before the camera and face it.
    patterns
        Numbers of the patterns shown within the exposure, in the order of time; empty where it was dark.
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
    """One frame.

    Attributes
    ----------
    index
        Number of the frame.
    time_s
        True time of the start of the exposure (the frame itself carries the camera's clock).
    arrays
        One record an array, in the order of the settings.
    noise
        The sensor's noise.
    """

    index: int
    time_s: float
    arrays: tuple[ArrayTruth, ...]
    noise: NoiseModel
