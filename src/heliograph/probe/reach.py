"""Estimated reach of each layer, from the light, noise and blur of an array in a film.

The model moves the array farther away: its pitch shrinks, while gray level, noise and blur in px stay. The link budget
gives the information in the symbols of each layer: for the receiver "soft" by linear MMSE with decoded higher layers,
for the receiver "plain" from the light at each LED with all other symbols as noise.
"""

from bisect import bisect_left
from collections.abc import Mapping
from dataclasses import replace
from functools import cache
from math import inf

import numpy as np

from heliograph.base.threads import one_thread
from heliograph.link.budget import Kind, SymbolImages, required_information
from heliograph.receive.decode.per_led import at_leds
from heliograph.receive.detect.alternation import size_limits
from heliograph.receive.geometry.footprint import footprints, to_quarters
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.geometry.window import RIM_PX, window_around
from heliograph.receive.observe.cutout import Noise
from heliograph.receive.observe.statistics import light_of_symbols, transform_quarters
from heliograph.receive.settings import SMALLEST_SIDE_PX
from heliograph.signal.settings import LAYERS, MULTIPLICITY, SignalSettings

MAX_SIDE = 32  # maximum LEDs per row: the matrices of 64 x 64 LEDs take minutes
MAX_PITCH_PX = 3.0  # maximum pitch: receivers reduce nearer arrays to it

_KINDS: dict[str, Kind] = {"plain": "sampled", "soft": "linear"}


Reach = Mapping[str, Mapping[str, float]]
"""Distance in m by receiver and layer; 0 if a layer is decoded nowhere, infinite beyond all tested distances."""


@one_thread()
def reaches(
    pose: Pose, gain: float, noise: Noise, distance_m: float, signal: SignalSettings, smallest_px: float | None = None
) -> Reach:
    """Estimate the reach of each layer for both receivers."""
    if signal.side > MAX_SIDE or (signal.modulation, signal.header) != ("haar", "m_sequence") or gain <= 0:
        return {}
    # distances over the distance in the film, to 12 times as far
    steps = [max(0.25, pose.pitch / MAX_PITCH_PX) * 1.03**step for step in range(132)]
    images = cache(lambda step, kind: _symbol_images(replace(pose, pitch=pose.pitch / steps[step]), signal.side, kind))
    snr = gain / noise.lit**0.5

    def end_m(kind: Kind, layer: int) -> float:
        required = required_information(getattr(signal.rate, LAYERS[layer]))
        numbers = range(len(steps))
        count = bisect_left(numbers, True, key=lambda step: images(step, kind).information(kind, layer, snr) < required)
        return inf if count == len(steps) else distance_m * steps[count - 1] if count else 0.0

    reach = {}
    for receiver, kind in _KINDS.items():
        smallest, _ = size_limits(smallest_px or SMALLEST_SIDE_PX[receiver], inf)
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
