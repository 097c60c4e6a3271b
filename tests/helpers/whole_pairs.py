"""A pair of frames without a sensor, and the whole matrices of its model."""

import numpy as np
from numpy.typing import NDArray
from observe_oracle import pair_model, transform, weights
from render_oracle import blur_matrix
from scenes import SIDE, draw, pitch_at

from heliograph.base.threads import one_thread
from heliograph.receive import Pose
from heliograph.receive.geometry.window import CombinedFrame
from heliograph.receive.observe.cutout import take_cutout
from heliograph.receive.observe.noise import Noise
from heliograph.receive.sync.pairing import FramePair

Floats = NDArray[np.float64]

SYMBOLS = SIDE * SIDE
GAIN = 150.0
T = transform(SIDE)
CUT = 5e-4
"""Part of an LED's light beyond 3.7 standard deviations, both axes, where the kernels' footprints end."""

MOTIONS = [(0.0, 0.0), (0.12, -0.2)]
ROLLS = [0.0, 0.05]


def pair_of(poses: tuple[Pose, Pose], x: Floats, noise: float = 0.0) -> FramePair:
    """A pattern x and its inverse without a sensor: gray levels as they are, and noise of a standard deviation."""
    rng = np.random.default_rng(4)
    light = [30 + GAIN * draw(p, y, (0, 0), (60, 60)) for p, y in zip(poses, (x, 1 - x), strict=True)]
    up, down = (
        CombinedFrame(k, k * 1e-3, image + rng.normal(0, noise, image.shape), (0, 0), 255)  # type: ignore[arg-type]
        for k, image in enumerate(light)
    )
    return FramePair(up, down)


def random_levels() -> tuple[Floats, Floats]:
    """Symbols, and the LEDs' levels 0 to 1 that they make."""
    symbols = np.random.default_rng(5).choice([-1.0, 1.0], SYMBOLS)
    return symbols, 0.5 * (1 + T @ symbols).reshape(SIDE, SIDE)


def moving(distance_m: float, roll: float, motion: tuple[float, float]) -> tuple[Pose, Pose]:
    """Poses in the two frames."""
    first = Pose(29.3, 30.4, pitch_at(distance_m), roll, 0.51)
    return first, first.moved(*motion)


class WholePair:
    """A cut-out and its model as whole matrices.

    Parameters
    ----------
    poses
        In the two frames.
    pair
        The frames.
    noise
        By which pixels are weighted.

    Attributes
    ----------
    cutout
        The cut-out.
    b, o
        (pixels, symbols) and (pixels,): d = g (b c + o) + n.
    w
        (pixels,) weights.
    d
        (pixels,) the difference.
    """

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
