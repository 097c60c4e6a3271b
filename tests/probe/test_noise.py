"""Photon transfer, compared with sensors of known gain, and its limits."""

from collections.abc import Callable
from functools import partial

import numpy as np
import pytest
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.probe.noise import NoiseEstimate, NoiseWatch

Levels = NDArray[np.float64]

SLOPE = np.tile(np.linspace(20, 200, 160), (120, 1))
"""Gray levels of a still scene."""


def estimate(
    scene: Callable[[int], Levels],
    gain: float = 0.05,
    dark_e: float = 30.0,
    after: Callable[[Levels], Levels] = np.rint,
) -> NoiseEstimate:
    """Estimate film noise for an electron-counting sensor with `gain` gray levels per electron."""
    rng, watch = np.random.default_rng(3), NoiseWatch(32)
    for k in range(33):
        electrons = rng.poisson(scene(k) / gain) + rng.normal(0, dark_e, scene(k).shape)
        watch.add(Frame(k, k / 1000, np.clip(after(gain * electrons), 0, 255).astype(np.uint8)), repeated=False)
    return watch.noise(255)


@pytest.mark.parametrize(("gain", "dark_e"), [(0.02, 60.0), (0.2, 10.0)])
def test_gain_and_dark_noise_of_the_sensor_are_estimated(gain: float, dark_e: float) -> None:
    noise = estimate(lambda _: SLOPE, gain, dark_e)
    assert noise.gain_dn_per_e == pytest.approx(gain, rel=0.05)
    assert noise.gain_dn_per_e is not None
    assert noise.gain_error is not None
    assert abs(noise.gain_dn_per_e - gain) < 4 * noise.gain_error + 0.02 * gain
    assert noise.dark_e == pytest.approx(dark_e, rel=0.2)
    # at level 100 both terms add up
    assert noise.variance_at(100) == pytest.approx(100 * gain + (gain * dark_e) ** 2 + 1 / 12, rel=0.05)


def blinking(leds: NDArray[np.int64], k: int) -> Levels:
    picture = SLOPE.copy()
    picture[30:94, 20:84] = 20 + 200 * np.kron(leds[k], np.ones((8, 8)))
    return picture


def partly_wiped(levels: Levels) -> Levels:
    """Remove the noise in a fifth of the picture and of the gray levels."""
    picture = levels.copy()
    picture[:, 128:] = np.rint(SLOPE[:, 128:])
    return picture


def test_blinking_light_and_wiped_parts_do_not_change_the_gain() -> None:
    leds = np.random.default_rng(4).integers(0, 2, (33, 8, 8))
    assert estimate(partial(blinking, leds)).gain_dn_per_e == pytest.approx(0.05, rel=0.06)
    assert estimate(lambda _: SLOPE, after=partly_wiped).gain_dn_per_e == pytest.approx(0.05, rel=0.06)


def test_single_gray_level_gives_noise_but_no_gain() -> None:
    noise = estimate(lambda _: np.full((120, 160), 100.0))
    assert (noise.gain_dn_per_e, noise.untold) == (None, "one level")
    assert noise.deviation == pytest.approx((100 * 0.05 + (0.05 * 30) ** 2) ** 0.5, rel=0.03)


def test_unsuitable_films_name_the_obstacle() -> None:
    assert estimate(lambda _: SLOPE, after=lambda _: np.rint(SLOPE)).untold == "wiped"
    coarse = [np.kron(np.random.default_rng(k).uniform(20, 200, (15, 20)), np.ones((8, 8))) for k in range(33)]
    assert estimate(lambda k: np.asarray(np.roll(coarse[k], k % 7, 1))).untold in ("moving", "few")
    assert estimate(lambda k: np.full((120, 160), 0.0 if k % 2 else 300.0)).untold == "few"
    assert NoiseWatch(None).noise(255).untold == "few"
