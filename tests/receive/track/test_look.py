"""Pair evaluation before the pose is known."""

import numpy as np
from scenes import ALL_ON, SIDE, draw, frame_of, pitch_at

from heliograph.receive import Pose
from heliograph.receive.track import kernels
from heliograph.receive.track.kalman import MotionModel, PoseState
from heliograph.receive.track.track import Track, TrackParameters, estimate_noise, line_distance, preview_pair

PARAMETERS = TrackParameters()
CORNER, SHAPE = (100, 50), (60, 64)


def test_a_preview_equals_the_separate_kernels() -> None:
    rng, pose = np.random.default_rng(2), Pose(131.2, 80.4, pitch_at(50.0), 0.02, 0.53)
    state = PoseState.start(0.0, pose.vector(), np.eye(5), MotionModel(1e-3, 0.1))
    track = Track(state, 200.0, 200.0, ALL_ON, 0.0, np.ones((SIDE, SIDE)), pairs=PARAMETERS.learning_pairs)
    for k in range(12):
        levels = rng.binomial(4, 0.5, (SIDE, SIDE)) / 4
        # a post entering from the left
        hidden = slice(0, max(0, 3 * k - 8))
        frames = []
        for x in (levels, 1 - levels):
            light = 0.1 + 0.7 * draw(pose, x, CORNER, SHAPE)
            light[:, hidden] = 0.9
            frames.append(frame_of(light, k, rng).pixels.astype(np.float64))
        up, down = frames
        difference, total, noise, after = preview_pair(track, up, down, CORNER, pose)
        assert np.array_equal(difference, up - down)
        assert np.array_equal(total, up + down)
        assert noise == estimate_noise(up - down, pose, CORNER, SIDE)
        clear, lines = np.ones((SIDE, SIDE)), np.full((2, SIDE + 2), np.nan) if track.lines is None else track.lines
        lines, middle = lines.copy(), np.array([pose.x - CORNER[0], pose.y - CORNER[1]])
        visible, least = (after.change >= PARAMETERS.min_visible).astype(float), PARAMETERS.min_line_change * 200.0
        assert np.array_equal(after.visible, visible)
        kernels.uncover(total, middle, pose.axes, line_distance(pose, SIDE), least, visible, lines, clear)
        assert after.lines is not None
        assert np.array_equal(after.lines, lines)
        assert np.array_equal(ALL_ON if after.clear is None else after.clear, clear)
        track = after
    assert track.pairs == PARAMETERS.learning_pairs + 12
    assert track.is_occluded
    assert track.uncovered.any()
