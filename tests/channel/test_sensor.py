"""Sensor model against EMVA 1288, Poisson statistics and a NumPy reference."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import stats

from heliograph.channel.sensor import read_out
from heliograph.channel.settings import SensorSettings
from heliograph.channel.truth import NoiseModel

U64 = np.uint64


def mix64(x: NDArray[np.uint64]) -> NDArray[np.uint64]:
    x = (x ^ (x >> U64(30))) * U64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> U64(27))) * U64(0x94D049BB133111EB)
    return np.asarray(x ^ (x >> U64(31)))


def mix32(x: NDArray[np.uint64]) -> NDArray[np.uint64]:
    for shift, factor in ((16, 0x7FEB352D), (15, 0x846CA68B), (16, 1)):
        x = ((x ^ (x >> U64(shift))) * U64(factor)) & U64(0xFFFFFFFF)
    return x


def normals(seed: int, frame: int, shape: tuple[int, int]) -> NDArray[np.float64]:
    """Return the sensor's standard normal variables in double precision."""
    golden = U64(0x9E3779B97F4A7C15)
    frame_key = mix64(np.array([seed], U64) + golden * np.array([frame + 1], U64))
    key = mix64(frame_key + golden * np.arange(1, shape[0] + 1, dtype=U64))[:, None]
    step = (np.arange(shape[1], dtype=U64) * U64(0x9E3779B9))[None]
    first = mix32((step + key) & U64(0xFFFFFFFF)).astype(float)
    second = mix32((step + (key >> U64(32))) & U64(0xFFFFFFFF)).astype(float)
    return np.asarray(np.sqrt(-2 * np.log((first + 0.5) / 2**32)) * np.cos(2 * np.pi * second / 2**32))


def flat(level: float, shape: tuple[int, int] = (300, 700)) -> NDArray[np.float32]:
    return np.full(shape, level, np.float32)


def test_kernel_is_its_reference() -> None:
    sensor = SensorSettings()
    light = np.random.default_rng(0).uniform(0, 0.9, (64, 200)).astype(np.float32)
    z, mu = normals(99, 3, light.shape), light * sensor.full_well_e
    total = mu + sensor.dark_noise_e**2
    electrons = mu + np.sqrt(total) * z + mu / total / 6 * (z**2 - 1)
    gray = np.clip(np.floor(sensor.gain_dn_per_e * electrons + 0.5), 0, 255)
    got = read_out(light, sensor, 99, 3)
    assert np.abs(got - gray).max() <= 1
    assert (got != gray).mean() < 1e-4  # float32 rounding at gray level boundaries


@pytest.mark.parametrize("bits", [8, 12])
def test_photon_transfer_slope_is_the_gain(bits: int) -> None:
    sensor, levels = SensorSettings(bits=bits), np.linspace(0.05, 0.9, 8)
    grays = [np.stack([read_out(flat(a), sensor, 5, k) for k in range(2)]).astype(float) for a in levels]
    mean, variance = np.array([g.mean() for g in grays]), np.array([g.var() for g in grays])
    slope, dark = np.polyfit(mean, variance, 1)
    # EMVA 1288: sigma_y^2 = K^2 sigma_d^2 + 1/12 + K mu_y
    assert slope == pytest.approx(sensor.gain_dn_per_e, rel=0.02)
    expected = sensor.gain_dn_per_e**2 * (sensor.dark_noise_e**2 + levels * sensor.full_well_e) + 1 / 12
    assert variance == pytest.approx(expected, rel=0.03)
    assert dark == pytest.approx(sensor.gain_dn_per_e**2 * 1600 + 1 / 12, rel=0.3)
    assert mean / sensor.full_scale == pytest.approx(levels, abs=3e-4)


def test_noise_of_the_reference_link_and_of_the_truth() -> None:
    sensor = SensorSettings()
    gray = np.stack([read_out(flat(0.4), sensor, 5, k) for k in range(4)]).astype(float) / 255
    assert gray.std() == pytest.approx(0.006, rel=0.04)
    assert gray.std() == pytest.approx(float(NoiseModel(sensor).sigma(0.4)), rel=0.01)


@pytest.mark.slow
def test_tails_are_those_of_a_normal_variable() -> None:
    sensor = SensorSettings(full_well_e=1e6, dark_noise_e=0, bits=12, offset_dn=0)
    mean, gain = 0.5e6, sensor.gain_dn_per_e
    z = np.concatenate([normals(11, k, (512, 1024)).ravel() for k in range(4)])
    count = z.size
    assert stats.kurtosis(z) == pytest.approx(0, abs=5 * np.sqrt(24 / count))
    assert z.std() == pytest.approx(1, abs=5 / np.sqrt(2 * count))
    for limit in (2, 3, 4, 4.5):
        expected = 2 * stats.norm.sf(limit) * count
        assert (np.abs(z) > limit).sum() == pytest.approx(expected, abs=5 * np.sqrt(expected))
    gray = read_out(flat(0.5), sensor, 11, 0)
    assert gray.std() == pytest.approx(np.sqrt(gain**2 * mean + 1 / 12), rel=0.01)


def test_neighbours_in_space_and_time_are_independent() -> None:
    z = np.stack([normals(4, k, (400, 600)) for k in range(3)])
    for column, row, frame in ((1, 0, 0), (2, 0, 0), (0, 1, 0), (1, 1, 0), (0, 0, 1)):
        a, b = z[frame:, row:, column:], z[: 3 - frame, : 400 - row, : 600 - column]
        assert abs((a * b).mean()) < 5 / np.sqrt(a.size)
        assert abs(((a**2 - 1) * (b**2 - 1)).mean() / 2) < 5 / np.sqrt(a.size)


@pytest.mark.parametrize("mean", [0.3, 3.0, 12.0, 30.0])
def test_few_photons_are_poisson(mean: float) -> None:
    sensor = SensorSettings(full_well_e=255, dark_noise_e=0)
    counts = np.bincount(read_out(flat(mean / 255, (512, 1024)), sensor, 8, 0).ravel(), minlength=80)[:80]
    expected = stats.poisson(mean).pmf(np.arange(80)) * 512 * 1024
    many = expected > 50
    chi2 = ((counts - expected) ** 2 / expected)[many].sum() / many.sum()
    assert chi2 < (2.0 if mean < 20 else 60)  # from mean 20, a normal variable with the same three moments
    assert stats.skew(np.repeat(np.arange(80), counts)) == pytest.approx(mean**-0.5, rel=0.05)


def test_bright_light_saturates_and_dark_noise_is_cut_at_black() -> None:
    dark = flat(0.0)
    assert read_out(dark, SensorSettings(), 1, 0).mean() == pytest.approx(0.68 / np.sqrt(2 * np.pi), abs=0.15)
    gray = read_out(dark, SensorSettings(offset_dn=16), 1, 0)
    assert gray.mean() == pytest.approx(16, abs=0.02)
    assert gray.std() == pytest.approx(np.sqrt(0.68**2 + 1 / 12), rel=0.02)
    assert (read_out(flat(1.2), SensorSettings(), 1, 0) == 255).all()
    assert (read_out(flat(1e9), SensorSettings(bits=12), 1, 0) == 4095).all()
    with pytest.raises(ValueError, match=r"light is \(h, w\) float32, not \(4, 4\) float64"):
        read_out(np.zeros((4, 4)), SensorSettings(), 1, 0)  # type: ignore[arg-type]
