"""What a pair shows of an array before its pose is found."""

import numpy as np
from scenes import ALL_ON, SIDE, draw, frame_of, pitch_at

from heliograph.receive import Pose
from heliograph.receive.track import kernels
from heliograph.receive.track.kalman import MotionModel, PoseState
from heliograph.receive.track.track import (
    LEAST_CHANGED,
    USUAL_PAIRS,
    Track,
    in_sight,
    line_distance,
    look,
    noise_around,
)

CORNER, SHAPE = (100, 50), (60, 64)


def test_a_look_is_its_parts_one_after_the_other() -> None:
    rng, pose = np.random.default_rng(2), Pose(131.2, 80.4, pitch_at(50.0), 0.02, 0.53)
    state = PoseState.start(0.0, pose.vector(), np.eye(5), MotionModel(1e-3, 0.1))
    track = Track(state, 200.0, 200.0, ALL_ON, 0.0, np.ones((SIDE, SIDE)), pairs=USUAL_PAIRS)
    for k in range(12):
        levels = rng.binomial(4, 0.5, (SIDE, SIDE)) / 4
        # a post that comes in from the left
        hidden = slice(0, max(0, 3 * k - 8))
        frames = []
        for x in (levels, 1 - levels):
            light = 0.1 + 0.7 * draw(pose, x, CORNER, SHAPE)
            light[:, hidden] = 0.9
            frames.append(frame_of(light, k, rng).pixels.astype(np.float64))
        up, down = frames
        seen = look(track, up, down, CORNER, pose)
        assert np.array_equal(seen.differs, up - down)
        assert np.array_equal(seen.total, up + down)
        assert seen.noise == noise_around(up - down, pose, CORNER, SIDE)
        clear, lines = np.ones((SIDE, SIDE)), np.full((2, SIDE + 2), np.nan) if track.lines is None else track.lines
        lines, middle = lines.copy(), np.array([pose.x - CORNER[0], pose.y - CORNER[1]])
        sight, least = in_sight(seen.track.change), LEAST_CHANGED * 200.0
        kernels.uncover(seen.total, middle, pose.axes, line_distance(pose, SIDE), least, sight, lines, clear)
        assert seen.track.lines is not None
        assert np.array_equal(seen.track.lines, lines)
        assert np.array_equal(ALL_ON if seen.track.clear is None else seen.track.clear, clear)
        track = seen.track
    assert track.pairs == USUAL_PAIRS + 12
    assert track.hidden
    assert track.unhidden.any()
