"""Photometry: electrons in a pixel from the luminous intensity of LEDs, lens and sensor."""

import math
from typing import Annotated

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass

from heliograph.base.config import CONFIG, clear_errors
from heliograph.channel.settings import ChannelSettings

PLANCK_J_S, LIGHT_M_S = 6.62607015e-34, 299_792_458.0
"""Planck constant and speed of light (SI)."""

VISIBILITY = (
    0.000396, 0.00121, 0.0040, 0.0116, 0.023, 0.038, 0.060, 0.09098, 0.13902, 0.20802, 0.323, 0.503, 0.710, 0.862,
    0.954, 0.99495, 0.995, 0.952, 0.870, 0.757, 0.631, 0.503, 0.381, 0.265, 0.175, 0.107, 0.061, 0.032, 0.017, 0.00821,
    0.004102,
)  # fmt: skip
"""Spectral luminous efficiency V of the photopic observer (CIE 1924), 400 to 700 nm in steps of 10 nm."""


@clear_errors
@dataclass(frozen=True, kw_only=True, config=CONFIG)
class LightSettings:
    """Light settings of LEDs, lens and sensor.

    Attributes
    ----------
    candela
        On-axis luminous intensity of an LED in cd, 1e-6 to 1e6; by default, the intensity that gives
        ``channel.emitter.all_on``.
    f_number
        Focal length over aperture diameter, 0.5 to 128.
    efficiency
        Electrons per photon at the lens: lens transmission times quantum efficiency, above 0 to 1.
    wavelength_nm
        Wavelength in nm, 400 to 700; 625 for a red traffic light.
    """

    candela: Annotated[float, Field(ge=1e-6, le=1e6)] | None = None
    f_number: Annotated[float, Field(ge=0.5, le=128)] = 11.0
    efficiency: Annotated[float, Field(gt=0, le=1)] = 0.4
    wavelength_nm: Annotated[float, Field(ge=400, le=700)] = 625.0

    @property
    def photons_per_lumen_second(self) -> float:
        """Photons per lumen second."""
        visibility = np.exp(np.interp(self.wavelength_nm, np.arange(400, 701, 10), np.log(VISIBILITY)))
        # lambda / (h c) photons per joule, and 683 V(lambda) lm per watt
        return float(self.wavelength_nm * 1e-9 / (PLANCK_J_S * LIGHT_M_S) / (683.0 * visibility))

    def electrons(self, channel: ChannelSettings, candela: float) -> float:
        """Return the electrons per pixel for an unresolved array with all LEDs on, each of an intensity in cd.

        The value is independent of distance and focal length: the light of an LED and the area of the image both fall
        with the square of the distance.
        """
        camera = channel.camera
        # I (pi / 4) (f / N)^2 / Z^2 tau photons per LED; the LED image covers (f p / (Z pixel))^2 pixels
        lumen_s = candela * math.pi / 4 / self.f_number**2 * camera.exposure_s
        return (
            self.efficiency * self.photons_per_lumen_second * lumen_s * (camera.pixel_m / channel.emitter.pitch_m) ** 2
        )

    def all_on(self, channel: ChannelSettings) -> float:
        """Return the light of an unresolved array in full scales, from `candela` or the channel settings."""
        if self.candela is None:
            return channel.emitter.all_on
        return self.electrons(channel, self.candela) / channel.sensor.full_well_e

    def candela_of(self, channel: ChannelSettings) -> float:
        """Return the LED intensity in cd: `candela`, or the intensity for the light in the settings."""
        if self.candela is not None:
            return self.candela
        return channel.emitter.all_on * channel.sensor.full_well_e / self.electrons(channel, 1.0)

    def lens_blur_px(self, channel: ChannelSettings, distance_m: float) -> float:
        """Return the minimum blur in px (standard deviation) at this f-number, with the lens focused at infinity."""
        camera = channel.camera
        # 0.42 N lambda: standard deviation of the Gaussian nearest to the Airy pattern
        diffraction = 0.42 * self.wavelength_nm * 1e-9 * self.f_number
        # a disc of diameter f^2 / (N Z) has a quarter of the diameter as standard deviation along an axis
        defocus = camera.focal_m**2 / (self.f_number * distance_m) / 4
        return math.hypot(diffraction, defocus) / camera.pixel_m
