"""Predicted reach of layers: measured reach of the reference link, and order of layers, light and blur."""

from dataclasses import replace

import pytest

from heliograph.probe.reach import reaches
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.observe.cutout import Noise
from heliograph.signal.settings import SignalSettings

NEAR = Pose(0.0, 0.0, 1.1667, 0.0, 0.5)
"""The reference array at 50 m."""


@pytest.mark.slow
def test_reach_of_the_reference_link_agrees_with_measurements() -> None:
    """The plain receiver reads the low layer to about 60 m and the middle layer to 70 m; soft reads all to 105 m."""
    best = reaches(NEAR, 204.0, Noise(4.8, 2.0), 50.0, SignalSettings())
    assert (best["plain"]["low"], best["plain"]["middle"]) == (pytest.approx(60, rel=0.15), pytest.approx(72, rel=0.15))
    assert best["soft"]["low"] == pytest.approx(110, rel=0.15)
    # less light, or more blur
    dim = reaches(NEAR, 50.0, Noise(4.8, 2.0), 50.0, SignalSettings())
    blurred = reaches(replace(NEAR, blur=1.0), 204.0, Noise(4.8, 2.0), 50.0, SignalSettings())
    for receiver, reach in best.items():
        assert reach["low"] < reach["middle"] < reach["high"]
        assert dim[receiver]["low"] < reach["low"]
        assert blurred[receiver]["low"] < reach["low"]


def test_soft_reads_dim_arrays_farther_than_plain() -> None:
    reach = reaches(NEAR, 8.0, Noise(1.3, 2.8), 50.0, SignalSettings(), smallest_px=3.0)
    for layer, distance_m in reach["plain"].items():
        assert reach["soft"][layer] >= 0.95 * distance_m


def test_large_and_dark_arrays_have_no_estimate() -> None:
    assert reaches(NEAR, 204.0, Noise(4.8, 2.0), 50.0, SignalSettings(side=64)) == {}
    assert reaches(NEAR, 0.0, Noise(4.8, 2.0), 50.0, SignalSettings()) == {}
