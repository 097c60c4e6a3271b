"""Photon transfer, compared with sensors of known gain, and its limits."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.probe.noise import NoiseEstimate, NoiseWatch

Levels = NDArray[np.float64]

SLOPE = np.tile(np.linspace(20, 200, 160), (120, 1))
"""Gray levels of a still scene."""


def found(
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


@pytest.mark.parametrize(("gain", "dark_e"), [(0.02, 60.0), (0.05, 30.0), (0.2, 10.0)])
def test_gain_and_dark_noise_are_those_of_the_sensor(gain: float, dark_e: float) -> None:
    noise = found(lambda _: SLOPE, gain, dark_e)
    assert noise.gain == pytest.approx(gain, rel=0.05)
    assert noise.gain is not None
    assert noise.gain_error is not None
    assert abs(noise.gain - gain) < 4 * noise.gain_error + 0.02 * gain
    assert noise.dark_e == pytest.approx(dark_e, rel=0.2)
    # at level 100 both terms add up
    assert noise.variance_at(100) == pytest.approx(100 * gain + (gain * dark_e) ** 2 + 1 / 12, rel=0.05)


def test_light_that_blinks_does_not_pass_for_noise() -> None:
    leds = np.random.default_rng(4).integers(0, 2, (33, 8, 8))

    def scene(k: int) -> Levels:
        out = SLOPE.copy()
        out[30:94, 20:84] = 20 + 200 * np.kron(leds[k], np.ones((8, 8)))
        return out

    assert found(scene).gain == pytest.approx(0.05, rel=0.06)


def test_one_gray_level_tells_no_gain() -> None:
    noise = found(lambda _: np.full((120, 160), 100.0))
    assert (noise.gain, noise.untold) == (None, "one level")
    assert noise.deviation == pytest.approx((100 * 0.05 + (0.05 * 30) ** 2) ** 0.5, rel=0.03)


def test_noise_wiped_out_by_compression_is_not_told() -> None:
    assert found(lambda _: SLOPE, after=lambda _: np.rint(SLOPE)).untold == "wiped"


def test_a_part_without_noise_does_not_weigh_as_if_it_were_exact() -> None:
    def after(levels: Levels) -> Levels:
        out = levels.copy()
        out[:, 128:] = np.rint(SLOPE[:, 128:])  # a fifth of the picture and of the gray levels
        return out

    noise = found(lambda _: SLOPE, after=after)
    assert noise.untold == ""
    assert noise.gain == pytest.approx(0.05, rel=0.06)


def test_a_scene_that_moves_tells_nothing() -> None:
    rng = np.random.default_rng(5)
    coarse = [np.kron(rng.uniform(20, 200, (15, 20)), np.ones((8, 8))) for _ in range(33)]
    assert found(lambda k: np.asarray(np.roll(coarse[k], k % 7, 1))).untold in ("moving", "few")


def test_black_and_saturated_pixels_tell_nothing() -> None:
    assert found(lambda k: np.full((120, 160), 0.0 if k % 2 else 300.0)).untold == "few"


def test_no_film_tells_nothing() -> None:
    assert NoiseWatch(None).noise(255).untold == "few"
