"""Light of LEDs and panel on the pixels: disc, lobe, Gaussian blur, integral over each pixel."""

import math
from collections.abc import Callable
from functools import cache, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import Floats
from heliograph.base.compiled import compiled
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


REACH_SIGMA = 5.0
"""An LED's image is cut this many standard deviations from its centre; 2 Phi(-5) = 6e-7 of the light is lost along an
axis. At half the value 1.2 % would be lost; at twice an image has up to four times the pixels."""

LEAST_COVARIANCE = 1e-3
"""Correlation of an LED's Gaussian below which it counts as upright: an error of 4e-4 of its peak at most, in
proportion to the value."""

PER_SIGMA = 512
"""Samples of the normal distribution function Phi by standard deviation: straight lines between them are right to
max |Phi''| / (8 512^2) = 1.2e-7; 4.6e-7 at half the value."""

LIMIT_SIGMA = 6
"""Standard deviations to which Phi is tabulated: beyond, it is 0 or 1 to 1e-9."""


@cache
def normal_table() -> Floats:
    """Return Phi(z) at z = -`LIMIT_SIGMA` ... `LIMIT_SIGMA` in steps of 1 / `PER_SIGMA`, and one sample beyond."""
    z = np.arange(-LIMIT_SIGMA * PER_SIGMA, LIMIT_SIGMA * PER_SIGMA + 2) / PER_SIGMA
    return np.array([0.5 * math.erfc(-v / math.sqrt(2)) for v in z])


@cache
def disc_cubature(resolution: float) -> tuple[Floats, float]:
    """Return equal Gaussians whose sum stands for a uniform disc.

    The largest error of a pixel, relative to an LED's brightest pixel, is 0.03 % up to a resolution of 0.4, 0.05 % up
    to 0.65, 0.2 % up to 1.6, 0.5 % up to 4. The reference lens at 60, 25 and 10 m has the resolutions 0.24, 0.58 and
    1.46.
    """
    # the disc has kappa_4 = -R^4 / 16; a ring of radius q has -3 q^4 / 8: equal at q = R / 6^(1/4);
    # a square of corners (+-q, +-q) has -2 q^4: equal at q = R / 32^(1/4) along the axes
    # largest resolution, radius of a disc by the blur, at which one Gaussian stands for the disc: right to 0.03 % (see
    # `disc_cubature`, as for the next three)
    if resolution <= 0.4:
        points = np.zeros((1, 2))
    # largest resolution at which four Gaussians stand for the disc: right to 0.05 %
    elif resolution <= 0.65:  # four Gaussians at the corners of a square
        points = _ring(2**0.5 / 32**0.25, 4)
    # largest resolution at which six Gaussians stand for the disc: right to 0.2 %
    elif resolution <= 1.6:
        points = _ring(6**-0.25, 6)
    else:
        # largest width of a ring of Gaussians beyond, in standard deviations of the blur: right to 0.5 % up to a
        # resolution of 4
        rings = math.ceil(resolution / 0.8)
        points = np.vstack([_ring(*_sectors(k, rings)) for k in range(rings)])
    return points, 0.25 - float((points**2).sum(1).mean()) / 2


def _ring(radius: float, count: int) -> Floats:
    angle = 2 * np.pi * (np.arange(count) + 0.5) / count
    return radius * np.stack([np.cos(angle), np.sin(angle)], -1)


def _sectors(k: int, rings: int) -> tuple[float, int]:
    """Return the radius of the sectors' centroids in annulus k, and their number 3 (2 k + 1): all have one area."""
    count = 3 * (2 * k + 1)
    inner, outer = k / rings, (k + 1) / rings
    return 2 / 3 * (outer**3 - inner**3) / (outer**2 - inner**2) * float(np.sinc(1 / count)), count


@compiled(error_model="numpy", inline="always")
def _phi(z: float, table: Floats) -> float:
    """Return Phi(z) by straight lines between the samples of the table."""
    place = (z + LIMIT_SIGMA) * PER_SIGMA
    if place <= 0.0:
        return 0.0
    if place >= 2 * LIMIT_SIGMA * PER_SIGMA:
        return 1.0
    k = int(place)
    return float(table[k] + (place - k) * (table[k + 1] - table[k]))


@compiled(error_model="numpy", inline="always")
def _fractions(out: Floats, first: int, last: int, centre: float, sigma: float, table: Floats) -> None:
    """Write the fraction of a 1-D Gaussian on each of the pixels first..last."""
    # integral over a pixel = Phi((i + 1/2 - x) / sigma) - Phi((i - 1/2 - x) / sigma)
    low = _phi((first - 0.5 - centre) / sigma, table)
    for i in range(first, last + 1):
        high = _phi((i + 0.5 - centre) / sigma, table)
        out[i - first] = high - low
        low = high


@compiled(error_model="numpy", inline="always")
def _span(centre: float, sigma: float, start: int, size: int) -> tuple[int, int]:
    """Return the first and the last pixel that a Gaussian reaches within a window."""
    first = math.ceil(centre - REACH_SIGMA * sigma - 0.5)
    last = math.floor(centre + REACH_SIGMA * sigma + 0.5)
    return max(start, first), min(start + size - 1, last)


@compiled(error_model="numpy", inline="always")
def _deposit(
    light: NDArray[np.float32],
    corner: tuple[int, int],
    centre: tuple[float, float],
    sigma: tuple[float, float],
    flux: float,
    scratch: Floats,
    table: Floats,
) -> None:
    """Add a Gaussian of a flux, integrated over each pixel."""
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


@compiled(error_model="numpy", inline="always")
def _image(
    h: Floats, drift: Floats, late: float, a: float, b: float
) -> tuple[float, float, float, float, float, float, float]:
    """Return image (x, y), depth z and Jacobian (dx/da, dx/db, dy/da, dy/db) of a point of the array's plane.

    (6) along the motion: the homography is that of the centroid of the LED's lit time, h + late drift.
    """
    ha, hb, hc = h[0, 0] + late * drift[0, 0], h[0, 1] + late * drift[0, 1], h[0, 2] + late * drift[0, 2]
    ka, kb, kc = h[1, 0] + late * drift[1, 0], h[1, 1] + late * drift[1, 1], h[1, 2] + late * drift[1, 2]
    za, zb, zc = h[2, 0] + late * drift[2, 0], h[2, 1] + late * drift[2, 1], h[2, 2] + late * drift[2, 2]
    z = za * a + zb * b + zc
    x, y = (ha * a + hb * b + hc) / z, (ka * a + kb * b + kc) / z
    return x, y, z, (ha - x * za) / z, (hb - x * zb) / z, (ka - y * za) / z, (kb - y * zb) / z


@compiled(error_model="numpy", inline="always")
def _velocity(drift: Floats, a: float, b: float, x: float, y: float, z: float) -> tuple[float, float]:
    """Return the velocity of the image of a point of the array's plane in px/s."""
    vz = drift[2, 0] * a + drift[2, 1] * b + drift[2, 2]
    vx = drift[0, 0] * a + drift[0, 1] * b + drift[0, 2] - x * vz
    vy = drift[1, 0] * a + drift[1, 1] * b + drift[1, 2] - y * vz
    return vx / z, vy / z


@compiled(error_model="numpy")
def add_leds(
    light: NDArray[np.float32],
    corner: tuple[int, int],
    homography: Floats,
    drift: Floats,
    eye: Floats,
    moments: tuple[Floats, Floats, Floats],
    emitter: tuple[float, float, float],
    lens: tuple[float, float],
    points: Floats,
    rest: float,
    table: Floats,
) -> None:
    """Add the light of an array's LEDs to a window of the image, in place."""
    level, late, spread = moments
    n = level.shape[0]
    scratch = np.empty((2, max(light.shape) + 1))
    for u in range(n):
        for v in range(n):
            if level[u, v] != 0.0:
                a, b = (v - (n - 1) / 2) * emitter[0], (u - (n - 1) / 2) * emitter[0]
                lit = (level[u, v], late[u, v], spread[u, v])
                _add_led(
                    light, corner, (a, b), homography, drift, eye, lit, emitter, lens, points, rest, scratch, table
                )


@compiled(error_model="numpy")
def _add_led(
    light: NDArray[np.float32],
    corner: tuple[int, int],
    place: tuple[float, float],
    homography: Floats,
    drift: Floats,
    eye: Floats,
    lit: tuple[float, float, float],
    emitter: tuple[float, float, float],
    lens: tuple[float, float],
    points: Floats,
    rest: float,
    scratch: Floats,
    table: Floats,
) -> None:
    """Add the light of one LED at a place (a, b) of the array's plane, `lit` as the moments of `add_leds`."""
    (a, b), (level, late, spread), (pitch, radius, order), (focal, blur) = place, lit, emitter, lens
    x, y, z, xa, xb, ya, yb = _image(homography, drift, late, a, b)
    vx, vy = _velocity(drift, a, b, x, y, z)
    # Lambertian lobe: I ~ cos^m of the angle between the array's normal and the direction of the camera
    away = math.sqrt((eye[0] - a) ** 2 + (eye[1] - b) ** 2 + eye[2] ** 2)
    lobe = (-eye[2] / away) ** order
    # h_uv of (3): flux = level (f p / (Z pixel))^2, so that an unresolved array has its surface brightness
    flux = level * lobe * (focal * pitch / z) ** 2 / len(points)
    # blur * disc * smear of the motion: variances add
    disc = rest * radius**2
    xx = blur**2 + disc * (xa**2 + xb**2) + vx**2 * spread
    yy = blur**2 + disc * (ya**2 + yb**2) + vy**2 * spread
    xy = disc * (xa * ya + xb * yb) + vx * vy * spread
    # a covariance worth counting: two halves at +-dx along a diagonal have +-dx^2, and dx^2 more variance
    halves = 2 if abs(xy) > LEAST_COVARIANCE * math.sqrt(xx * yy) else 1
    dx = math.sqrt(abs(xy)) if halves == 2 else 0.0
    dy = dx if xy > 0 else -dx
    sigma = (math.sqrt(xx - dx**2), math.sqrt(yy - dx**2))
    for k in range(len(points) * halves):
        p, q = radius * points[k // halves, 0], radius * points[k // halves, 1]
        side = 1 - 2 * (k % halves)
        at = (x + xa * p + xb * q + side * dx, y + ya * p + yb * q + side * dy)
        _deposit(light, corner, at, sigma, flux / halves, scratch, table)


@compiled(error_model="numpy")
def draw_images(
    images: NDArray[np.float32],
    corners: NDArray[np.int64],
    homography: Floats,
    eye: Floats,
    emitter: tuple[float, float, float],
    lens: tuple[float, float],
    points: Floats,
    rest: float,
    table: Floats,
) -> None:
    """Add the light of each LED of an array at rest to an image of its own, in place."""
    n, still = images.shape[0], np.zeros((3, 3))
    scratch = np.empty((2, images.shape[2] + 1))
    for u in range(n):
        for v in range(n):
            a, b = (v - (n - 1) / 2) * emitter[0], (u - (n - 1) / 2) * emitter[0]
            corner = (corners[u, v, 0], corners[u, v, 1])
            lit = (1.0, 0.0, 0.0)
            one = images[u, v]
            _add_led(one, corner, (a, b), homography, still, eye, lit, emitter, lens, points, rest, scratch, table)


@compiled(error_model="numpy")
def add_images(
    light: NDArray[np.float32],
    corner: tuple[int, int],
    level: NDArray[np.float32],
    images: NDArray[np.float32],
    corners: NDArray[np.int64],
) -> None:
    """Add the light of LEDs to a window of the image by their own images, in place."""
    height, width = light.shape
    # images are cut to what is lit: they may be higher than wide
    rows, cols = images.shape[2], images.shape[3]
    for u in range(level.shape[0]):
        for v in range(level.shape[1]):
            value = level[u, v]
            if value == np.float32(0):
                continue
            x, y = corners[u, v, 0] - corner[0], corners[u, v, 1] - corner[1]
            first, last = max(0, -x), min(cols, width - x)
            for i in range(max(0, -y), min(rows, height - y)):
                # by parts of rows, whose numbers begin at 0: several pixels at once
                row, image = light[y + i, x + first : x + last], images[u, v, i, first:last]
                for j in range(len(row)):
                    row[j] += value * image[j]


@compiled(error_model="numpy")
def cover(
    light: NDArray[np.float32],
    corner: tuple[int, int],
    inverse: Floats,
    half: tuple[float, float],
    box: tuple[int, int, int, int],
    level: float,
    table: Floats,
) -> None:
    """Lay an opaque square panel over a window of the image, in place."""
    height, width = light.shape
    for y in range(max(box[1], corner[1]), min(box[3], corner[1] + height - 1) + 1):
        for x in range(max(box[0], corner[0]), min(box[2], corner[0] + width - 1) + 1):
            w = inverse[2, 0] * x + inverse[2, 1] * y + inverse[2, 2]
            a = (inverse[0, 0] * x + inverse[0, 1] * y + inverse[0, 2]) / w
            b = (inverse[1, 0] * x + inverse[1, 1] * y + inverse[1, 2]) / w
            # an edge blurred by a Gaussian is Phi(distance / sigma); the square is the product of two strips
            strip_a = _phi(half[0] - a, table) - _phi(-half[0] - a, table)
            strip_b = _phi(half[1] - b, table) - _phi(-half[1] - b, table)
            old = light[y - corner[1], x - corner[0]]
            light[y - corner[1], x - corner[0]] = np.float32(old + strip_a * strip_b * (level - old))
