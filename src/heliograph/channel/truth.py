"""Truth of a film for error counts; inaccessible to the receiver."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from heliograph.channel.exposure import Faults
from heliograph.channel.settings import ChannelSettings, SensorSettings


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """Pixel noise according to EMVA 1288."""

    sensor: SensorSettings

    def sigma(self, level: ArrayLike) -> NDArray[np.float64]:
        """Return the rms noise in full scales, clipping ignored."""
        s = self.sensor
        # EMVA 1288: sigma_y^2 = K^2 (sigma_d^2 + mu_e) + 1/12 DN^2
        electrons = np.asarray(level, float) * s.full_well_e
        return np.sqrt(s.gain_dn_per_e**2 * (s.dark_noise_e**2 + electrons) + 1 / 12) / s.full_scale


@dataclass(frozen=True, slots=True)
class ArrayTruth:
    """Truth of an array in a frame, at mid-exposure."""

    # Image of the centre in px, rightward
    x: float
    # Image of the centre in px, downward
    y: float
    # LED pitch in the image in px: square root of the area of a grid cell
    pitch_px: float
    # Direction of the LED rows in the image in rad, clockwise (from x towards y)
    roll_rad: float
    # (3, 3) float64: (right, down, 1) from the array centre in m -> (x, y, 1) Z in px, Z the depth in m
    homography: NDArray[np.float64]
    # Depth of the centre along the optical axis in m
    distance_m: float
    # True if the array faces the camera, with all LEDs on the sensor
    visible: bool
    # Numbers of the patterns during the exposure in temporal order
    patterns: tuple[int, ...]
    # (3,) position of the camera in the axes of the array in m, and (3, 3) change of the homography per s
    eye: NDArray[np.float64] = field(default_factory=lambda: np.zeros(3))
    drift: NDArray[np.float64] = field(default_factory=lambda: np.zeros((3, 3)))


@dataclass(frozen=True, slots=True)
class Truth:
    """Truth of a frame."""

    # Frame number from 0, dropped frames included
    index: int
    # True start of the exposure in s; the frame has the time of the camera clock
    time_s: float
    # Truth of each array, in the order of ``channel.arrays``
    arrays: tuple[ArrayTruth, ...]
    noise: NoiseModel
    # Light of the LEDs of each array
    faults: tuple[Faults, ...] = ()


@dataclass(frozen=True, slots=True)
class KnownChannel:
    """True channel of a film in simulation, without the data, for receivers that are bounds."""

    settings: ChannelSettings
    # Identity of each array
    identities: Sequence[int]
    # Returns the truth of the latest frame
    latest: Callable[[], Truth]
