"""Synthetic street: sizes, day and night, and use as a background."""

import numpy as np
import pytest

from heliograph.channel.background import draw_street


@pytest.mark.parametrize("size", [(20, 30), (640, 1152), (300, 200)])
def test_a_street_has_any_size_and_is_the_same_for_a_seed(size: tuple[int, int]) -> None:
    day, night = (draw_street(size, np.random.default_rng(2), dark) for dark in (False, True))
    assert day.shape == night.shape == size
    assert day.dtype == np.uint8
    assert night.mean() < 0.4 * day.mean()
    # by day the sky is brighter than the road
    middle = slice(size[1] // 2 - 2, size[1] // 2 + 2)
    assert day[size[0] // 4, middle].mean() > day[-1, size[1] // 3]
    assert np.array_equal(day, draw_street(size, np.random.default_rng(2)))
    assert not np.array_equal(day, draw_street(size, np.random.default_rng(3)))
