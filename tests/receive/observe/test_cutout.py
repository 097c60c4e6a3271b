"""Pair cut-outs, background motion compensation, and packet noise inside the array and in the background."""

from dataclasses import replace

import numpy as np
import observe_oracle as reference
import pytest
from scenes import ALL_ON, SIDE, Floats, draw, frame_of, pitch_at
from scipy.special import erf
from whole_pairs import GAIN, SYMBOLS, T, combination, moving, pair_of, random_levels

from heliograph.base.frames import Frame
from heliograph.receive import Pose
from heliograph.receive.geometry.window import window_around
from heliograph.receive.observe.cutout import Cutout, _unevenness, measure_noise, noise_beside, take_cutout
from heliograph.receive.sync.pairing import FramePair


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
    """Add noise with standard deviations (rows, columns) to a pair."""
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
