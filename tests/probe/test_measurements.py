"""Blinking regions: position, size, rate, and rejection of other regions."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.probe.activity import Stretches, stretch_of
from heliograph.probe.regions import Region, regions_of

Picture = NDArray[np.float64]


def frames(draw: Callable[[int, Picture], None], count: int = 128) -> list[Frame]:
    """Draw into a uniform noisy scene."""
    rng, out = np.random.default_rng(7), list[Frame]()
    for k in range(count):
        picture = np.full((96, 128), 40.0)
        draw(k, picture)
        noisy = np.clip(np.rint(picture + rng.normal(0, 1.5, picture.shape)), 0, 255)
        out.append(Frame(k, k / 1000, noisy.astype(np.uint8)))
    return out


CELLS = np.random.default_rng(8).integers(0, 2, (64, 4, 4)).astype(float)


def blink(k: int, picture: Picture, x: int, y: int, cell: int, light: float = 60.0) -> None:
    """Draw 4 x 4 cells with patterns and inverses, two of each as in a header."""
    pattern = CELLS[k // 4 % 64]
    cells = pattern if k % 2 == 0 else 1 - pattern
    picture[y : y + 4 * cell, x : x + 4 * cell] += light * np.kron(cells, np.ones((cell, cell)))


def regions(film: list[Frame]) -> list[Region]:
    return regions_of(stretch_of(film), 255)[0]


def test_place_size_and_contrast_of_regions_are_measured() -> None:
    def draw(k: int, picture: Picture) -> None:
        blink(k, picture, 20, 30, 5)
        blink(k + 7, picture, 90, 60, 3, 30.0)

    large, small = regions(frames(draw))
    assert (large.x, large.y) == pytest.approx((29.5, 39.5), abs=1)
    assert (large.width, large.height) == pytest.approx((20, 20), abs=1)
    assert (small.x, small.y) == pytest.approx((95.5, 65.5), abs=1)
    assert (small.width, small.height) == pytest.approx((12, 12), abs=1)
    # includes the half-bright rim
    assert large.contrast == pytest.approx(0.85 * 60 / 255, rel=0.1)
    assert not large.at_border
    assert large.speed_px < 0.02
    assert large.saturated == 0


def test_motion_is_measured_in_pixels_per_frame() -> None:
    film = frames(lambda k, picture: blink(k, picture, 10 + k // 2, 70 - k // 4, 4))
    (region,) = regions(film)
    assert region.speed == pytest.approx((0.5, -0.25), abs=0.03)


def test_region_at_the_border_is_marked() -> None:
    (region,) = regions(frames(lambda k, picture: blink(k, picture, 0, 40, 5)))
    assert region.at_border


def test_drifting_shadow_does_not_blink() -> None:
    def draw(k: int, picture: Picture) -> None:
        x = np.arange(picture.shape[1])
        picture += 60 / (1 + np.exp(-(x - 20 - 0.7 * k) / 3))

    assert all(region.blinks < 0.45 for region in regions(frames(draw)))
    assert regions(frames(lambda k, picture: blink(k, picture, 20, 30, 5)))[0].blinks > 0.6


def test_noise_makes_no_region() -> None:
    found, count = regions_of(stretch_of(frames(lambda _, __: None)), 255)
    assert (found, count) == ([], 0)


def test_stretch_with_the_most_blinking_light_is_kept() -> None:
    watch = Stretches()
    for frame in frames(lambda k, picture: blink(k, picture, 20, 30, 5) if 600 <= k < 700 else None, 1100):
        watch.add(frame)
    best = watch.best()
    assert best is not None
    assert best.frames[0].index == 512
    assert len(best.frames) == 256
