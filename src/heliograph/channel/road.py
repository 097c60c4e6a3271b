"""Roughness of a road by ISO 8608."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

ROUGHNESS_M3 = {"A": 16e-6, "B": 64e-6, "C": 256e-6, "D": 1024e-6}
"""Displacement density G_d(n0) in m^3 by road class: the geometric means of ISO 8608."""

REFERENCE_PER_M = 0.1
"""Reference spatial frequency n0 in cycle/m (ISO 8608)."""

BAND_PER_M = (0.01, 4.0)
"""Spatial frequencies of a synthetic road in cycle/m. Chosen: waves of 100 m, 0.08 Hz at 30 km/h and far below the
body's modes, down to 0.25 m, the length of a tyre's footprint, over which a tyre averages."""

STEP_M = 0.0125
"""Distance between samples: a twentieth of the shortest wave, of which straight lines cut off 1.2 % at most; 4.9 % at
twice the value."""

SHORTEST_M = 204.8
"""Least length of a profile in m: 2^14 samples, twice the longest wave, so that the lines of its spectrum are at most
0.005 cycle/m apart."""

_WHOLE = 1e-9
"""Excess over a power of two that counts as a rounding error."""


@dataclass(frozen=True)
class RoadProfile:
    """Height of a road, periodic."""

    # (samples,) float64 heights in m, upward, every `STEP_M`
    height_m: NDArray[np.float64]

    def at(self, distance_m: ArrayLike) -> NDArray[np.float64]:
        """Return the height in m along the road, by straight lines between the samples."""
        place = np.asarray(distance_m) / STEP_M
        return np.interp(place, np.arange(self.height_m.size), self.height_m, period=self.height_m.size)


def roughness(road_class: str, per_m: ArrayLike) -> NDArray[np.float64]:
    """Return the displacement power spectral density of a road (ISO 8608)."""
    # ISO 8608: G_d(n) = G_d(n0) (n / n0)^-2
    return ROUGHNESS_M3[road_class] * (np.asarray(per_m) / REFERENCE_PER_M) ** -2.0


def road_profile(road_class: str, length_m: float, rng: np.random.Generator) -> RoadProfile:
    """Draw a random road: a sum of sine waves of random phase with the spectrum of ISO 8608."""
    samples = 1 << int(np.ceil(np.log2(max(length_m, SHORTEST_M) / STEP_M - _WHOLE)))
    per_m = np.fft.rfftfreq(samples, STEP_M)
    band = (per_m >= BAND_PER_M[0]) & (per_m <= BAND_PER_M[1])
    # a wave of amplitude A has the power A^2 / 2 = G_d(n) dn
    amplitude = np.sqrt(2 * roughness(road_class, per_m[band]) * per_m[1])
    spectrum = np.zeros(per_m.size, complex)
    spectrum[band] = amplitude / 2 * samples * np.exp(2j * np.pi * rng.random(int(band.sum())))
    return RoadProfile(np.fft.irfft(spectrum, samples))
