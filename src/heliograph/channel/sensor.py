"""EMVA 1288 sensor: light -> electrons with shot and dark noise -> gray levels.

Noise is a function of seed, frame, row and column: a window has the same noise as the full frame.
"""

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from heliograph.base.compiled import compiled
from heliograph.base.frames import Pixels
from heliograph.channel.scene import Corner, Light
from heliograph.channel.settings import SensorSettings

_GOLDEN_64 = np.uint64(0x9E3779B97F4A7C15)  # 2^64 over the golden ratio: step of the Weyl sequence of splitmix64


@compiled(inline="always")
def _mix64(x: np.uint64) -> np.uint64:
    """Mix 64 bits: the finaliser of splitmix64 (Steele, Lea, Flood 2014)."""
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))


@compiled(inline="always")
def _mix32(x: np.uint32) -> np.uint32:
    """Mix 32 bits with low bias (finaliser and constants by C. Wellons, hash-prospector)."""
    x = np.uint32(x ^ (x >> np.uint32(16)))
    x = np.uint32(x * np.uint32(0x7FEB352D))
    x = np.uint32(x ^ (x >> np.uint32(15)))
    x = np.uint32(x * np.uint32(0x846CA68B))
    return np.uint32(x ^ (x >> np.uint32(16)))


@compiled(inline="always")
def _row_key(seed: np.uint64, frame: int, row: int) -> np.uint64:
    """Return 64 random bits for a row of a frame."""
    return _mix64(_mix64(seed + _GOLDEN_64 * np.uint64(frame + 1)) + _GOLDEN_64 * np.uint64(row + 1))


@compiled(inline="always")
def _normal(key: np.uint64, column: int) -> np.float32:
    """Return a standard normal variable (Box-Muller) for a row key and a column, up to 6.6 sigma."""
    step = np.uint32(np.uint32(column) * np.uint32(0x9E3779B9))  # 2^32 over the golden ratio
    first = _mix32(np.uint32(step + np.uint32(key)))
    second = _mix32(np.uint32(step + np.uint32(key >> np.uint64(32))))
    # -2 ln u of u = (first + 1/2) / 2^32: exponent and mantissa of the float, ln(1 + m) by the atanh series
    bits = np.float32(np.float32(first) + np.float32(0.5)).view(np.int32)
    mantissa = np.int32((bits & np.int32(0x7FFFFF)) | np.int32(0x3F800000)).view(np.float32)
    big = mantissa > np.float32(1.41421356)
    mantissa = mantissa * np.float32(0.5) if big else mantissa
    exponent = np.float32((bits >> np.int32(23)) - np.int32(159)) + (np.float32(1) if big else np.float32(0))
    t = (mantissa - np.float32(1)) / (mantissa + np.float32(1))
    q = t * t
    series = np.float32(2) + q * (np.float32(2 / 3) + q * (np.float32(2 / 5) + q * np.float32(2 / 7)))
    log = exponent * np.float32(math.log(2)) + t * series
    radius = np.sqrt(max(np.float32(-2) * log, np.float32(0)))
    # cos(2 pi w) = sin(2 pi (1/4 - |w|)), w = second / 2^32 in -1/2..1/2, by the series of the sine
    w = np.float32(np.int32(second)) * np.float32(2.0**-32)
    x = np.float32(2 * math.pi) * (np.float32(0.25) - abs(w))
    y = x * x
    sine = np.float32(-1 / 5040) + y * (np.float32(1 / 362880) - y * np.float32(1 / 39916800))
    sine = x * (np.float32(1) + y * (np.float32(-1 / 6) + y * (np.float32(1 / 120) + y * sine)))
    return np.float32(radius * sine)


@compiled()
def _poisson(mean: float, key: np.uint64, column: int) -> int:
    """Return a Poisson variable of small mean for a row key and a column, by inversion."""
    # 2^64 over the root 1.2207 of x^4 = x + 1: an independent step
    bits = _mix64(key ^ (np.uint64(0xD1B54A32D192ED03) * np.uint64(column + 1)))
    remainder = (float(bits >> np.uint64(11)) + 0.5) * 2.0**-53  # uniform in (0, 1)
    probability, count = math.exp(-mean), 0
    while remainder > probability and count < 1000:
        remainder -= probability
        count += 1
        probability *= mean / count
    return count


@compiled()
def fill_levels(
    out: NDArray[Any], light: Light, corner: Corner, seed: np.uint64, frame: int, scales: tuple[float, ...]
) -> None:
    """Write the gray levels of `read_out`."""
    well, dark, gain = np.float32(scales[0]), np.float32(scales[1]), np.float32(scales[2])
    offset, top = np.float32(scales[3]), np.float32(scales[4])
    height, width = light.shape
    zero, half, sixth = np.float32(0), np.float32(0.5), np.float32(1 / 6)
    variance = dark * dark
    for i in range(height):
        key = _row_key(seed, frame, i + corner[1])
        row, source = out[i], light[i]
        for j in range(width):
            mu = min(max(source[j], zero), np.float32(64.0)) * well  # more light overflows float32
            total = mu + variance
            # sigma_e^2 = sigma_d^2 + mu_e; third cumulant mu_e by the Cornish-Fisher term (z^2 - 1) skew / 6
            z = _normal(key, j + corner[0])
            sigma = np.sqrt(total)
            skew = mu / max(total, np.float32(1e-20))
            electrons = mu + sigma * z + skew * sixth * (z * z - np.float32(1))
            # y = K electrons, rounded and clipped: 1/12 DN^2 of quantisation noise
            y = min(max(gain * electrons + offset + half, zero), top)
            row[j] = np.int32(y)
        # above the skewness of a Poisson variable of mean 20, the Poisson variable is drawn exactly; the skewness
        # mu / (mu + sigma^2)^1.5 is at most 0.385 / sigma, below this limit above 1.72
        if dark < np.float32(1.8):
            for j in range(width):
                mu = max(source[j], zero) * well
                if zero < mu < 64 and mu > np.float32(0.2236) * (mu + variance) ** np.float32(1.5):
                    electrons = np.float32(_poisson(mu, key, j + corner[0])) + dark * _normal(key, j + corner[0])
                    row[j] = np.int32(min(max(gain * electrons + offset + half, zero), top))


def read_out(light: Light, sensor: SensorSettings, seed: int, frame: int, corner: Corner = (0, 0)) -> Pixels:
    """Return the gray levels of a frame or a window.

    EMVA 1288: mean mu_y = K mu_e + offset, variance sigma_y^2 = K^2 (sigma_d^2 + mu_e) + 1/12 DN^2, before gamma.
    """
    if light.ndim != 2 or light.dtype != np.float32:
        raise ValueError(f"light is (h, w) float32, not {light.shape} {light.dtype}")
    out: Pixels = np.empty(light.shape, np.uint8 if sensor.bits == 8 else np.uint16)
    if sensor.gamma != 1:
        offset_dn = sensor.offset_dn * (1 << 12 - sensor.bits)
        linear = read_out(light, replace(sensor, bits=12, offset_dn=offset_dn, gamma=1.0), seed, frame, corner)
        # 12 bits as in phone sensors; gray level = full scale light^(1 / gamma)
        table = np.rint(sensor.full_scale * (np.arange(4096) / 4095) ** (1 / sensor.gamma))
        return table.astype(np.uint8)[linear] if sensor.bits == 8 else table.astype(np.uint16)[linear]
    levels = (sensor.gain_dn_per_e, float(sensor.offset_dn), float(sensor.full_scale))
    scales = (float(sensor.full_well_e), float(sensor.dark_noise_e), *levels)
    fill_levels(out, light, corner, np.uint64(seed), frame, scales)
    return out
