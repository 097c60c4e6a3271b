"""Sufficient pair statistics against dense matrices."""

from dataclasses import replace

import numpy as np
import pytest
from known_packets import by_matrices
from numpy.typing import NDArray
from scenes import ALL_ON, SIDE
from whole_pairs import CUT, GAIN, MOTIONS, ROLLS, SYMBOLS, WholePair, moving, pair_of, random_levels

from heliograph.receive.geometry.footprint import image_of
from heliograph.receive.observe.noise import Noise
from heliograph.receive.observe.statistics import PairStatistics, whiten
from heliograph.receive.sync.combine import combine_pair

Floats = NDArray[np.float64]


def assert_equal(got: PairStatistics, want: PairStatistics, rel: float = 1e-6) -> None:
    """Check that all statistics agree within a relative error."""
    for name in ("gram", "matched", "offset"):
        result, expected = np.asarray(getattr(got, name), float), np.asarray(getattr(want, name), float)
        assert np.abs(result - expected).max() <= rel * np.abs(expected).max(), name
    for name in ("cross", "offset_power", "power", "pixels"):
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
    got, w = whiten(whole.cutout, noise, SIDE).statistics, whole.w
    # the separable weights neglect roll and truncated light
    scale = float(w.max())
    assert np.abs(got.gram - whole.b.T @ (w[:, None] * whole.b)).max() < 4 * CUT * scale
    assert np.abs(got.matched - whole.b.T @ (w * whole.d)).max() < 4 * CUT * scale * np.abs(whole.d).max()
    assert np.abs(got.offset - whole.b.T @ (w * whole.o)).max() < 4 * CUT * scale
    assert got.cross == pytest.approx(float(whole.d @ (w * whole.o)), abs=2e-2 * scale * np.abs(whole.d).max())
    assert got.offset_power == pytest.approx(float(whole.o @ (w * whole.o)), rel=2e-2, abs=1e-3)
    assert got.power == pytest.approx(float(whole.d @ (w * whole.d)), rel=2e-2)
    assert got.pixels == (w > 0).sum()
    if motion == (0.0, 0.0):
        assert not got.offset.any()


@pytest.mark.parametrize("motion", [(0.3, 0.0), (0.1, -0.6), (0.7, 0.8)])
def test_far_motion_makes_two_images(motion: tuple[float, float]) -> None:
    """Pothole: the array moves by up to a pixel between pattern and inverse."""
    _, x = random_levels()
    poses, noise = moving(95, 0.0, motion), Noise(4.5, 4.5)
    whole = WholePair(poses, pair_of(poses, x), noise)
    want = whole.b.T @ (whole.w[:, None] * whole.b)
    assert np.abs(whiten(whole.cutout, noise, SIDE).statistics.gram - want).max() < 1e-5 * want.max()


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
    # transmitted symbols leave no residual
    right = whitened.residual(GAIN, random_levels()[0])
    assert np.abs(right).max() < 0.01 * np.abs(want).max()


@pytest.mark.parametrize("motion", MOTIONS)
def test_images_are_correlated_with_those_of_the_symbols(motion: tuple[float, float]) -> None:
    poses, noise = moving(80, 0.02, motion), Noise(4.0, 1.5)
    whole = WholePair(poses, pair_of(poses, random_levels()[1]), noise)
    whitened = whiten(whole.cutout, noise, SIDE)
    images = np.random.default_rng(3).normal(size=(5, *whole.cutout.shape))
    want = (np.sqrt(whole.w)[:, None] * whole.b).T @ images.reshape(5, -1).T
    assert np.abs(whitened.correlate(images) - want).max() < 20 * CUT


def test_other_images_are_marginalised() -> None:
    """d = g (B c + o + H e) + n with prior covariance P for e: noise covariance s^2 + g^2 H P H^T."""
    rng, noise, poses = np.random.default_rng(4), Noise(4.0, 1.5), moving(80, 0.02, (0.12, -0.2))
    whole = WholePair(poses, pair_of(poses, random_levels()[1], noise=1.5), noise)
    whitened = whiten(whole.cutout, noise, SIDE)
    # scale the images so that prior and data contribute about equally
    slopes = whitened.root * whole.cutout.slopes(rng.uniform(-1, 1, (SIDE, SIDE)))[:3]
    slopes *= 1.5 / np.sqrt((slopes**2).sum((1, 2), keepdims=True))
    got = whitened.marginalised(slopes, np.diag([2.0, 0.5, 8.0]))
    b, h = np.sqrt(whole.w)[:, None] * whole.b, slopes.reshape(3, -1).T
    d, o = np.sqrt(whole.w) * whole.d, np.sqrt(whole.w) * whole.o
    inverse = np.linalg.inv(np.eye(len(h)) + h @ np.diag([0.5, 2.0, 0.125]) @ h.T)
    for name, left, right in (("gram", b, b), ("matched", b, d), ("offset", b, o)):
        want, apart = left.T @ inverse @ right, left.T @ right
        assert np.abs(getattr(got, name) - want).max() < 0.1 * np.abs(want - apart).max(), name


def test_led_gains_scale_the_light() -> None:
    gains = np.random.default_rng(5).uniform(0, 1, (SIDE, SIDE))
    symbols, x = random_levels()
    poses, noise = moving(60, 0.0, (0.12, -0.2)), Noise(4.0, 1.5)
    # LEDs with gain w emit w x, and w (1 - x) in the inverse
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


def test_pixels_outside_a_frame_have_no_weight() -> None:
    poses, noise = moving(80, 0.0, (0.0, 0.0)), Noise(4.0, 1.5)
    cutout = WholePair(poses, pair_of(poses, random_levels()[1]), noise).cutout
    rows, cols = cutout.shape
    there = (np.arange(cols) < cols - 5).astype(float), (np.arange(rows) >= 6).astype(float)
    root = whiten(replace(cutout, covered=there), noise, SIDE).root
    whole = whiten(cutout, noise, SIDE).root
    assert np.array_equal(root, whole * np.outer(there[1], there[0]))
    spoilt = cutout.difference + 1e3 * (1 - np.outer(there[1], there[0]))
    parts = [
        whiten(replace(cutout, covered=there, difference=difference), noise, SIDE).statistics
        for difference in (cutout.difference, spoilt)
    ]
    assert_equal(parts[0], parts[1])
    assert parts[0].pixels == (root > 0).sum() < (whole > 0).sum()


def test_combined_frames_have_other_noise_and_levels() -> None:
    """Weights use pair-difference units; mean light in pattern and inverse need not be 1/2."""
    poses, noise = moving(80, 0.02, (0.12, -0.2)), Noise(4.0, 4.0)
    cutout = WholePair(poses, pair_of(poses, random_levels()[1]), noise).cutout
    combination = combine_pair(np.arange(-2, 5) / 1.5 + 0.2, 1 / 1.5, (0, 1, 2, 3))
    assert combination is not None
    assert abs(combination.noise - 1) > 0.2
    got = whiten(replace(cutout, combination=combination), noise, SIDE).statistics
    apart = whiten(cutout, noise, SIDE).statistics
    assert got.combination is combination
    assert np.allclose(got.gram, apart.gram / combination.noise)
    assert got.matched == pytest.approx(apart.matched / combination.noise)
    assert got.power == pytest.approx(apart.power / combination.noise)
    # o = l_1 A_1 1 - l_2 A_2 1
    first, second = (image_of(ALL_ON, pose, cutout.corner, cutout.shape) for pose in poses)
    whitened = whiten(replace(cutout, combination=combination), noise, SIDE)
    want = combination.levels[0] * first - combination.levels[1] * second
    assert whitened.offset == pytest.approx(whitened.root * want, abs=1e-9)
