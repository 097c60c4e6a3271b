"""What comes before an array from a side: it covers the array's surroundings before it hides an LED.

The sum of a pattern and its inverse shows all LEDs and the background, whatever is sent. Along a column or a row of
LEDs, and along a line beside the array, it hardly changes from pair to pair. A post that comes near changes it at once.
Its light would pull the pose: an array seems to end where a post begins.
"""

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.receive.image.pose import Pose
from heliograph.receive.track import kernels

BESIDE_PITCHES, BESIDE_PX = 1.5, 2.0
"""Distance of a line beside the array from its edge, in pitches, and at least in px.

2 px from an edge a blur of 0.7 px leaves 0.2 % of the array's light, and 8 % of an array 1 px off its place.
"""

LEAST_CHANGED = 0.15
"""Least change of a line that counts, as a fraction of the array's light.

Without it posts pull the pose: of 7389 pairs in 44 passages 931 were off by over half a pitch, with it 613 of 7281.
"""


def clear_leds(
    total: Floats, pose: Pose, corner: tuple[int, int], usual: Floats | None, gain: float, in_sight: Floats
) -> tuple[Floats, Floats]:
    """LEDs before which nothing has come from a side, and what their lines usually show.

    Parameters
    ----------
    total
        (rows, columns) sum of a pair in gray levels.
    pose
        Pose of the array, in the middle of the pair.
    corner
        (x, y) on the sensor of the first pixel.
    usual
        (2, n + 2) what the lines usually showed before the pair; None before the first.
    gain
        Gray levels of a sum with all LEDs on; infinite as long as it is not known what is usual: nothing is covered.
    in_sight
        (n, n) 1 for LEDs that changed from patterns to inverses, 0 for those that something hides.

    Returns
    -------
    (n, n) 1 or 0: the outermost LEDs are covered where the line beside them is. And (2, n + 2) gray levels that
    columns, from left to right, and rows, from top to bottom, usually show; NaN where nothing was seen yet.
    """
    side = len(in_sight)
    lines = np.full((2, side + 2), np.nan) if usual is None else usual.copy()
    away = 0.5 * side + max(BESIDE_PITCHES, BESIDE_PX / pose.pitch)
    middle = np.array([pose.x - corner[0], pose.y - corner[1]])
    clear = np.ones((side, side))
    kernels.uncover(np.asarray(total), middle, pose.axes, away, LEAST_CHANGED * gain, in_sight, lines, clear)
    return clear, lines
