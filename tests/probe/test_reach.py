"""Predicted reach of layers: measured reach of the reference link, and order of layers, light and blur."""

from dataclasses import replace
from typing import Any

import pytest

from heliograph.link.budget import reaches
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.observe.cutout import Noise
from heliograph.signal.settings import SignalSettings

NOISE, NEAR = Noise(4.8, 2.0), Pose(0.0, 0.0, 1.1667, 0.0, 0.5)
"""Noise of the reference sensor, and the reference array at 50 m."""


def reach_of(light: float, noise: Noise = NOISE, pose: Pose = NEAR, **given: float) -> dict[str, Any]:
    return dict(reaches(pose, light, noise, 50.0, SignalSettings(), **given))


@pytest.mark.slow
def test_reach_of_the_reference_link_agrees_with_measurements() -> None:
    """The plain receiver reads the low layer to about 60 m and the middle layer to 70 m; soft reads all to 105 m."""
    best, dim, blurred = reach_of(204.0), reach_of(50.0), reach_of(204.0, pose=replace(NEAR, blur=1.0))
    found = [best["plain"]["low"], best["plain"]["middle"], best["soft"]["low"]]
    assert found == pytest.approx([60, 72, 110], rel=0.15)
    for receiver, reach in best.items():
        assert max(dim[receiver]["low"], blurred[receiver]["low"]) < reach["low"] < reach["middle"] < reach["high"]


def test_soft_reads_dim_arrays_farther_than_plain() -> None:
    reach = reach_of(8.0, Noise(1.3, 2.8), smallest_px=3.0)
    for layer, distance_m in reach["plain"].items():
        assert reach["soft"][layer] >= 0.95 * distance_m


def test_large_and_dark_arrays_have_no_estimate() -> None:
    assert reaches(NEAR, 204.0, NOISE, 50.0, SignalSettings(side=64)) == reach_of(0.0) == {}
