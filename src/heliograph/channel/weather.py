"""Weather: extinction, airlight and forward scatter of fog and rain; glare of the sun; drops on the windscreen.

Light of luminance L0 at the distance d arrives as L = L0 exp(-sigma d) + L_h (1 - exp(-sigma d)), with the extinction
sigma in 1/m and the light of the horizon L_h (Koschmieder 1924). Multiple scattering is a halo only, see `scattered`.
"""

import math
from typing import TypeVar

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.channel.motion import Travel
from heliograph.channel.scene import Corner, Light
from heliograph.channel.settings import ChannelSettings, WeatherSettings

DIFFRACTED = 0.5
"""Share of the extinction that droplets much larger than the wavelength diffract forward (van de Hulst 1957)."""

WAVELENGTH_M = 625e-9  # red traffic light

Level = TypeVar("Level", float, Light)


def fog_extinction(weather: WeatherSettings) -> float:
    """Return the extinction of fog in 1/m."""
    # WMO-No. 8: over the meteorological optical range V, the light of a beam falls to 5 %: sigma = 2.996 / V;
    # Koschmieder's 3.912 / V belongs to a contrast of 2 %
    return -math.log(0.05) / weather.visibility_m if weather.visibility_m else 0.0


def extinction(weather: WeatherSettings) -> float:
    """Return the extinction sigma of fog and rain in 1/m, 0 for clear air."""
    # 1.076 R^0.67 dB/km at the rain rate R in mm/h (Carbonneau, Wisely 1998; ITU-R P.1814)
    rain_db_per_m = 1.076e-3 * weather.rain_mm_h**0.67
    return fog_extinction(weather) + math.log(10) / 10 * rain_db_per_m


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
    the sum over n >= 1 is an approximation. The refracted light, 1 - w, spreads over tens of degrees and is lost, as is
    all light scattered by rain.
    """
    depth = DIFFRACTED * fog_extinction(weather) * distance_m
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


class Windscreen:
    """Rain drops on the windscreen, at rest until the next wipe, out of focus for a lens focused far beyond.

    The rays of a pixel pass the windscreen in a disc of the diameter of the aperture. A drop that covers the share a of
    the disc leaves B (1 - a) + a R of the light B (You et al. 2016). A drop is a wide-angle lens (Garg, Nayar 2004),
    hence R is the airlight; the light of the array within R is omitted, as are the wiper blade and running water.
    """

    MAX_M = 2.0  # limit of width and height of the windscreen

    def __init__(self, settings: ChannelSettings, seed: int) -> None:
        self._weather, self._travel, self._seed = settings.weather, Travel.of(settings), seed
        camera = settings.camera
        self._px_per_m = camera.focal_px / self._weather.windscreen_m
        self._size_m = np.array([camera.width, camera.height]) / self._px_per_m + self._weather.aperture_m + 0.01
        self._size_m = np.minimum(self._size_m, self.MAX_M)
        # the first wipe is at a random time before the film
        self._start_s = camera.start_s - self._weather.wiper_s * np.random.default_rng([seed, 0, 2]).random()
        self._wipe, self._drops = -1, np.empty((0, 4))
        self._clear = np.ones((camera.height, camera.width), np.float32)

    def look_through(self, light: Light, corner: Corner, time_s: float) -> None:
        """Replace covered light by airlight in a window, in place; times must not decrease."""
        wipe = math.floor((time_s - self._start_s) / self._weather.wiper_s)
        if wipe != self._wipe:
            self._wipe, self._drops = wipe, self._draw(wipe)
            self._clear.fill(1)
        landed = int(np.searchsorted(self._drops[:, 0], time_s))
        for _, x, y, diameter in self._drops[:landed] * self._px_per_m:
            self._land(x, y, diameter / 2)
        self._drops = self._drops[landed:]
        (x, y), (height, width) = corner, light.shape
        clear = self._clear[y : y + height, x : x + width]
        light *= clear
        light += np.float32(self._weather.airlight) * (1 - clear)

    def _draw(self, wipe: int) -> Floats:
        """Return time, position from the centre and diameter on the glass of the drops after a wipe, by time."""
        weather, rng = self._weather, np.random.default_rng([self._seed, wipe + 1, 2])
        start_s, rake = self._start_s + wipe * weather.wiper_s, math.radians(weather.rake_deg)
        # Marshall, Palmer 1948: N(D) = 8000 exp(-Lambda D) drops per m^3 and mm of the diameter D in mm
        per_mm = 4.1 * weather.rain_mm_h**-0.21
        # through an area normal to the travel, the car runs into N(D) v drops per m^2 and s, whatever the rake of the
        # glass behind; drops fall on the glass at 3.78 D^0.67 m/s (Atlas, Ulbrich 1977)
        ahead = float(self._travel.speed(np.array(start_s)))
        down = 3.78 * math.gamma(1.67) * per_mm**-0.67 / math.tan(rake)
        drops = []
        for speed_m_s, shape in ((ahead, 1.0), (down, 1.67)):
            n = rng.poisson(8000 / per_mm * speed_m_s * weather.wiper_s * self._size_m.prod())
            # a hemisphere has 2^(1/3) times the diameter of a sphere of equal volume
            diameter_m = 2 ** (1 / 3) * 1e-3 * rng.gamma(shape, 1 / per_mm, n)
            at = (rng.random((n, 2)) - 0.5) * self._size_m
            drops.append(np.column_stack([start_s + weather.wiper_s * rng.random(n), at, diameter_m]))
        joined = np.concatenate(drops)
        return joined[np.argsort(joined[:, 0])]

    def _land(self, x: float, y: float, radius: float) -> None:
        """Cover the light of a drop in px from the picture centre."""
        (height, width), ring = self._clear.shape, 0.5 * self._weather.aperture_m * self._px_per_m
        x, y, reach = x + (width - 1) / 2, y + (height - 1) / 2, radius + ring
        left, right = (int(np.clip(edge, 0, width)) for edge in (math.ceil(x - reach), math.floor(x + reach) + 1))
        top, low = (int(np.clip(edge, 0, height)) for edge in (math.ceil(y - reach), math.floor(y + reach) + 1))
        if left < right and top < low:
            apart = np.hypot(np.arange(left, right) - x, (np.arange(top, low) - y)[:, None])
            covered = common_area(apart, ring, radius) / (math.pi * ring**2)
            self._clear[top:low, left:right] *= (1 - covered).astype(np.float32)


def common_area(apart: Floats, first: float, second: float) -> Floats:
    """Return the common area of two discs of given radii and distances of the centres."""
    apart, area = np.maximum(apart, 1e-9), np.zeros_like(apart)
    for radius, other in ((first, second), (second, first)):
        cosine = np.clip((apart**2 + radius**2 - other**2) / (2 * apart * radius), -1, 1)
        area += radius**2 * (np.arccos(cosine) - cosine * np.sqrt(1 - cosine**2))
    return area
