"""Robust statistics."""

import numpy as np
import pytest

from heliograph.receive.geometry.fit import correlation, median_of, robust_std


@pytest.mark.parametrize("shape", [(40001,), (200, 201)])
def test_spread_of_a_gaussian_whatever_a_tenth_of_it_is(shape: tuple[int, ...]) -> None:
    values = np.random.default_rng(0).normal(0, 3.0, shape)
    assert robust_std(values) == pytest.approx(3.0, rel=0.02)
    values.ravel()[::10] = 1e6
    # contamination: 5/9 of the remaining values lie below the median, Phi^-1(7/9) / Phi^-1(3/4)
    assert robust_std(values) == pytest.approx(3.0 * 1.1338, rel=0.03)


@pytest.mark.parametrize("values", [[-2.0], [1.0, -3.0], [5.0, 0.0, -2.0], [4.0, -1.0, 2.0, 8.0]])
def test_spread_is_that_of_the_median_magnitude(values: list[float]) -> None:
    # Phi^-1(3/4) = 0.67449
    assert robust_std(np.array(values)) == pytest.approx(np.median(np.abs(values)) / 0.67449, rel=1e-4)


@pytest.mark.parametrize("shape", [(1,), (2,), (7,), (256,), (5, 6)])
def test_median_is_that_of_numpy(shape: tuple[int, ...]) -> None:
    values = np.random.default_rng(2).normal(size=shape)
    before = values.copy()
    assert median_of(values) == np.median(values)
    assert np.array_equal(values, before)


def test_correlation() -> None:
    rng = np.random.default_rng(1)
    a, b = rng.normal(size=(2, 9, 7))
    assert correlation(a, b) == pytest.approx(np.corrcoef(a.ravel(), b.ravel())[0, 1])
    assert correlation(a, 3 * a + 5) == pytest.approx(1)
    assert correlation(a, -a) == pytest.approx(-1)
    assert correlation(a, np.full((9, 7), 4.0)) == 0
