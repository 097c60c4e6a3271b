"""Predicted layer range: textbook limits of symbol information, and order of layers."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad
from threadpoolctl import threadpool_info, threadpool_limits

from heliograph.probe import reach
from heliograph.probe.reach import information_of, reaches
from heliograph.receive.equalise.lmmse import Estimate, equalise
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.observe.noise import Noise
from heliograph.signal.settings import SignalSettings

NEAR = Pose(0.0, 0.0, 1.1667, 0.0, 0.5)
"""The reference array at 50 m."""


def test_information_of_bits_in_white_noise_is_that_of_the_books() -> None:
    def lost(snr: float) -> float:
        """Return the mean of log2(1 + exp(-LLR)) over channel outputs."""

        def at(y: float) -> float:
            return float(np.exp(-0.5 * (y - snr**0.5) ** 2) / (2 * np.pi) ** 0.5 * np.logaddexp(0, -2 * snr**0.5 * y))

        return float(quad(at, -30, 40)[0] / np.log(2))

    snr = np.array([0.1, 0.5, 1.0, 4.0, 100.0])
    assert information_of(snr) == pytest.approx([1 - lost(one) for one in snr], abs=1e-3)
    assert information_of(np.array([1.0])) == pytest.approx(0.486, abs=1e-3)


def test_what_is_expected_of_the_reference_link_is_what_is_measured_of_it() -> None:
    """The plain receiver reads the low layer to about 60 m and the middle layer to 70 m; soft reads all to 105 m."""
    plain, soft = reaches(NEAR, 204.0, Noise(4.8, 2.0), 50.0, SignalSettings())
    assert plain.distance_m["low"] == pytest.approx(60, rel=0.15)
    assert plain.distance_m["middle"] == pytest.approx(72, rel=0.15)
    assert soft.distance_m["low"] == pytest.approx(110, rel=0.15)
    for one in (plain, soft):
        assert one.distance_m["low"] < one.distance_m["middle"] < one.distance_m["high"] <= one.found_m


def test_less_light_and_more_blur_are_read_less_far() -> None:
    best = reaches(NEAR, 204.0, Noise(4.8, 2.0), 50.0, SignalSettings())
    dim = reaches(NEAR, 50.0, Noise(4.8, 2.0), 50.0, SignalSettings())
    blurred = reaches(replace(NEAR, blur=1.0), 204.0, Noise(4.8, 2.0), 50.0, SignalSettings())
    for worse in (dim, blurred):
        for one, other in zip(best, worse, strict=True):
            assert other.distance_m["low"] < one.distance_m["low"]


def test_of_a_dim_array_soft_reads_farther_than_plain() -> None:
    plain, soft = reaches(NEAR, 8.0, Noise(1.3, 2.8), 50.0, SignalSettings(), smallest_px=3.0)
    for layer in ("high", "middle", "low"):
        assert soft.distance_m[layer] >= 0.95 * plain.distance_m[layer]


def test_its_algebra_runs_in_one_thread(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two BLAS threads took twenty times as long on a loaded machine."""
    threads: list[int] = []

    def counting(*given: Any) -> Estimate:
        threads.extend(info["num_threads"] for info in threadpool_info() if info["user_api"] == "blas")
        return equalise(*given)

    monkeypatch.setattr(reach, "equalise", counting)
    with threadpool_limits(limits=2, user_api="blas"):
        reaches(NEAR, 8.0, Noise(1.3, 2.8), 50.0, SignalSettings(), smallest_px=3.0)
    assert threads
    assert set(threads) == {1}


def test_large_arrays_and_other_modulations_are_not_told() -> None:
    assert reaches(NEAR, 204.0, Noise(4.8, 2.0), 50.0, SignalSettings(side=64)) == ()
    assert reaches(NEAR, 0.0, Noise(4.8, 2.0), 50.0, SignalSettings()) == ()
