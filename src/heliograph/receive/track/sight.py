"""Which LEDs are in sight: where a pattern and its inverse hardly differ, something hides them.

Data are random, so over a few pairs every LED in sight changes from pattern to inverse. What hides an array stands
still from one frame to the next, whatever its gray.
"""

from math import ceil

import cv2
import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import Floats
from heliograph.receive.image.pose import Pose

SQUARE_LEDS, SQUARE_PX = 5, 4.0
"""Side of the square about an LED whose change counts, in LEDs, and at least in px.

Of random data the mean power of 25 LEDs is within a quarter of its expectation. After the blur, fewer than 16 pixels
show too few LEDs.
"""

RECENT_PAIR_WEIGHT = 0.25
"""Weight of the newest pair in the recent change of an LED.

With 25 LEDs about each and four pairs, the recent change has an error of a tenth, at most a fifth. A post that passes
in 0.1 s hides an LED each 3 ms, so the recent change lags by two or three LEDs.
"""

LEAST_CHANGE_IN_SIGHT = 0.2
"""Least recent change of an LED in sight, as a fraction of that of the others.

It lies four standard deviations below theirs. Because of the blur an LED of the rim changes half as much as others, one
in a corner a third as much.
"""

BRIGHT_QUANTILE = 0.8
"""Quantile of the LEDs' changes that stands for one in sight: a fifth of the array is enough."""

LEAST_DATA_POWER = 0.1
"""Least of that quantile, as a fraction of the power that random data have: below it all are hidden.

The change then has sqrt(0.1) = 0.32 of the amplitude of data. So LEDs may be three times dimmer than the gain says.
"""

MOST_CHANGE = 2.0
"""Most that a pair counts for an LED in sight, as a multiple of that quantile.

It bounds how long a hidden LED counts as in sight, whatever was seen of it: 2 * 0.75^n is below `LEAST_CHANGE_IN_SIGHT`
after nine pairs. From 1, which the LED at that quantile has, it takes six.
"""

LEAST_OPEN = 0.9
"""Least part of the open pixels that whole columns or rows must leave.

What hides a side leaves all of them. What hides a quarter in a corner leaves two thirds: at 80 m the codewords of such
an array were lost without the rest.
"""

LEAST_DARK_ZONE = 0.4
"""Least fraction of the LEDs about one that are dark in a header for it to lie in a zone that something hid then.

Of 16 LEDs in a row two columns at the rim have 3/5 or more, one column 2/5. Of LEDs that are dead here and there, 15 %
in all, one in 500 has as many dead ones about it.
"""


def in_sight(change: Floats) -> Floats:
    """1 for LEDs in sight, 0 for those that something hides, (n, n)."""
    return (change >= LEAST_CHANGE_IN_SIGHT).astype(np.float64)


def around_leds(values: Floats, pose: Pose) -> Floats:
    """Mean of values of LEDs over the squares about them."""
    width = square_leds(pose, len(values))
    return np.asarray(cv2.blur(values, (width, width), borderType=cv2.BORDER_REFLECT), np.float64)


def square_leds(pose: Pose, side: int) -> int:
    """LEDs in a row of the square about one, whose change counts for it."""
    return min(max(SQUARE_LEDS, ceil(SQUARE_PX / pose.pitch) | 1), side - 1 | 1)


def dark_zone(dark: NDArray[np.bool_], pose: Pose) -> NDArray[np.bool_]:
    """LEDs that something hides, of those that a header shows dark: they lie together, and dead ones do not."""
    return dark & (around_leds(dark.astype(np.float64), pose) >= LEAST_DARK_ZONE)


def open_pixels(seen: Floats, pose: Pose, corner: tuple[int, int], shape: tuple[int, int]) -> Floats:
    """Pixels before which nothing is: those whose LED and its neighbours are in sight."""
    side = len(seen)
    sure = cv2.erode(seen.astype(np.float32), np.ones((3, 3), np.uint8), borderType=cv2.BORDER_REPLICATE)
    middle, inverse = 0.5 * (side - 1), np.linalg.inv(pose.axes)
    first = inverse @ (np.array(corner, float) - (pose.x, pose.y)) + middle
    return np.asarray(
        cv2.warpAffine(
            sure,
            np.column_stack([inverse, first]),
            (shape[1], shape[0]),
            flags=cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_REPLICATE,
        ),
        np.float64,
    )


def open_lines(unhidden: Floats) -> tuple[Floats, Floats]:
    """Unoccluded columns or rows, whichever keep more pixels: passing objects have a straight edge."""
    rows, columns = unhidden.shape
    across, down = unhidden.min(0), unhidden.min(1)
    by_columns, by_rows = across.sum() * rows, down.sum() * columns
    if max(by_columns, by_rows) < LEAST_OPEN * unhidden.sum():
        return np.ones(columns), np.ones(rows)
    return (across, np.ones(rows)) if by_columns >= by_rows else (np.ones(columns), down)
