"""How far each layer may be read: an estimate, from what a film shows of an array's light, its noise and its blur.

The same array is put farther away in thought: its pitch shrinks, while its gray level, the noise and the blur in px
stay. Symbols of +-1 with independent noise of the signal to noise ratio r hold 1 - E log2(1 + exp(-2 r - 2 sqrt(r)
z)) bit each, z normal. "soft" estimates symbols by linear MMSE, whose posterior covariance S gives r = 1 / S_ii - 1,
layer after layer, those before being known once they can be decoded. "plain" takes the light at each LED's place for
its own; what it gets of other symbols counts as noise. A layer is read where its symbols hold `NEEDED` times its
code's rate.
"""

from dataclasses import dataclass, replace
from functools import cache, lru_cache
from math import inf

import numpy as np

from heliograph.base.arrays import TINY, Floats
from heliograph.base.threads import one_thread
from heliograph.receive.decode.per_led import at_leds
from heliograph.receive.detect.alternation import size_limits
from heliograph.receive.equalise.lmmse import equalise
from heliograph.receive.geometry import kernels as image_kernels
from heliograph.receive.geometry.footprint import to_grid
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.geometry.window import RIM_PX, window_around
from heliograph.receive.observe.cutout import RING_PX, Cutout
from heliograph.receive.observe.noise import Noise
from heliograph.receive.observe.statistics import leds_of, whiten
from heliograph.receive.settings import SMALLEST_SIDE_PX
from heliograph.signal.settings import LAYERS, MULTIPLICITY, SignalSettings

NEEDED = 1.3
"""Information in LLRs over a code's rate from which on it is decoded: the turbo code of rate 1/3 and 1000 bits needs
0.43 bit per bit."""

FARTHEST, NEAREST = 12.0, 0.25
"""Distances that are looked at, over that of the film."""

STEP = 1.03
"""Ratio of two distances between which a layer's end is not told."""

MOST_SIDE = 32
"""Most LEDs in a row of an array whose reach is estimated: the matrices of 64 x 64 LEDs take minutes."""

NEAR_PITCH_PX = 3.0
"""Largest pitch in px that is looked at: nearer arrays are reduced to it."""

OFF_CENTRE = 0.29
"""Place in px of the array's centre off that of a pixel: neither on a pixel nor between two."""


@dataclass(frozen=True, slots=True)
class Reach:
    """How far a layer is expected to be read."""

    # Whose reach it is, "plain" or "soft"
    receiver: str
    # Distance in m up to which each layer is read, by layer; 0 where it is read nowhere, infinite where the end lies
    # beyond all distances looked at
    distance_m: dict[str, float]
    # Distance in m up to which the array is as large as what the receiver looks for
    found_m: float


@one_thread()  # its matrices are as small as a receiver's
def reaches(
    pose: Pose, gain: float, noise: Noise, distance_m: float, signal: SignalSettings, smallest_px: float | None = None
) -> tuple[Reach, ...]:
    """How far each layer is expected to be read by both receivers."""
    if signal.side > MOST_SIDE or signal.modulation != "haar" or gain <= 0:
        return ()
    out = []
    for receiver in ("plain", "soft"):
        least_px, _ = size_limits(smallest_px or SMALLEST_SIDE_PX[receiver], inf)
        found_m = distance_m * signal.side * pose.pitch / least_px
        ends = _ends(receiver, pose, gain, noise, signal)
        out.append(Reach(receiver, {layer: min(end * distance_m, found_m) for layer, end in ends.items()}, found_m))
    return tuple(out)


def layer_information(receiver: str, pose: Pose, gain: float, noise: Noise, signal: SignalSettings) -> dict[str, float]:
    """Information in the LLRs of each layer, in bit per sent bit."""
    read = _plain if receiver == "plain" else _soft
    return read(replace(pose, x=OFF_CENTRE, y=OFF_CENTRE, roll=pose.roll), gain, noise, signal)


def information_of(snr: Floats) -> Floats:
    """Information of bits sent as +-1 in white noise, in bit per bit."""
    points, weights = _normal()
    spread = -2 * snr[..., None] - 2 * np.sqrt(snr)[..., None] * points
    return np.asarray(1 - np.logaddexp(0, spread) @ weights / np.log(2))


@lru_cache
def _normal() -> tuple[Floats, Floats]:
    """Points and weights of a mean over a normal variable (Gauss and Hermite)."""
    points, weights = np.polynomial.hermite_e.hermegauss(40)
    return points, weights / weights.sum()


def _ends(receiver: str, pose: Pose, gain: float, noise: Noise, signal: SignalSettings) -> dict[str, float]:
    """Distances up to which layers are read, over that of the pose."""
    # where LEDs are large all is read, as near arrays are reduced: it is not looked at
    nearest = max(NEAREST, pose.pitch / NEAR_PITCH_PX)
    steps = nearest * STEP ** np.arange(int(np.log(max(FARTHEST / nearest, STEP)) / np.log(STEP)) + 1)

    @cache
    def held(k: int) -> dict[str, float]:
        return layer_information(receiver, replace(pose, pitch=pose.pitch / steps[k]), gain, noise, signal)

    out = {}
    for layer in LAYERS:
        needed = NEEDED * getattr(signal.rate, layer)
        low, high = -1, len(steps)
        while high - low > 1:
            middle = (low + high) // 2
            low, high = (middle, high) if held(middle)[layer] >= needed else (low, middle)
        out[layer] = 0.0 if low < 0 else float("inf") if high == len(steps) else float(steps[low])
    return out


def _bounds(side: int) -> list[tuple[str, slice]]:
    """The symbols of each layer."""
    ends = np.cumsum(MULTIPLICITY) * (side // 2) ** 2
    return [(name, slice(int(end) - many * (side // 2) ** 2, int(end)))
            for name, many, end in zip(LAYERS, MULTIPLICITY, ends, strict=True)]  # fmt: skip


def _cutout(pose: Pose, side: int) -> Cutout:
    x, y, width, height = window_around(pose, side, RIM_PX + RING_PX)
    empty = np.zeros((height, width))
    return Cutout(empty, empty, (x, y), (pose, pose))


def _soft(pose: Pose, gain: float, noise: Noise, signal: SignalSettings) -> dict[str, float]:
    side = signal.side
    pair = whiten(_cutout(pose, side), noise, side).statistics
    mean, variance = np.zeros(side * side), np.ones(side * side)
    out = {}
    for name, part in _bounds(side):
        estimate = equalise(pair, gain, noise.lit, mean, variance)
        spread = np.ones(side * side)
        spread[estimate.unknown] = estimate.spread
        snr = np.maximum(1 / np.maximum(spread[part], TINY) - 1, 0.0)
        out[name] = float(information_of(snr).mean())
        if out[name] >= NEEDED * getattr(signal.rate, name):
            variance[part] = 0.0
    return out


def _plain(pose: Pose, gain: float, noise: Noise, signal: SignalSettings) -> dict[str, float]:
    side, seen = signal.side, _cutout(pose, signal.side)
    count = side * side
    through = np.empty((count, count))
    image = np.empty((6, *seen.shape))
    for symbol, levels in enumerate(_patterns(side)):
        image_kernels.render(pose.full_vector(), levels, float(seen.corner[0]), float(seen.corner[1]), image, 0.0, 0.0)
        shown = at_leds(image[0], seen.corner, pose, side)
        through[:, symbol] = shown.ravel()
    back = _symbols_of_leds(side)
    seen_of = back @ through
    own = np.diag(seen_of)
    others = (seen_of**2).sum(1) - own**2
    # LEDs that are near each other share pixels, and so their noise
    # images of noise that tell how much of it sampling at LEDs leaves: of the mean over a layer's symbols 3 % off at
    # most
    white = np.random.default_rng(0).standard_normal((64, *seen.shape))
    sampled = np.array([at_leds(one, seen.corner, pose, side).ravel() for one in white])
    rest = noise.lit / gain**2 * ((sampled @ back.T) ** 2).mean(0)
    snr = np.maximum(own, 0.0) ** 2 / np.maximum(others + rest, TINY)
    return {name: float(information_of(snr[part]).mean()) for name, part in _bounds(side)}


@lru_cache(maxsize=4)
def _patterns(side: int) -> Floats:
    """Luminances 2 x - 1 of the LEDs by each symbol alone, (symbols, n, n)."""
    count = side * side
    return np.array([to_grid(leds_of(np.eye(1, count, symbol)[0])) for symbol in range(count)])


@lru_cache(maxsize=4)
def _symbols_of_leds(side: int) -> Floats:
    """The inverse of T, 2 x - 1 = T c, which has orthogonal columns: (symbols, LEDs)."""
    t = _patterns(side).reshape(side * side, -1)
    return np.asarray(t / (t**2).sum(1)[:, None])
