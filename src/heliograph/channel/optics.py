"""Images of LEDs and panel: disc, lobe, Gaussian blur, integral over each pixel."""

import math
from collections.abc import Callable
from functools import cache, lru_cache

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import Floats
from heliograph.base.compiled import compiled
from heliograph.channel.exposure import Moments
from heliograph.channel.parts import POINT_SPREADS
from heliograph.channel.psf import PointSpread
from heliograph.channel.scene import Box, Corner, Light, Pair
from heliograph.channel.settings import CameraSettings, ChannelSettings

LedOptics = tuple[tuple[float, float, float], tuple[float, float], Floats, float, Floats]
"""Pitch in m, radius in m and Lambertian order; focal length and blur in px; cubature points and remaining variance of
the disc (`disc_cubature`); `normal_table`."""

LedMaps = tuple[Floats, Floats, Floats]  # homography, the rate of change per s, and camera position of an array

LitMoments = tuple[float, float, float]  # fraction of an exposure, centroid and variance of the light of an LED


def spots(settings: ChannelSettings, plane: Floats) -> list[tuple[float, Floats, LedOptics]]:
    """Return share of light, (3, 3) shift and optics of the Gaussians of the point-spread function at a pose."""
    camera, emitter = settings.camera, settings.emitter
    shape, parts = (emitter.pitch_m, emitter.diameter_m / 2, emitter.lobe_order), []
    for fraction, shift, sigma in _gaussians(POINT_SPREADS[camera.psf], camera):
        resolution = emitter.diameter_m / 2 * camera.focal_px / plane[2, 2] / sigma
        # rounding limits the number of cubatures
        cubature = disc_cubature(2.0 ** (math.ceil(8 * math.log2(resolution)) / 8))
        parts.append((fraction, shift, (shape, (camera.focal_px, sigma), *cubature, normal_table())))
    return parts


@lru_cache(maxsize=16)
def _gaussians(
    make: Callable[[CameraSettings], PointSpread], camera: CameraSettings
) -> tuple[tuple[float, Floats, float], ...]:
    """Return share of light, shift and width in px of the Gaussians."""
    psf = make(camera)
    shifts = np.tile(np.eye(3), (len(psf.fraction), 1, 1))
    shifts[:, :2, 2] = psf.shift_px
    return tuple(zip(psf.fraction.tolist(), shifts, psf.sigma_px.tolist(), strict=True))


REACH_SIGMA = 5.0  # radius of an LED image in standard deviations; 2 Phi(-5) = 6e-7 of the light is lost along an axis

PER_SIGMA = 512
"""Samples of the normal distribution function Phi per standard deviation; the interpolation error is 1.2e-7."""

LIMIT_SIGMA = 6  # range of the table of Phi in standard deviations; outside, Phi is 0 or 1 to 1e-9


@cache
def normal_table() -> Floats:
    """Return Phi(z) at z = -`LIMIT_SIGMA` ... `LIMIT_SIGMA` in steps of 1 / `PER_SIGMA`, plus a sample."""
    z = np.arange(-LIMIT_SIGMA * PER_SIGMA, LIMIT_SIGMA * PER_SIGMA + 2) / PER_SIGMA
    return np.array([0.5 * math.erfc(-v / math.sqrt(2)) for v in z])


@cache
def disc_cubature(resolution: float) -> tuple[Floats, float]:
    """Return positions of equal Gaussians that approximate a uniform disc, and the remaining variance.

    The resolution is disc radius over blur. The largest pixel error relative to the peak is 0.03 % up to a resolution
    of 0.4, 0.05 % up to 0.65, 0.2 % up to 1.6, 0.5 % up to 4.
    """
    # the disc has kappa_4 = -R^4 / 16; a ring of radius q has -3 q^4 / 8: equal at q = R / 6^(1/4);
    # a square of corners (+-q, +-q) has -2 q^4: equal at q = R / 32^(1/4) along the axes
    if resolution <= 0.4:
        points = np.zeros((1, 2))
    elif resolution <= 0.65:
        points = _ring(2**0.5 / 32**0.25, 4)
    elif resolution <= 1.6:
        points = _ring(6**-0.25, 6)
    else:
        rings = math.ceil(resolution / 0.8)
        points = np.vstack([_ring(*_sectors(k, rings)) for k in range(rings)])
    return points, 0.25 - float((points**2).sum(1).mean()) / 2


def _ring(radius: float, count: int) -> Floats:
    angle = 2 * np.pi * (np.arange(count) + 0.5) / count
    return radius * np.stack([np.cos(angle), np.sin(angle)], -1)


def _sectors(k: int, rings: int) -> tuple[float, int]:
    """Return the centroid radius and the number 3 (2 k + 1) of the sectors of equal area in annulus k."""
    count = 3 * (2 * k + 1)
    inner, outer = k / rings, (k + 1) / rings
    return 2 / 3 * (outer**3 - inner**3) / (outer**2 - inner**2) * float(np.sinc(1 / count)), count


@compiled(inline="always")
def _phi(z: float, table: Floats) -> float:
    """Interpolate Phi(z) in the table."""
    place = (z + LIMIT_SIGMA) * PER_SIGMA
    if place <= 0.0:
        return 0.0
    if place >= 2 * LIMIT_SIGMA * PER_SIGMA:
        return 1.0
    k = int(place)
    return float(table[k] + (place - k) * (table[k + 1] - table[k]))


@compiled(inline="always")
def _fractions(out: Floats, first: int, last: int, centre: float, sigma: float, table: Floats) -> None:
    """Write the integral of a 1-D Gaussian over each of the pixels first..last."""
    # integral over a pixel = Phi((i + 1/2 - x) / sigma) - Phi((i - 1/2 - x) / sigma)
    low = _phi((first - 0.5 - centre) / sigma, table)
    for i in range(first, last + 1):
        high = _phi((i + 0.5 - centre) / sigma, table)
        out[i - first] = high - low
        low = high


@compiled(inline="always")
def _span(centre: float, sigma: float, start: int, size: int) -> tuple[int, int]:
    """Return the first and the last pixel of a Gaussian within a window."""
    first = math.ceil(centre - REACH_SIGMA * sigma - 0.5)
    return max(start, first), min(start + size - 1, math.floor(centre + REACH_SIGMA * sigma + 0.5))


@compiled(inline="always")
def _deposit(
    light: Light, corner: Corner, centre: Pair, sigma: Pair, flux: float, scratch: Floats, table: Floats
) -> None:
    """Add a Gaussian, integrated over each pixel."""
    left, right = _span(centre[0], sigma[0], corner[0], light.shape[1])
    top, low = _span(centre[1], sigma[1], corner[1], light.shape[0])
    if left > right or top > low:
        return
    across, down = scratch[0], scratch[1]
    _fractions(across, left, right, centre[0], sigma[0], table)
    _fractions(down, top, low, centre[1], sigma[1], table)
    for i in range(top, low + 1):
        row, g = light[i - corner[1]], flux * down[i - top]
        for j in range(left, right + 1):
            row[j - corner[0]] += np.float32(g * across[j - left])


@compiled()
def add_gaussian(light: Light, corner: Corner, centre: Pair, sigma: Pair, flux: float, table: Floats) -> None:
    """Add a Gaussian to a window of the image, in place."""
    _deposit(light, corner, centre, sigma, flux, np.empty((2, max(light.shape) + 1)), table)


@compiled()
def add_leds(light: Light, corner: Corner, maps: LedMaps, moments: Moments, optics: LedOptics) -> None:
    """Add the light of the LEDs of an array to a window of the image, in place."""
    n, pitch = moments[0].shape[0], optics[0][0]
    scratch = np.empty((2, max(light.shape) + 1))
    for u in range(n):
        for v in range(n):
            if moments[0][u, v] != 0.0:
                place = ((v - (n - 1) / 2) * pitch, (u - (n - 1) / 2) * pitch)
                lit = (moments[0][u, v], moments[1][u, v], moments[2][u, v])
                _add_led(light, corner, place, maps, lit, optics, scratch)


@compiled()
def _add_led(
    light: Light, corner: Corner, place: Pair, maps: LedMaps, lit: LitMoments, optics: LedOptics, scratch: Floats
) -> None:
    """Add the light of an LED at (a, b) in the array plane with the moments `lit`."""
    (a, b), (level, late, spread), (homography, drift, eye) = place, lit, maps
    (pitch, radius, order), (focal, blur), points, rest, table = optics
    # equation (6): the homography of the temporal centroid of the light
    h = np.empty((3, 3))
    for i in range(3):
        for j in range(3):
            h[i, j] = homography[i, j] + late * drift[i, j]
    z = h[2, 0] * a + h[2, 1] * b + h[2, 2]
    x, y = (h[0, 0] * a + h[0, 1] * b + h[0, 2]) / z, (h[1, 0] * a + h[1, 1] * b + h[1, 2]) / z
    # Jacobian and image velocity in px/s
    xa, xb = (h[0, 0] - x * h[2, 0]) / z, (h[0, 1] - x * h[2, 1]) / z
    ya, yb = (h[1, 0] - y * h[2, 0]) / z, (h[1, 1] - y * h[2, 1]) / z
    vz = drift[2, 0] * a + drift[2, 1] * b + drift[2, 2]
    vx = (drift[0, 0] * a + drift[0, 1] * b + drift[0, 2] - x * vz) / z
    vy = (drift[1, 0] * a + drift[1, 1] * b + drift[1, 2] - y * vz) / z
    # Lambertian lobe: I ~ cos^m of the angle between array normal and camera direction
    away = math.sqrt((eye[0] - a) ** 2 + (eye[1] - b) ** 2 + eye[2] ** 2)
    lobe = (-eye[2] / away) ** order
    # h_uv of (3): flux = level (f p / (Z pixel))^2, an unresolved array has the surface brightness
    flux = level * lobe * (focal * pitch / z) ** 2 / len(points)
    # convolution of blur, disc and motion blur: variances add
    disc = rest * radius**2
    xx = blur**2 + disc * (xa**2 + xb**2) + vx**2 * spread
    yy = blur**2 + disc * (ya**2 + yb**2) + vy**2 * spread
    xy = disc * (xa * ya + xb * yb) + vx * vy * spread
    # two halves at +-dx along a diagonal have the covariance +-dx^2 and dx^2 more variance; below a correlation of
    # 1e-3 the error is at most 4e-4 of the peak
    halves = 2 if abs(xy) > 1e-3 * math.sqrt(xx * yy) else 1
    dx = math.sqrt(abs(xy)) if halves == 2 else 0.0
    dy = dx if xy > 0 else -dx
    sigma = (math.sqrt(xx - dx**2), math.sqrt(yy - dx**2))
    for k in range(len(points) * halves):
        p, q = radius * points[k // halves, 0], radius * points[k // halves, 1]
        side = 1 - 2 * (k % halves)
        at = (x + xa * p + xb * q + side * dx, y + ya * p + yb * q + side * dy)
        _deposit(light, corner, at, sigma, flux / halves, scratch, table)


@compiled()
def add_images(
    light: Light, corner: Corner, level: NDArray[np.float32], images: NDArray[np.float32], corners: NDArray[np.int64]
) -> None:
    """Add precomputed LED images to a window of the image, in place."""
    height, width = light.shape
    rows, cols = images.shape[2], images.shape[3]
    for u in range(level.shape[0]):
        for v in range(level.shape[1]):
            value = level[u, v]
            if value == np.float32(0):
                continue
            x, y = corners[u, v, 0] - corner[0], corners[u, v, 1] - corner[1]
            first, last = max(0, -x), min(cols, width - x)
            for i in range(max(0, -y), min(rows, height - y)):
                # row slices allow vectorisation
                row, image = light[y + i, x + first : x + last], images[u, v, i, first:last]
                for j in range(len(row)):
                    row[j] += value * image[j]


@compiled()
def cover(light: Light, corner: Corner, inverse: Floats, half: Pair, box: Box, level: float, table: Floats) -> None:
    """Cover a window of the image with an opaque square panel, in place."""
    height, width = light.shape
    for y in range(max(box[1], corner[1]), min(box[3], corner[1] + height - 1) + 1):
        for x in range(max(box[0], corner[0]), min(box[2], corner[0] + width - 1) + 1):
            w = inverse[2, 0] * x + inverse[2, 1] * y + inverse[2, 2]
            a = (inverse[0, 0] * x + inverse[0, 1] * y + inverse[0, 2]) / w
            b = (inverse[1, 0] * x + inverse[1, 1] * y + inverse[1, 2]) / w
            # a blurred edge is Phi(distance / sigma); the square is the product of two strips
            strip_a = _phi(half[0] - a, table) - _phi(-half[0] - a, table)
            strip_b = _phi(half[1] - b, table) - _phi(-half[1] - b, table)
            old = light[y - corner[1], x - corner[0]]
            light[y - corner[1], x - corner[0]] = np.float32(old + strip_a * strip_b * (level - old))
