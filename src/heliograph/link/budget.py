"""The budget of a link before it is built: light, electrons, blur, and how far each layer should be read."""

import contextlib
import math
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from typing import Any

from heliograph.base.errors import SettingsError, shown
from heliograph.link.information import Kind, Reach, array_images, needed, noise_share
from heliograph.link.photometry import LightSettings
from heliograph.link.settings import LinkSettings
from heliograph.receive.detect.alternation import size_limits
from heliograph.receive.settings import SMALLEST_SIDE_PX
from heliograph.signal.formats import AGREED, Format, Mode
from heliograph.signal.packet import PacketFormat
from heliograph.signal.settings import LAYERS

PLAIN, SOFT = "plain", "soft"
"""The receivers whose reach is known."""

MOST_LIGHT = 1.0
"""Light of the array with every LED on, in full scales, above which no ranges are given: its brightest levels would be
one and the same."""

SEEN_LEDS, RESOLVED_PX = 6, 32.0
"""LEDs of a side by which an array's brightness is judged, and pitch in px above which it is judged at that pitch.
Chosen: an LED is then 16 standard deviations of the reference link's blur from the next."""

ROUNDING = 1e-3
"""Share of a period by which exposures and frames may differ from patterns without a note."""


@dataclass(frozen=True, slots=True)
class Spot:
    """An array as the camera sees it at a distance.

    Attributes
    ----------
    distance_m
        Distance to the array's plane in m.
    pitch_px
        Pixels from one LED to the next.
    side_px
        Pixels of a side of the array.
    electrons_led
        Electrons that a frame gets of an LED that is on for the whole exposure.
    electrons_px
        Electrons of a pixel with every LED on, where the array is not resolved.
    light
        The same in full scales.
    peak
        Light of the brightest pixel with every LED on, in full scales; it saturates above 1.
    noise
        Standard deviation of a pixel's noise at the array's mean light, in full scales.
    blur_px
        Standard deviation of an LED's image in px: lens, emitter and the pixel's own box.
    blur_pitches
        The same in pitches; the low layer fades from about 0.6 on.
    lens_px
        Blur in px that no lens of this f-number goes below: diffraction, and the focus at infinity.
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
    lens_px: float


@dataclass(frozen=True, slots=True)
class LayerReach:
    """How far a layer should be read, by a camera at rest.

    Attributes
    ----------
    receiver
        Name of the receiver, "plain" or "soft".
    mode
        Whether inverses follow the patterns, "paired", or not, "single".
    layer
        Priority of the layer, "high", "middle" or "low".
    rate
        Code rate in information bits per sent bit.
    range_m
        Distance in m up to which the code gets the information it needs: of "soft" by linear estimates and the layers
        above known, of "plain" from the luminances at the LEDs' places.
    most_m
        Distance in m up to which any receiver could read it, all other symbols known.
    here
        Information in bit per coded bit at the settings' distance, as for `range_m`.
    needed
        What the code needs of it.
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
    """What a link has, before it is built.

    Attributes
    ----------
    spot
        The array as the camera sees it at the settings' distance.
    candela
        Luminous intensity of an LED on its axis in cd that goes with this light.
    found_m
        Distances in m up to which the receivers find the array, by their names.
    layers
        Reach of each layer by receiver and mode; empty where the array saturates.
    notes
        What keeps the link from this budget, or the budget from holding; a line each.
    """

    spot: Spot
    candela: float
    found_m: dict[str, float]
    layers: tuple[LayerReach, ...]
    notes: tuple[str, ...]

    def plain(self) -> dict[str, Any]:
        """All of it by name, for JSON."""
        return asdict(self)


class Budgets:
    """Makes budgets; what is computed for one distance or mode is kept for the others of the same link."""

    def __init__(self, light: LightSettings):
        self.light = light
        self._reaches: dict[LinkSettings, Reach] = {}

    def of(self, settings: LinkSettings) -> Budget:
        """Return the budget of a link."""
        channel, light, read = settings.channel, self.light, _read(settings)
        all_on = light.all_on(channel)
        spot = _spot(settings, light, all_on)
        found = {name: found_m(settings, name) for name in (PLAIN, SOFT)}
        layers: tuple[LayerReach, ...] = ()
        if 0 < spot.light <= MOST_LIGHT:
            layers = tuple(self._layers(settings, read, all_on, found))
        return Budget(spot, light.candela_of(channel), found, layers, tuple(_notes(settings, light, spot)))

    def _layers(
        self, settings: LinkSettings, read: list[tuple[str, Format]], all_on: float, found: dict[str, float]
    ) -> list[LayerReach]:
        # the same link at any distance, whatever moves
        same = replace(settings, channel=replace(settings.channel, distance_m=1e4, speed_m_s=0.0, speed_profile=()))
        if same not in self._reaches:
            self._reaches[same] = Reach(settings, all_on)
        reach, at_m = self._reaches[same], settings.channel.distance_m + settings.channel.arrays[0].z_offset_m
        out = []
        for receiver, form in read:
            rates = dict(zip(LAYERS, form.rates(settings.signal.rate), strict=True))
            kind: Kind = "linear" if receiver == SOFT else "sampled"
            for layer, rate in rates.items():
                far, most = (reach.range_m(one, form.mode, layer, rate, found[receiver]) for one in (kind, "bound"))
                here = reach.information(kind, form.mode, layer, at_m)
                out.append(LayerReach(receiver, form.mode, layer, rate, far, most, here, needed(rate)))
        return out


def budget(settings: LinkSettings, light: LightSettings | None = None) -> Budget:
    """Return what a link has, before it is built: electrons, pixels, blur, and how far each layer should be read.

    Parameters
    ----------
    settings
        The link. The camera is taken to be at rest, in step, and to see whole patterns; vehicle and shake, and all
        arrays but the first, are left aside.
    light
        Intensity of the LEDs, f-number and efficiency; the defaults leave the light to ``channel.emitter.all_on``.

    Raises
    ------
    SettingsError
        The settings are no `LinkSettings`, or the light no `LightSettings`.
    """
    if not isinstance(settings, LinkSettings):
        raise SettingsError(f"a budget is of heliograph.load_settings(...), not {shown(settings)}")
    if not isinstance(light, LightSettings | None):
        raise SettingsError(f"light is a heliograph.LightSettings, not {shown(light)}")
    return Budgets(light or LightSettings()).of(settings)


def _read(settings: LinkSettings) -> list[tuple[str, Format]]:
    """What the receivers read: the formats sent, or both modes where none is named; an error where none can be sent."""
    named = list(settings.transmit.formats)
    for one in named or [AGREED]:
        PacketFormat(settings.signal, one).layers  # noqa: B018 - a packet may be too small for a codeword
    if not named:
        named, single = [AGREED], Format(mode="single")
        with contextlib.suppress(SettingsError):  # this signal has no single mode
            if PacketFormat(settings.signal, single).layers:
                named.append(single)
    plain = [] if settings.transmit.formats else [(PLAIN, AGREED)]
    return plain + [(SOFT, one) for one in named]


def found_m(settings: LinkSettings, receiver: str) -> float:
    """Largest distance at which a receiver finds the array."""
    detect = settings.receive.detect
    least, _ = size_limits(detect.min_side_px or SMALLEST_SIDE_PX[receiver], detect.max_side_px)
    return settings.signal.side * settings.channel.emitter.pitch_m * settings.channel.camera.focal_px / least


def _spot(settings: LinkSettings, light: LightSettings, all_on: float) -> Spot:
    channel = settings.channel
    camera, emitter, place = channel.camera, channel.emitter, channel.arrays[0]
    distance_m = channel.distance_m + place.z_offset_m
    if distance_m <= 0:
        raise SettingsError(f"the array is {-distance_m:g} m behind the camera; raise channel.arrays.0.z_offset_m")
    pitch_px = emitter.pitch_m * camera.focal_px / distance_m
    # nearer, LEDs stand apart, and look no brighter
    near = array_images(channel, SEEN_LEDS, distance_m * max(1.0, pitch_px / RESOLVED_PX), (0.0, 0.0))
    all_on *= place.brightness
    disc_px = emitter.diameter_m / 4 * pitch_px / emitter.pitch_m
    blur_px = math.sqrt(camera.blur_px**2 + disc_px**2 + 1 / 12)
    electrons_px = all_on * near.light * channel.sensor.full_well_e
    return Spot(
        distance_m=distance_m,
        pitch_px=pitch_px,
        side_px=settings.signal.side * pitch_px,
        electrons_led=electrons_px * pitch_px**2,
        electrons_px=electrons_px,
        light=all_on * near.light,
        peak=all_on * near.peak,
        noise=noise_share(channel, all_on * near.light),
        blur_px=blur_px,
        blur_pitches=blur_px / pitch_px,
        lens_px=light.lens_blur_px(channel, distance_m),
    )


def _notes(settings: LinkSettings, light: LightSettings, spot: Spot) -> Iterator[str]:
    """What keeps the link from its budget, or the budget from holding."""
    camera, period_s = settings.channel.camera, settings.signal.pattern_period_s
    if spot.light > MOST_LIGHT:
        # light that is advised where it is too much: that of the reference link
        stop = light.f_number * math.sqrt(spot.light / 0.8)
        yield (
            f"the array saturates, {spot.light:.3g} full scales with every LED on: close the lens to f/{stop:.2g}, or "
            "expose for a shorter time; no ranges are given"
        )
    elif spot.light < settings.receive.detect.min_contrast:
        yield (
            f"the array is too dim to be looked for, {spot.light:.2g} of full scale with every LED on: open the lens, "
            "or lower receive.detect.min_contrast"
        )
    if camera.fps * period_s < 1 - ROUNDING:
        yield f"{camera.fps:g} frames/s are fewer than the {1 / period_s:g} patterns a second: some are never seen"
    if camera.exposure_s < period_s * (1 - ROUNDING):
        yield (
            f"an exposure of {camera.exposure_s * 1e3:g} ms sees a part of each pattern of {period_s * 1e3:g} ms; the "
            "ranges hold for whole ones"
        )
    if spot.lens_px > camera.blur_px:
        yield (
            f"a lens of f/{light.f_number:g} blurs by {spot.lens_px:.2g} px at {spot.distance_m:g} m, more than "
            f"channel.camera.blur_px={camera.blur_px:g}: raise that"
        )
    place = settings.channel.arrays[0]
    x, y = (camera.focal_px * across / spot.distance_m for across in (place.x_m, place.y_m))
    if abs(x) > camera.width / 2 or abs(y) > camera.height / 2:
        yield f"at {spot.distance_m:g} m the array is not in the picture: {x:+.0f}, {y:+.0f} px from its middle"
