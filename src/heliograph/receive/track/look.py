"""What a pair shows of an array before its pose is found: how much it changes, where it is hidden, what covers it."""

from dataclasses import dataclass
from math import inf

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.receive.image.pose import Pose
from heliograph.receive.track import kernels
from heliograph.receive.track.activity import BESIDE_EDGE_PX, contrast
from heliograph.receive.track.beside import LEAST_CHANGED, line_distance
from heliograph.receive.track.sight import (
    BRIGHT_QUANTILE,
    LEAST_CHANGE_IN_SIGHT,
    LEAST_DATA_POWER,
    MOST_CHANGE,
    RECENT_PAIR_WEIGHT,
    square_leds,
)
from heliograph.receive.track.track import Track

USUAL_PAIRS = 50
"""Pairs after which it is known what an array and its surroundings usually show in sums: a packet.

Of arrays found while a post was leaving them, what it had covered was taken for covered when it came to light.
"""


@dataclass(frozen=True, slots=True)
class Look:
    """What a pair shows of an array where it is expected."""

    # (rows, columns) pattern less inverse in gray levels
    differs: Floats
    # (rows, columns) their sum
    total: Floats
    # Standard deviation of the noise of the difference in gray levels
    noise: float
    # The array's track with what the pair adds to `Track.change`, `Track.lines` and `Track.clear`
    track: Track


def look(track: Track, up: Floats, down: Floats, corner: tuple[int, int], pose: Pose) -> Look:
    """Look at a pair where an array is expected."""
    side = len(track.change)
    differs, total = np.empty(up.shape), np.empty(up.shape)
    after, sight, clear = np.empty((side, side)), np.empty((side, side)), np.empty((side, side))
    lines = np.full((2, side + 2), np.nan) if track.lines is None else track.lines.copy()
    # an array just found may be covered in part: what is usual shows later
    light = max(track.gain, track.data_gain) if track.pairs >= USUAL_PAIRS else inf
    # random data change the light by half of it
    least = LEAST_DATA_POWER * (0.5 * contrast(pose) * track.data_gain) ** 2
    noise, hidden, covered = kernels.look(
        up,
        down,
        np.array((pose.x - corner[0], pose.y - corner[1])),
        pose.axes,
        0.5 * side * pose.pitch + BESIDE_EDGE_PX,
        track.change,
        least,
        square_leds(pose, side),
        int(BRIGHT_QUANTILE * (side**2 - 1)),
        MOST_CHANGE,
        RECENT_PAIR_WEIGHT,
        LEAST_CHANGE_IN_SIGHT,
        line_distance(pose, side),
        LEAST_CHANGED * light,
        lines,
        differs,
        total,
        after,
        sight,
        clear,
    )
    seen = track.looked_at(after, sight if hidden else None, lines, clear if covered else None)
    return Look(differs, total, noise, seen)
