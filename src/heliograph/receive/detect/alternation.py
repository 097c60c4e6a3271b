"""Coarse search: what alternates in a few frames, correlated with all headers over scale and position.

Hardly anything alternates in a road scene. So means over blocks come first, and only the part of the frames about busy
blocks is searched.

The parts of frames that are searched: what surrounds the blocks in which something alternates.
"""

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame
from heliograph.receive.detect.kernels import BLOCK_PX
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.geometry.window import window_around

RING = 0.12
"""Width of the ring around a candidate that must not alternate, as a fraction of its side: half a header's cell."""

GRID = 0.1
"""Step of the places looked at as a fraction of the side: half a step costs a fifth of a cell's overlap."""

APART_SIDES = 0.5
"""Least distance of two candidates as a fraction of the larger one's side: arrays do not overlap."""

TURNED_APART_SIDES = 0.2
"""The same where headers may be turned: less than a cell, by which one shifted may look like another.

Off the grid, a header then correlates less than another shifted one on it; a fit of both decides.
"""

SIDE_STEP = 1.12
"""Ratio of successive sizes looked for: half a step costs 3 % of correlation."""


def size_limits(min_side_px: float, max_side_px: float) -> tuple[float, float]:
    """Smallest and largest side in px of an array that is found: half a step beyond the sizes that are searched."""
    half_step = SIDE_STEP**0.5
    return min_side_px / half_step, max_side_px * half_step


BUSY = 2.0
"""Least mean alternation of a busy block, over the median block's.

Noise alone never reaches it: the mean of 64 magnitudes has a standard deviation of 9 % of itself.
"""

BLANK = -1.0
"""Stands for the mean alternation of blocks of arrays that are followed: less than any mean."""

PART_LIT = 0.25
"""Least mean alternation of a busy block as a fraction of the least contrast: the array may fill a quarter of it."""


MAX_ONE_SIDED, ANY_SIDED = 0.75, 2.0
"""Largest magnitude of the sum of what alternates in a place, by the sum of its magnitudes: where a quarter of the
budget is used up, and no limit. Half of a header's cells turn brighter while the others turn darker. A header of which
a third is hidden has 0.5 at most, a header after darkness, half a pattern out of step, 0.75 to 0.9, a lamp 1."""


UNBOUNDED = 1 << 60
"""More work than any search does."""

COARSE_CONTRAST = 0.5
"""Least rms alternation of a candidate as a fraction of the least contrast: an array half of it off the grid."""


@dataclass(frozen=True, kw_only=True)
class SearchParameters:
    """What the detector takes for an array."""

    # Smallest array looked for, in px
    min_side_px: float
    # Largest array looked for, in px
    max_side_px: float
    # Least luminance of a lit cell, as a fraction of full scale, 0 to 1
    min_contrast: float
    # Least correlation with a header of a candidate worth a fit, 0 to 1; it costs time only, as `score` decides
    coarse_score: float = 0.5
    # Least correlation with the fitted header of a detection, 0 to 1
    score: float
    # Least ratio of the weakest to the mean alternation of the header's frames, 0 to 1; clutter alternates unevenly
    regularity: float
    # Most candidates fitted per search
    candidates: int
    # Part of a core's time that searches may take on average, by the count of `budget`
    cpu_share: float = 1e6
    # Whether tilted and partly hidden arrays are looked for too; more clutter is taken for one of them
    impaired: bool = False
    # Whether headers are squares that blink as a whole, without an identity
    all_on: bool = False
    # First guess of the blur's standard deviation in px
    blur_px: float
    # Whether every block is searched, as somebody said where the array is; else those alone in which more changes than
    # in others
    everywhere: bool = False
    # Pose of an array on the sensor as somebody gave it: others of its roll and tilt are looked for, and its header is
    # tried there in any case. None where nobody did
    start: Pose | None = None
    # Rolls of the arrays looked for if no upright or turned one is found; each finds arrays up to 12 degrees away
    rolls_deg: tuple[float, ...] = (22.5, -22.5, 45.0, -45.0, 67.5, -67.5)

    def sides(self) -> NDArray[np.float64]:
        """Sizes looked for in px, (sizes,), rising by `SIDE_STEP` at most."""
        count = int(np.ceil(np.log(self.max_side_px / self.min_side_px) / np.log(SIDE_STEP))) + 1
        return np.geomspace(self.min_side_px, self.max_side_px, count)


FrameWeights = tuple[float, float, float, float]
"""Weights of the four frames that are combined."""

ALTERNATION: FrameWeights = (0.25, -0.75, 0.75, -0.25)
"""Of four frames, (f0 - 3 f1 + 3 f2 - f3) / 4: a header stays, and what stands still, drifts or accelerates evenly
cancels."""

DIFFERENCE: FrameWeights = (0.5, -0.5, 0.5, -0.5)
"""Of two frames that both come twice, f0 f1 f0 f1."""


def alternation_of(frames: Sequence[Frame]) -> NDArray[np.float32]:
    """What alternates in two or four frames."""
    return combined(*_four(frames))


def alternation_means(frames: Sequence[Frame]) -> NDArray[np.float32]:
    """Mean magnitude of `alternation_of` over blocks."""
    return combined_means(*_four(frames))


def combined(frames: Sequence[Frame], weights: FrameWeights) -> NDArray[np.float32]:
    """Weighted sum of four frames. Returns (rows, columns) float32 in gray levels."""
    from heliograph.receive.detect import kernels  # Numba is slow to import

    f0, f1, f2, f3 = (frame.pixels for frame in frames)
    out = np.empty(f0.shape, np.float32)
    kernels.combined(f0, f1, f2, f3, np.array(weights, np.float32), out)
    return out


def combined_means(frames: Sequence[Frame], weights: FrameWeights) -> NDArray[np.float32]:
    """Mean magnitude of a weighted sum of four frames over blocks."""
    from heliograph.receive.detect import kernels

    f0, f1, f2, f3 = (frame.pixels for frame in frames)
    out = np.empty([-(-size // BLOCK_PX) for size in f0.shape], np.float32)
    whole = _whole(weights) if f0.dtype == np.uint8 else None
    if whole is None:
        kernels.combined_means(f0, f1, f2, f3, np.array(weights, np.float32), BLOCK_PX, out)
    else:
        kernels.integer_means(f0, f1, f2, f3, *whole, out)
    return out


@lru_cache
def _whole(weights: FrameWeights) -> tuple[np.int16, np.int16, np.float32] | None:
    """Weights a, b, -b, -a as whole numbers a and b in proportion, and what they are multiplied by; None of others."""
    if (weights[0], weights[1]) != (-weights[3], -weights[2]):
        return None
    for parts in (1, 2, 4):
        numbers = np.array(weights) * parts
        # a column of a block sums to less than 2^16
        if (numbers == np.rint(numbers)).all() and np.abs(numbers).sum() * 255 * BLOCK_PX < 1 << 16:
            return np.int16(numbers[0]), np.int16(numbers[1]), np.float32(1 / parts)
    return None


def busy_blocks(
    means: NDArray[np.float32],
    frame: Frame,
    taken: Sequence[Pose],
    side: int,
    min_contrast: float,
    everywhere: bool = False,
) -> NDArray[np.bool_]:
    """Blocks in which an array may have its centre: something alternates there, and no array is followed there."""
    from heliograph.receive.detect import kernels

    left, least = np.empty_like(means), PART_LIT * min_contrast * frame.full_scale
    spans = np.array([_spans(pose, side, frame.origin) for pose in taken], np.int64).reshape(-1, 4)
    # mostly nothing is busy, and then no median is needed
    middle, quiet = kernels.middle_of_busy(means, spans, BLANK, BUSY, least, left)
    if everywhere:
        return np.asarray(left != BLANK)
    if middle < 0:
        return np.zeros(means.shape, bool)
    # a large array lights all of the frame through the windscreen: its own blocks say nothing of that
    median = 0.0 if quiet else float(np.partition(left, middle, axis=None)[middle])
    busy = left > max(least, BUSY * median)
    return np.asarray(cv2.dilate(busy.view(np.uint8), np.ones((3, 3), np.uint8)), dtype=bool)


class Searched(NamedTuple):
    """What a coarse search found and did."""

    # (candidates, 5) of score (negative where the inverse comes first), x and y of the centre in px of the image, side
    # in px, identity; the best first
    rows: NDArray[np.float64]
    # Work done, in places looked at
    work: int
    # Number of blocks gone through, busy or not, from the one it began with
    passed: int
    # Number of places compared with the headers; where it is 0, it is so for other headers too
    compared: int


NOT_SEARCHED = Searched(np.zeros((0, 5)), 0, 0, 0)
"""What a search finds that may do no work."""


class _Sums(threading.local):
    """Integral images in memory that each thread keeps: that of a whole frame's takes longer to get than to fill."""

    def __init__(self) -> None:
        self._kept = np.empty(0)

    def of(self, change: NDArray[np.float32]) -> NDArray[np.float64]:
        """Integral images, valid until the next call, as `integrals` has them."""
        shape = 3, change.shape[0] + 1, change.shape[1] + 1
        size = shape[0] * shape[1] * shape[2]
        if size > self._kept.size:
            self._kept = np.empty(size)
        return integrals(change, self._kept[:size].reshape(shape))


def integrals(change: NDArray[np.float32], out: NDArray[np.float64]) -> NDArray[np.float64]:
    """Fill `out`, (3, rows + 1, columns + 1), with the integral images of an image, its magnitude and its square."""
    cv2.integral2(change, out[0], out[2], cv2.CV_64F, cv2.CV_64F)
    cv2.integral(np.abs(change), out[1], cv2.CV_64F)
    return out


_sums = _Sums()


def coarse_search(
    change: NDArray[np.float32],
    busy: NDArray[np.bool_],
    frame: Frame,
    parameters: SearchParameters,
    cells: NDArray[np.float64],
    sides: NDArray[np.float64],
    apart: float = APART_SIDES,
    begin: int = 0,
    limit: float = UNBOUNDED,
    one_sided: float = MAX_ONE_SIDED,
) -> Searched:
    """Best candidates of a search."""
    from heliograph.receive.detect import kernels

    best = np.zeros((parameters.candidates, 5))
    contrast = COARSE_CONTRAST * parameters.min_contrast * frame.full_scale
    corner = np.array(frame.origin, np.float64)
    found, work, passed, compared = kernels.search(
        _sums.of(change),
        busy,
        float(BLOCK_PX),
        cells,
        sides,
        contrast,
        parameters.coarse_score,
        ANY_SIDED if cells.sum(axis=1).any() else one_sided,
        RING,
        GRID,
        apart,
        corner,
        begin,
        int(limit),
        best,
    )
    return Searched(best[:found], work, passed, compared)


def _four(frames: Sequence[Frame]) -> tuple[Sequence[Frame], FrameWeights]:
    """Two or four frames as four, and the weights of what alternates in them."""
    return (frames, ALTERNATION) if len(frames) == 4 else ([*frames, *frames], DIFFERENCE)


@lru_cache(maxsize=64)  # a frame is searched by several detectors
def _spans(pose: Pose, side: int, origin: tuple[int, int]) -> tuple[int, int, int, int]:
    """First row and column of the blocks of an array that is followed, and those after its last."""
    x0, y0, width, height = window_around(pose, side, BLOCK_PX)
    top, first = y0 - origin[1], x0 - origin[0]
    ends = (top + height) // BLOCK_PX + 1, (first + width) // BLOCK_PX + 1
    return max(0, top // BLOCK_PX), max(0, first // BLOCK_PX), max(0, ends[0]), max(0, ends[1])


PART_BLOCKS = 3000
"""Blocks of 8 x 8 pixels that it takes as long to combine and to sum up as a part takes beside its pixels: 250 us."""


class SearchRegion(NamedTuple):
    """A part of frames that is searched."""

    # (rows, columns) gray levels of what alternates
    change: NDArray[np.float32]
    # (blocks down, blocks across), whether an array may have its centre there
    busy: NDArray[np.bool_]
    # The first of the frames, for place and full scale
    first: Frame


def search_regions(
    frames: Sequence[Frame],
    busy: NDArray[np.bool_],
    largest_px: float,
    change_of: Callable[[Sequence[Frame]], NDArray[np.float32]],
) -> list[SearchRegion]:
    """The parts of frames that candidates in busy blocks are seen in, from a block's first pixel on.

    Blocks that are far from each other have parts of their own, where these are smaller together than one for all.
    """
    # an array and its ring about a centre in a busy block, and two blocks for where its fit moves it and tilts it
    reach = int(np.ceil((0.5 + RING) * largest_px / BLOCK_PX)) + 2
    groups, spans = [busy], [_spans_of(busy, reach)]
    if _blocks(*spans[0]) > PART_BLOCKS and len(apart := _apart(busy, 2 * reach)) > 1:
        spans_apart = [_spans_of(group, reach) for group in apart]
        if sum(PART_BLOCKS + _blocks(*one) for one in spans_apart) < PART_BLOCKS + _blocks(*spans[0]):
            groups, spans = apart, spans_apart
    parts = []
    for group, (down, across) in zip(groups, spans, strict=True):
        rows, columns = (slice(span.start * BLOCK_PX, span.stop * BLOCK_PX) for span in (down, across))
        place = frames[0].origin[0] + columns.start, frames[0].origin[1] + rows.start
        cut = [replace(frame, pixels=frame.pixels[rows, columns], origin=place) for frame in frames]
        parts.append(SearchRegion(change_of(cut), group[down, across], cut[0]))
    return parts


def _apart(busy: NDArray[np.bool_], gap: int) -> list[NDArray[np.bool_]]:
    """Busy blocks by groups that have at least so many calm columns between them, or rows."""
    groups = []
    for columns in _runs(np.any(busy, axis=0), gap):
        for rows in _runs(np.any(busy[:, columns], axis=1), gap):
            groups.append(np.zeros_like(busy))
            groups[-1][rows, columns] = busy[rows, columns]
    return groups


def _runs(busy: NDArray[np.bool_], gap: int) -> list[slice]:
    """Places from the first to the last that is busy, cut where at least so many in a row are calm."""
    places = np.flatnonzero(busy)
    cuts = np.flatnonzero(places[1:] - places[:-1] > gap)
    firsts, lasts = [0, *(cuts + 1).tolist()], [*cuts.tolist(), -1]
    return [slice(int(places[k]), int(places[j]) + 1) for k, j in zip(firsts, lasts, strict=True)]


def _spans_of(busy: NDArray[np.bool_], reach: int) -> tuple[slice, slice]:
    """Rows and columns of the blocks that are busy, and so many around."""
    down, across = (slice(*_span(np.any(busy, axis=axis), reach)) for axis in (1, 0))
    return down, across


def _blocks(down: slice, across: slice) -> int:
    """How many blocks rows and columns hold."""
    return int((down.stop - down.start) * (across.stop - across.start))


def _span(busy: NDArray[np.bool_], reach: int) -> tuple[int, int]:
    """First and end of the busy places, and of those around."""
    places = np.flatnonzero(busy)
    return max(int(places[0]) - reach, 0), min(int(places[-1]) + 1 + reach, busy.size)
