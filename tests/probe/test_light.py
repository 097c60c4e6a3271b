"""Pattern period from light: correlation kernel, reference, lamps, clock."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from light_oracle import expected_correlation

from heliograph.base.frames import Frame
from heliograph.probe import kernels
from heliograph.probe.arrays import Clock, clock_of
from heliograph.probe.light import MIN_VARIANCE, lamp_period, pair_covariance
from heliograph.signal.settings import SignalSettings

ORDER = SignalSettings().slot_order


def test_kernel_agrees_with_the_reference() -> None:
    rates, phases, exposures = np.array([0.7, 1.0, 1.37, 4.2]), np.array([0.0, 0.3, 1.6]), np.array([0.3, 1.0])
    numbers, lags = np.arange(5.0), np.array([1, 2, 3])
    out = np.empty((4, 3, 2, 5, 3))
    covariance = pair_covariance(ORDER)
    kernels.expected_correlations(rates, phases, exposures, numbers, lags, covariance, MIN_VARIANCE, out)
    for place in np.ndindex(out.shape):
        r, p, x, t, k = place
        expected = expected_correlation(float(rates[r]), float(phases[p]), float(exposures[x]), t, int(lags[k]), ORDER)
        assert out[place] == pytest.approx(expected, abs=1e-9), place


def test_pattern_and_inverse_are_opposite_and_other_pairs_independent() -> None:
    # the variance floor keeps the correlation above -1
    assert expected_correlation(1.0, 0.0, 1.0, 0, 1, ORDER) < -0.8
    assert expected_correlation(1.0, 0.0, 1.0, 1, 1, ORDER) == pytest.approx(0, abs=1e-9)
    assert expected_correlation(1.0, 0.0, 1.0, 0, 2, ORDER) == pytest.approx(0, abs=1e-9)
    # two frames of a pattern cover different halves of the slots
    assert expected_correlation(2.0, 0.0, 1.0, 0, 1, ORDER) > 0.2


@pytest.mark.parametrize("period", [4.0, 7.5, 20.0])
def test_period_of_a_lamp_is_measured(period: float) -> None:
    brightness = 100 + 20 * np.sign(np.sin(2 * np.pi * (np.arange(240) + 0.3) / period))
    assert lamp_period(brightness) == pytest.approx(period, rel=0.02)


def test_random_flicker_has_no_period() -> None:
    assert lamp_period(np.random.default_rng(1).normal(100, 5, 240)) is None
    assert lamp_period(np.full(240, 7.0)) is None


def clock(phase: float, ppm: float, packets: int) -> Clock:
    signal = SignalSettings()
    starts = (phase * signal.pattern_period_s + np.arange(packets) * signal.packet_s * (1 + ppm * 1e-6)).tolist()
    frames = [Frame(k, k * 1e-3, np.zeros((1, 1), np.uint8)) for k in range(20)]
    rows: Any = [SimpleNamespace(start_time_s=start) for start in starts]
    return clock_of(rows, frames, signal)


@pytest.mark.parametrize("phase", [0.0, 0.3, -0.45])
def test_phase_of_the_clock_is_the_delay_of_patterns_after_frames(phase: float) -> None:
    measured = clock(phase, 0.0, 1)
    assert measured.phase_patterns == pytest.approx(phase, abs=1e-9)
    assert measured.rate_ppm is None
    assert measured.in_step == (abs(phase) < 0.1)


def test_rate_of_the_clock_needs_distant_packets() -> None:
    assert clock(0.1, 80.0, 2).rate_ppm is None
    measured = clock(0.1, 80.0, 20)
    assert measured.rate_ppm == pytest.approx(80, abs=0.1)
    assert measured.rate_error_ppm is not None
    assert measured.rate_error_ppm < 20
