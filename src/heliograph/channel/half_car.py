"""Half-car model: what a rough road does to the car, front and rear axle.

SciPy is imported where it is used, so that the package costs nothing to import.
"""

from dataclasses import dataclass

import numpy as np

from heliograph.base.arrays import Floats


@dataclass(frozen=True)
class HalfCar:
    """A passenger car in side view: body with heave and pitch, two axles on springs, two tyres.

    Masses, springs and dampers are sums over both sides. The defaults are chosen as common textbook values: the body's
    modes lie at 1.01 and 1.27 Hz, wheel hop at 10.4 and 10.9 Hz.
    """

    # Mass of the body in kg
    body_kg: float = 1380.0
    # Its moment of inertia about the pitch axis in kg m^2
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
        """Return the car's displacements on a road, from rest at the first heights."""
        advance, enter = _discretise(self.matrices(), step_s)
        drive = road_m @ enter.T
        state = np.zeros((len(road_m) + 1, 8))
        state[0, :4] = self._rest(road_m[0])
        for k in range(len(road_m)):
            state[k + 1] = advance @ state[k] + drive[k]
        return state[:-1, :4]

    def _rest(self, road_m: Floats) -> Floats:
        _, _, stiffness, tyres = self.matrices()
        return np.asarray(np.linalg.solve(stiffness, tyres @ road_m), float)


def _discretise(matrices: tuple[Floats, ...], step_s: float) -> tuple[Floats, Floats]:
    """Return A and B of x[k+1] = A x[k] + B r[k], x = (q, q'), exact for a road height that holds over the step."""
    from scipy.linalg import expm

    mass, damping, stiffness, tyres = matrices
    system = np.zeros((10, 10))
    system[:4, 4:8] = np.eye(4)
    system[4:8, :4] = -np.linalg.solve(mass, stiffness)
    system[4:8, 4:8] = -np.linalg.solve(mass, damping)
    system[4:8, 8:] = np.linalg.solve(mass, tyres)
    step = expm(system * step_s)
    return step[:8, :8], step[:8, 8:]
