"""Cut-outs without the LEDs that a post or a car hides."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.receive.observe.cutout import Cutout
from heliograph.receive.track.sight import open_lines, open_pixels

NOTICED_PAIRS = 6
"""Pairs after which an LED that is hidden from one pair to the next is known to be so.

Its recent change falls by 0.75 a pair (`RECENT_PAIR_WEIGHT`), from 1 to `LEAST_CHANGE_IN_SIGHT` in six.
"""


def beside_what_hides(cutout: Cutout, in_sight: Floats) -> Cutout:
    """A cut-out without the pixels that something hides, or may hide in part: LEDs next to hidden ones."""
    across, down = open_lines(open_pixels(in_sight, cutout.middle, cutout.corner, cutout.shape))
    if cutout.covered is not None:
        across, down = across * cutout.covered[0], down * cutout.covered[1]
    return replace(cutout, in_sight=in_sight, covered=(across, down))


def hidden_since(cutouts: Mapping[int, Cutout], place: int, in_sight: Floats) -> dict[int, Cutout]:
    """Cut-outs of earlier pairs in which LEDs were hidden already that are noticed as hidden only now."""
    found = dict[int, Cutout]()
    for earlier in range(place - NOTICED_PAIRS, place):
        cutout = cutouts.get(earlier)
        seen = None if cutout is None else cutout.shining(in_sight)
        if cutout is not None and seen is not None and not np.array_equal(seen, cutout.shining(np.ones(seen.shape))):
            found[earlier] = beside_what_hides(cutout, seen)
    return found
