"""Estimated reach of each layer, from the light, noise and blur of an array in a film.

The model moves the array farther away: its pitch shrinks, while gray level, noise and blur in px stay. Symbols of +-1
with independent noise of the signal-to-noise ratio r hold 1 - E log2(1 + exp(-2 r - 2 sqrt(r) z)) bit each, with a
normal z. The receiver "soft" estimates symbols by linear MMSE; the posterior covariance S gives r = 1 / S_ii - 1,
layer after layer; decoded layers are known. The receiver "plain" samples the light at each LED, and the crosstalk of
other symbols counts as noise. A layer can be decoded if its symbols hold `needed` times the rate of its code.
"""

from bisect import bisect_left
from collections.abc import Iterator
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


@dataclass(frozen=True, slots=True)
class ReachTuning:
    """Parameters of the estimate of the reach."""

    # Information in LLRs over the rate of the code that decoding needs: 0.43 bit for rate 1/3 and 1000 bits
    needed: float = 1.3
    # Distances over the distance in the film, and the ratio of two successive distances
    nearest: float = 0.25
    farthest: float = 12.0
    step: float = 1.03
    # Maximum LEDs per row: the matrices of 64 x 64 LEDs take minutes
    max_side: int = 32
    # Maximum pitch in px: receivers reduce nearer arrays to it
    max_pitch_px: float = 3.0
    # Offset in px of the array's centre from the centre of a pixel: neither on a pixel nor between two
    offset_px: float = 0.29


TUNING = ReachTuning()


@dataclass(frozen=True, slots=True)
class Reach:
    """Estimated reach of each layer."""

    # "plain" or "soft"
    receiver: str
    # Distance in m by layer; 0 if a layer is decoded nowhere, infinite if the end is beyond all tested distances
    distance_m: dict[str, float]
    # Distance in m at which the array has the minimum size for the receiver
    found_m: float


@one_thread()
def reaches(
    pose: Pose, gain: float, noise: Noise, distance_m: float, signal: SignalSettings, smallest_px: float | None = None
) -> tuple[Reach, ...]:
    """Estimate the reach of each layer for both receivers."""
    if signal.side > TUNING.max_side or signal.modulation != "haar" or gain <= 0:
        return ()
    out = []
    for receiver in ("plain", "soft"):
        least_px, _ = size_limits(smallest_px or SMALLEST_SIDE_PX[receiver], inf)
        found_m = distance_m * signal.side * pose.pitch / least_px
        ends = _ends(receiver, pose, gain, noise, signal)
        out.append(Reach(receiver, {layer: min(end * distance_m, found_m) for layer, end in ends.items()}, found_m))
    return tuple(out)


def layer_information(receiver: str, pose: Pose, gain: float, noise: Noise, signal: SignalSettings) -> dict[str, float]:
    """Return the information in the LLRs of each layer, in bit per sent bit."""
    estimate = _plain if receiver == "plain" else _soft
    return estimate(replace(pose, x=TUNING.offset_px, y=TUNING.offset_px), gain, noise, signal)


def information_of(snr: Floats) -> Floats:
    """Return the information of bits sent as +-1 in white noise, in bit per bit."""
    # mean over a normal variable by Gauss-Hermite quadrature
    points, weights = np.polynomial.hermite_e.hermegauss(40)
    exponent = -2 * snr[..., None] - 2 * np.sqrt(snr)[..., None] * points
    return np.asarray(1 - np.logaddexp(0, exponent) @ (weights / weights.sum()) / np.log(2))


def _ends(receiver: str, pose: Pose, gain: float, noise: Noise, signal: SignalSettings) -> dict[str, float]:
    """Return the reach of each layer over the distance of the pose."""
    nearest = max(TUNING.nearest, pose.pitch / TUNING.max_pitch_px)
    count = int(np.log(max(TUNING.farthest / nearest, TUNING.step)) / np.log(TUNING.step)) + 1
    steps = nearest * TUNING.step ** np.arange(count)

    @cache
    def information(k: int) -> dict[str, float]:
        return layer_information(receiver, replace(pose, pitch=pose.pitch / steps[k]), gain, noise, signal)

    out = {}
    for layer in LAYERS:
        needed = TUNING.needed * getattr(signal.rate, layer)
        decoded = bisect_left(range(count), True, key=lambda k: information(k)[layer] < needed)
        out[layer] = 0.0 if decoded == 0 else inf if decoded == count else float(steps[decoded - 1])
    return out


def _layer_slices(side: int) -> Iterator[tuple[str, slice]]:
    """Yield the symbols of each layer."""
    end = 0
    for name, count in zip(LAYERS, MULTIPLICITY, strict=True):
        first, end = end, end + count * (side // 2) ** 2
        yield name, slice(first, end)


def _cutout(pose: Pose, side: int) -> Cutout:
    x, y, width, height = window_around(pose, side, RIM_PX + RING_PX)
    empty = np.zeros((height, width))
    return Cutout(empty, empty, (x, y), (pose, pose))


def _soft(pose: Pose, gain: float, noise: Noise, signal: SignalSettings) -> dict[str, float]:
    side = signal.side
    pair = whiten(_cutout(pose, side), noise, side).statistics
    mean, variance = np.zeros(side * side), np.ones(side * side)
    out = {}
    for name, part in _layer_slices(side):
        estimate = equalise(pair, gain, noise.lit, mean, variance)
        spread = np.ones(side * side)
        spread[estimate.unknown] = estimate.spread
        snr = np.maximum(1 / np.maximum(spread[part], TINY) - 1, 0.0)
        out[name] = float(information_of(snr).mean())
        if out[name] >= TUNING.needed * getattr(signal.rate, name):
            variance[part] = 0.0
    return out


def _plain(pose: Pose, gain: float, noise: Noise, signal: SignalSettings) -> dict[str, float]:
    side, cutout = signal.side, _cutout(pose, signal.side)
    through = np.empty((side * side, side * side))
    image = np.empty((6, *cutout.shape))
    x, y = map(float, cutout.corner)
    for symbol, levels in enumerate(_symbol_patterns(side)):
        image_kernels.render(pose.full_vector(), levels, x, y, image, 0.0, 0.0)
        through[:, symbol] = at_leds(image[0], cutout.corner, pose, side).ravel()
    # inverse of 2 x - 1 = T c; the columns of T are orthogonal
    t = _symbol_patterns(side).reshape(side * side, -1)
    back = t / (t**2).sum(1)[:, None]
    response = back @ through
    own = np.diag(response)
    crosstalk = (response**2).sum(1) - own**2
    # neighbouring LEDs share pixels and noise: sample 64 images of noise, 3 % standard error at most
    white = np.random.default_rng(0).standard_normal((64, *cutout.shape))
    sampled = np.array([at_leds(sample, cutout.corner, pose, side).ravel() for sample in white])
    sampled_noise = noise.lit / gain**2 * ((sampled @ back.T) ** 2).mean(0)
    snr = np.maximum(own, 0.0) ** 2 / np.maximum(crosstalk + sampled_noise, TINY)
    return {name: float(information_of(snr[part]).mean()) for name, part in _layer_slices(side)}


@lru_cache(maxsize=4)
def _symbol_patterns(side: int) -> Floats:
    """Luminances 2 x - 1 of the LEDs for each single symbol, (symbols, n, n)."""
    count = side * side
    return np.array([to_grid(leds_of(np.eye(1, count, symbol)[0])) for symbol in range(count)])
