"""Reference for the detector kernels in `kernels.py` and `coarse.py`, in plain NumPy."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import Floats
from heliograph.receive.detect.alternation import DETECT

ScoredSquare = tuple[float, float, float, float, int]
"""Score, x, y, side, identity."""


@dataclass(frozen=True)
class Grid:
    """Search grid of `search`."""

    # (sizes,) array sides in px
    sides: Floats
    # Maximum number of candidates
    count: int
    # Minimum rms alternation in gray levels
    contrast: float = 3.0
    # Minimum correlation, 0 to 1
    threshold: float = 0.35
    # Minimum candidate distance along x or y, as a fraction of the larger side
    apart: float = 0.5
    # Ring width and position step as fractions of the side
    ring: float = DETECT.ring
    step: float = 0.1


def block_means(image: Floats, size: int) -> Floats:
    """Return mean magnitudes of blocks, (blocks down, blocks across)."""
    rows, cols = image.shape
    return np.asarray(np.abs(image).reshape(rows // size, size, cols // size, size).mean(axis=(1, 3)))


def busy(means: Floats, free: NDArray[np.bool_], least: float, ratio: float) -> NDArray[np.bool_]:
    """Mark blocks with above-median alternation and their neighbours, (blocks down, blocks across)."""
    if not free.any():
        return np.zeros(means.shape, bool)
    # upper median for an even count
    median = np.sort(means[free])[np.count_nonzero(free) // 2]
    found = np.pad(free & (means > max(least, ratio * median)), 1)
    rows, columns = means.shape
    return np.any([found[i : i + rows, j : j + columns] for i in range(3) for j in range(3)], axis=0)


def search(image: Floats, busy: NDArray[np.bool_], block: int, cells: Floats, grid: Grid) -> list[ScoredSquare]:
    """Return the best candidates over scale and position, best first."""
    kept: list[ScoredSquare] = []
    places = [place for side in map(float, grid.sides) for place in _places(image.shape, block, side, grid)]
    for (down, across), x, y, side in sorted(places, key=lambda place: place[0]):
        for number, score in _scores(image, cells, x, y, side, grid) if busy[down, across] else ():
            if abs(score) >= grid.threshold:
                kept = _merge(kept, (score, x + side / 2, y + side / 2, side, number), grid)
    return kept


def _places(
    shape: tuple[int, ...], block: int, side: float, grid: Grid
) -> Iterator[tuple[tuple[int, int], float, float, float]]:
    """Return centre block, upper left corner and side of each square whose ring lies inside the image."""
    step, ring = max(1.0, grid.step * side), grid.ring * side
    for y in np.arange(ring, shape[0] - 1 - side - ring, step).tolist():
        for x in np.arange(ring, shape[1] - 1 - side - ring, step).tolist():
            yield (int((y + side / 2) / block), int((x + side / 2) / block)), x, y, side


def _scores(image: Floats, cells: Floats, x: float, y: float, side: float, grid: Grid) -> list[tuple[int, float]]:
    """Correlate a square with each header; light in the ring lowers the score."""
    ring = grid.ring * side
    energy = _box_sums(image**2, x - ring, y - ring, side + 2 * ring, 1)[0]
    if energy < grid.contrast**2 * side**2:
        return []
    # <D, T> / (|D| |T|) with |T| = side
    scores = cells @ _box_sums(image, x, y, side / 4, 4) / (side * np.sqrt(energy))
    return list(enumerate(scores.tolist()))


def _box_sums(image: Floats, x: float, y: float, size: float, count: int) -> Floats:
    """Integrate over adjacent squares with fractional pixels, row by row; pixel (0, 0) begins at 0."""
    starts, (rows, columns) = size * np.arange(count, dtype=np.float64), image.shape
    return np.asarray(_overlap(y + starts, size, rows) @ image @ _overlap(x + starts, size, columns).T).ravel()


def _overlap(starts: Floats, size: float, count: int) -> Floats:
    """Return the fraction of each pixel within [start, start + size], (starts, pixels)."""
    first, starts = np.arange(count), starts[:, None]
    return np.clip(np.minimum(starts + size, first + 1) - np.maximum(starts, first), 0, 1)


def _merge(kept: list[ScoredSquare], new: ScoredSquare, grid: Grid) -> list[ScoredSquare]:
    """Add a candidate unless a better candidate overlaps; drop worse overlapping candidates."""
    near = [old for old in kept if max(abs(old[1] - new[1]), abs(old[2] - new[2])) < grid.apart * max(new[3], old[3])]
    if any(abs(old[0]) >= abs(new[0]) for old in near):
        return kept
    rest = [old for old in kept if old not in near]
    return sorted([*rest, new], key=lambda c: -abs(c[0]))[: grid.count]
