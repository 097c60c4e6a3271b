"""Camera motion: speed profile, half-car model on a rough road (ISO 8608), recorded trace, or hand."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import expm

from heliograph.base.arrays import Floats
from heliograph.base.errors import SettingsError
from heliograph.channel.parts import MOTIONS
from heliograph.channel.scene import CameraPose
from heliograph.channel.settings import MIN_DISTANCE_M, ChannelSettings
from heliograph.channel.trajectory import Path, array_paths, camera_path

Shake = Callable[[Floats], Floats]  # times (...) in s -> (..., 4): heave in m, upward; pitch, yaw, roll in rad

Motion = Callable[[Floats], CameraPose]  # times in s -> camera poses

STEP_S = 2e-3  # largest step of the half-car simulation
STEP_ROAD_M = 0.12  # largest step along the road: two samples of the shortest wave of the road
RUN_IN_S = 5.0  # drive time of the half-car before time 0; the slowest mode decays as exp(-1.76 t)


ROUGHNESS_M3 = {"A": 16e-6, "B": 64e-6, "C": 256e-6, "D": 1024e-6}
"""Displacement density G_d(n0) in m^3 by road class: geometric means of ISO 8608."""

STEP_M = 0.0125  # distance between samples, a twentieth of the shortest wave: linear interpolation loses at most 1.2 %


def roughness(road_class: str, per_m: ArrayLike) -> Floats:
    """Return the displacement power spectral density of a road (ISO 8608)."""
    # ISO 8608: G_d(n) = G_d(n0) (n / n0)^-2, n0 = 0.1 cycle/m
    return ROUGHNESS_M3[road_class] * (np.asarray(per_m) / 0.1) ** -2.0


def road_profile(road_class: str, length_m: float, rng: np.random.Generator) -> Floats:
    """Draw the heights of a random road in m, upward, every `STEP_M`: sine waves with the spectrum of ISO 8608."""
    # a power of two of at least 2^14 samples, twice the longest wave; 1e-9: rounding
    samples = 1 << int(np.ceil(np.log2(max(length_m, 204.8) / STEP_M - 1e-9)))
    per_m = np.fft.rfftfreq(samples, STEP_M)
    # from 100 m, far below the modes of the body, to 0.25 m, the length of the tyre contact
    band = (per_m >= 0.01) & (per_m <= 4.0)
    # a wave of amplitude A has the power A^2 / 2 = G_d(n) dn
    amplitude = np.sqrt(2 * roughness(road_class, per_m[band]) * per_m[1])
    spectrum = np.zeros(per_m.size, complex)
    spectrum[band] = amplitude / 2 * samples * np.exp(2j * np.pi * rng.random(int(band.sum())))
    return np.fft.irfft(spectrum, samples)


def road_height(profile: Floats, distance_m: ArrayLike) -> Floats:
    """Return the interpolated height along a periodic road in m."""
    return np.interp(np.asarray(distance_m) / STEP_M, np.arange(profile.size), profile, period=profile.size)


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
        _, _, stiffness, tyres = self.matrices()
        advance, enter = self._discretise(step_s)
        drive = road_m @ enter.T
        state = np.zeros((len(road_m) + 1, 8))
        state[0, :4] = np.linalg.solve(stiffness, tyres @ road_m[0])
        for k in range(len(road_m)):
            state[k + 1] = advance @ state[k] + drive[k]
        return state[:-1, :4]

    def _discretise(self, step_s: float) -> tuple[Floats, Floats]:
        """Return A and B of x[k+1] = A x[k] + B r[k], x = (q, q'), exact for a constant road height over the step."""
        mass, damping, stiffness, tyres = self.matrices()
        system = np.zeros((10, 10))
        system[:4, 4:8] = np.eye(4)
        system[4:8, :4] = -np.linalg.solve(mass, stiffness)
        system[4:8, 4:8] = -np.linalg.solve(mass, damping)
        system[4:8, 8:] = np.linalg.solve(mass, tyres)
        step = expm(system * step_s)
        return step[:8, :8], step[:8, 8:]


@dataclass(frozen=True)
class ImuTrace:
    """Recorded trace of a camera in a car."""

    # (samples,) float64 times in s, rising
    t_s: Floats
    # (samples, 3) float64 rates in rad/s about the forward, right and down axis: roll, pitch and yaw
    gyro_rad_s: Floats
    # (samples,) float64 speeds in m/s
    speed_m_s: Floats

    @classmethod
    def from_columns(cls, *values: ArrayLike) -> "ImuTrace":
        """Join columns of equal length: time, roll, pitch and yaw rate, speed; the first time becomes 0."""
        columns = [np.asarray(column, float) for column in values]
        shapes = {c.shape for c in columns}
        if len(shapes) > 1 or columns[0].ndim != 1 or columns[0].size < 32:
            raise ValueError(f"an IMU trace has columns of one length of at least 32, not {sorted(shapes)}")
        if not all(np.isfinite(c).all() for c in columns) or (np.diff(columns[0]) <= 0).any():
            raise ValueError("an IMU trace has finite values and rising times")
        return cls(columns[0] - columns[0][0], np.stack(columns[1:4], -1), columns[4])

    def speed_profile(self, step_s: float = 0.5) -> tuple[tuple[float, float], ...]:
        """Return the recorded speed, at least 0, as points (s, m/s) for ``channel.speed_profile``."""
        times = np.arange(0, self.t_s[-1], step_s)
        speeds = np.maximum(np.interp(times, self.t_s, self.speed_m_s), 0)
        return tuple((float(t), float(v)) for t, v in zip(times, speeds, strict=True))


@dataclass(frozen=True)
class Travel:
    """Speed and distance along the road: piecewise linear speed, constant outside the points."""

    # (points,) times in s, rising
    time_s: Floats
    # (points,) speeds in m/s, at least 0
    speed_m_s: Floats

    @classmethod
    def of(cls, settings: ChannelSettings) -> "Travel":
        """Return the travel of the vehicle in the settings."""
        if (path := camera_path(settings)) is not None:
            return cls(path.x, np.linalg.norm(path(path.x, 1)[:, (0, 2)], axis=1))
        return cls(*np.array(settings.speed_profile or ((0.0, settings.speed_m_s),), float).T)

    def speed(self, times_s: Floats) -> Floats:
        """Return the speed in m/s at times."""
        return np.interp(times_s, self.time_s, self.speed_m_s)

    def distance(self, times_s: ArrayLike) -> Floats:
        """Return the travelled distance in m since time 0; negative before time 0."""
        return self._since_first(np.asarray(times_s, float)) - self._since_first(np.zeros(1))[0]

    def _since_first(self, times_s: Floats) -> Floats:
        k = np.clip(np.searchsorted(self.time_s, times_s) - 1, 0, None)
        steps = np.diff(self.time_s) * (self.speed_m_s[1:] + self.speed_m_s[:-1]) / 2
        start = np.concatenate([[0.0], np.cumsum(steps)])
        # ds = (v(t_k) + v(t)) / 2 dt for linear speed
        return start[k] + (self.speed_m_s[k] + self.speed(times_s)) / 2 * (times_s - self.time_s[k])

    def time_of(self, distance_m: float, max_s: float = 3600.0) -> float:
        """Return the time in s of a travelled distance."""
        from scipy.optimize import brentq

        if float(self.distance(max_s)) < distance_m:
            raise SettingsError(f"the vehicle does not drive {distance_m:g} m within {max_s:g} s; set duration_s")
        return float(brentq(lambda t: float(self.distance(t)) - distance_m, 0.0, max_s, xtol=1e-12))


def film_duration(settings: ChannelSettings) -> float:
    """Return the film length in s: ``duration_s``, or the first end of a trajectory, the time to ``stop_m``, or 1 s."""
    if settings.duration_s is not None:
        return settings.duration_s
    if settings.trajectories:
        return min(points[-1][0] for points in settings.trajectories.values())
    return Travel.of(settings).time_of(settings.distance_m - settings.stop_m) if settings.moves else 1.0


def road_shake(travel: Travel, road: Floats, start_s: float, end_s: float) -> Shake:
    """Return heave and pitch of the camera in a half-car on a road as a cubic spline."""
    from scipy.interpolate import CubicSpline

    step_s = min(STEP_S, STEP_ROAD_M / max(float(travel.speed_m_s.max()), 1.0))
    car, times = HalfCar(), np.arange(start_s - RUN_IN_S, end_s + 0.1, step_s)  # to beyond the last exposure
    distance = travel.distance(times + step_s / 2)
    axles = [road_height(road, distance + car.front_m), road_height(road, distance - car.rear_m)]
    q = car.ride(np.stack(axles, -1), step_s)
    zero = np.zeros(len(q))
    # heave of the camera = heave of the body + lever * pitch
    return CubicSpline(times, np.stack([q[:, 0] + car.camera_m * q[:, 1], q[:, 1], zero, zero], -1))


def imu_shake(trace: ImuTrace, trace_start_s: float, start_s: float, end_s: float) -> Shake:
    """Return pitch, yaw and roll of a recorded gyro as a cubic spline: integrated rates, zero-phase high-pass."""
    from scipy.interpolate import CubicSpline
    from scipy.signal import butter, sosfiltfilt

    rate_hz = 1 / float(np.median(np.diff(trace.t_s)))
    times = np.arange(start_s - RUN_IN_S, end_s + RUN_IN_S, 1 / rate_hz)
    length = trace.t_s[-1]
    # a mirrored trace extends short traces smoothly
    turned = np.abs((times + trace_start_s + length) % (2 * length) - length)
    rates = CubicSpline(trace.t_s, trace.gyro_rad_s)(turned)
    angles = CubicSpline(times, rates).antiderivative()(times)
    # below 0.3 Hz are steering and gyro drift
    angles = sosfiltfilt(butter(2, 0.3, "highpass", fs=rate_hz, output="sos"), angles, axis=0)
    roll, pitch, yaw = angles.T
    return CubicSpline(times, np.stack([np.zeros_like(roll), pitch, yaw, roll], -1))


@dataclass(frozen=True)
class Drive:
    """Input for constructing a camera motion.

    Attributes
    ----------
    settings
        Channel settings; ``settings.custom`` has the settings of registered parts.
    travel
        Distance along the road.
    start_s
        Start of the film in s, at most 0.
    end_s
        End of the film in s.
    imu
        Recorded trace, if any.
    rng
        Random generator for the motion.
    """

    settings: ChannelSettings
    travel: Travel
    start_s: float
    end_s: float
    imu: ImuTrace | None
    rng: np.random.Generator


def none_motion(drive: Drive) -> None:
    """Return no shake."""


def road_motion(drive: Drive) -> Shake | None:
    """Return the shake of a half-car on a random road."""
    travel = drive.travel
    # 10 m more for the distance of the axles
    length = float(travel.distance(drive.end_s) - travel.distance(drive.start_s - RUN_IN_S)) + 10.0
    road = road_profile(drive.settings.road_class, length, drive.rng)
    return road_shake(travel, road, drive.start_s, drive.end_s)


def imu_motion(drive: Drive) -> Shake | None:
    """Return the shake of a recorded trace."""
    if drive.imu is None:
        raise SettingsError("shake = imu needs a recorded trace: pass imu, or choose shake = road or none")
    return imu_shake(drive.imu, drive.settings.imu_start_s, drive.start_s, drive.end_s)


def motion(settings: ChannelSettings, imu: ImuTrace | None, rng: np.random.Generator) -> Motion:
    """Return the motion of the camera over the film."""
    travel, path = Travel.of(settings), _vehicle(settings)
    drive = Drive(settings, travel, min(0.0, settings.camera.start_s), film_duration(settings), imu, rng)
    shake: Shake | None = MOTIONS[settings.shake](drive)

    def pose(times_s: Floats) -> CameraPose:
        turns = np.zeros((*times_s.shape, 4)) if shake is None else shake(times_s)
        (right, down, forward, heading), (heave, pitch, yaw, roll) = (
            np.moveaxis(a, -1, 0) for a in (path(times_s), turns)
        )
        return CameraPose(forward, heave - down, pitch, yaw + heading, roll, right)

    return pose


def _vehicle(settings: ChannelSettings) -> Path:
    """Return the path of the vehicle of the camera: a trajectory, or straight ahead."""
    travel, path, ahead = Travel.of(settings), camera_path(settings), np.array([0.0, 0.0, 1.0, 0.0])
    return path if path is not None else lambda times_s: travel.distance(times_s)[..., None] * ahead


def nearest_m(settings: ChannelSettings) -> float:
    """Return the smallest distance in the film to arrays with ``z_offset_m`` = 0."""
    if not settings.trajectories:
        return min(settings.distance_m, settings.stop_m) if settings.moves else settings.distance_m
    times = np.linspace(0, film_duration(settings), 256)
    driven = _vehicle(settings)(times)[:, 2]
    gaps = [(settings.distance_m if path is None else path(times)[:, 2]) - driven for path in array_paths(settings)]
    return max(float(np.min(gaps)), MIN_DISTANCE_M)


def hand_motion(drive: Drive) -> Shake | None:
    """Return the shake of a hand: pitch, yaw and roll as sums of sines."""
    rms, rng, n_waves = np.deg2rad(drive.settings.hand_deg), drive.rng, 24
    if not rms:
        return None
    # bands of sway and tremor
    hz = np.concatenate([rng.uniform(*band, (3, n_waves)) for band in ((0.1, 1.5), (6.0, 12.0))], axis=1)
    phase = rng.uniform(0, 2 * np.pi, hz.shape)
    size = rms * np.sqrt(2 / n_waves) * np.repeat([1.0, 0.1], n_waves)

    def shake(times_s: Floats) -> Floats:
        waves = size * np.sin(2 * np.pi * hz * times_s[..., None, None] + phase)
        return np.concatenate([np.zeros((*times_s.shape, 1)), waves.sum(-1)], -1)

    return shake
