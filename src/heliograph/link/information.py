"""What the optics leave of a layer's symbols: mutual information, and how far a code of some rate can be read.

Model: r = A d + n, with A the images of the symbols as the channel renders them, d = +-1 and n white Gaussian noise. A
pattern and its inverse, seen once each, count as one look with half the noise power. Pose, blur and brightness are
taken as known, and nothing moves.

======== =================================================================================================
linear   all symbols of the layer and of those below unknown, those above known: linear MMSE. A receiver that
         cancels the layers it has decoded has this at least.
bound    all other symbols known: the matched filter. No receiver has more.
sampled  the luminance at each LED's place, as the receiver "plain" reads it; the rest disturbs.
======== =================================================================================================
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.channel.render import Canvas, add_array
from heliograph.channel.scene import CameraPose, centre_scale, homography, project, square
from heliograph.channel.settings import ChannelSettings
from heliograph.link.settings import LinkSettings
from heliograph.signal import haar
from heliograph.signal.formats import Mode
from heliograph.signal.pwm import SLOTS
from heliograph.signal.settings import LAYERS, SignalSettings

Kind = Literal["linear", "bound", "sampled"]

NEEDED = ((1 / 3, 0.408), (2 / 5, 0.476), (1 / 2, 0.583), (3 / 5, 0.690), (2 / 3, 0.753), (3 / 4, 0.824),
          (5 / 6, 0.892), (9 / 10, 0.946), (1.0, 1.0))  # fmt: skip
"""Information in bit per coded bit at which 1 % of the codewords of 3072 bits are wrong, by code rate: measured in
white noise by ``python -m benchmarks.budget needs``, log-MAP, 8 iterations. Codewords of 6144 bits need 0.01 less."""

LARGEST = 16
"""LEDs of a side, at most, that are looked at: of a larger array a part, whose symbols are as well seen. Chosen: 16 x
16 are the reference link's; four times as many symbols take 64 times as long."""

LOOKS_PX = tuple(((0.5 + 0.7548777 * k) % 1 - 0.5, (0.5 + 0.5698403 * k) % 1 - 0.5) for k in range(5))
"""Places of the array on the pixel grid over which information is averaged: five that fill it evenly (the steps are 1/g
and 1/g^2, g^3 = g + 1). The low layer's information at 105 to 125 m is that of twelve random places to 0.02."""

STEP = 1.08
"""Factor from one distance to the next at which information is computed to find a range; between them it is taken for a
straight line."""

MARGIN_PX, MARGIN_SIGMA = 2.0, 4.0
"""Pixels, and standard deviations of the blur, beyond the array that are looked at. Chosen: what lies further out has
less than 1e-4 of an LED's light, and a halo of a twentieth of the light is cut off there."""

NOISE_LOOKS = 64
"""Noise images by which the noise of sampled symbols is estimated: right to 1 % for a layer of 64."""


def noise_share(channel: ChannelSettings, all_on: float) -> float:
    """Return the standard deviation of a pixel's noise within the array at its mean light, in full scales."""
    sensor = channel.sensor
    mean_e = sensor.full_well_e * (all_on / 2 + channel.emitter.panel_level)
    # EMVA 1288: sigma^2 = sigma_d^2 + mu_e, and 1/12 DN^2 of quantisation
    return math.sqrt((sensor.dark_noise_e**2 + mean_e) / sensor.full_well_e**2 + 1 / 12 / sensor.full_scale**2)


@dataclass(frozen=True, slots=True)
class ArrayImages:
    """Images of the LEDs of an array, of LARGEST x LARGEST at most."""

    # (rows, columns, n, n) light of each pixel with one LED on, so that the array with every LED on has the light 1 on
    # its axis where it is not resolved
    leds: Floats
    # (n * n, 2) places (x, y) of the LEDs in px of the image
    points: Floats
    # Distance of neighbouring LEDs in px, the root of the area that one has
    pitch_px: float
    # Light of the array with every LED on by that on its axis: below 1 where it is seen from the side
    light: float

    @property
    def peak(self) -> float:
        """Light of the brightest pixel with every LED on; above 1 where LEDs are resolved."""
        return float(self.leds.sum((2, 3)).max())


def array_images(channel: ChannelSettings, side: int, distance_m: float, shift_px: tuple[float, float]) -> ArrayImages:
    """Return the images of the first array's LEDs, as the channel renders them for a camera at rest."""
    still = np.zeros(())
    count, place = min(side, LARGEST), channel.arrays[0]
    one, eye = homography(CameraPose(*5 * [still]), still, place, distance_m - place.z_offset_m, channel.camera)
    middle = one[:2, 2] / one[2, 2]
    moved = shift_px - (middle - np.round(middle))
    one = np.array([[1.0, 0.0, moved[0]], [0.0, 1.0, moved[1]], [0.0, 0.0, 1.0]]) @ one
    pitch_m = channel.emitter.pitch_m
    pitch_px = pitch_m * math.sqrt(abs(np.linalg.det(centre_scale(one))))
    corners = project(one, square(count * pitch_m / 2))[0]
    margin = MARGIN_PX + MARGIN_SIGMA * channel.camera.blur_px
    low, high = np.floor(corners.min(0) - margin), np.ceil(corners.max(0) + margin)
    width, height = (high - low).astype(int) + 1
    corner = (int(low[0]), int(low[1]))
    images = np.empty((height, width, count, count))
    still_leds, drift = np.zeros((count, count)), np.zeros((3, 3))
    for u in range(count):
        for v in range(count):
            lit, light = np.zeros((count, count)), np.zeros((height, width), np.float32)
            lit[u, v] = 1.0
            add_array(channel, one, drift, eye, (lit, still_leds, still_leds), Canvas(light, corner))
            images[:, :, u, v] = light
    steps = (np.arange(count) - (count - 1) / 2) * pitch_m
    grid = np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2)
    points = project(one, grid)[0] - low
    return ArrayImages(images, points, pitch_px, float(images.sum()) / (count * pitch_px) ** 2)


@cache
def symbol_levels(side: int, modulation: str) -> Floats:
    """Return the change of each LED's luminance, 0 to 1, by each symbol, (side, side, side * side)."""
    units = np.eye(side * side).reshape(-1, side, side)
    levels = haar.inverse_transform(units) / SLOTS if modulation == "haar" else 0.5 * units
    return np.moveaxis(levels, 0, -1)


@cache
def symbol_layers(side: int) -> Floats:
    """Return the layer of each symbol, (side * side,): 0 high, 1 middle, 2 low (section 5 of the air interface)."""
    half = np.arange(side) >= side // 2
    return (half[:, None].astype(np.float64) + half[None, :]).ravel()


@dataclass(frozen=True, slots=True)
class Looks:
    """What of the symbols can be told at a distance, of one unit of light and of noise."""

    # (symbols, symbols) inner products of the symbols' images at each place on the pixel grid
    gram: tuple[Floats, ...]
    # For each place (symbols, symbols) change of each sampled symbol by each sent one, and (symbols,) standard
    # deviation of the sampled ones in noise of 1
    sampled: tuple[tuple[Floats, Floats], ...]
    # (symbols,) layer of each symbol
    layer: Floats

    def information(self, kind: Kind, layer: int, snr: float) -> float:
        """Return the mean information of a layer's symbols in bit per coded bit."""
        ratios = [self._ratio(kind, look, layer, snr) for look in range(len(self.gram))]
        return float(binary_information(np.concatenate(ratios)).mean())

    def _ratio(self, kind: Kind, look: int, layer: int, snr: float) -> Floats:
        """Mean squared over variance, of each symbol of a layer."""
        of_layer = self.layer == layer
        if kind == "bound":
            return np.asarray(np.diag(self.gram[look])[of_layer] * snr**2)
        if kind == "sampled":
            changes, noise = (part[of_layer] for part in self.sampled[look])
            own = changes[np.arange(len(changes)), np.flatnonzero(of_layer)]
            disturbing = (changes**2).sum(1) - own**2
            return np.asarray(own**2 / (disturbing + (noise / snr) ** 2))
        rest = self.layer >= layer
        gram = self.gram[look][np.ix_(rest, rest)] * snr**2
        error = np.diag(np.linalg.inv(np.eye(len(gram)) + gram))[of_layer[rest]]
        return np.asarray((1 - error) / error)


def binary_information(ratio: Floats) -> Floats:
    """Return the mutual information in bit of +-1 and itself in Gaussian noise."""
    z = np.linspace(-6, 6, 97)
    weight = np.exp(-z * z / 2)
    llr = 2 * ratio[:, None] + 2 * np.sqrt(ratio[:, None]) * z
    # I = 1 - E log2(1 + exp(-L)), L normal of mean 2 ratio and variance 4 ratio
    return np.asarray(1 - np.logaddexp(0, -llr) @ weight / weight.sum() / math.log(2))


def looks_at(channel: ChannelSettings, signal: SignalSettings, distance_m: float) -> Looks:
    """Return what of the symbols can be told at a distance."""
    from heliograph.receive.decode.kernels import sample_cubic  # Numba is slow to import

    side = min(signal.side, LARGEST)
    levels = symbol_levels(side, signal.modulation)
    grams, sampled = [], []
    rng = np.random.default_rng(0)
    for shift in LOOKS_PX:
        images = array_images(channel, side, distance_m, shift)
        height, width = images.leds.shape[:2]
        symbols = images.leds.reshape(height, width, -1) @ levels.reshape(side * side, -1)
        flat = symbols.reshape(height * width, -1)
        grams.append(flat.T @ flat)

        noise = rng.standard_normal((NOISE_LOOKS, height, width))
        read = np.empty((side * side + NOISE_LOOKS, side * side))
        for image, out in zip([*np.moveaxis(symbols, 2, 0), *noise], read, strict=True):
            sample_cubic(np.ascontiguousarray(image), images.points, out)
        if signal.modulation == "haar":
            read = haar.decode(read.reshape(-1, side, side)).reshape(read.shape)
        changes, noise = read[: side * side].T, read[side * side :]
        layer = symbol_layers(side)
        # symbols of a layer have nearly the same noise, and more looks together
        rms = np.array([math.sqrt((noise[:, layer == k] ** 2).mean()) for k in layer])
        sampled.append((changes, rms))
    return Looks(tuple(grams), tuple(sampled), symbol_layers(side))


def needed(rate: float) -> float:
    """Return the information in bit per coded bit that a code needs."""
    rates, information = zip(*NEEDED, strict=True)
    return float(np.interp(rate, rates, information))


class Reach:
    """How far layers can be read: information by distance, computed where it is asked for and kept."""

    def __init__(self, settings: LinkSettings, all_on: float):
        channel = settings.channel
        self._channel, self._signal = channel, settings.signal
        light = all_on * channel.arrays[0].brightness
        self._snr = light / noise_share(channel, light)
        # Largest pitch that is looked at: what is nearer is seen better. Chosen: LEDs stand apart, by 8 standard
        # deviations of the reference link's blur
        self._nearest_m = channel.camera.focal_px * channel.emitter.pitch_m / 4.0
        self._looks: dict[float, Looks] = {}
        self._known: dict[tuple[Kind, Mode, str, float], float] = {}

    def information(self, kind: Kind, mode: Mode, layer: str, distance_m: float) -> float:
        """Return the information in bit per coded bit."""
        distance_m = max(distance_m, self._nearest_m)
        asked = (kind, mode, layer, distance_m)
        if asked not in self._known:
            if distance_m not in self._looks:
                self._looks[distance_m] = looks_at(self._channel, self._signal, distance_m)
            snr = self._snr * (1.0 if mode == "single" else math.sqrt(2))
            self._known[asked] = self._looks[distance_m].information(kind, LAYERS.index(layer), snr)
        return self._known[asked]

    def range_m(self, kind: Kind, mode: Mode, layer: str, rate: float, farthest_m: float) -> float:
        """Return the largest distance at which a layer can be read, in m; 0 where it cannot at all."""
        enough = needed(rate)

        def spare(distance_m: float) -> float:
            return self.information(kind, mode, layer, distance_m) - enough

        # the same distances for all layers and modes, so that each is computed once
        steps = max(0, math.ceil(math.log(farthest_m / self._nearest_m) / math.log(STEP)))
        grid = [min(self._nearest_m * STEP**step, farthest_m) for step in range(steps + 1)]
        return _crossing(spare, grid)


def _crossing(spare: Callable[[float], float], grid: list[float]) -> float:
    """Where something that falls along a grid gets to 0: its last point if it does not, 0 if it begins below."""
    if spare(grid[-1]) >= 0:
        return grid[-1]
    if spare(grid[0]) < 0:
        return 0.0
    low, high = 0, len(grid) - 1
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if spare(grid[middle]) >= 0 else (low, middle)
    above, below = spare(grid[low]), spare(grid[high])
    return grid[low] + (grid[high] - grid[low]) * above / (above - below)
