"""Roughness of a road after ISO 8608."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

ROUGHNESS_M3 = {"A": 16e-6, "B": 64e-6, "C": 256e-6, "D": 1024e-6}
"""G_d(n0) by road class, in m^3."""

REFERENCE_PER_M = 0.1
"""n0 in cycle/m."""

BAND_PER_M = (0.01, 4.0)
"""Spatial frequencies of a synthetic road in cycle/m: waves of 100 m down to the length of a tyre's footprint."""

STEP_M = 0.0125
SHORTEST_M = 204.8


@dataclass(frozen=True)
class RoadProfile:
    """Height of a road, periodic.

    Attributes
    ----------
    height_m
        (samples,) float64, up, every `STEP_M`.
    """

    height_m: NDArray[np.float64]

    def at(self, way_m: ArrayLike) -> NDArray[np.float64]:
        """Height in m at distances along the road, straight lines between the samples."""
        place = np.asarray(way_m) / STEP_M
        return np.interp(place, np.arange(self.height_m.size), self.height_m, period=self.height_m.size)


def roughness(road_class: str, per_m: ArrayLike) -> NDArray[np.float64]:
    """Displacement power spectral density in m^3 at spatial frequencies in cycle/m, ISO 8608."""
    # ISO 8608: G_d(n) = G_d(n0) (n / n0)^-2
    return ROUGHNESS_M3[road_class] * (np.asarray(per_m) / REFERENCE_PER_M) ** -2.0


def road_profile(road_class: str, length_m: float, rng: np.random.Generator) -> RoadProfile:
    """A random road: a sum of sine waves of random phase with the spectrum of ISO 8608.

    Parameters
    ----------
    road_class
        "A" to "D".
    length_m
        The profile repeats after at least this length.
    """
    samples = 1 << int(np.ceil(np.log2(max(length_m, SHORTEST_M) / STEP_M - 1e-9)))
    per_m = np.fft.rfftfreq(samples, STEP_M)
    band = (per_m >= BAND_PER_M[0]) & (per_m <= BAND_PER_M[1])
    # a wave of amplitude A has the power A^2 / 2 = G_d(n) dn
    amplitude = np.sqrt(2 * roughness(road_class, per_m[band]) * per_m[1])
    spectrum = np.zeros(per_m.size, complex)
    spectrum[band] = amplitude / 2 * samples * np.exp(2j * np.pi * rng.random(int(band.sum())))
    return RoadProfile(np.fft.irfft(spectrum, samples))
