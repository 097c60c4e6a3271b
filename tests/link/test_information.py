"""Symbol information, compared with an independent oracle and with the closed form for images."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from properties import examples

from heliograph.channel.settings import CameraSettings, ChannelSettings, Placement
from heliograph.link import budget
from heliograph.link.budget import RangeEstimator, required_information
from heliograph.link.settings import load_settings
from heliograph.signal import haar
from heliograph.signal.formats import Mode
from heliograph.signal.settings import LAYERS, SignalSettings

ORACLE = {100: ((0.914, 0.711, 0.651), (1.00, 1.00, 0.820)), 150: ((0.545, 0.295, 0.082), (1.00, 0.768, 0.091))}
"""Information per distance for the high, middle and low layer: with higher layers cancelled, and with all others known.

From an independent program with one Gaussian for disc and blur, a small random roll and random positions."""


@pytest.mark.slow
def test_information_is_that_of_a_program_written_apart() -> None:
    settings = load_settings("static")
    reach = RangeEstimator(settings, settings.channel.emitter.all_on)
    for distance_m, (linear, bound) in ORACLE.items():
        for layer, one, most in zip(LAYERS, linear, bound, strict=True):
            assert reach.information("linear", "paired", layer, distance_m) == pytest.approx(one, abs=0.02)
            assert reach.information("bound", "paired", layer, distance_m) == pytest.approx(most, abs=0.02)


@pytest.mark.parametrize(("ratio", "bits"), [(0.0, 0.0), (1.0, 0.4859), (100.0, 1.0)])
def test_information_of_a_binary_symbol(ratio: float, bits: float) -> None:
    """The binary-input Gaussian channel has a capacity of 0.4859 at 0 dB."""
    assert budget.binary_information(np.array([ratio]))[0] == pytest.approx(bits, abs=2e-4)


def test_a_turned_array_is_narrower_and_dimmer() -> None:
    channel = ChannelSettings(arrays=(Placement(x_m=0, y_m=0, yaw_deg=40),))
    found = budget.array_images(channel, 8, 60.0, (0.0, 0.0))
    facing = channel.camera.focal_px * 0.02 / 60
    assert found.pitch_px == pytest.approx(facing * math.sqrt(math.cos(math.radians(40))), rel=1e-2)
    lobe = math.cos(math.radians(40)) ** channel.emitter.lobe_order
    assert found.light == pytest.approx(lobe / math.cos(math.radians(40)), rel=2e-2)


def test_symbols_are_those_of_the_transform() -> None:
    d = np.random.default_rng(0).choice([-1.0, 1.0], (8, 8))
    assert budget.symbol_levels(8, "haar") @ d.ravel() + 0.5 == pytest.approx(haar.encode(d) / 4)
    assert [int((budget.symbol_layers(8) == k).sum()) for k in range(3)] == [16, 32, 16]


def test_noise_is_that_of_the_sensor() -> None:
    channel = ChannelSettings()
    electrons = 15000 * (0.4 + 0.02)
    variance = 40**2 + electrons + (15000 / 255) ** 2 / 12
    assert budget.noise_share(channel, 0.8) == pytest.approx(math.sqrt(variance) / 15000)


@given(st.floats(20, 120), st.floats(0.2, 1.5), st.floats(1, 300), st.sampled_from(["haar", "ook"]))
@examples(12)
@pytest.mark.slow
def test_no_estimate_has_more_than_the_bound(distance_m: float, blur_px: float, snr: float, modulation: Any) -> None:
    channel = ChannelSettings(camera=CameraSettings(blur_px=blur_px))
    looks = budget.symbol_images(channel, SignalSettings(side=4, modulation=modulation), distance_m)
    for layer in range(3):
        sampled, linear, bound = (looks.information(kind, layer, snr) for kind in ("sampled", "linear", "bound"))
        assert -1e-9 <= linear <= bound + 1e-9 <= 1 + 2e-9
        # "sampled" has the same unknown symbols in the high layer, and a higher error
        assert layer or sampled <= linear + 0.01


@pytest.mark.slow
def test_a_range_ends_where_the_code_no_longer_gets_enough() -> None:
    reach = RangeEstimator(load_settings("static", {"signal": {"side": 8}}), 0.8)
    cases: list[tuple[Mode, float]] = [("paired", 1 / 3), ("single", 2 / 3)]
    for mode, rate in cases:
        far = [reach.range_m("linear", mode, layer, rate, 400.0) for layer in LAYERS]
        assert far == sorted(far, reverse=True)
        for layer, at_m in zip(LAYERS, far, strict=True):
            inside, beyond = (reach.information("linear", mode, layer, at_m * k) for k in (0.95, 1.05))
            assert inside > required_information(rate) > beyond
    assert reach.range_m("linear", "paired", "high", 1 / 3, 40.0) == 40.0
    assert reach.range_m("linear", "paired", "high", 1 / 3, 5.0) == 5.0
    estimator = RangeEstimator(load_settings("static", {"signal": {"side": 4}}), 1e-4)
    assert estimator.range_m("linear", "paired", "low", 0.5, 99) == 0


def test_required_information_rises_with_the_rate() -> None:
    rates, needed = zip(*budget.REQUIRED_INFORMATION, strict=True)
    assert required_information(1 / 3) == needed[0]
    assert required_information(0.45) == pytest.approx((needed[1] + needed[2]) / 2)
    assert all(rate < information <= 1 for rate, information in budget.REQUIRED_INFORMATION[:-1])
    assert [required_information(rate) for rate in rates] == sorted(needed)
