"""Sensor-free frame pairs and their full model matrices."""

import numpy as np
from observe_oracle import pair_model, transform, weights
from render_oracle import blur_matrix
from scenes import SIDE, draw, pitch_at

from heliograph.base.arrays import Floats
from heliograph.base.threads import one_thread
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.geometry.window import CombinedFrame
from heliograph.receive.observe.cutout import Noise, take_cutout
from heliograph.receive.sync.combine import Combination, combine_pair
from heliograph.receive.sync.pairing import FramePair

SYMBOLS = SIDE * SIDE
GAIN = 150.0
T = transform(SIDE)
CUT = 5e-4
"""Light fraction beyond 3.7 standard deviations in x and y, where the kernel footprints end."""

MOTIONS = [(0.0, 0.0), (0.12, -0.2)]
ROLLS = [0.0, 0.05]


def pair_of(poses: tuple[Pose, Pose], x: Floats, noise: float = 0.0) -> FramePair:
    """Return a pattern x and its inverse as exact gray levels plus Gaussian noise."""
    rng = np.random.default_rng(4)
    light = [30 + GAIN * draw(p, y, (0, 0), (60, 60)) for p, y in zip(poses, (x, 1 - x), strict=True)]
    up, down = (
        CombinedFrame(k, k * 1e-3, image + rng.normal(0, noise, image.shape), (0, 0), 255)  # type: ignore[arg-type]
        for k, image in enumerate(light)
    )
    return FramePair(up, down)


def random_levels() -> tuple[Floats, Floats]:
    """Return random symbols and the resulting LED levels from 0 to 1."""
    symbols = np.random.default_rng(5).choice([-1.0, 1.0], SYMBOLS)
    return symbols, 0.5 * (1 + T @ symbols).reshape(SIDE, SIDE)


def moving(distance_m: float, roll: float, motion: tuple[float, float]) -> tuple[Pose, Pose]:
    """Return poses for both frames."""
    first = Pose(29.3, 30.4, pitch_at(distance_m), roll, 0.51)
    return first, first.moved(*motion)


def combination() -> Combination:
    """Return the combination of 1.5 frames per pattern, with other noise than two frames."""
    found = combine_pair(np.arange(-2, 5) / 1.5 + 0.2, 1 / 1.5, (0, 1, 2, 3))
    assert found is not None
    assert abs(found.noise - 1) > 0.2
    return found


class WholePair:
    """Cut-out with full model matrices: difference d (pixels,) = g (b c + o) + n with weights w (pixels,)."""

    def __init__(self, poses: tuple[Pose, Pose], pair: FramePair, noise: Noise):
        self.cutout = take_cutout(pair, poses, SIDE)
        corner, shape = self.cutout.corner, self.cutout.shape
        a = [blur_matrix(pose, SIDE, corner, shape) for pose in poses]
        with one_thread():
            self.b, self.o = pair_model(a[0], a[1], T)
        motion = abs(poses[1].x - poses[0].x) / 2, abs(poses[1].y - poses[0].y) / 2
        middle = Pose.midway(*poses)
        wide = blur_matrix(middle, SIDE, corner, shape, motion)
        self.w = weights(wide, middle.pitch, noise.lit, noise.dark, 2, shape)
        self.d = self.cutout.difference.ravel()
