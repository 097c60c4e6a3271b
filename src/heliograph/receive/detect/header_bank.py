"""The header in a pair of frames: its luminances, and how much of it the pair shows.

What a header may mean: an identity, and how the camera sees the array.

A header that is turned or mirrored may be the header of another identity, upright or turned otherwise. Only what the
array sends tells them apart: its blocks name the identity and have a CRC.
"""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import TINY, Floats
from heliograph.receive.detect.alternation import APART_SIDES, TURNED_APART_SIDES
from heliograph.receive.geometry.fit import header_amplitudes
from heliograph.receive.geometry.pose import Orientation, Pose
from heliograph.receive.sync.combine import Combination
from heliograph.receive.sync.pairing import FramePair
from heliograph.signal.header import IDENTITIES, dimmed_leds, header_cells, header_levels, signalling_levels


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


Hypothesis = tuple[int, Orientation]
"""Identity of an array, and how the camera sees it."""


@dataclass(frozen=True, slots=True)
class Headers:
    """Headers looked for."""

    # (headers, 16) of +-1, as the camera sees them; no two are the same
    cells: NDArray[np.float64]
    # What each may mean, the most plausible first
    hypotheses: tuple[tuple[Hypothesis, ...], ...]
    # Least distance of two candidates as a fraction of the side; see `coarse_search`
    apart: float = APART_SIDES


ALL_ON = Headers(np.ones((1, 16)), (((0, Orientation()),),))
"""A square that blinks as a whole, without an identity."""


@lru_cache
def headers(orientations: Sequence[Orientation], other: Sequence[Orientation] = ()) -> Headers:
    """Headers of all identities as a camera sees them."""
    seen: dict[bytes, list[Hypothesis]] = defaultdict(list)
    for orientation in (*orientations, *other):
        for number in range(IDENTITIES):
            seen[orientation.turned(header_cells(number)).tobytes()].append((number, orientation))
    kept = {cells: hypotheses for cells, hypotheses in seen.items() if hypotheses[0][1] in orientations}
    cells = np.array([np.frombuffer(one, np.int8) for one in kept], np.float64)
    apart = APART_SIDES if len(orientations) == 1 else TURNED_APART_SIDES
    return Headers(cells, tuple(map(tuple, kept.values())), apart)
