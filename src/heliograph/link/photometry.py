"""From candela to electrons: what an LED's light makes of a pixel, by lens and sensor."""

import math
from typing import Annotated

import numpy as np
from pydantic import Field
from pydantic.dataclasses import dataclass

from heliograph.base.config import CONFIG, clear_errors
from heliograph.channel.settings import ChannelSettings

PLANCK_J_S, LIGHT_M_S = 6.62607015e-34, 299_792_458.0
"""Planck's constant and the speed of light, by the definition of the SI."""

LUMENS_PER_WATT = 683.0
"""Luminous efficacy of light of 540 THz, by the definition of the candela."""

VISIBILITY = (
    0.000396, 0.00121, 0.0040, 0.0116, 0.023, 0.038, 0.060, 0.09098, 0.13902, 0.20802, 0.323, 0.503, 0.710, 0.862,
    0.954, 0.99495, 0.995, 0.952, 0.870, 0.757, 0.631, 0.503, 0.381, 0.265, 0.175, 0.107, 0.061, 0.032, 0.017, 0.00821,
    0.004102,
)  # fmt: skip
"""Spectral luminous efficiency V of the CIE's photopic observer (1924), 400 to 700 nm in steps of 10 nm."""

AIRY_SIGMA = 0.42
"""Standard deviation of the Gaussian nearest to a lens's diffraction image, in wavelengths times f-number."""


@clear_errors
@dataclass(frozen=True, kw_only=True, config=CONFIG)
class LightSettings:
    """LEDs, lens and sensor as far as they decide how many electrons a frame has.

    Attributes
    ----------
    candela
        Luminous intensity of an LED on its axis in cd, 1e-6 to 1e6; left out: what ``channel.emitter.all_on`` stands
        for.
    f_number
        Focal length over the diameter of the lens's opening, 0.5 to 128.
    efficiency
        Electrons per photon before the lens: its transmission times the sensor's quantum efficiency, above 0 to 1.
    wavelength_nm
        Wavelength of the light in nm, 400 to 700; 625 is a red traffic light's.
    """

    candela: Annotated[float, Field(ge=1e-6, le=1e6)] | None = None
    f_number: Annotated[float, Field(ge=0.5, le=128)] = 11.0
    efficiency: Annotated[float, Field(gt=0, le=1)] = 0.4
    wavelength_nm: Annotated[float, Field(ge=400, le=700)] = 625.0

    @property
    def photons_per_lumen_second(self) -> float:
        """Photons of a lumen in a second."""
        visibility = np.exp(np.interp(self.wavelength_nm, np.arange(400, 701, 10), np.log(VISIBILITY)))
        # lambda / (h c) photons a joule, and 683 V(lambda) lm a watt
        return float(self.wavelength_nm * 1e-9 / (PLANCK_J_S * LIGHT_M_S) / (LUMENS_PER_WATT * visibility))

    def electrons(self, channel: ChannelSettings, candela: float) -> float:
        """Return the electrons a pixel gets of an array whose LEDs are all on, too far away to be resolved.

        It is the same at any distance and focal length: an LED's light falls with the square of the distance, and so
        does its image.

        Parameters
        ----------
        channel
            The channel, of which exposure, pixel and pitch of the LEDs are used.
        candela
            Luminous intensity of an LED on its axis in cd.
        """
        camera = channel.camera
        # I (pi / 4) (f / N)^2 / Z^2 tau photons an LED, whose image covers (f p / (Z pixel))^2 pixels
        lumen_s = candela * math.pi / 4 / self.f_number**2 * camera.exposure_s
        return (
            self.efficiency * self.photons_per_lumen_second * lumen_s * (camera.pixel_m / channel.emitter.pitch_m) ** 2
        )

    def all_on(self, channel: ChannelSettings) -> float:
        """Return the light of such an array in full scales: by `candela`, or that of the channel's settings.

        Parameters
        ----------
        channel
            The channel: camera, emitter and sensor are used.
        """
        if self.candela is None:
            return channel.emitter.all_on
        return self.electrons(channel, self.candela) / channel.sensor.full_well_e

    def candela_of(self, channel: ChannelSettings) -> float:
        """Return the intensity of an LED in cd that gives the array's light: `candela`, or that of the settings.

        Parameters
        ----------
        channel
            The channel: camera, emitter and sensor are used.
        """
        if self.candela is not None:
            return self.candela
        return channel.emitter.all_on * channel.sensor.full_well_e / self.electrons(channel, 1.0)

    def lens_blur_px(self, channel: ChannelSettings, distance_m: float) -> float:
        """Return the blur that no lens of this f-number goes below, as a standard deviation in px.

        Parameters
        ----------
        channel
            The channel, of which focal length and pixel are used.
        distance_m
            Distance of the array in m; the lens is focused at infinity.
        """
        camera = channel.camera
        diffraction = AIRY_SIGMA * self.wavelength_nm * 1e-9 * self.f_number
        # a disc of diameter f^2 / (N Z) has a quarter of it along an axis
        defocus = camera.focal_m**2 / (self.f_number * distance_m) / 4
        return math.hypot(diffraction, defocus) / camera.pixel_m
