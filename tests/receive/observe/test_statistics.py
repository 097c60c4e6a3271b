"""Sufficient statistics of pairs, against whole matrices."""

import numpy as np
import pytest
from known_packets import by_matrices
from numpy.typing import NDArray
from scenes import SIDE
from whole_pairs import CUT, GAIN, MOTIONS, ROLLS, SYMBOLS, WholePair, moving, pair_of, random_levels

from heliograph.receive.observe.noise import Noise
from heliograph.receive.observe.statistics import PairStatistics, whiten

Floats = NDArray[np.float64]


def assert_equal(got: PairStatistics, want: PairStatistics, rel: float = 1e-6) -> None:
    """Check that all statistics are the same to a relative error."""
    for name in ("gram", "matched", "offset"):
        one, other = np.asarray(getattr(got, name), float), np.asarray(getattr(want, name), float)
        assert np.abs(one - other).max() <= rel * np.abs(other).max(), name
    for name in ("cross", "drift", "power", "pixels"):
        assert getattr(got, name) == pytest.approx(getattr(want, name), rel=rel), name


@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("roll", ROLLS)
def test_the_difference_of_a_pair_is_that_of_the_model(roll: float, motion: tuple[float, float]) -> None:
    symbols, x = random_levels()
    poses = moving(80, roll, motion)
    whole = WholePair(poses, pair_of(poses, x), Noise(4.0, 4.0))
    assert whole.d == pytest.approx(GAIN * (whole.b @ symbols + whole.o), abs=1e-9)


@pytest.mark.parametrize("noise", [Noise(4.5, 4.5), Noise(4.5, 1.4), Noise(3.0, 9.0)])
@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("roll", ROLLS)
def test_statistics_are_those_of_all_pixels(roll: float, motion: tuple[float, float], noise: Noise) -> None:
    _, x = random_levels()
    poses = moving(80, roll, motion)
    whole = WholePair(poses, pair_of(poses, x, noise=2.0), noise)
    got, w = whiten(whole.cutout, noise, SIDE).statistics(), whole.w
    # a roll or the light beyond the reach of the kernels is not in the weights' profile to the last digit
    scale = float(w.max())
    assert np.abs(got.gram - whole.b.T @ (w[:, None] * whole.b)).max() < 4 * CUT * scale
    assert np.abs(got.matched - whole.b.T @ (w * whole.d)).max() < 4 * CUT * scale * np.abs(whole.d).max()
    assert np.abs(got.offset - whole.b.T @ (w * whole.o)).max() < 4 * CUT * scale
    assert got.cross == pytest.approx(float(whole.d @ (w * whole.o)), abs=2e-2 * scale * np.abs(whole.d).max())
    assert got.drift == pytest.approx(float(whole.o @ (w * whole.o)), rel=2e-2, abs=1e-3)
    assert got.power == pytest.approx(float(whole.d @ (w * whole.d)), rel=2e-2)
    assert got.pixels == (w > 0).sum()
    if motion == (0.0, 0.0):
        assert not got.offset.any()


@pytest.mark.parametrize(("weight", "gain"), [(0.5, 1.0), (1.0, 0.7), (3.0, 1.8)])
def test_scaled_statistics_are_those_of_scaled_weights_and_light(weight: float, gain: float) -> None:
    rng = np.random.default_rng(0)
    b, d, o, w = rng.normal(size=(40, 12)), rng.normal(size=40), rng.normal(size=40), rng.uniform(0.5, 2, 40)
    got = by_matrices(b, d, o, w).scaled(weight, gain)
    assert_equal(got, by_matrices(gain * b, d, gain * o, weight * w))
    assert_equal(by_matrices(b, d, o, w).scaled(1.0), by_matrices(b, d, o, w))


def test_added_statistics_are_those_of_both_together() -> None:
    rng = np.random.default_rng(1)
    b, d, o, w = rng.normal(size=(2, 40, 12)), rng.normal(size=(2, 40)), rng.normal(size=(2, 40)), np.ones((2, 40))
    first, second = (by_matrices(b[k], d[k], o[k], w[k]) for k in range(2))
    both = by_matrices(b.reshape(80, 12), d.ravel(), o.ravel(), w.ravel())
    assert_equal(first.plus(second), both)


@pytest.mark.parametrize("motion", MOTIONS)
def test_the_residual_is_the_difference_less_the_light_of_the_symbols(motion: tuple[float, float]) -> None:
    rng, noise = np.random.default_rng(2), Noise(4.5, 1.4)
    poses = moving(80, 0.02, motion)
    whole = WholePair(poses, pair_of(poses, random_levels()[1]), noise)
    whitened, mean = whiten(whole.cutout, noise, SIDE), rng.uniform(-1, 1, SYMBOLS)
    want = np.sqrt(whole.w) * (whole.d - GAIN * (whole.b @ mean + whole.o))
    assert whitened.residual(GAIN, mean).ravel() == pytest.approx(want, abs=0.01 * np.abs(want).max())
    # with the symbols that were sent nothing is left
    right = whitened.residual(GAIN, random_levels()[0])
    assert np.abs(right).max() < 0.01 * np.abs(want).max()


@pytest.mark.parametrize("motion", MOTIONS)
def test_images_are_correlated_alike_one_by_one_and_at_once(motion: tuple[float, float]) -> None:
    poses, noise = moving(80, 0.02, motion), Noise(4.0, 1.5)
    whole = WholePair(poses, pair_of(poses, random_levels()[1]), noise)
    whitened = whiten(whole.cutout, noise, SIDE)
    images = np.random.default_rng(3).normal(size=(5, *whole.cutout.shape))
    want = (np.sqrt(whole.w)[:, None] * whole.b).T @ images.reshape(5, -1).T
    assert np.abs(whitened.all_correlated(images) - want).max() < 20 * CUT
    assert np.stack([whitened.correlated(image) for image in images], axis=1) == pytest.approx(
        whitened.all_correlated(images), abs=1e-9
    )


def test_other_images_are_marginalised() -> None:
    """d = g (B c + o + H e) + n, e of a prior covariance P: noise of the covariance s^2 + g^2 H P H^T."""
    rng, noise, poses = np.random.default_rng(4), Noise(4.0, 1.5), moving(80, 0.02, (0.12, -0.2))
    whole = WholePair(poses, pair_of(poses, random_levels()[1], noise=1.5), noise)
    whitened = whiten(whole.cutout, noise, SIDE)
    slopes = whitened.root * rng.normal(size=(3, *whole.cutout.shape))
    got = whitened.without(slopes, np.diag([2.0, 0.5, 8.0]))
    b, h = np.sqrt(whole.w)[:, None] * whole.b, slopes.reshape(3, -1).T
    d, o = np.sqrt(whole.w) * whole.d, np.sqrt(whole.w) * whole.o
    inverse = np.linalg.inv(np.eye(len(h)) + h @ np.diag([0.5, 2.0, 0.125]) @ h.T)
    for name, want in (("gram", b.T @ inverse @ b), ("matched", b.T @ inverse @ d), ("offset", b.T @ inverse @ o)):
        assert np.abs(getattr(got, name) - want).max() < 0.01 * np.abs(want).max(), name


def test_leds_of_other_gains_shine_by_their_gains() -> None:
    gains = np.random.default_rng(5).uniform(0, 1, (SIDE, SIDE))
    symbols, x = random_levels()
    poses, noise = moving(60, 0.0, (0.12, -0.2)), Noise(4.0, 1.5)
    # LEDs of a gain w shine w x, and w (1 - x) in the inverse
    up, down = (pair_of(poses, gains * y).pattern.pixels - 30.0 for y in (x, 1 - x))
    moved = pair_of((poses[1], poses[1]), gains * (1 - x)).pattern.pixels - 30.0
    assert not np.allclose(down, moved)
    whole = WholePair(poses, pair_of(poses, x), noise)
    left, top = whole.cutout.corner
    rows, cols = whole.cutout.shape
    shown = (up - moved)[top : top + rows, left : left + cols]
    whitened = whiten(whole.cutout, noise, SIDE, gains)
    explained = whitened.root * shown - (whitened.difference - whitened.residual(GAIN, symbols))
    assert np.abs(explained).max() < 0.01 * np.abs(shown).max()
