"""Half-car model on a rough road (ISO 8608): heave and pitch of the car."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import expm

from heliograph.base.arrays import Floats

ROUGHNESS_M3 = {"A": 16e-6, "B": 64e-6, "C": 256e-6, "D": 1024e-6}
"""Displacement density G_d(n0) in m^3 by road class: geometric means of ISO 8608."""

STEP_M = 0.0125
"""Distance between samples, a twentieth of the shortest wave: linear interpolation loses at most 1.2 %."""


@dataclass(frozen=True)
class RoadProfile:
    """Periodic road height."""

    # (samples,) float64 heights in m, upward, every `STEP_M`
    height_m: NDArray[np.float64]

    def at(self, distance_m: ArrayLike) -> NDArray[np.float64]:
        """Return the interpolated height in m along the road."""
        place = np.asarray(distance_m) / STEP_M
        return np.interp(place, np.arange(self.height_m.size), self.height_m, period=self.height_m.size)


def roughness(road_class: str, per_m: ArrayLike) -> NDArray[np.float64]:
    """Return the displacement power spectral density of a road (ISO 8608)."""
    # ISO 8608: G_d(n) = G_d(n0) (n / n0)^-2, n0 = 0.1 cycle/m
    return ROUGHNESS_M3[road_class] * (np.asarray(per_m) / 0.1) ** -2.0


def road_profile(road_class: str, length_m: float, rng: np.random.Generator) -> RoadProfile:
    """Draw a random road: sine waves of random phase with the spectrum of ISO 8608."""
    # a power of two of at least 2^14 samples, twice the longest wave; 1e-9: rounding
    samples = 1 << int(np.ceil(np.log2(max(length_m, 204.8) / STEP_M - 1e-9)))
    per_m = np.fft.rfftfreq(samples, STEP_M)
    # from 100 m, far below the modes of the body, to 0.25 m, the length of the tyre contact
    band = (per_m >= 0.01) & (per_m <= 4.0)
    # a wave of amplitude A has the power A^2 / 2 = G_d(n) dn
    amplitude = np.sqrt(2 * roughness(road_class, per_m[band]) * per_m[1])
    spectrum = np.zeros(per_m.size, complex)
    spectrum[band] = amplitude / 2 * samples * np.exp(2j * np.pi * rng.random(int(band.sum())))
    return RoadProfile(np.fft.irfft(spectrum, samples))


@dataclass(frozen=True)
class HalfCar:
    """Passenger car in side view: body with heave and pitch, two axles on springs, two tyres.

    Masses, springs and dampers are sums over both sides. With the defaults, the body modes are at 1.01 and 1.27 Hz,
    and wheel hop at 10.4 and 10.9 Hz.
    """

    # Mass of the body in kg
    body_kg: float = 1380.0
    # Moment of inertia about the pitch axis in kg m^2
    inertia_kg_m2: float = 2440.0
    # Front axle before the centre of mass in m
    front_m: float = 1.25
    # Rear axle behind the centre of mass in m
    rear_m: float = 1.51
    # Masses of the front and the rear axle in kg
    axle_kg: tuple[float, float] = (81.0, 91.0)
    # Stiffness of the front and the rear springs in N/m
    spring_n_m: tuple[float, float] = (34e3, 44e3)
    # Damping of the front and the rear dampers in N s/m
    damper_n_s_m: tuple[float, float] = (3e3, 3e3)
    # Stiffness of the front and the rear tyres in N/m
    tyre_n_m: tuple[float, float] = (384e3, 384e3)
    # Camera before the centre of mass in m: near the windscreen
    camera_m: float = 0.5

    def matrices(self) -> tuple[Floats, Floats, Floats, Floats]:
        """Return the matrices of the equation of motion M q" + C q' + K q = B r."""
        travel = np.array([[1, self.front_m, -1, 0], [1, -self.rear_m, 0, -1]])  # of the springs
        tyres = np.array([[0, 0], [0, 0], [self.tyre_n_m[0], 0], [0, self.tyre_n_m[1]]])
        mass = np.diag([self.body_kg, self.inertia_kg_m2, *self.axle_kg])
        damping = travel.T @ np.diag(self.damper_n_s_m) @ travel
        stiffness = travel.T @ np.diag(self.spring_n_m) @ travel + np.diag([0, 0, *self.tyre_n_m])
        return mass, damping, stiffness, tyres

    def ride(self, road_m: Floats, step_s: float) -> Floats:
        """Return the displacements of the car on a road, from rest at the first heights."""
        _, _, stiffness, tyres = matrices = self.matrices()
        advance, enter = _discretise(matrices, step_s)
        drive = road_m @ enter.T
        state = np.zeros((len(road_m) + 1, 8))
        state[0, :4] = np.linalg.solve(stiffness, tyres @ road_m[0])
        for k in range(len(road_m)):
            state[k + 1] = advance @ state[k] + drive[k]
        return state[:-1, :4]


def _discretise(matrices: tuple[Floats, ...], step_s: float) -> tuple[Floats, Floats]:
    """Return A and B of x[k+1] = A x[k] + B r[k], x = (q, q'), exact for a constant road height over the step."""
    mass, damping, stiffness, tyres = matrices
    system = np.zeros((10, 10))
    system[:4, 4:8] = np.eye(4)
    system[4:8, :4] = -np.linalg.solve(mass, stiffness)
    system[4:8, 4:8] = -np.linalg.solve(mass, damping)
    system[4:8, 8:] = np.linalg.solve(mass, tyres)
    step = expm(system * step_s)
    return step[:8, :8], step[:8, 8:]
