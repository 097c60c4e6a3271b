"""Photometry against textbook values, and electron counts derived from the solid angle."""

import math
from dataclasses import replace

import pytest

from heliograph.channel.settings import CameraSettings, ChannelSettings
from heliograph.link.photometry import LightSettings


@pytest.mark.parametrize(("wavelength_nm", "photons"), [(555, 4.09e15), (625, 1.435e16), (500, 1.141e16)])
def test_photons_of_a_lumen(wavelength_nm: float, photons: float) -> None:
    """683 V(lambda) lm/W and h c / lambda, with CIE V = 1.000, 0.321 and 0.323."""
    light = LightSettings(wavelength_nm=wavelength_nm)
    assert light.photons_per_lumen_second == pytest.approx(photons, rel=0.012)


@pytest.mark.parametrize("distance_m", [20.0, 150.0])
@pytest.mark.parametrize("focal_m", [0.016, 0.05])
def test_electrons_are_those_of_the_solid_angle(distance_m: float, focal_m: float) -> None:
    channel = ChannelSettings(camera=CameraSettings(focal_m=focal_m, exposure_s=4e-4))
    light = LightSettings(f_number=4.0, efficiency=0.5)
    opening_m2 = math.pi * (focal_m / 4.0) ** 2 / 4
    lumens = 2.0 * opening_m2 / distance_m**2
    of_led = 0.5 * lumens * 4e-4 * light.photons_per_lumen_second
    pitch_px = focal_m * channel.emitter.pitch_m / distance_m / channel.camera.pixel_m
    assert light.electrons(channel, 2.0) == pytest.approx(of_led / pitch_px**2)


def test_intensity_and_light_are_inverse() -> None:
    channel = ChannelSettings()
    meant = LightSettings().candela_of(channel)
    assert 0.5 < meant < 2
    assert replace(LightSettings(), candela=meant).all_on(channel) == pytest.approx(channel.emitter.all_on)
    assert LightSettings(candela=3.0).candela_of(channel) == 3.0


def test_the_lens_blurs_by_diffraction_and_focus() -> None:
    channel = ChannelSettings()
    wide, narrow = (LightSettings(f_number=number).lens_blur_px(channel, 1e4) for number in (2.0, 22.0))
    assert narrow == pytest.approx(11 * wide, rel=1e-3)
    # the first dark ring of the Airy disc, at 1.22 lambda N, is 2.9 standard deviations out
    assert narrow * channel.camera.pixel_m == pytest.approx(1.22 * 625e-9 * 22 / 2.9, rel=0.01)
    near = LightSettings(f_number=2.0).lens_blur_px(channel, 5.0) * channel.camera.pixel_m
    assert near == pytest.approx(0.035**2 / (2 * 5) / 4, rel=1e-3)
