"""Cut-outs of a whole packet from drawn frames, at known poses."""

from functools import cache

import numpy as np
from known_packets import FORM, random_blocks, symbols_of
from scenes import ALL_ON, SIDE, draw, frame_of, pitch_at

from heliograph.base.arrays import Floats
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.observe.cutout import Cutout, Noise, take_cutout
from heliograph.receive.sync.pairing import FramePair
from heliograph.signal import haar

GAIN, NOISE = 0.7 * 255, Noise(4.5, 1.5)
"""Gain and noise variances of the drawn frames."""

UNEQUAL = 1 + 0.2 * np.random.default_rng(3).standard_normal((SIDE, SIDE))
UNEQUAL /= np.median(UNEQUAL)
DEAD = np.ones((SIDE, SIDE))
DEAD.ravel()[np.random.default_rng(2).permutation(SIDE**2)[:38]] = 0.0
LED_GAINS = {"equal": ALL_ON, "unequal": UNEQUAL, "dead": DEAD}


def drawn_pair(
    poses: tuple[Pose, Pose],
    levels: tuple[Floats, Floats],
    rng: np.random.Generator,
    gain: float = GAIN,
    shape: tuple[int, int] = (60, 60),
) -> FramePair:
    """Film an array's LED levels, 0 to 1, in a frame each, before an even background and with the reference noise."""
    up, down = (
        frame_of(0.1 + gain / 255 * draw(pose, shown, (0, 0), shape), k, rng)
        for k, (pose, shown) in enumerate(zip(poses, levels, strict=True))
    )
    return FramePair(up, down)


@cache  # 24 pairs take a second, and tests do not change them
def drawn_packet(kind: str = "equal", seed: int = 0) -> tuple[list[Cutout], Floats]:
    """Return the cut-outs of a packet at 95 m with a kind of LED gains, and the symbols (pairs, symbols)."""
    rng, symbols, cutouts = np.random.default_rng(seed + 1), symbols_of(random_blocks(seed)), list[Cutout]()
    for x in haar.encode(FORM.join(symbols.astype(np.int8))) / 4.0:
        x_px, y_px = (float(v) for v in rng.uniform(30, 31, 2))
        pose = Pose(x_px, y_px, pitch_at(95.0), float(rng.normal(0, 0.01)), 0.51)
        pair = drawn_pair((pose, pose), (x * LED_GAINS[kind], (1 - x) * LED_GAINS[kind]), rng)
        cutouts.append(take_cutout(pair, (pose, pose), SIDE))
    return cutouts, symbols
