"""Sufficient pair statistics and images of symbols against dense matrices."""

from dataclasses import replace

import numpy as np
import pytest
from known_packets import by_matrices
from render_oracle import blur_matrix
from scenes import ALL_ON, SIDE, draw
from whole_pairs import CUT, GAIN, MOTIONS, ROLLS, SYMBOLS, T, WholePair, combination, moving, pair_of, random_levels

from heliograph.receive import Pose
from heliograph.receive.geometry.footprint import footprints, image_of, sum_of_leds
from heliograph.receive.observe import statistics
from heliograph.receive.observe.cutout import Noise
from heliograph.receive.observe.statistics import PairStatistics, WhitenedCutout, gram_of, leds_of, whiten
from heliograph.signal import haar
from heliograph.signal.packet import PacketFormat
from heliograph.signal.settings import SignalSettings

NOISE = Noise(4.0, 1.5)


def test_the_transform_is_that_of_the_signal() -> None:
    rng, form = np.random.default_rng(0), PacketFormat(SignalSettings(data_pairs=8))
    symbols = rng.choice(np.array([-1, 1], np.int8), (8, SYMBOLS))
    levels = haar.encode(form.join(symbols))
    assert np.allclose(symbols @ T.T, levels.reshape(8, -1) / 2.0 - 1.0)
    assert np.allclose(T.T @ T, np.eye(SYMBOLS) / 4)
    # and back
    leds = leds_of(symbols[0].astype(float))
    squares = (T @ symbols[0]).reshape(SIDE // 2, 2, SIDE // 2, 2).transpose(1, 3, 0, 2)
    assert leds == pytest.approx(squares.ravel())
    assert statistics.transform_quarters(leds) == pytest.approx(symbols[0])


# the second array is partly outside the window
@pytest.mark.parametrize("pose", [Pose(21.0, 18.9, 1.9, -0.4, 0.9), Pose(3.0, 38.0, 1.1, 0.1, 0.6)])
def test_images_of_symbols_and_their_products_equal_the_matrix(pose: Pose) -> None:
    b, light = blur_matrix(pose, SIDE, (0, 0), (40, 44)) @ T, footprints(pose, (0, 0), (40, 44), SIDE)
    symbols = np.random.default_rng(2).normal(size=SYMBOLS)
    assert sum_of_leds(leds_of(symbols), light).ravel() == pytest.approx(b @ symbols, abs=CUT * np.abs(symbols).max())
    assert np.abs(statistics.light_of_symbols(light).T - b).max() < CUT
    gram, want = gram_of(light), b.T @ b
    assert np.abs(gram - want).max() < 4 * CUT * want.max()
    assert np.abs(gram - gram.T).max() < 1e-6 * want.max()


def example(
    motion: tuple[float, float] = (0.12, -0.2),
    noise: Noise = NOISE,
    pixel_noise: float = 0.0,
    roll: float = 0.02,
    distance_m: float = 80.0,
) -> tuple[WholePair, WhitenedCutout]:
    """Return a pair with full matrices, and its whitened difference."""
    poses = moving(distance_m, roll, motion)
    whole = WholePair(poses, pair_of(poses, random_levels()[1], noise=pixel_noise), noise)
    return whole, whiten(whole.cutout, noise, SIDE)


def assert_equal(got: PairStatistics, want: PairStatistics, rel: float = 1e-6) -> None:
    """Check that all statistics agree within a relative error."""
    for name in ("gram", "matched", "offset", "cross", "offset_power", "power", "pixels"):
        result, expected = np.asarray(getattr(got, name), float), np.asarray(getattr(want, name), float)
        assert np.abs(result - expected).max() <= rel * np.abs(expected).max(), name


@pytest.mark.parametrize("noise", [Noise(4.5, 4.5), Noise(4.5, 1.4), Noise(3.0, 9.0)])
@pytest.mark.parametrize("motion", MOTIONS)
@pytest.mark.parametrize("roll", ROLLS)
def test_statistics_equal_sums_over_all_pixels(roll: float, motion: tuple[float, float], noise: Noise) -> None:
    (clean, _), (whole, whitened) = (example(motion, noise, pixel_noise, roll) for pixel_noise in (0.0, 2.0))
    assert clean.d == pytest.approx(GAIN * (clean.b @ random_levels()[0] + clean.o), abs=1e-9)
    got, want = whitened.statistics, by_matrices(whole.b, whole.d, whole.o, whole.w)
    # the separable weights neglect roll and truncated light
    scale, d = float(whole.w.max()), np.abs(whole.d).max()
    for name, error in (("gram", 4 * CUT), ("matched", 4 * CUT * d), ("offset", 4 * CUT), ("cross", 2e-2 * d)):
        assert np.abs(getattr(got, name) - getattr(want, name)).max() < error * scale, name
    assert (got.offset_power, got.power) == pytest.approx((want.offset_power, want.power), rel=2e-2, abs=1e-3)
    assert got.pixels == want.pixels
    assert motion != (0.0, 0.0) or not got.offset.any()


@pytest.mark.parametrize("motion", [(0.3, 0.0), (0.1, -0.6), (0.7, 0.8)])
def test_large_motion_gives_two_images(motion: tuple[float, float]) -> None:
    """Pothole: the array moves by up to a pixel between pattern and inverse."""
    whole, whitened = example(motion, Noise(4.5, 4.5), roll=0.0, distance_m=95.0)
    want = whole.b.T @ (whole.w[:, None] * whole.b)
    assert np.abs(whitened.statistics.gram - want).max() < 1e-5 * want.max()


@pytest.mark.parametrize(("weight", "gain"), [(1.0, 1.0), (0.5, 1.0), (1.0, 0.7), (3.0, 1.8)])
def test_statistics_are_scaled_by_weight_and_light_and_added(weight: float, gain: float) -> None:
    rng = np.random.default_rng(0)
    b, d, o, w = rng.normal(size=(40, 12)), rng.normal(size=40), rng.normal(size=40), rng.uniform(0.5, 2, 40)
    one = by_matrices(b, d, o, w)
    scaled = by_matrices(gain * b, d, gain * o, weight * w)
    assert_equal(one.scaled(weight, gain), scaled)
    both = (np.concatenate(parts) for parts in ((b, gain * b), (d, d), (o, gain * o), (w, weight * w)))
    assert_equal(one.plus(scaled), by_matrices(*both))


@pytest.mark.parametrize("motion", MOTIONS)
def test_the_residual_is_the_difference_less_the_light_of_the_symbols(motion: tuple[float, float]) -> None:
    (whole, whitened), mean = example(motion, Noise(4.5, 1.4)), np.random.default_rng(2).uniform(-1, 1, SYMBOLS)
    want = np.sqrt(whole.w) * (whole.d - GAIN * (whole.b @ mean + whole.o))
    assert whitened.residual(GAIN, mean).ravel() == pytest.approx(want, abs=0.01 * np.abs(want).max())
    # transmitted symbols leave no residual
    right = whitened.residual(GAIN, random_levels()[0])
    assert np.abs(right).max() < 0.01 * np.abs(want).max()


def test_images_are_correlated_with_the_images_of_symbols() -> None:
    whole, whitened = example()
    images = np.random.default_rng(3).normal(size=(5, *whole.cutout.shape))
    want = (np.sqrt(whole.w)[:, None] * whole.b).T @ images.reshape(5, -1).T
    assert np.abs(whitened.correlate(images) - want).max() < 20 * CUT


def test_other_images_are_marginalised() -> None:
    """d = g (B c + o + H e) + n with prior covariance P for e: noise covariance s^2 + g^2 H P H^T."""
    rng, (whole, whitened) = np.random.default_rng(4), example(pixel_noise=1.5)
    # scale the images so that prior and data contribute about equally
    slopes = whitened.root * whole.cutout.slopes(rng.uniform(-1, 1, (SIDE, SIDE)))[:3]
    slopes *= 1.5 / np.sqrt((slopes**2).sum((1, 2), keepdims=True))
    got = whitened.marginalised(slopes, np.diag([2.0, 0.5, 8.0]))
    root, h = np.sqrt(whole.w), slopes.reshape(3, -1).T
    b, d, o = root[:, None] * whole.b, root * whole.d, root * whole.o
    inverse = np.linalg.inv(np.eye(len(h)) + h @ np.diag([0.5, 2.0, 0.125]) @ h.T)
    for name, right in (("gram", b), ("matched", d), ("offset", o)):
        want, apart = b.T @ inverse @ right, b.T @ right
        assert np.abs(getattr(got, name) - want).max() < 0.1 * np.abs(want - apart).max(), name


def test_led_gains_scale_the_light() -> None:
    gains, (symbols, x) = np.random.default_rng(5).uniform(0, 1, (SIDE, SIDE)), random_levels()
    cutout = example(roll=0.0, distance_m=60.0)[0].cutout
    # LEDs with gain w emit w x, and w (1 - x) in the inverse
    up, down = (
        draw(pose, gains * y, cutout.corner, cutout.shape) for pose, y in zip(cutout.poses, (x, 1 - x), strict=True)
    )
    shown, whitened = GAIN * (up - down), whiten(cutout, NOISE, SIDE, gains)
    explained = whitened.root * shown - (whitened.difference - whitened.residual(GAIN, symbols))
    assert np.abs(explained).max() < 0.01 * np.abs(shown).max()


def test_pixels_outside_a_frame_have_no_weight() -> None:
    pair, whitened = example((0.0, 0.0))
    cutout, (rows, cols) = pair.cutout, pair.cutout.shape
    covered = (np.arange(cols) < cols - 5).astype(float), (np.arange(rows) >= 6).astype(float)
    inside = np.outer(covered[1], covered[0])
    differences = cutout.difference, cutout.difference + 1e3 * (1 - inside)
    first, second = (whiten(replace(cutout, covered=covered, difference=one), NOISE, SIDE) for one in differences)
    assert np.array_equal(first.root, whitened.root * inside)
    assert_equal(first.statistics, second.statistics)
    assert first.statistics.pixels == (first.root > 0).sum() < (whitened.root > 0).sum()


def test_combined_frames_have_other_noise_and_levels() -> None:
    """Weights use pair-difference units; mean light in pattern and inverse need not be 1/2."""
    (whole, separate), combined = example(noise=Noise(4.0, 4.0)), combination()
    whitened = whiten(replace(whole.cutout, combination=combined), Noise(4.0, 4.0), SIDE)
    got, apart = whitened.statistics, separate.statistics
    assert got.combination is combined
    for name in ("gram", "matched", "power"):
        assert np.allclose(getattr(got, name), getattr(apart, name) / combined.noise)
    # o = l_1 A_1 1 - l_2 A_2 1
    first, second = (image_of(ALL_ON, pose, whole.cutout.corner, whole.cutout.shape) for pose in whole.cutout.poses)
    want = combined.levels[0] * first - combined.levels[1] * second
    assert whitened.offset == pytest.approx(whitened.root * want, abs=1e-9)
