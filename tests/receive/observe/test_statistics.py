"""Sufficient pair statistics against dense matrices, cut-outs, background motion and packet noise."""

from dataclasses import replace

import numpy as np
import observe_oracle as reference
import pytest
from known_packets import by_matrices
from render_oracle import blur_matrix
from scenes import ALL_ON, SIDE, Floats, draw, frame_of, pitch_at
from scipy.special import erf
from whole_pairs import CUT, GAIN, MOTIONS, ROLLS, SYMBOLS, T, WholePair, combination, moving, pair_of, random_levels

from heliograph.base.frames import Frame
from heliograph.receive.geometry.footprint import footprints, image_of, sum_of_leds
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.geometry.window import window_around
from heliograph.receive.observe import statistics
from heliograph.receive.observe.cutout import Cutout, Noise, _unevenness, measure_noise, noise_beside, take_cutout
from heliograph.receive.observe.statistics import PairStatistics, WhitenedCutout, gram_of, leds_of, whiten
from heliograph.receive.sync.pairing import FramePair
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
    poses = moving(distance_m, roll, motion)
    whole = WholePair(poses, pair_of(poses, random_levels()[1], noise=pixel_noise), noise)
    return whole, whiten(whole.cutout, noise, SIDE)


def assert_equal(got: PairStatistics, want: PairStatistics, rel: float = 1e-6) -> None:
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


def test_a_cutout_holds_sum_and_difference_about_the_array() -> None:
    poses = moving(80, 0.02, (0.12, -0.2))
    pair = pair_of(poses, random_levels()[1], noise=2.0)
    cutout = take_cutout(pair, poses, SIDE)
    # 2 px margin for LED light and a 2 px ring
    x, y, cols, rows = window_around(Pose.midway(*poses), SIDE, 4.0)
    assert (cutout.corner, cutout.shape) == ((x, y), (rows, cols))
    up, down = (frame.pixels[y : y + rows, x : x + cols] for frame in (pair.pattern, pair.inverted))
    assert np.array_equal(cutout.total, up + down)
    assert np.array_equal(cutout.difference, up - down)
    assert cutout.poses == poses
    assert cutout.middle == Pose.midway(*poses)
    assert (cutout.mean_light_pose, cutout.combination, cutout.covered) == (None, None, None)


def test_pixels_beyond_a_frame_are_not_covered() -> None:
    pose = Pose(4.0, 30.0, 0.8)
    frames = [Frame(k, k * 1e-3, np.zeros((60, 60), np.uint8)) for k in range(2)]
    cutout = take_cutout(FramePair(frames[0], frames[1]), (pose, pose), SIDE)
    assert cutout.covered is not None
    columns, rows = cutout.covered
    assert columns.tolist() == (cutout.corner[0] + np.arange(cutout.shape[1]) >= 0).tolist()
    assert rows.all()


def test_slopes_and_corrected_poses_follow_the_image() -> None:
    poses = moving(60, 0.02, (0.12, -0.2))
    cutout = take_cutout(pair_of(poses, random_levels()[1]), poses, SIDE)
    levels, vector = np.random.default_rng(1).uniform(-1, 1, (SIDE, SIDE)), cutout.middle.vector()

    def image(v: Floats) -> Floats:
        return draw(Pose.from_vector(v), levels, cutout.corner, cutout.shape)

    for slope, step in zip(cutout.slopes(levels), 1e-4 * np.eye(5)[:4], strict=True):
        want = (image(vector + step) - image(vector - step)) / 2e-4
        assert np.abs(slope - want).max() < 0.01 * np.abs(want).max()
    moved = cutout.moved(np.array([0.1, -0.2, 0.01, 0.02]))
    for before, after in zip(poses, moved.poses, strict=True):
        assert after.full_vector() - before.full_vector() == pytest.approx([0.1, -0.2, 0.01, 0.02, 0, 0, 0])
    assert np.array_equal(moved.difference, cutout.difference)


def test_background_motion_is_compensated() -> None:
    """A bright edge moves by a third of a pixel between frames; data are unchanged."""
    rng, (_, x), grid = np.random.default_rng(5), random_levels(), np.arange(60)
    pose = Pose(30.3, 29.8, pitch_at(80), 0.0, 0.51)
    poses = pose, pose.moved(0.3, 0.1)
    lit = [0.6 * draw(p, y, (0, 0), (60, 60)) for p, y in zip(poses, (x, 1 - x), strict=True)]
    edges = [0.15 * (1 + erf((grid - p.x - 7) / 0.8)) for p in poses]
    up, down = (frame_of(light + edge, k, rng) for k, (light, edge) in enumerate(zip(lit, edges, strict=True)))
    cutout = take_cutout(FramePair(up, down), poses, SIDE)
    compensated = cutout.motion_compensated(0.6 * 255, ALL_ON)
    rows, columns = (slice(c, c + n) for c, n in zip(reversed(cutout.corner), cutout.shape, strict=True))
    sent = 255 * (lit[0] - lit[1])[rows, columns]
    before, after = (np.sqrt(((part.difference - sent) ** 2).mean()) for part in (cutout, compensated))
    # sensor noise: 1.8 gray levels
    assert before > 3.5
    assert after < 2.2
    # a single frame has no motion
    single = replace(cutout, poses=poses[:1])
    assert single.motion_compensated(0.6 * 255, ALL_ON) is single


def noisy(pair: FramePair, sigma: Floats, rng: np.random.Generator) -> FramePair:
    up, down = (
        replace(frame, pixels=frame.pixels + rng.normal(0, sigma))  # type: ignore[arg-type]
        for frame in (pair.pattern, pair.inverted)
    )
    return FramePair(up, down)


# without motion correction the estimate at 60 m would be 12.3 instead of 8
@pytest.mark.parametrize(("motion", "error"), [((0.0, 0.0), 0.06), ((0.05, 0.1), 0.12), ((0.2, 0.2), 0.3)])
@pytest.mark.parametrize(("distance_m", "inside", "outside"), [(60, 2.0, 2.0), (100, 1.5, 0.8), (150, 1.5, 0.8)])
def test_noise_inside_and_outside_the_array_is_measured(
    distance_m: float, inside: float, outside: float, motion: tuple[float, float], error: float
) -> None:
    rng, cutouts, poses = np.random.default_rng(7), [], moving(distance_m, 0.02, motion)
    lit = draw(poses[0], ALL_ON, (0, 0), (60, 60))
    sigma = np.sqrt(outside**2 + (inside**2 - outside**2) * np.clip(lit, 0, 1))
    for _ in range(48):
        pair = pair_of(poses, 0.5 * (1 + T @ rng.choice([-1.0, 1.0], SYMBOLS)).reshape(SIDE, SIDE))
        cutouts.append(take_cutout(noisy(pair, sigma, rng), poses, SIDE))
    measured = measure_noise(cutouts, GAIN, SIDE)
    # difference between two frames: twice the variance
    assert measured.lit == pytest.approx(2 * inside**2, rel=error)
    assert measured.dark == pytest.approx(2 * outside**2, rel=0.06)


def test_background_noise_of_single_frames() -> None:
    rng, poses = np.random.default_rng(8), moving(80, 0.02, (0.0, 0.0))
    even = pair_of(poses, np.zeros((SIDE, SIDE)))
    cutouts = []
    for _ in range(8):
        pair = noisy(even, np.full((60, 60), 1.5), rng)
        cutout = take_cutout(FramePair(pair.pattern, even.pattern), poses, SIDE)
        # twice the frame minus background
        cutouts.append(replace(cutout, difference=2 * cutout.difference, poses=poses[:1]))
    assert noise_beside(cutouts, SIDE) == pytest.approx((2 * 1.5) ** 2, rel=0.06)


def test_noise_of_combined_frames_refers_to_two_frames() -> None:
    """Sum and difference have different noise variances; the array's sum is uniform."""
    rng, sigma, poses, combined = np.random.default_rng(9), 1.5, moving(80, 0.02, (0.0, 0.0)), combination()
    even, cutouts = take_cutout(pair_of(poses, np.full((SIDE, SIDE), 0.5)), poses, SIDE), []
    for _ in range(48):
        noises = [sigma * rng.normal(0, (w**2).sum() ** 0.5, even.shape) for w in (combined.total, combined.difference)]
        cutouts.append(replace(even, total=even.total + noises[0], difference=noises[1], combination=combined))
    measured = measure_noise(cutouts, GAIN, SIDE)
    assert (measured.lit, measured.dark) == pytest.approx((2 * sigma**2, 2 * sigma**2), rel=0.12)


def test_noise_without_cutouts_is_rounding() -> None:
    # rounding noise 1 / 12 per frame
    none = measure_noise([], GAIN, SIDE)
    assert (none.lit, none.dark) == pytest.approx((1 / 6, 1 / 6))
    assert noise_beside([], SIDE) == pytest.approx(1 / 6)


def test_noise_hidden_by_motion_is_not_zero() -> None:
    rng, cutouts = np.random.default_rng(9), []
    poses = moving(40, 0.02, (1.2, 0.4))
    for _ in range(12):
        # short exposures move less than expected, so sums are smoother
        x = 0.5 + 0.2 * (T @ rng.choice([-1.0, 1.0], SYMBOLS)).reshape(SIDE, SIDE)
        cutouts.append(take_cutout(noisy(pair_of(poses, x), np.full((60, 60), 2.0), rng), poses, SIDE))
    measured = measure_noise(cutouts, GAIN, SIDE)
    # factor 2 too high is harmless; factor 1/30 gave overconfident wrong symbols
    assert measured.lit > 2 * 2.0**2


def test_even_light_is_not_noise() -> None:
    """For a near array, the array image and the plane are linearly dependent."""
    rng, pose = np.random.default_rng(11), Pose(20.0, 20.0, 1.0, 0.0, 0.8)
    cutout = Cutout(rng.normal(100, 2, (40, 40)), np.zeros((40, 40)), (0, 0), (pose, pose))
    found, corner, motion = _unevenness(cutout, 0.0, SIDE, None)
    inside = np.isfinite(found)
    assert 0.6 * SIDE**2 < inside.sum() < SIDE**2
    want = reference.uneven(cutout.total, np.ones((40, 40)), inside)
    assert np.corrcoef(found[inside], want)[0, 1] > 0.97
    assert found[inside].std() == pytest.approx(2.0, rel=0.15)
    assert (corner, motion) == ((0, 0), 0.0)
