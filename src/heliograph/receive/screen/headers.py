"""Headers among solved pairs: whose array it is, how the camera sees it, and the format that it names."""

from dataclasses import dataclass

import numpy as np

from heliograph.base.arrays import TINY, Floats
from heliograph.receive.image.orientation import ORIENTATIONS, Orientation
from heliograph.signal.formats import ALL_MODES, DIMMED, words
from heliograph.signal.header import CELLS, all_header_cells

LEAST_MATCH = 0.75
"""Least correlation of a pair with a header. A pair of random data of 8 x 8 cells has a standard deviation of 0.125,
and is compared with 240 turned headers: six of them are 0.75."""

TIES = 0.03
"""Correlations this near are of headers that look alike in several orientations; the data tell which is right."""


@dataclass(frozen=True)
class HeaderSeen:
    """A header among pairs."""

    # Number of its first pair among those solved
    place: int
    # Number of the array, 0 to 29
    identity: int
    # How the camera sees it
    orientation: Orientation
    # Correlation with the header, 0 to 1
    score: float
    # Number of the format, 0 to 2047; 0 where the header has one pair
    form: int = 0


def headers(change: Floats, pairs: int) -> list[HeaderSeen]:
    """Find headers among pairs, the surest first."""
    n = change.shape[-1]
    centred = change / np.maximum(np.linalg.norm(change, axis=(1, 2), keepdims=True), TINY)
    cells = centred.reshape(-1, CELLS, n // CELLS, CELLS, n // CELLS).mean((2, 4)) * n
    known = all_header_cells()
    found = []
    for orientation in ORIENTATIONS:
        turned = np.stack([orientation.turned(one) for one in known]) / CELLS
        # correlation over all cells of the array, (pairs, identities)
        match = np.einsum("pij,kij->pk", cells, turned) / CELLS
        # of several pairs of a header the weakest counts; a format dims the later ones
        whole = match[: len(match) - pairs + 1].copy()
        for later in range(1, pairs):
            whole = np.minimum(whole, match[later : later + len(whole)] / 0.9)
        found += [
            HeaderSeen(int(p), int(k), orientation, float(whole[p, k])) for p, k in np.argwhere(whole > LEAST_MATCH)
        ]
    found.sort(key=lambda one: -one.score)
    return found


def named_format(header: HeaderSeen, change: Floats, pairs: int) -> int:
    """Return the number of the format that a header names, 0 to 2047."""
    if pairs < 2:
        return 0
    n = change.shape[-1]
    upright = np.stack([header.orientation.upright(one) for one in change[header.place : header.place + pairs]])
    cells = upright.reshape(-1, CELLS, n // CELLS, CELLS, n // CELLS).mean((2, 4))
    first, later = cells[0].ravel(), cells[1:].mean(0).ravel()
    # a dimmed cell has half the contrast that it had in the first pair
    shown = np.where(words(ALL_MODES), DIMMED, 1.0) * first
    return int(np.argmin(((shown - later) ** 2).sum(1)))
