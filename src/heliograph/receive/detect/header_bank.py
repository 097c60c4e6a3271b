"""Headers of all identities and orientations.

A turned or mirrored header may equal the header of another identity. The blocks of a packet name the identity and have
a CRC, so the data resolve the ambiguity.
"""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from heliograph.base.arrays import Floats
from heliograph.receive.detect.alternation import DETECT
from heliograph.receive.geometry.pose import Orientation
from heliograph.signal.header import IDENTITIES, header_cells

Hypothesis = tuple[int, Orientation]
"""Identity of an array, and the orientation in the camera's image."""


@dataclass(frozen=True, slots=True)
class Headers:
    """Set of different headers."""

    # (headers, 16) of +-1, as the camera sees them
    cells: Floats
    # Identities and orientations of each header, the most plausible first
    hypotheses: tuple[tuple[Hypothesis, ...], ...]
    # Least distance of two candidates as a fraction of the side
    min_distance: float = DETECT.min_distance


ALL_ON = Headers(np.ones((1, 16)), (((0, Orientation()),),))
"""Blinking square with no identity."""


@lru_cache
def headers(orientations: Sequence[Orientation], other: Sequence[Orientation] = ()) -> Headers:
    """Return the headers of all identities in some orientations; `other` orientations add hypotheses alone."""
    hypotheses: dict[bytes, list[Hypothesis]] = defaultdict(list)
    for orientation in (*orientations, *other):
        for number in range(IDENTITIES):
            hypotheses[orientation.turned(header_cells(number)).tobytes()].append((number, orientation))
    kept = {cells: meanings for cells, meanings in hypotheses.items() if meanings[0][1] in orientations}
    cells = np.array([np.frombuffer(header, np.int8) for header in kept], np.float64)
    min_distance = DETECT.min_distance if len(orientations) == 1 else DETECT.min_distance_turned
    return Headers(cells, tuple(map(tuple, kept.values())), min_distance)
