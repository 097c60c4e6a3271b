"""An LED's light on the sensor as spots: the Gaussians of the point-spread function, and the LEDs they are of."""

import math
from collections.abc import Callable
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.channel.optics import disc_cubature
from heliograph.channel.parts import POINT_SPREADS
from heliograph.channel.psf import PointSpread
from heliograph.channel.settings import CameraSettings, ChannelSettings

_STEPS_PER_OCTAVE = 8
"""Steps of the resolution for which cubatures are made, rounded up, so that few are made and kept. Chosen: from 10 to
80 m there are 24; the rounding makes a cubature finer than needed by at most 9 %, by 19 % at half the value."""


def shape_of(settings: ChannelSettings) -> tuple[float, float, float]:
    """Return pitch in m, radius in m and Lambertian order of a channel's LEDs."""
    emitter = settings.emitter
    return emitter.pitch_m, emitter.diameter_m / 2, emitter.lobe_order


class Spot(NamedTuple):
    """A Gaussian of the point-spread function, for LEDs at a pose.

    Attributes
    ----------
    fraction
        Part of the light that it has.
    homography
        (3, 3) map onto the sensor, moved by the Gaussian's shift.
    shift
        (3, 3) that shift; None for none.
    lens, points, rest
        Lens and cubature of the disc, as for `optics.add_leds`.
    """

    fraction: float
    homography: Floats
    shift: Floats | None
    lens: tuple[float, float]
    points: Floats
    rest: float


def spots(settings: ChannelSettings, one: Floats) -> list[Spot]:
    """Return the Gaussians of the point-spread function for an array's LEDs at a pose."""
    camera, parts = settings.camera, list[Spot]()
    for fraction, shift, sigma in _gaussians(POINT_SPREADS[camera.psf], camera):
        resolution = settings.emitter.diameter_m / 2 * camera.focal_px / one[2, 2] / sigma
        steps = math.ceil(_STEPS_PER_OCTAVE * math.log2(resolution))
        cubature = disc_cubature(2.0 ** (steps / _STEPS_PER_OCTAVE))
        parts.append(Spot(fraction, one if shift is None else shift @ one, shift, (camera.focal_px, sigma), *cubature))
    return parts


@lru_cache(maxsize=16)  # one of a film is asked for in each frame
def _gaussians(
    make: Callable[[CameraSettings], PointSpread], camera: CameraSettings
) -> tuple[tuple[float, Floats | None, float], ...]:
    """Light, shift and width in px of the Gaussians of a point-spread function; None for no shift."""
    psf, parts = make(camera), []
    for fraction, (dx, dy), sigma in zip(psf.fraction.tolist(), psf.shift_px, psf.sigma_px.tolist(), strict=True):
        # the Gaussian's place beside the point moves the image: (x + dx, y + dy, 1) Z
        shift = np.array([[1.0, 0.0, dx], [0.0, 1.0, dy], [0.0, 0.0, 1.0]])
        parts.append((fraction, shift if dx or dy else None, sigma))
    return tuple(parts)
