"""The header in a pair of frames: its luminances, and how much of it the pair shows."""

from functools import lru_cache

import numpy as np

from heliograph.base.arrays import TINY, Floats
from heliograph.receive.image.fit import header_amplitudes
from heliograph.receive.image.pose import Pose
from heliograph.receive.timing.combination import Combination
from heliograph.receive.timing.frame_pair import FramePair
from heliograph.signal.header import dimmed_leds, header_levels, signalling_levels


def header_weights(identity: int, form: int, side: int, combination: Combination | None = None) -> Floats:
    """Luminances of a header less its inverse, (n, n): +-1, or +-1/2 where cells are dimmed."""
    if combination is None:
        # a kernel would be compiled anew for what is not writeable
        return _in_step(identity, form, side).copy()
    signs = header_levels(identity, side) / 2.0 - 1.0
    contrast, light = combination.dimmed
    return np.where(dimmed_leds(form, side), contrast * signs + light, signs)


def header_score(pair: FramePair, pose: Pose, weights: Floats, gain: float) -> float:
    """Amplitude of a header as a fraction of the array's light; about 1."""
    up, down = header_amplitudes((pair.pattern, pair.inverted), pose, weights)
    return float(up - down) / max(gain, TINY)


@lru_cache(maxsize=64)  # an array's headers are alike
def _in_step(identity: int, form: int, side: int) -> Floats:
    """`header_weights` of two frames in step, not writeable."""
    weights = signalling_levels(identity, form, side) / 2.0 - 1.0
    weights.setflags(write=False)
    return weights
