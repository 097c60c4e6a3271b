"""Cut-outs of a whole packet from drawn frames, at known poses."""

from functools import cache

import numpy as np
from known_packets import FORM, random_blocks, symbols_of
from scenes import ALL_ON, SIDE, draw, frame_of, pitch_at

from heliograph.base.arrays import Floats
from heliograph.receive import Pose
from heliograph.receive.observe.cutout import Cutout, take_cutout
from heliograph.receive.observe.noise import Noise
from heliograph.receive.sync.pairing import FramePair
from heliograph.signal import haar

GAIN, NOISE = 0.7 * 255, Noise(4.5, 1.5)
"""Gain and noise variances of the drawn frames."""

UNEQUAL = 1 + 0.2 * np.random.default_rng(3).standard_normal((SIDE, SIDE))
UNEQUAL /= np.median(UNEQUAL)
DEAD = np.ones((SIDE, SIDE))
DEAD.ravel()[np.random.default_rng(2).permutation(SIDE**2)[:38]] = 0.0
LED_GAINS = {"equal": ALL_ON, "unequal": UNEQUAL, "dead": DEAD}


@cache  # 24 pairs take a second, and tests do not change them
def drawn_packet(kind: str = "equal", seed: int = 0) -> tuple[list[Cutout], Floats]:
    """Return the cut-outs of a packet at 95 m with a kind of LED gains, and the symbols (pairs, symbols)."""
    rng, symbols, cutouts = np.random.default_rng(seed + 1), symbols_of(random_blocks(seed)), list[Cutout]()
    for x in haar.encode(FORM.join(symbols.astype(np.int8))) / 4.0:
        x_px, y_px = (float(v) for v in rng.uniform(30, 31, 2))
        pose = Pose(x_px, y_px, pitch_at(95.0), float(rng.normal(0, 0.01)), 0.51)
        lights = (0.1 + 0.7 * draw(pose, y * LED_GAINS[kind], (0, 0), (60, 60)) for y in (x, 1 - x))
        up, down = (frame_of(light, k, rng) for k, light in enumerate(lights))
        cutouts.append(take_cutout(FramePair(up, down), (pose, pose), SIDE))
    return cutouts, symbols
