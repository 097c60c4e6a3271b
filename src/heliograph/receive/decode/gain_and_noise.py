"""Gain and noise of a packet by expectation and maximisation, along with its symbols."""

import math
from dataclasses import dataclass, replace

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.receive.equalise.lmmse import Estimate
from heliograph.receive.observe.noise import LEAST_NOISE
from heliograph.receive.observe.statistics import PairStatistics


@dataclass(frozen=True, slots=True)
class GainAndNoise:
    """Gain and noise of a packet."""

    # Gray levels of the array with all LEDs on
    gain: float
    # Variance of a pixel of a difference in squared gray levels
    noise: float
    # Largest gain that the sensor can show, in gray levels
    full_scale: float = math.inf

    def updated(self, moments: Floats, combined: bool) -> "GainAndNoise":
        """Maximise the expected likelihood (a step of expectation and maximisation)."""
        match, norm, power, pixels = moments
        # g = <d, B m + o> / E|B c + o|^2; of pairs that do not show the array it may be anything
        gain = min(match / norm, self.full_scale) if match > 0 and norm > 0 else self.gain
        if not combined:
            return replace(self, gain=gain)
        # s^2 = E|d - g (B c + o)|^2 / pixels
        noise = (power - 2 * gain * match + gain**2 * norm) / pixels
        return replace(self, gain=gain, noise=max(noise, LEAST_NOISE))


def moments_of(pair: PairStatistics, estimate: Estimate) -> Floats:
    """What a pair says of gain and noise."""
    m = estimate.mean
    match = float(m @ pair.matched) + pair.cross
    norm = (
        float(m @ (pair.gram @ m.astype(np.float32))) + estimate.trace + 2 * float(m @ pair.offset) + pair.offset_power
    )
    return np.array([match, norm, pair.power, pair.pixels])
