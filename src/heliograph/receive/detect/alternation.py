"""Coarse search: the alternation of a few frames, correlated with all headers over scale and position.

Hardly anything alternates in a road scene. So the search computes means over blocks first, and correlates only the
regions of the frames about busy blocks.
"""

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import Floats
from heliograph.base.frames import Frame, Pixels
from heliograph.receive.detect import kernels
from heliograph.receive.detect.kernels import BLOCK_PX
from heliograph.receive.geometry.fit import Fit
from heliograph.receive.geometry.pose import Pose
from heliograph.receive.geometry.window import CombinedFrame, window_around

Change = NDArray[np.float32]  # alternation in gray levels: an image, or the mean magnitudes of blocks

Blocks = NDArray[np.bool_]  # set of blocks, (blocks down, blocks across)

SearchRegion = tuple[CombinedFrame, Blocks]  # alternation in gray levels, and the busy blocks


@dataclass(frozen=True, kw_only=True)
class DetectorParameters:
    """Grid and thresholds of the detectors."""

    # Width of the quiet ring around a candidate as a fraction of the side: half a header's cell
    ring: float = 0.12
    # Ratio of successive sizes: half a step costs 3 % of correlation
    size_ratio: float = 1.12
    # Least distance of two candidates as a fraction of the larger side: arrays do not overlap
    min_distance: float = 0.5
    # The same for turned headers: less than a cell, as a shifted header may fit the grid better than the right one
    min_distance_turned: float = 0.2
    # Least mean alternation of a busy block over the median block's: noise has a standard deviation of 9 % of its mean
    busy_ratio: float = 2.0
    # Least mean alternation of a busy block as a fraction of the least contrast: the array may fill a quarter of it
    busy_contrast: float = 0.25
    # Largest magnitude of the sum over the sum of magnitudes of a place when work is scarce: a header of which a third
    # is hidden has 0.5, a lamp 1
    max_imbalance: float = 0.75
    # Margin in px of the fit around a candidate and the ring
    margin_px: float = 1.0
    # Standard deviations of stretch and shear of level, upright and tilted candidates; 10 degrees of yaw are a stretch
    # of -0.008, 40 degrees of -0.13
    level_sigma: float = 1e-5
    upright_sigma: float = 0.01
    tilted_sigma: float = 0.1
    # Pitches of blur to hide single LEDs, or the fit locks in a pitch off
    hiding_blur: float = 0.5
    # Most Gauss-Newton steps
    max_steps: int = 6
    # Score of an array beyond doubt
    clear_score: float = 0.95
    # Least regularity of an array with a hidden part; a format with half of the cells dimmed leaves 0.86
    min_hidden_regularity: float = 0.85
    # Largest array on the finest level of the pyramid in px a side and in px of pitch: single LEDs are hardly visible
    max_side_px: float = 64.0
    max_pitch_px: float = 4.0


DETECT = DetectorParameters()


def size_limits(min_side_px: float, max_side_px: float) -> tuple[float, float]:
    """Return the smallest and largest side in px to be found: half a step beyond the searched sizes."""
    half_step = DETECT.size_ratio**0.5
    return min_side_px / half_step, max_side_px * half_step


@dataclass(frozen=True, kw_only=True)
class SearchParameters:
    """Properties of the arrays to detect."""

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
    # Mean share of a core for searches, by the work count of `budget`
    cpu_share: float = 1e6
    # True to look for tilted and partly hidden arrays too, which finds more clutter
    impaired: bool = False
    # True if headers are blinking squares with no identity
    all_on: bool = False
    # First guess of the blur's standard deviation in px
    blur_px: float
    # True to search every block, as the user gave the place; False to search busy blocks
    everywhere: bool = False
    # Pose on the sensor if the user gave corners: candidates have this roll and tilt, and the pose is a candidate too
    start: Pose | None = None
    # Rolls searched if no upright or turned array is found; each finds arrays up to 12 degrees away
    rolls_deg: tuple[float, ...] = (22.5, -22.5, 45.0, -45.0, 67.5, -67.5)

    def sides(self) -> Floats:
        """Return the searched sizes in px, (sizes,)."""
        count = int(np.ceil(np.log(self.max_side_px / self.min_side_px) / np.log(DETECT.size_ratio))) + 1
        return np.geomspace(self.min_side_px, self.max_side_px, count)

    def is_in_size_range(self, pose: Pose, side: int) -> bool:
        """Return True if an array has a size in the searched range."""
        smallest, largest = size_limits(self.min_side_px, self.max_side_px)
        return smallest <= side * pose.pitch <= largest

    def is_plausible(self, fit: Fit, full_scale: int) -> bool:
        """Return True if a fit has the brightness and the tilt of an array."""
        # pixels with more light than full scale saturate
        is_bright = self.min_contrast <= fit.gain / full_scale <= 1.25
        # relative to a given pose
        stretch, shear = (self.start.stretch, self.start.shear) if self.start is not None else (0.0, 0.0)
        # LEDs of 22.6 degrees half angle hardly shine beyond 48 degrees
        return bool(is_bright and np.hypot(fit.pose.stretch - stretch, fit.pose.shear - shear) <= 0.2)


FrameWeights = tuple[float, float, float, float]  # weights of four frames in their sum

# (f0 - 3 f1 + 3 f2 - f3) / 4 keeps a header and cancels light at rest or in even motion or acceleration
ALTERNATION: FrameWeights = (0.25, -0.75, 0.75, -0.25)

DIFFERENCE: FrameWeights = (0.5, -0.5, 0.5, -0.5)  # weights of two repeated frames, f0 f1 f0 f1


def alternation_of(frames: Sequence[Frame], weights: FrameWeights = ALTERNATION) -> Change:
    """Compute the weighted sum of four frames, or the difference of two, (rows, columns) in gray levels."""
    pixels, weights = _four(frames, weights)
    out = np.empty(pixels[0].shape, np.float32)
    kernels.combined(*pixels, np.array(weights, np.float32), out)
    return out


def alternation_means(frames: Sequence[Frame], weights: FrameWeights = ALTERNATION) -> Change:
    """Compute the mean magnitude of `alternation_of` over blocks."""
    pixels, weights = _four(frames, weights)
    out = np.empty([-(-size // BLOCK_PX) for size in pixels[0].shape], np.float32)
    integers = _integer_weights(weights) if pixels[0].dtype == np.uint8 else None
    if integers is None:
        kernels.combined_means(*pixels, np.array(weights, np.float32), BLOCK_PX, out)
    else:
        kernels.integer_means(*pixels, *integers, out)
    return out


def _four(frames: Sequence[Frame], weights: FrameWeights) -> tuple[list[Pixels], FrameWeights]:
    """Return the pixels of two or four frames as four, and the weights."""
    pixels = [frame.pixels for frame in frames]
    return (pixels, weights) if len(pixels) == 4 else (pixels * 2, DIFFERENCE)


@lru_cache
def _integer_weights(weights: FrameWeights) -> tuple[np.int16, np.int16, np.float32] | None:
    """Write weights a, b, -b, -a as integers a and b times a scale; None if 16 bits are too few."""
    if (weights[0], weights[1]) != (-weights[3], -weights[2]):
        return None
    for parts in (1, 2, 4):
        numbers = np.array(weights) * parts
        # a column of a block sums to less than 2^16
        if (numbers == np.rint(numbers)).all() and np.abs(numbers).sum() * 255 * BLOCK_PX < 1 << 16:
            return np.int16(numbers[0]), np.int16(numbers[1]), np.float32(1 / parts)
    return None


def busy_blocks(
    means: Change, frame: Frame, tracked: Sequence[Pose], side: int, min_contrast: float, everywhere: bool = False
) -> Blocks:
    """Find the alternating blocks outside tracked arrays, and the blocks around."""
    # mean magnitudes are never negative: -1 marks the blocks of tracked arrays
    free = means.copy()
    for pose in tracked:
        top, left, end_row, end_column = _block_span(pose, side, frame.origin)
        free[top:end_row, left:end_column] = -1
    if everywhere:
        return free >= 0
    # mostly no block is busy, and no median is needed
    peak, least, ratio = free.max(), DETECT.busy_contrast * min_contrast * frame.full_scale, DETECT.busy_ratio
    if peak <= least:
        return np.zeros(means.shape, bool)
    # a large array lights all of the frame through the windscreen: the blocks within it do not count
    count = np.count_nonzero(free < 0) if tracked else 0
    middle = count + (free.size - count) // 2
    # counts, which are faster than the median: no block above `ratio` times the median, or only the least matters
    if np.count_nonzero(free < peak / ratio) <= middle:
        return np.zeros(means.shape, bool)
    is_quiet = np.count_nonzero(free < least / ratio) > middle
    median = 0.0 if is_quiet else float(np.partition(free, middle, axis=None)[middle])
    busy = free > max(least, ratio * median)
    return np.asarray(cv2.dilate(busy.view(np.uint8), np.ones((3, 3), np.uint8)), dtype=bool)


@lru_cache(maxsize=64)  # several detectors search a frame
def _block_span(pose: Pose, side: int, origin: tuple[int, int]) -> tuple[int, int, int, int]:
    """Return first row, first column, end row and end column of the blocks of a tracked array."""
    x0, y0, width, height = window_around(pose, side, BLOCK_PX)
    top, first = y0 - origin[1], x0 - origin[0]
    ends = (top + height) // BLOCK_PX + 1, (first + width) // BLOCK_PX + 1
    return max(0, top // BLOCK_PX), max(0, first // BLOCK_PX), max(0, ends[0]), max(0, ends[1])


def coarse_search(
    change: CombinedFrame,
    busy: Blocks,
    parameters: SearchParameters,
    cells: Floats,
    sides: Floats,
    min_distance: float = DETECT.min_distance,
    begin: int = 0,
    max_work: float = 1 << 60,
    max_imbalance: float = DETECT.max_imbalance,
) -> tuple[Floats, int, int, int]:
    """Correlate the alternation with headers, from a block on; return the best candidates, and the effort.

    Arrays may have their centres in busy blocks.

    Returns rows of score (negative where the inverse comes first), x and y of the centre in px of the image, side in px
    and header, the best first; the number of places visited, of blocks visited, busy or not, and of places compared
    with the headers, which is 0 for other headers too if it is 0.
    """
    best = np.zeros((parameters.candidates, 5))
    # the array may be half off the grid
    contrast = 0.5 * parameters.min_contrast * change.full_scale
    # blinking squares have no limit
    max_imbalance = 2.0 if cells.sum(axis=1).any() else max_imbalance
    limits = contrast, parameters.coarse_score, max_imbalance, min_distance
    # step of the places as a fraction of the side: half a step costs a fifth of a cell's overlap
    places = DETECT.ring, 0.1, np.array(change.origin, np.float64), begin, int(max_work)
    images, columns = integral_images(change.pixels), np.ascontiguousarray(cells.T, np.float32)
    count, work, passed, compared = kernels.search(
        images, np.ascontiguousarray(busy), cells, columns, sides, limits, *places, best
    )
    return best[:count], work, passed, compared


_memory = threading.local()


def integral_images(change: Change) -> Floats:
    """Compute the integral images of an image, of the magnitude and the square, valid until the thread's next call."""
    shape = 3, change.shape[0] + 1, change.shape[1] + 1
    size = shape[0] * shape[1] * shape[2]
    # memory takes longer to allocate than to fill
    if size > getattr(_memory, "size", 0):
        _memory.size, _memory.buffer = size, np.empty(size)
    out: Floats = _memory.buffer[:size].reshape(shape)
    cv2.integral2(change, out[0], out[2], cv2.CV_64F, cv2.CV_64F)
    cv2.integral(np.abs(change), out[1], cv2.CV_64F)
    return out


def search_regions(
    frames: Sequence[Frame], busy: Blocks, max_side_px: float, combine: Callable[[Sequence[Frame]], Change]
) -> list[SearchRegion]:
    """Combine frames about busy blocks, in separate regions for distant groups if these cost less."""
    # an array and the ring about a centre in a busy block, and two blocks for the fit
    reach = int(np.ceil((0.5 + DETECT.ring) * max_side_px / BLOCK_PX)) + 2
    groups, spans = [busy], [_span(busy, reach)]
    # the fixed cost of a region is that of 3000 blocks, 250 us
    if _size(*spans[0]) > 3000 and len(distant := _distant_groups(busy, 2 * reach)) > 1:
        spans_distant = [_span(group, reach) for group in distant]
        if sum(3000 + _size(*span) for span in spans_distant) < 3000 + _size(*spans[0]):
            groups, spans = distant, spans_distant
    regions = []
    for group, (down, across) in zip(groups, spans, strict=True):
        rows, columns = (slice(span.start * BLOCK_PX, span.stop * BLOCK_PX) for span in (down, across))
        origin = frames[0].origin[0] + columns.start, frames[0].origin[1] + rows.start
        cut = [replace(frame, pixels=frame.pixels[rows, columns], origin=origin) for frame in frames]
        change = CombinedFrame(cut[0].index, cut[0].time_s, combine(cut), origin, cut[0].full_scale)
        regions.append((change, group[down, across]))
    return regions


def _distant_groups(busy: Blocks, gap: int) -> list[Blocks]:
    """Split busy blocks into groups with more than `gap` quiet columns or rows between."""
    groups = []
    for columns in _runs(np.any(busy, axis=0), gap):
        for rows in _runs(np.any(busy[:, columns], axis=1), gap):
            groups.append(np.zeros_like(busy))
            groups[-1][rows, columns] = busy[rows, columns]
    return groups


def _runs(busy: Blocks, gap: int) -> list[slice]:
    """Cut the span of the busy places at gaps longer than `gap`."""
    places = np.flatnonzero(busy)
    runs = np.split(places, np.flatnonzero(np.diff(places) > gap) + 1)
    return [slice(int(run[0]), int(run[-1]) + 1) for run in runs]


def _span(busy: Blocks, reach: int) -> tuple[slice, slice]:
    """Return rows and columns of the busy blocks, widened by `reach`."""
    x, y, width, height = cv2.boundingRect(busy.view(np.uint8))
    rows, columns = busy.shape
    down = slice(max(y - reach, 0), min(y + height + reach, rows))
    return down, slice(max(x - reach, 0), min(x + width + reach, columns))


def _size(down: slice, across: slice) -> int:
    """Return the number of blocks in rows and columns."""
    return int((down.stop - down.start) * (across.stop - across.start))
