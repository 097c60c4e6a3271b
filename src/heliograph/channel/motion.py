"""Motion of the vehicle: speed profile, half-car model on a rough road, replayed IMU trace.

SciPy is imported where it is used, so that the package costs nothing to import.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from heliograph.base.errors import SettingsError
from heliograph.channel.road import RoadProfile, road_profile
from heliograph.channel.scene import Pose
from heliograph.channel.settings import ChannelSettings

Floats = NDArray[np.float64]
Shake = Callable[[Floats], Floats]
"""Times (...) in s -> (..., 4): heave in m; pitch, yaw, roll in rad."""

STEP_S = 2e-3
RUN_IN_S = 5.0
STEERING_HZ = 0.3
"""Slower turns are the driver's steering and the drift of the integrated gyro, not the channel's."""


@dataclass(frozen=True)
class HalfCar:
    """A passenger car in side view: body with heave and pitch, two axles on springs, two tyres.

    Masses, springs and dampers are sums over both sides. Common textbook values; body modes near 1 to
    1.3 Hz, wheel hop near 11 Hz.
    """

    body_kg: float = 1380.0
    inertia_kg_m2: float = 2440.0
    front_m: float = 1.25
    rear_m: float = 1.51
    axle_kg: tuple[float, float] = (81.0, 91.0)
    spring_n_m: tuple[float, float] = (34e3, 44e3)
    damper_n_s_m: tuple[float, float] = (3e3, 3e3)
    tyre_n_m: tuple[float, float] = (384e3, 384e3)
    camera_m: float = 0.5
    """Camera before the centre of mass, near the windscreen."""

    def matrices(self) -> tuple[Floats, Floats, Floats, Floats]:
        """M, C, K, B of M q" + C q' + K q = B r; q = heave, pitch, front and rear axle; r = road at the axles."""
        travel = np.array([[1, self.front_m, -1, 0], [1, -self.rear_m, 0, -1]])  # of the springs
        tyres = np.array([[0, 0], [0, 0], [self.tyre_n_m[0], 0], [0, self.tyre_n_m[1]]])
        mass = np.diag([self.body_kg, self.inertia_kg_m2, *self.axle_kg])
        damping = travel.T @ np.diag(self.damper_n_s_m) @ travel
        stiffness = travel.T @ np.diag(self.spring_n_m) @ travel + np.diag([0, 0, *self.tyre_n_m])
        return mass, damping, stiffness, tyres

    def response(self, hz: float) -> NDArray[np.complex128]:
        """(4, 2) transfer matrix from road heights at the axles to q at a frequency."""
        mass, damping, stiffness, tyres = self.matrices()
        s = 2j * np.pi * hz
        return np.linalg.solve(mass * s**2 + damping * s + stiffness, tyres.astype(complex))

    def ride(self, road_m: Floats, step_s: float) -> Floats:
        """Displacements q (samples, 4) over road heights (samples, 2) at the axles, from rest at the first height.

        A road height of row k holds from sample k to k + 1: take it in the middle of the step.
        """
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
    """x[k+1] = A x[k] + B r[k], exact for a road height that holds over the step; x = q, q'."""
    from scipy.linalg import expm

    mass, damping, stiffness, tyres = matrices
    system = np.zeros((10, 10))
    system[:4, 4:8] = np.eye(4)
    system[4:8, :4] = -np.linalg.solve(mass, stiffness)
    system[4:8, 4:8] = -np.linalg.solve(mass, damping)
    system[4:8, 8:] = np.linalg.solve(mass, tyres)
    step = expm(system * step_s)
    return step[:8, :8], step[:8, 8:]


@dataclass(frozen=True)
class ImuTrace:
    """A recorded trace of a camera in a car.

    Attributes
    ----------
    t_s
        (samples,) float64, rising.
    gyro_rad_s
        (samples, 3) float64 about the forward, right and down axis (roll, pitch, yaw rate).
    speed_m_s
        (samples,) float64.
    """

    t_s: Floats
    gyro_rad_s: Floats
    speed_m_s: Floats

    @classmethod
    def from_columns(
        cls,
        t_s: ArrayLike,
        forward_rad_s: ArrayLike,
        right_rad_s: ArrayLike,
        down_rad_s: ArrayLike,
        speed_m_s: ArrayLike,
    ) -> "ImuTrace":
        """Check and join columns of equal length.

        Raises
        ------
        ValueError
            The lengths differ, there are fewer than 32 samples, a value is not finite or the times do not rise.
        """
        columns = [np.asarray(c, float) for c in (t_s, forward_rad_s, right_rad_s, down_rad_s, speed_m_s)]
        shapes = {c.shape for c in columns}
        if len(shapes) > 1 or columns[0].ndim != 1 or columns[0].size < 32:
            raise ValueError(f"an IMU trace has columns of one length of at least 32, not {sorted(shapes)}")
        if not all(np.isfinite(c).all() for c in columns) or (np.diff(columns[0]) <= 0).any():
            raise ValueError("an IMU trace has finite values and rising times")
        return cls(columns[0] - columns[0][0], np.stack(columns[1:4], -1), columns[4])

    def speed_profile(self, step_s: float = 0.5) -> tuple[tuple[float, float], ...]:
        """The recorded speed as points for the settings' ``speed_profile``."""
        times = np.arange(0, self.t_s[-1], step_s)
        speeds = np.maximum(np.interp(times, self.t_s, self.speed_m_s), 0)
        return tuple((float(t), float(v)) for t, v in zip(times, speeds, strict=True))


@dataclass(frozen=True)
class Travel:
    """Distance along the road: straight lines between points of speed, constant beyond them."""

    time_s: Floats
    speed_m_s: Floats

    @classmethod
    def of(cls, settings: ChannelSettings) -> "Travel":
        """Of the speed profile, or of the constant speed."""
        points = settings.speed_profile or ((0.0, settings.speed_m_s),)
        return cls(*np.array(points, float).T)

    def speed(self, times_s: Floats) -> Floats:
        """Speed in m/s at times in s."""
        return np.interp(times_s, self.time_s, self.speed_m_s)

    def way(self, times_s: ArrayLike) -> Floats:
        """Distance driven in m since time 0."""
        return self._since_first(np.asarray(times_s, float)) - self._since_first(np.zeros(1))[0]

    def _since_first(self, times_s: Floats) -> Floats:
        k = np.clip(np.searchsorted(self.time_s, times_s) - 1, 0, None)
        start = np.concatenate(
            [[0.0], np.cumsum(np.diff(self.time_s) * (self.speed_m_s[1:] + self.speed_m_s[:-1]) / 2)]
        )
        # ds = (v(t_k) + v(t)) / 2 dt on a line of speed
        return start[k] + (self.speed_m_s[k] + self.speed(times_s)) / 2 * (times_s - self.time_s[k])

    def time_of(self, way_m: float, longest_s: float = 3600.0) -> float:
        """When a distance has been driven.

        Raises
        ------
        SettingsError
            It is not reached within `longest_s`.
        """
        from scipy.optimize import brentq

        if float(self.way(longest_s)) < way_m:
            raise SettingsError(f"the vehicle does not drive {way_m:g} m within {longest_s:g} s; set duration_s")
        return float(brentq(lambda t: float(self.way(t)) - way_m, 0.0, longest_s, xtol=1e-12))


@dataclass(frozen=True)
class Motion:
    """The camera's pose as a smooth function of time."""

    travel: Travel
    shake: Shake | None

    def pose(self, times_s: Floats) -> Pose:
        """Pose at times of any shape."""
        shake = np.zeros((*times_s.shape, 4)) if self.shake is None else self.shake(times_s)
        return Pose(self.travel.way(times_s), *np.moveaxis(shake, -1, 0))


def film_duration(settings: ChannelSettings) -> float:
    """Length of the film in s: as set, until ``stop_m`` is reached, or 1 s at a standstill."""
    if settings.duration_s is not None:
        return settings.duration_s
    return Travel.of(settings).time_of(settings.distance_m - settings.stop_m) if settings.moves else 1.0


def road_shake(travel: Travel, road: RoadProfile, start_s: float, end_s: float, car: HalfCar | None = None) -> Shake:
    """Heave and pitch of the camera in a half-car on a road, a cubic spline through steps of 2 ms."""
    from scipy.interpolate import CubicSpline

    car = car or HalfCar()
    times = np.arange(start_s - RUN_IN_S, end_s + 0.1, STEP_S)
    way = travel.way(times + STEP_S / 2)
    q = car.ride(np.stack([road.at(way + car.front_m), road.at(way - car.rear_m)], -1), STEP_S)
    zero = np.zeros(len(q))
    # the camera: heave of the body + lever * pitch
    return CubicSpline(times, np.stack([q[:, 0] + car.camera_m * q[:, 1], q[:, 1], zero, zero], -1))


def imu_shake(trace: ImuTrace, trace_start_s: float, start_s: float, end_s: float) -> Shake:
    """Pitch, yaw and roll from a gyro: integrated, high-passed at 0.3 Hz without a shift of phase, a cubic spline.

    A trace shorter than the film runs backward and forward again: its rates are mirrored, so that the
    angle has neither a jump nor a kink. Displacement is left out (a gyro does not know it).
    """
    from scipy.interpolate import CubicSpline
    from scipy.signal import butter, sosfiltfilt

    rate_hz = 1 / float(np.median(np.diff(trace.t_s)))
    times = np.arange(start_s - RUN_IN_S, end_s + RUN_IN_S, 1 / rate_hz)
    length = trace.t_s[-1]
    turned = np.abs((times + trace_start_s + length) % (2 * length) - length)  # triangle wave: the mirrored trace
    rates = CubicSpline(trace.t_s, trace.gyro_rad_s)(turned)
    angles = CubicSpline(times, rates).antiderivative()(times)
    angles = sosfiltfilt(butter(2, STEERING_HZ, "highpass", fs=rate_hz, output="sos"), angles, axis=0)
    roll, pitch, yaw = angles.T
    return CubicSpline(times, np.stack([np.zeros_like(roll), pitch, yaw, roll], -1))


def motion(settings: ChannelSettings, imu: ImuTrace | None, rng: np.random.Generator) -> Motion:
    """The vehicle's motion over the film.

    Raises
    ------
    SettingsError
        shake is "imu" and there is no trace.
    """
    travel, end_s = Travel.of(settings), film_duration(settings)
    start_s = min(0.0, settings.camera.start_s)
    if settings.shake == "imu":
        if imu is None:
            raise SettingsError("shake = imu needs a recorded trace: pass imu, or choose shake = road or none")
        return Motion(travel, imu_shake(imu, settings.imu_start_s, start_s, end_s))
    if settings.shake == "road":
        length = float(travel.way(end_s) - travel.way(start_s - RUN_IN_S)) + 10
        return Motion(travel, road_shake(travel, road_profile(settings.road_class, length, rng), start_s, end_s))
    return Motion(travel, None)
