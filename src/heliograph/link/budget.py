"""Link budget before construction, or from a film: light, electrons, blur, and the range of each layer.

Ranges follow from the mutual information of the symbols in r = A d + n. A has the symbol images as the channel renders
them, d = +-1, and n is white Gaussian noise. Pose, blur and brightness are known, and the scene is static. A pattern
and the inverse count as a single observation at half the noise power. Fog and rain dim the array and add airlight;
glare adds shot noise as at the picture centre; the budget omits the halo of fog and drops on the windscreen.

======== ==================================================================================================
linear   Linear MMSE with higher layers known, the layer and lower layers unknown. A lower bound for receivers
         that cancel decoded layers.
bound    Matched filter with all other symbols known. An upper bound for every receiver.
sampled  Luminance at the LED positions, as in the receiver "plain". Other symbols act as noise.
======== ==================================================================================================
"""

import contextlib
import math
from bisect import bisect_left
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from typing import Any, Literal

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.base.errors import SettingsError, shown
from heliograph.base.threads import one_thread
from heliograph.channel.render import Canvas, add_array
from heliograph.channel.scene import CameraPose, centre_scale, homography, project, square
from heliograph.channel.settings import ChannelSettings
from heliograph.channel.weather import seen, transmission
from heliograph.link.photometry import LightSettings
from heliograph.link.settings import LinkSettings
from heliograph.receive.decode.per_led import at_leds
from heliograph.receive.detect.alternation import size_limits
from heliograph.receive.geometry.footprint import footprints, to_quarters
from heliograph.receive.geometry.kernels import sample_cubic
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.geometry.window import RIM_PX, window_around
from heliograph.receive.observe.cutout import Noise
from heliograph.receive.observe.statistics import light_of_symbols, transform_quarters
from heliograph.receive.settings import SMALLEST_SIDE_PX
from heliograph.signal import haar
from heliograph.signal.formats import AGREED, Format, Mode
from heliograph.signal.packet import PacketFormat
from heliograph.signal.pwm import SLOTS
from heliograph.signal.settings import LAYERS, MULTIPLICITY, SignalSettings

Kind = Literal["linear", "bound", "sampled"]

REQUIRED_INFORMATION = (
    (1 / 3, 0.408), (2 / 5, 0.476), (1 / 2, 0.583), (3 / 5, 0.690), (2 / 3, 0.753), (3 / 4, 0.824), (5 / 6, 0.892),
    (9 / 10, 0.946), (1.0, 1.0),
)  # fmt: skip
"""Code rate, and information in bit per coded bit for 1 % wrong codewords of 3072 bits: ``benchmarks.budget needs``,
log-MAP, 8 iterations. Codewords of 6144 bits need 0.01 less."""

MAX_SIDE = 16
"""Largest side of a simulated array in LEDs; larger arrays are represented by a section. Cost grows as side^6."""

GRID_SHIFTS_PX = tuple(((0.5 + 0.7548777 * k) % 1 - 0.5, (0.5 + 0.5698403 * k) % 1 - 0.5) for k in range(5))
"""Positions on the pixel grid for averaging: a low-discrepancy sequence with steps 1/g and 1/g^2, g^3 = g + 1."""

MAX_LIGHT = 1.0  # maximum light in full scales with all LEDs on; above, bright levels saturate and no ranges are given


@dataclass(frozen=True, slots=True)
class Spot:
    """Image of an array at a distance.

    Attributes
    ----------
    distance_m
        Distance to the array plane in m.
    pitch_px
        LED pitch in px.
    side_px
        Side of the array in px.
    electrons_led
        Electrons per frame from an LED that is on for the full exposure.
    electrons_px
        Electrons per pixel with all LEDs on, for an unresolved array.
    light
        The same in full scales.
    peak
        Light of the brightest pixel with all LEDs on, in full scales; a value above 1 saturates.
    noise
        Standard deviation of the pixel noise at the mean light of the array, in full scales.
    blur_px
        Standard deviation of an LED image in px: lens, emitter and pixel area.
    blur_pitches
        The same in pitches; the low layer fades above about 0.6.
    electrons_bit
        Photoelectrons per information bit: light of a packet over the information bits of all codewords.
    lens_px
        Minimum blur in px at this f-number: diffraction, and defocus for a focus at infinity.
    """

    distance_m: float
    pitch_px: float
    side_px: float
    electrons_led: float
    electrons_px: float
    light: float
    peak: float
    noise: float
    blur_px: float
    blur_pitches: float
    electrons_bit: float
    lens_px: float


@dataclass(frozen=True, slots=True)
class LayerReach:
    """Range of a layer for a static camera.

    Attributes
    ----------
    receiver
        Receiver name, "plain" or "soft".
    mode
        "paired" (patterns with inverses) or "single".
    layer
        Priority of the layer, "high", "middle" or "low".
    rate
        Code rate in information bits per sent bit.
    range_m
        Distance in m up to which the code gets the required information: for "soft" by linear estimation with known
        higher layers, for "plain" from luminances at the LED positions.
    most_m
        Upper bound of the range in m for every receiver, with all other symbols known.
    here
        Information in bit per coded bit at the distance in the settings, as for `range_m`.
    needed
        Information in bit per coded bit that the code requires.
    """

    receiver: str
    mode: Mode
    layer: str
    rate: float
    range_m: float
    most_m: float
    here: float
    needed: float


@dataclass(frozen=True, slots=True)
class Budget:
    """Link budget.

    Attributes
    ----------
    spot
        Image of the array at the distance in the settings.
    candela
        On-axis luminous intensity of an LED in cd for this light.
    found_m
        Detection range in m by receiver.
    layers
        Range of each layer by receiver and mode; empty if the array saturates.
    notes
        Limitations of the link or the budget, a line each.
    """

    spot: Spot
    candela: float
    found_m: dict[str, float]
    layers: tuple[LayerReach, ...]
    notes: tuple[str, ...]

    def plain(self) -> dict[str, Any]:
        """Return the budget as plain values for JSON."""
        return asdict(self)


def budgets(links: Iterable[LinkSettings], light: LightSettings) -> Iterator[Budget]:
    """Yield the budget of each link; links that differ in distance and speed share the renderings."""
    estimators: dict[LinkSettings, RangeEstimator] = {}
    for settings in links:
        channel, formats, all_on = settings.channel, _received_formats(settings), light.all_on(settings.channel)
        spot = _spot(settings, light, all_on, formats[0][1])
        found = {name: detection_range_m(settings, name) for name in ("plain", "soft")}
        layers: tuple[LayerReach, ...] = ()
        if 0 < spot.light <= MAX_LIGHT:
            key = replace(settings, channel=replace(channel, distance_m=1e4, speed_m_s=0.0, speed_profile=()))
            estimator = estimators.setdefault(key, RangeEstimator(settings, all_on))
            layers = tuple(_layers(settings, formats, estimator, found))
        yield Budget(spot, light.candela_of(channel), found, layers, tuple(_notes(settings, light, spot)))


def _layers(
    settings: LinkSettings, formats: list[tuple[str, Format]], estimator: "RangeEstimator", found: dict[str, float]
) -> Iterator[LayerReach]:
    at_m = settings.channel.distance_m + settings.channel.arrays[0].z_offset_m
    for receiver, form in formats:
        kind: Kind = "linear" if receiver == "soft" else "sampled"
        for layer, rate in zip(LAYERS, form.rates(settings.signal.rate), strict=True):
            reach, bound = (estimator.range_m(k, form.mode, layer, rate, found[receiver]) for k in (kind, "bound"))
            here = estimator.information(kind, form.mode, layer, at_m)
            yield LayerReach(receiver, form.mode, layer, rate, reach, bound, here, required_information(rate))


def budget(settings: LinkSettings, light: LightSettings | None = None) -> Budget:
    """Return the budget of a link: electrons, pixels, blur, and the range of each layer.

    Parameters
    ----------
    settings
        Link settings. The model assumes a static camera that is synchronous and exposes full patterns; vehicle, shake
        and further arrays are ignored.
    light
        LED intensity, f-number and efficiency; by default, the light is ``channel.emitter.all_on``.

    Raises
    ------
    SettingsError
        The settings are no `LinkSettings`, or the light is no `LightSettings`.
    """
    if not isinstance(settings, LinkSettings):
        raise SettingsError(f"a budget is of heliograph.load_settings(...), not {shown(settings)}")
    if not isinstance(light, LightSettings | None):
        raise SettingsError(f"light is a heliograph.LightSettings, not {shown(light)}")
    return next(budgets([settings], light or LightSettings()))


def _received_formats(settings: LinkSettings) -> list[tuple[str, Format]]:
    """Return receiver and format pairs: the formats in the settings, by default both modes; check the packet sizes."""
    formats = list(settings.transmit.formats)
    for form in formats or [AGREED]:
        PacketFormat(settings.signal, form).layers  # noqa: B018 - raises if a packet has no room for a codeword
    if formats:
        return [("soft", form) for form in formats]
    out = [("plain", AGREED), ("soft", AGREED)]
    single = Format(mode="single")
    with contextlib.suppress(SettingsError):  # the signal has no single mode
        if PacketFormat(settings.signal, single).layers:
            out.append(("soft", single))
    return out


def detection_range_m(settings: LinkSettings, receiver: str) -> float:
    """Return the largest distance at which a receiver detects the array."""
    detect = settings.receive.detect
    min_side_px, _ = size_limits(detect.min_side_px or SMALLEST_SIDE_PX[receiver], detect.max_side_px)
    return settings.signal.side * settings.channel.emitter.pitch_m * settings.channel.camera.focal_px / min_side_px


def _spot(settings: LinkSettings, light: LightSettings, all_on: float, form: Format) -> Spot:
    channel, packet = settings.channel, PacketFormat(settings.signal, form)
    camera, emitter, place = channel.camera, channel.emitter, channel.arrays[0]
    distance_m = channel.distance_m + place.z_offset_m
    if distance_m <= 0:
        raise SettingsError(f"the array is {-distance_m:g} m behind the camera; raise channel.arrays.0.z_offset_m")
    pitch_px = emitter.pitch_m * camera.focal_px / distance_m
    # 6 LEDs give the brightness; above a pitch of 32 px, LEDs are separate and the brightness is constant
    image_m = distance_m * max(1.0, pitch_px / 32.0)
    image = array_images(channel, 6, image_m, (0.0, 0.0))
    all_on *= place.brightness
    blur_px = math.sqrt(camera.blur_px**2 + (emitter.diameter_m / 4 * pitch_px / emitter.pitch_m) ** 2 + 1 / 12)
    electrons_px = all_on * image.light * channel.sensor.full_well_e
    # an oblique view has a smaller area per LED
    electrons_led = electrons_px * (image.pitch_px * image_m / distance_m) ** 2
    # on average, half of the LEDs are lit
    electrons = settings.signal.side**2 * electrons_led * packet.settings.packet_s * camera.fps / 2
    return Spot(
        distance_m=distance_m,
        pitch_px=pitch_px,
        side_px=settings.signal.side * pitch_px,
        electrons_led=electrons_led,
        electrons_px=electrons_px,
        light=all_on * image.light,
        peak=all_on * float(image.leds.sum((2, 3)).max()),
        noise=noise_share(channel, all_on * image.light, distance_m),
        blur_px=blur_px,
        blur_pitches=blur_px / pitch_px,
        electrons_bit=electrons / sum(layer.codewords * layer.code.k for layer in packet.layers.values()),
        lens_px=light.lens_blur_px(channel, distance_m),
    )


def _notes(settings: LinkSettings, light: LightSettings, spot: Spot) -> Iterator[str]:
    """Yield limitations of the link and the budget."""
    camera, period_s = settings.channel.camera, settings.signal.pattern_period_s
    rounding = 1e-3  # relative difference of times that is ignored
    if spot.light > MAX_LIGHT:
        stop = light.f_number * math.sqrt(spot.light / 0.8)  # light of the reference link
        yield (
            f"the array saturates, {spot.light:.3g} full scales with every LED on: close the lens to f/{stop:.2g}, or "
            "expose for a shorter time; no ranges are given"
        )
    elif spot.light < settings.receive.detect.min_contrast:
        yield (
            f"the array is too dim to be detected, {spot.light:.2g} of full scale with every LED on: open the lens, "
            "or lower receive.detect.min_contrast"
        )
    if camera.fps * period_s < 1 - rounding:
        yield f"{camera.fps:g} frames/s are fewer than the {1 / period_s:g} patterns a second: some are missed"
    if camera.exposure_s < period_s * (1 - rounding):
        yield (
            f"an exposure of {camera.exposure_s * 1e3:g} ms covers a part of each pattern of {period_s * 1e3:g} ms; "
            "the ranges assume full patterns"
        )
    if spot.lens_px > camera.blur_px:
        yield (
            f"a lens of f/{light.f_number:g} blurs by {spot.lens_px:.2g} px at {spot.distance_m:g} m, more than "
            f"channel.camera.blur_px={camera.blur_px:g}: raise channel.camera.blur_px"
        )
    place = settings.channel.arrays[0]
    x, y = (camera.focal_px * offset_m / spot.distance_m for offset_m in (place.x_m, place.y_m))
    if abs(x) > camera.width / 2 or abs(y) > camera.height / 2:
        yield f"at {spot.distance_m:g} m the array is not in the picture: {x:+.0f}, {y:+.0f} px from the centre"


def noise_share(channel: ChannelSettings, all_on: float, distance_m: float = 0.0) -> float:
    """Return the standard deviation of the pixel noise at the mean light of the array, in full scales."""
    sensor, panel = channel.sensor, seen(channel.weather, channel.emitter.panel_level, distance_m)
    mean_e = sensor.full_well_e * (all_on / 2 + panel + channel.weather.glare)
    # EMVA 1288: sigma^2 = sigma_d^2 + mu_e, and 1/12 DN^2 of quantisation
    return math.sqrt((sensor.dark_noise_e**2 + mean_e) / sensor.full_well_e**2 + 1 / 12 / sensor.full_scale**2)


@dataclass(frozen=True, slots=True)
class ArrayImages:
    """Images of the LEDs of an array of at most MAX_SIDE x MAX_SIDE LEDs."""

    # (rows, columns, n, n) pixel light of single LEDs; an unresolved array with all LEDs on has light 1 on axis
    leds: Floats
    # (n * n, 2) LED positions (x, y) in px of the image
    points: Floats
    # LED pitch in px: square root of the area per LED
    pitch_px: float
    # Light with all LEDs on, relative to the on-axis value; below 1 for an oblique view
    light: float


def array_images(channel: ChannelSettings, side: int, distance_m: float, shift_px: tuple[float, float]) -> ArrayImages:
    """Render each LED of the first array for a static camera."""
    still = np.zeros(())
    count, place = min(side, MAX_SIDE), channel.arrays[0]
    plane, eye = homography(CameraPose(*6 * [still]), still, place, distance_m - place.z_offset_m, channel.camera)
    centre = plane[:2, 2] / plane[2, 2]
    dx, dy = shift_px - (centre - np.round(centre))
    plane = np.array([[1.0, 0.0, dx], [0.0, 1.0, dy], [0.0, 0.0, 1.0]]) @ plane
    pitch_m = channel.emitter.pitch_m
    pitch_px = pitch_m * math.sqrt(abs(np.linalg.det(centre_scale(plane))))
    corners = project(plane, square(count * pitch_m / 2))[0]
    margin = 2 + 4 * channel.camera.blur_px  # beyond it lies less than 1e-4 of the light of an LED
    low, high = np.floor(corners.min(0) - margin), np.ceil(corners.max(0) + margin)
    width, height = (high - low).astype(int) + 1
    corner = (int(low[0]), int(low[1]))
    images = np.empty((height, width, count, count))
    still_leds, drift = np.zeros((count, count)), np.zeros((3, 3))
    for u, v in np.ndindex(count, count):
        lit, light = np.zeros((count, count)), np.zeros((height, width), np.float32)
        lit[u, v] = 1.0
        add_array(channel, plane, drift, eye, (lit, still_leds, still_leds), Canvas(light, corner))
        images[:, :, u, v] = light
    steps = (np.arange(count) - (count - 1) / 2) * pitch_m
    points = project(plane, np.stack(np.meshgrid(steps, steps), -1).reshape(-1, 2))[0] - low
    return ArrayImages(images, points, pitch_px, float(images.sum()) / (count * pitch_px) ** 2)


@cache
def symbol_levels(side: int, modulation: str) -> Floats:
    """Return the luminance change of each LED, 0 to 1, by each symbol, (side, side, side * side)."""
    units = np.eye(side * side).reshape(-1, side, side)
    levels = haar.inverse_transform(units) / SLOTS if modulation == "haar" else 0.5 * units
    return np.moveaxis(levels, 0, -1)


@cache
def symbol_layers(side: int) -> Floats:
    """Return the layer of each symbol, (side * side,): 0 high, 1 middle, 2 low (section 5 of the air interface)."""
    half = np.arange(side) >= side // 2
    return (half[:, None].astype(np.float64) + half[None, :]).ravel()


@dataclass(frozen=True, slots=True)
class SymbolImages:
    """Symbol images at a distance, for unit light and unit noise."""

    # (symbols, symbols) inner products of the symbol images at each position on the pixel grid
    gram: tuple[Floats, ...]
    # At each position, (symbols, symbols) response of each sampled symbol to each sent symbol, and (symbols,) standard
    # deviation of sampled symbols in unit noise
    sampled: tuple[tuple[Floats, Floats], ...]
    # (symbols,) layer of each symbol
    layer: Floats

    def information(self, kind: Kind, layer: int, snr: float) -> float:
        """Return the mean information of the symbols of a layer in bit per coded bit."""
        ratios = [self._snr(kind, position, layer, snr) for position in range(len(self.gram))]
        return float(binary_information(np.concatenate(ratios)).mean())

    def _snr(self, kind: Kind, position: int, layer: int, snr: float) -> Floats:
        """Return mean squared over variance of each symbol of a layer."""
        of_layer = self.layer == layer
        if kind == "bound":
            return np.asarray(np.diag(self.gram[position])[of_layer] * snr**2)
        if kind == "sampled":
            responses, noise = (part[of_layer] for part in self.sampled[position])
            wanted = responses[np.arange(len(responses)), np.flatnonzero(of_layer)]
            interference = (responses**2).sum(1) - wanted**2
            return np.asarray(wanted**2 / (interference + (noise / snr) ** 2))
        unknown = self.layer >= layer
        gram = self.gram[position][np.ix_(unknown, unknown)] * snr**2
        error = np.diag(np.linalg.inv(np.eye(len(gram)) + gram))[of_layer[unknown]]
        return np.asarray((1 - error) / error)


def binary_information(ratio: Floats) -> Floats:
    """Return the mutual information in bit of a +-1 symbol observed in Gaussian noise."""
    z = np.linspace(-6, 6, 97)
    weight = np.exp(-z * z / 2)
    llr = 2 * ratio[:, None] + 2 * np.sqrt(ratio[:, None]) * z
    # I = 1 - E log2(1 + exp(-L)), L normal with mean 2 ratio and variance 4 ratio
    return np.asarray(1 - np.logaddexp(0, -llr) @ weight / weight.sum() / math.log(2))


def symbol_images(channel: ChannelSettings, signal: SignalSettings, distance_m: float) -> SymbolImages:
    """Render the symbols of the first array at a distance."""
    side, n_noise = min(signal.side, MAX_SIDE), 64
    levels, layer = symbol_levels(side, signal.modulation), symbol_layers(side)
    grams, sampled = [], []
    rng = np.random.default_rng(0)
    for shift in GRID_SHIFTS_PX:
        images = array_images(channel, side, distance_m, shift)
        height, width = images.leds.shape[:2]
        symbols = images.leds.reshape(height, width, -1) @ levels.reshape(side * side, -1)
        flat = symbols.reshape(height * width, -1)
        grams.append(flat.T @ flat)

        noise = rng.standard_normal((n_noise, height, width))
        samples = np.empty((side * side + n_noise, side * side))
        for image, out in zip([*np.moveaxis(symbols, 2, 0), *noise], samples, strict=True):
            sample_cubic(np.ascontiguousarray(image), images.points, out)
        if signal.modulation == "haar":
            samples = haar.decode(samples.reshape(-1, side, side)).reshape(samples.shape)
        responses, noise = samples[: side * side].T, samples[side * side :]
        # symbols of a layer have nearly equal noise
        rms = np.array([math.sqrt((noise[:, layer == k] ** 2).mean()) for k in layer])
        sampled.append((responses, rms))
    return SymbolImages(tuple(grams), tuple(sampled), layer)


def required_information(rate: float) -> float:
    """Return the information in bit per coded bit that a code requires."""
    rates, information = zip(*REQUIRED_INFORMATION, strict=True)
    return float(np.interp(rate, rates, information))


class RangeEstimator:
    """Information by distance and layer ranges of a link, with cached renderings."""

    def __init__(self, settings: LinkSettings, all_on: float):
        channel = settings.channel
        self._channel, self._light = channel, all_on * channel.arrays[0].brightness
        # a pitch of 4 px separates the LEDs; nearer arrays have at least the same information
        self._nearest_m = channel.camera.focal_px * channel.emitter.pitch_m / 4.0
        self._images = cache(partial(symbol_images, channel, settings.signal))
        self._information: dict[tuple[object, ...], float] = {}

    def information(self, kind: Kind, mode: Mode, layer: str, distance_m: float) -> float:
        """Return the information in bit per coded bit."""
        key = (kind, mode, layer, distance_m)
        if key not in self._information:
            arrived = self._light * transmission(self._channel.weather, distance_m)
            snr = self._light / noise_share(self._channel, arrived, distance_m) * (1.0 if mode == "single" else 2**0.5)
            images = self._images(max(distance_m, self._nearest_m))
            self._information[key] = images.information(kind, LAYERS.index(layer), snr)
        return self._information[key]

    def range_m(self, kind: Kind, mode: Mode, layer: str, rate: float, max_m: float) -> float:
        """Return the range of a layer in m, at most `max_m`; 0 for an unreadable layer."""
        required = required_information(rate)
        # common distances for all layers and modes share the renderings
        step = 1.08
        steps = max(0, math.ceil(math.log(max_m / self._nearest_m) / math.log(step)))
        grid = [min(self._nearest_m * step**k, max_m) for k in range(steps + 1)]

        def margin(distance_m: float) -> float:
            return self.information(kind, mode, layer, distance_m) - required

        if margin(grid[-1]) >= 0:
            return grid[-1]
        if not (end := bisect_left(grid, True, key=lambda distance_m: margin(distance_m) < 0)):
            return 0.0
        above, below = margin(grid[end - 1]), margin(grid[end])
        return grid[end - 1] + (grid[end] - grid[end - 1]) * above / (above - below)


REACH_MAX_SIDE = 32  # maximum LEDs per row: the matrices of 64 x 64 LEDs take minutes
REACH_MAX_PITCH_PX = 3.0  # maximum pitch: receivers reduce nearer arrays to it

_KINDS: dict[str, Kind] = {"plain": "sampled", "soft": "linear"}

Reach = Mapping[str, Mapping[str, float]]
"""Distance in m by receiver and layer; 0 if a layer is decoded nowhere, infinite beyond all tested distances."""


@one_thread()
def reaches(
    pose: Pose, gain: float, noise: Noise, distance_m: float, signal: SignalSettings, smallest_px: float | None = None
) -> Reach:
    """Estimate the reach of each layer for both receivers, from the light, noise and blur of an array in a film.

    The model moves the array farther away: its pitch shrinks, while gray level, noise and blur in px stay.
    """
    if signal.side > REACH_MAX_SIDE or (signal.modulation, signal.header) != ("haar", "m_sequence") or gain <= 0:
        return {}
    # distances over the distance in the film, to 12 times as far
    steps = [max(0.25, pose.pitch / REACH_MAX_PITCH_PX) * 1.03**step for step in range(132)]
    images = cache(lambda step, kind: _symbol_images(replace(pose, pitch=pose.pitch / steps[step]), signal.side, kind))
    snr = gain / noise.lit**0.5

    def end_m(kind: Kind, layer: int) -> float:
        required = required_information(getattr(signal.rate, LAYERS[layer]))
        numbers = range(len(steps))
        count = bisect_left(numbers, True, key=lambda step: images(step, kind).information(kind, layer, snr) < required)
        return math.inf if count == len(steps) else distance_m * steps[count - 1] if count else 0.0

    reach = {}
    for receiver, kind in _KINDS.items():
        smallest, _ = size_limits(smallest_px or SMALLEST_SIDE_PX[receiver], math.inf)
        detected_m = distance_m * signal.side * pose.pitch / smallest
        reach[receiver] = {layer: min(end_m(kind, number), detected_m) for number, layer in enumerate(LAYERS)}
    return reach


@one_thread()
def high_information(receiver: str, pose: Pose, gain: float, noise: Noise, side: int) -> float:
    """Return the information in the high layer in bit per sent bit."""
    return _symbol_images(pose, side, _KINDS[receiver]).information(_KINDS[receiver], 0, gain / noise.lit**0.5)


def _symbol_images(pose: Pose, side: int, kind: Kind) -> SymbolImages:
    """Render the symbols of an array in differences of pattern and inverse; sample only for the kind "sampled"."""
    # neither on a pixel nor between two
    pose = replace(pose, x=0.29, y=0.29)
    x, y, width, height = window_around(pose, side, RIM_PX)
    light = light_of_symbols(footprints(pose, (x, y), (height, width), side)).astype(np.float64)
    layers = np.repeat(np.arange(3.0), np.array(MULTIPLICITY) * (side // 2) ** 2)
    if kind != "sampled":
        return SymbolImages((light @ light.T,), (), layers)
    # neighbouring LEDs share pixels and noise: sample 64 images of noise, 3 % standard error at most
    white = np.random.default_rng(0).standard_normal((64, height, width))
    images = [*light.reshape(-1, height, width), *white]
    samples = np.array([to_quarters(at_leds(image, (x, y), pose, side)) for image in images])
    responses, noise = np.split(transform_quarters(samples.T), [side * side], axis=1)
    return SymbolImages((light @ light.T,), ((responses, np.sqrt((noise**2).mean(1))),), layers)
