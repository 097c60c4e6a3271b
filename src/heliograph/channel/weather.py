"""Weather: extinction, airlight and forward scatter of fog; glare of the sun.

Light of luminance L0 at the distance d arrives as L = L0 exp(-sigma d) + L_h (1 - exp(-sigma d)), with the extinction
sigma in 1/m and the light of the horizon L_h (Koschmieder 1924). Multiple scattering is a halo only, see `scattered`.
"""

import math
from typing import TypeVar

import numpy as np

from heliograph.channel.scene import Light
from heliograph.channel.settings import ChannelSettings, WeatherSettings

DIFFRACTED = 0.5
"""Share of the extinction that droplets much larger than the wavelength diffract forward (van de Hulst 1957)."""

WAVELENGTH_M = 625e-9  # red traffic light

Level = TypeVar("Level", float, Light)


def extinction(weather: WeatherSettings) -> float:
    """Return the extinction sigma in 1/m, 0 for clear air."""
    # WMO-No. 8: over the meteorological optical range V, the light of a beam falls to 5 %: sigma = 2.996 / V;
    # Koschmieder's 3.912 / V belongs to a contrast of 2 %
    return -math.log(0.05) / weather.visibility_m if weather.visibility_m else 0.0


def transmission(weather: WeatherSettings, distance_m: float) -> float:
    """Return the share of light that arrives unscattered, exp(-sigma d); 1 for clear air."""
    return math.exp(-extinction(weather) * distance_m)


def seen(weather: WeatherSettings, light: Level, distance_m: float) -> Level:
    """Return the light of an object at a distance, airlight included, in full scales."""
    clear = transmission(weather, distance_m)
    return light * clear + weather.airlight * (1 - clear)


def scattered(weather: WeatherSettings, distance_m: float) -> tuple[float, float]:
    """Return share and angle in rad of the light that fog droplets scatter forward into a halo.

    Small-angle approximation (Wells 1969; Zege, Ivanov, Katsev 1991): the share w of the extinction is scattered by
    small angles of standard deviation theta along an axis, n times with the Poisson mean w sigma d. At the fraction s
    of the way, an angle theta is seen as s theta, of mean square theta^2 / 3. A Gaussian with share and variance of
    the sum over n >= 1 is an approximation. The refracted light, 1 - w, spreads over tens of degrees and is lost.
    """
    depth = DIFFRACTED * extinction(weather) * distance_m
    # Airy pattern (2 J1(x) / x)^2, x = pi D theta / lambda: exp(-x^2 / 4) near the centre
    theta = math.sqrt(2) * WAVELENGTH_M / (math.pi * weather.droplet_m)
    share = transmission(weather, distance_m) * math.expm1(depth)
    return share, theta * math.sqrt(depth / -math.expm1(-depth) / 3) if depth else 0.0


def glare(settings: ChannelSettings) -> Light:
    """Return the veil of the sun on the sensor in full scales, (rows, columns).

    The veiling luminance of a point source falls as 1 / theta^2 with the angle theta in degrees (Stiles-Holladay, valid
    from 1 to 30 degrees; CIE 146:2002). 1 / (theta^2 + 1) is finite at the sun. ``glare`` sets the veil at the picture
    centre, for lens and windscreen together; the disc of the sun, ghosts of the lens and camera shake are omitted.
    """
    camera, (right, up) = settings.camera, np.radians(settings.weather.sun_deg)
    x, y = ((np.arange(size) - (size - 1) / 2) / camera.focal_px for size in (camera.width, camera.height))
    sun_x, sun_y, sun_z = np.sin(right) * np.cos(up), -np.sin(up), np.cos(right) * np.cos(up)
    cosine = (sun_x * x + sun_y * y[:, None] + sun_z) / np.sqrt(1 + x**2 + y[:, None] ** 2)
    theta, centre = (np.degrees(np.arccos(np.clip(value, -1, 1))) for value in (cosine, sun_z))
    veil: Light = (settings.weather.glare * (centre**2 + 1) / (theta**2 + 1)).astype(np.float32)
    return veil
