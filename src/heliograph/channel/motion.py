"""Motion of the camera: speed profile, half-car model on a rough road, recorded trace, or a hand."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from heliograph.base.arrays import Floats
from heliograph.base.errors import SettingsError
from heliograph.channel.half_car import HalfCar, RoadProfile, road_profile
from heliograph.channel.parts import MOTIONS
from heliograph.channel.scene import CameraPose
from heliograph.channel.settings import ChannelSettings

Shake = Callable[[Floats], Floats]
"""Times (...) in s -> (..., 4): heave in m upward; pitch, yaw, roll in rad."""

STEP_S = 2e-3
"""Step of the half-car's simulation. In the reference link the image is then right to 0.0004 px on a road of class B
and 0.0016 px on class D, against a step 16 times finer; twice the step gives four times the error."""

RUN_IN_S = 5.0
"""Time for which the half-car drives before time 0, so that its rest at the start is forgotten. Its slowest mode decays
as exp(-1.76 t): 2e-4 is left. On a road of class D the image at time 0 is right to 0.001 px; at half the value to 0.09
px, at twice to 1e-6 px."""

_LEAST_SAMPLES = 32
"""Least samples of a trace. Chosen: shorter columns are taken for a mistake; the splines need 4."""


@dataclass(frozen=True)
class ImuTrace:
    """A recorded trace of a camera in a car."""

    # (samples,) float64 times in s, rising
    t_s: Floats
    # (samples, 3) float64 rates in rad/s about the forward, right and down axis: roll, pitch and yaw
    gyro_rad_s: Floats
    # (samples,) float64 speeds in m/s
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
        """Check columns of equal length and join them; times then count from the first."""
        columns = [np.asarray(c, float) for c in (t_s, forward_rad_s, right_rad_s, down_rad_s, speed_m_s)]
        shapes = {c.shape for c in columns}
        if len(shapes) > 1 or columns[0].ndim != 1 or columns[0].size < _LEAST_SAMPLES:
            least = f"columns of one length of at least {_LEAST_SAMPLES}"
            raise ValueError(f"an IMU trace has {least}, not {sorted(shapes)}")
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
    """Speed and distance along the road: straight lines between points of speed, constant speed beyond them."""

    # (points,) times in s, rising
    time_s: Floats
    # (points,) speeds in m/s, at least 0
    speed_m_s: Floats

    @classmethod
    def of(cls, settings: ChannelSettings) -> "Travel":
        """Return the travel of a channel's vehicle."""
        points = settings.speed_profile or ((0.0, settings.speed_m_s),)
        return cls(*np.array(points, float).T)

    def speed(self, times_s: Floats) -> Floats:
        """Return the speed in m/s at some times."""
        return np.interp(times_s, self.time_s, self.speed_m_s)

    def distance(self, times_s: ArrayLike) -> Floats:
        """Return the distance in m driven since time 0; negative before time 0."""
        return self._since_first(np.asarray(times_s, float)) - self._since_first(np.zeros(1))[0]

    def _since_first(self, times_s: Floats) -> Floats:
        k = np.clip(np.searchsorted(self.time_s, times_s) - 1, 0, None)
        start = np.concatenate(
            [[0.0], np.cumsum(np.diff(self.time_s) * (self.speed_m_s[1:] + self.speed_m_s[:-1]) / 2)]
        )
        # ds = (v(t_k) + v(t)) / 2 dt on a line of speed
        return start[k] + (self.speed_m_s[k] + self.speed(times_s)) / 2 * (times_s - self.time_s[k])

    # Longest drive whose end is searched for. Chosen: an hour
    def time_of(self, distance_m: float, longest_s: float = 3600.0) -> float:
        """Return the time in s at which a distance has been driven."""
        from scipy.optimize import brentq

        if float(self.distance(longest_s)) < distance_m:
            raise SettingsError(f"the vehicle does not drive {distance_m:g} m within {longest_s:g} s; set duration_s")
        # largest error of the time at which a distance is driven: 1e-10 m at any speed of the settings
        return float(brentq(lambda t: float(self.distance(t)) - distance_m, 0.0, longest_s, xtol=1e-12))


@dataclass(frozen=True)
class Motion:
    """The camera's pose as a smooth function of time."""

    # Distance along the road
    travel: Travel
    # Heave, pitch, yaw and roll; None for none
    shake: Shake | None

    def pose(self, times_s: Floats) -> CameraPose:
        """Return the poses at some times."""
        shake = np.zeros((*times_s.shape, 4)) if self.shake is None else self.shake(times_s)
        return CameraPose(self.travel.distance(times_s), *np.moveaxis(shake, -1, 0))


def film_duration(settings: ChannelSettings) -> float:
    """Return the length of the film in s: as set, until ``stop_m`` is reached, or 1 s at a standstill."""
    if settings.duration_s is not None:
        return settings.duration_s
    return Travel.of(settings).time_of(settings.distance_m - settings.stop_m) if settings.moves else 1.0


def road_shake(travel: Travel, road: RoadProfile, start_s: float, end_s: float, car: HalfCar | None = None) -> Shake:
    """Return the camera's heave and pitch in a half-car on a road, as a cubic spline through steps of 2 ms."""
    from scipy.interpolate import CubicSpline

    car = car or HalfCar()
    # time for which the half-car drives on after the film, so that the last exposure is not at the spline's end
    times = np.arange(start_s - RUN_IN_S, end_s + 0.1, STEP_S)
    distance = travel.distance(times + STEP_S / 2)
    q = car.ride(np.stack([road.at(distance + car.front_m), road.at(distance - car.rear_m)], -1), STEP_S)
    zero = np.zeros(len(q))
    # heave of the camera = heave of the body + lever * pitch
    return CubicSpline(times, np.stack([q[:, 0] + car.camera_m * q[:, 1], q[:, 1], zero, zero], -1))


def imu_shake(trace: ImuTrace, trace_start_s: float, start_s: float, end_s: float) -> Shake:
    """Return pitch, yaw and roll of a recorded gyro as a cubic spline.

    The rates are integrated and high-passed at 0.3 Hz without a shift of phase. A trace shorter than the film runs
    backward and forward again with its rates mirrored, so that the angle has neither a jump nor a kink. Heave is 0: a
    gyro does not measure it.
    """
    from scipy.interpolate import CubicSpline
    from scipy.signal import butter, sosfiltfilt

    rate_hz = 1 / float(np.median(np.diff(trace.t_s)))
    times = np.arange(start_s - RUN_IN_S, end_s + RUN_IN_S, 1 / rate_hz)
    length = trace.t_s[-1]
    turned = np.abs((times + trace_start_s + length) % (2 * length) - length)  # triangle wave: the mirrored trace
    rates = CubicSpline(trace.t_s, trace.gyro_rad_s)(turned)
    angles = CubicSpline(times, rates).antiderivative()(times)
    # Corner of the high-pass for recorded angles: slower turns are the driver's steering and the drift of the
    # integrated gyro, not shake. Chosen: the recorded trace moves the image of the reference link by 10.4 px rms in
    # pitch and 1.6 px in yaw; at half the value by 14.9 and 3.5 px, at twice by 8.6 and 0.8 px
    # Order of that high-pass (Butterworth); run forward and backward it counts twice. Chosen: of order 1 and of order 4
    # the recorded trace moves the image within 3 % as far in pitch and 30 % in yaw
    angles = sosfiltfilt(butter(2, 0.3, "highpass", fs=rate_hz, output="sos"), angles, axis=0)
    roll, pitch, yaw = angles.T
    return CubicSpline(times, np.stack([np.zeros_like(roll), pitch, yaw, roll], -1))


@dataclass(frozen=True)
class Drive:
    """What a motion of the camera is made for.

    Attributes
    ----------
    settings
        The channel; settings of a part of one's own are in ``settings.custom``.
    travel
        Distance along the road.
    start_s
        Start of the film in s, at most 0.
    end_s
        End of the film in s.
    imu
        Recorded trace; None where there is none.
    rng
        Source of randomness, the same for the same seed.
    """

    settings: ChannelSettings
    travel: Travel
    start_s: float
    end_s: float
    imu: ImuTrace | None
    rng: np.random.Generator


def no_motion(drive: Drive) -> None:  # noqa: ARG001 - all motions are made of a drive
    """Return no shake."""
    return


def road_motion(drive: Drive) -> Shake | None:
    """Return the shake of a half-car on a random road."""
    travel = drive.travel
    # road beyond the distance driven, for the axles before and behind the centre of mass, 2.76 m apart
    length = float(travel.distance(drive.end_s) - travel.distance(drive.start_s - RUN_IN_S)) + 10.0
    road = road_profile(drive.settings.road_class, length, drive.rng)
    return road_shake(travel, road, drive.start_s, drive.end_s)


def imu_motion(drive: Drive) -> Shake | None:
    """Return the shake of a recorded trace."""
    if drive.imu is None:
        raise SettingsError("shake = imu needs a recorded trace: pass imu, or choose shake = road or none")
    return imu_shake(drive.imu, drive.settings.imu_start_s, drive.start_s, drive.end_s)


def motion(settings: ChannelSettings, imu: ImuTrace | None, rng: np.random.Generator) -> Motion:
    """Return the vehicle's motion over the film."""
    travel = Travel.of(settings)
    drive = Drive(settings, travel, min(0.0, settings.camera.start_s), film_duration(settings), imu, rng)
    return Motion(travel, MOTIONS[settings.shake](drive))


WAVES = 24
"""Sines of each band. Chosen: the sum of 24 of random phases is normal to a few per cent."""


def hand_motion(drive: "Drive") -> "Shake | None":
    """Return the shake of a hand: pitch, yaw and roll as sums of sines."""
    rms, rng = np.deg2rad(drive.settings.hand_deg), drive.rng
    if not rms:
        return None
    # Frequencies of the sway. Chosen: arms and breath move a phone slowly; what is slower is a user who walks
    # frequencies of the tremor: physiological tremor of a hand lies at 8 to 12 Hz, of a loaded one a little below
    hz = np.concatenate([rng.uniform(*band, (3, WAVES)) for band in ((0.1, 1.5), (6.0, 12.0))], axis=1)
    phase = rng.uniform(0, 2 * np.pi, hz.shape)
    # Amplitude of the tremor by that of the sway. Chosen: at the default sway 0.5 px rms of a phone's 1000 px of focal
    # length, a quarter of a cell of the smallest array that is read
    size = rms * np.sqrt(2 / WAVES) * np.repeat([1.0, 0.1], WAVES)

    def shake(times_s: Floats) -> Floats:
        angles = [
            (size * np.sin(2 * np.pi * f * times_s[..., None] + p)).sum(-1) for f, p in zip(hz, phase, strict=True)
        ]
        return np.stack([np.zeros_like(times_s), *angles], -1)

    return shake
