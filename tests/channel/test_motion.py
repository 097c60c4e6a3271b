"""Road, half-car and IMU traces against theory."""

from pathlib import Path

import numpy as np
import pytest
from scipy.signal import welch

from heliograph.channel.motion import (
    ROUGHNESS_M3,
    STEP_M,
    STEP_S,
    HalfCar,
    ImuTrace,
    Travel,
    film_duration,
    imu_shake,
    motion,
    road_height,
    road_profile,
    road_shake,
    roughness,
)  # fmt: skip
from heliograph.channel.settings import ChannelSettings


@pytest.mark.parametrize("road_class", "AD")
def test_spectrum_of_the_road_is_iso_8608(road_class: str) -> None:
    road = road_profile(road_class, 3000, np.random.default_rng(1))
    per_m, density = welch(road, 1 / STEP_M, nperseg=1 << 14)
    for low in (0.02, 0.05, 0.1, 0.3, 1.0, 3.0):
        band = (per_m >= low) & (per_m < low * 1.3)
        assert density[band].mean() == pytest.approx(roughness(road_class, per_m[band]).mean(), rel=0.1)
    assert roughness(road_class, 0.1) == pytest.approx(ROUGHNESS_M3[road_class])


def test_road_is_smooth_between_samples_and_repeats() -> None:
    road = road_profile("A", 100, np.random.default_rng(0))
    length, way = road.size * STEP_M, np.linspace(0, 50, 999)
    assert road_height(road, way + length) == pytest.approx(road_height(road, way), abs=1e-9)
    assert length >= 100


@pytest.mark.parametrize("hz", [0.8, 11.0])
def test_half_car_follows_its_transfer_function(hz: float) -> None:
    car, time = HalfCar(), np.arange(0, 15, STEP_S)
    delay = (car.front_m + car.rear_m) / 8.0  # the rear axle follows with a delay
    middle = time + STEP_S / 2
    road = 0.01 * np.stack([np.sin(2 * np.pi * hz * middle), np.sin(2 * np.pi * hz * (middle - delay))], -1)
    q = car.ride(road, STEP_S)[-2500:]  # an integer number of periods
    wave = np.exp(-2j * np.pi * hz * time[-2500:])
    reached = 2j * (q * wave[:, None]).mean(0)
    mass, damping, stiffness, tyres = car.matrices()
    s = 2j * np.pi * hz
    response = np.linalg.solve(mass * s**2 + damping * s + stiffness, tyres.astype(complex))
    expected = response @ (0.01 * np.array([1, np.exp(-2j * np.pi * hz * delay)]))
    assert np.abs(reached - expected).max() < 0.01 * np.abs(expected).max()


def test_car_settles_on_a_slope() -> None:
    # a long triangle with slope 2 %: far from the corners, car and camera pitch with the slope
    way = STEP_M * np.arange(1 << 16)
    road = 0.02 * np.minimum(way, way[-1] - way)
    late = road_shake(Travel(np.zeros(1), np.array([20.0])), road, 6, 12)(np.array([12.0]))[0]
    assert late[1] == pytest.approx(0.02, rel=1e-2)
    assert late[0] == pytest.approx(0.02 * (20 * 12 + HalfCar().camera_m), rel=1e-2)
    assert late[2:] == pytest.approx([0, 0])


@pytest.mark.parametrize(("speed_m_s", "step_s"), [(30.0, 2e-3), (60.0, 2e-3), (100.0, 1.2e-3)])
def test_fast_car_samples_the_shortest_wave_of_the_road_twice(speed_m_s: float, step_s: float) -> None:
    shake = road_shake(Travel(np.zeros(1), np.array([speed_m_s])), np.zeros(1 << 14), 0, 1)
    assert np.diff(shake.x) == pytest.approx(step_s)  # type: ignore[attr-defined]  # a spline
    assert speed_m_s * step_s <= 0.25 / 2  # the road has waves down to 0.25 m


def test_standing_car_is_not_shaken() -> None:
    settings = ChannelSettings(speed_m_s=0, shake="road", road_class="D")
    pose = motion(settings, None, np.random.default_rng(0))(np.linspace(0, 1, 50))
    assert np.ptp(pose.pitch_rad) < 1e-9
    assert np.ptp(pose.travelled_m) == 0


def test_pitch_rate_grows_with_the_road_class() -> None:
    rates = []
    for road_class in "ABCD":
        settings = ChannelSettings(shake="road", road_class=road_class)  # type: ignore[arg-type]
        pose = motion(settings, None, np.random.default_rng(5))(np.arange(0, 6.6, 1e-3))
        rates.append(np.diff(pose.pitch_rad).std() * 1e3)
    assert np.array(rates[1:]) / rates[:-1] == pytest.approx([2, 2, 2], rel=1e-3)
    assert 0.003 < rates[1] < 0.1  # rad/s, class B at 30 km/h


def test_travel_integrates_the_speed_of_settings_and_recordings() -> None:
    profile = ((1.0, 4.0), (3.0, 8.0), (5.0, 0.0))
    travel = Travel.of(ChannelSettings(speed_profile=profile))
    time = np.linspace(0, 7, 7001)
    summed = np.concatenate([[0], np.cumsum((travel.speed(time)[1:] + travel.speed(time)[:-1]) / 2 * np.diff(time))])
    assert travel.distance(time) == pytest.approx(summed, abs=1e-6)
    assert travel.distance(travel.time_of(17.5)) == pytest.approx(17.5)
    assert film_duration(ChannelSettings()) == pytest.approx(6.6)
    t = np.arange(0, 10, 0.01)
    recorded = ImuTrace.from_columns(t, t, t, t, 2 * t).speed_profile(2.5)
    assert np.array(recorded) == pytest.approx(np.array([[0, 0], [2.5, 5], [5, 10], [7.5, 15]]))
    assert film_duration(ChannelSettings(speed_profile=recorded, distance_m=40, stop_m=15)) == pytest.approx(5)


def gyro(seconds: float, hz: float, rate: float) -> ImuTrace:
    t = np.arange(0, seconds, 1 / 104)
    zero = np.zeros_like(t)
    return ImuTrace.from_columns(t, zero, rate * np.sin(2 * np.pi * hz * t), zero, zero)


def test_gyro_is_integrated_above_the_steering_without_jumps() -> None:
    time = np.linspace(10, 30, 5000)
    pitch = imu_shake(gyro(60, 5.0, 0.1), 0, 0, 40)(time)[:, 1]
    assert pitch == pytest.approx(-0.1 / (2 * np.pi * 5) * np.cos(2 * np.pi * 5 * time), abs=2e-5)
    slow = imu_shake(gyro(60, 0.03, 0.1), 0, 0, 40)(time)[:, 1]
    assert np.abs(slow).max() < 0.02 * 0.1 / (2 * np.pi * 0.03)
    pitch = imu_shake(gyro(20, 1.3, 0.1), 3, 0, 100)(np.arange(0, 100, 1e-3))[:, 1]
    assert np.abs(np.diff(pitch)).max() < 0.15e-3
    assert np.abs(np.diff(pitch, 2)).max() < 6e-6


@pytest.mark.real_data
def test_recorded_trace_keeps_its_pitch_rate(data: Path) -> None:
    rows = np.loadtxt(data / "motion" / "car-imu.csv", delimiter=",", skiprows=1)
    trace = ImuTrace.from_columns(rows[:, 0], rows[:, 1], rows[:, 2], rows[:, 3], rows[:, 7])
    pitch = imu_shake(trace, 0, 0, 55)(np.arange(1, 50, 1e-3))[:, 1]
    per_hz, density = welch(np.diff(pitch) * 1e3, 1e3, nperseg=10_000)
    raw_hz, raw = welch(rows[:, 2], 104.2, nperseg=1042)
    for low, high in ((0.7, 2), (2, 5), (5, 15), (15, 30)):
        rms = np.sqrt(raw[(raw_hz >= low) & (raw_hz < high)].sum() * raw_hz[1])
        made = np.sqrt(density[(per_hz >= low) & (per_hz < high)].sum() * per_hz[1])
        assert made == pytest.approx(rms, rel=0.1)
    assert 2917 * np.abs(np.diff(pitch)).max() < 1.2


def test_broken_trace_is_refused() -> None:
    t = np.arange(40.0)
    with pytest.raises(ValueError, match="columns of one length of at least 32"):
        ImuTrace.from_columns(t, t, t, t, t[:-1])
    with pytest.raises(ValueError, match="finite values and rising times"):
        ImuTrace.from_columns(t[::-1], t, t, t, t)
