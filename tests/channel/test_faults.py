"""Impaired arrays: failed LEDs, occlusion, timing offsets and array motion."""

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from heliograph.base.config import from_mapping
from heliograph.channel import ChannelSettings, film

SIDE = 16
NEAR = {
    "distance_m": 10, "speed_m_s": 0, "shake": "none", "camera": {"width": 160, "height": 160},
    "sensor": {"full_well_e": 1e7, "dark_noise_e": 0},
}  # fmt: skip
"""LED pitch 5.8 px, so that LED images do not overlap."""


def shoot(level: int, frames: int = 1, **place: Any) -> list[NDArray[np.float64]]:
    """Render an array at a constant level, in gray levels."""
    lights: Iterator[NDArray[np.uint8]] = itertools.repeat(np.full((SIDE, SIDE), level, np.uint8))
    scene = {**NEAR, "duration_s": 1e-3 * frames, "arrays": [{"x_m": 0, "y_m": 0, "brightness": 0.1, **place}]}
    settings = from_mapping(ChannelSettings, scene)
    shot = film(settings, [lights], np.random.default_rng(3), pattern_period_s=1e-3)
    return [frame.pixels.astype(float) for frame, _ in shot]


def at_leds(image: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the pixels at LED centres."""
    at = np.round(79.5 + (np.arange(SIDE) - 7.5) * 35 / 12 * 20 / 10).astype(int)
    return np.asarray(image[np.ix_(at, at)])


def leds(image: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return the mask of lit LEDs."""
    return np.asarray(at_leds(image) > 20)


def test_all_leds_of_a_sound_array_shine() -> None:
    assert leds(shoot(4)[0]).all()
    assert not leds(shoot(0)[0]).any()


def test_dead_leds_stay_dark_and_stuck_ones_lit() -> None:
    lit, dark = leds(shoot(4, dead=0.05, stuck=0.025)[0]), leds(shoot(0, dead=0.05, stuck=0.025)[0])
    assert (~lit).sum() == round(0.05 * 256)
    assert dark.sum() == round(0.025 * 256)
    assert not (dark & ~lit).any()


def test_leds_differ_by_their_spread() -> None:
    even, first, second = (shoot(4, 2, spread=spread)[k] for spread, k in ((0.0, 0), (0.2, 0), (0.2, 1)))
    gains = [at_leds(frame) / at_leds(even) for frame in (first, second)]
    assert gains[0].std() == pytest.approx(0.2, rel=0.15)
    assert gains[0].mean() == pytest.approx(1, abs=0.04)
    assert np.abs(gains[1] - gains[0]).max() < 0.05


def test_dark_while_it_is_off() -> None:
    frames = shoot(4, 5, off_s=[(0.001, 0.0025), (0.0042, 0.0044)], stuck=0.1)
    light = np.array([frame.sum() - shoot(0)[0].sum() for frame in frames])
    assert light / light[0] == pytest.approx([1.0, 0.0, 0.5, 1.0, 0.8], abs=0.01)


def test_a_part_is_hidden_by_something_of_its_own_light() -> None:
    image = shoot(4, hidden=(0.0, 0.5, 0.25, 1.0), hidden_level=0.3)[0]
    part = np.zeros((SIDE, SIDE), bool)
    part[8:, :4] = True
    seen = at_leds(image)
    assert seen[part] == pytest.approx(0.3 * 255, abs=1)
    assert not np.isclose(seen[~part], 0.3 * 255, atol=1).any()


def test_an_array_drives_away() -> None:
    lights = [itertools.repeat(np.zeros((SIDE, SIDE), np.uint8))]
    for speed, rate in ((0, -10), (25, 15)):
        scene = {**NEAR, "speed_m_s": 10, "distance_m": 30, "duration_s": 0.01, "arrays": [{"vz_m_s": speed}]}
        settings = from_mapping(ChannelSettings, scene)
        *_, (_, truth) = film(settings, lights, np.random.default_rng(0), pattern_period_s=1e-3)
        assert truth.arrays[0].distance_m == pytest.approx(30 + rate * 0.0095, abs=1e-6)
