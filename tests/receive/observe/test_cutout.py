"""Pair cut-outs and background motion compensation."""

from dataclasses import replace

import numpy as np
import pytest
from scenes import ALL_ON, SIDE, Floats, draw, frame_of, pitch_at
from scipy.special import erf
from whole_pairs import moving, pair_of, random_levels

from heliograph.base.frames import Frame
from heliograph.receive import Pose
from heliograph.receive.geometry.window import window_around
from heliograph.receive.observe.cutout import take_cutout
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
