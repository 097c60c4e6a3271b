"""Hierarchical code against the double sums in (8) and (10) and against PyWavelets."""

import numpy as np
import pytest
import pywt
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from properties import examples

from heliograph.signal import haar

Floats = NDArray[np.float64]
seeds = st.integers(0, 2**32 - 1)
halves = st.integers(1, 10)


def paper_matrix(n: int) -> list[list[int]]:
    """Equation (9), element by element."""
    h = n // 2
    sums = [[int(v // 2 == m) for v in range(n)] for m in range(h)]
    return sums + [[int(v // 2 == m) * (-1) ** v for v in range(n)] for m in range(h)]


def equation_8(d: Floats) -> Floats:
    n, h = len(d), paper_matrix(len(d))
    r = range(n)
    return np.array([[sum(d[m, k] * h[k][v] * h[m][u] for m in r for k in r) / 2 for v in r] for u in r])


def equation_10(x: Floats) -> Floats:
    n, h = len(x), paper_matrix(len(x))
    r = range(n)
    return np.array([[sum(x[u, v] * h[k][v] * h[m][u] for u in r for v in r) / 2 for k in r] for m in r])


def data(seed: int, *shape: int) -> NDArray[np.int8]:
    return np.random.default_rng(seed).choice(np.array([-1, 1], np.int8), shape)


@pytest.mark.parametrize("n", [2, 4, 6, 10, 16])
def test_double_sums_of_the_paper(n: int) -> None:
    d = data(n, n, n)
    x = equation_8(d.astype(float))
    assert np.array_equal(haar.inverse_transform(d), x)
    assert np.array_equal(haar.encode(d), x + 2)
    soft = np.random.default_rng(n).normal(size=(n, n))
    assert np.allclose(haar.decode(soft), equation_10(soft))


@examples(40)
@given(halves, seeds)
def test_same_as_pywavelets(half: int, seed: int) -> None:
    x = np.random.default_rng(seed).normal(size=(3, 2 * half, 2 * half))
    mean, (horizontal, vertical, diagonal) = pywt.dwt2(x, "haar", mode="periodization")
    # PyWavelets names details by edge direction: vertical edges are differences along a row, D12
    theirs = np.block([[mean, vertical], [horizontal, diagonal]])
    assert np.allclose(haar.decode(x), theirs)  # both are orthonormal, 1 / sqrt 2 along each axis
    assert np.allclose(haar.inverse_transform(theirs), x)


@examples(40)
@given(halves, seeds)
def test_levels_and_round_trip(half: int, seed: int) -> None:
    d = data(seed, 2, 3, 2 * half, 2 * half)
    levels = haar.encode(d)
    assert levels.shape == d.shape
    assert levels.dtype == np.uint8
    assert levels.max() <= 4
    x = levels.astype(float) - 2
    assert np.array_equal(haar.decode(x), d)
    assert np.array_equal(np.where(haar.decode(x) > 0, 1, -1), d)
    assert np.array_equal(haar.encode(-d), 4 - levels)  # the inverse pattern encodes -D
    assert np.array_equal(haar.encode(d[1, 2]), levels[1, 2])


@pytest.mark.parametrize("shape", [(3, 3), (4, 6), (4,), (0, 0)])
def test_wrong_shapes(shape: tuple[int, ...]) -> None:
    for transform in (haar.encode, haar.decode, haar.inverse_transform):
        with pytest.raises(ValueError, match="n even"):
            transform(np.ones(shape))
