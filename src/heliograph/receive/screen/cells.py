"""Cells of a screen array: work budget of the search, fit of the cells in a frame, and tracking from frame to frame.

The array is resampled upright, S samples per cell, with a ring of one cell around. The samples are B X B^T, with the
light X of the cells and of the ring, and the spread B of a cell by the blur. Least squares give X; the residual,
projected on the derivatives of B X B^T, corrects the place.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from heliograph.base.arrays import TINY, Floats
from heliograph.base.frames import Frame, Pixels
from heliograph.receive.geometry.pose import Pose, pose_of_axes

Pixels32 = NDArray[np.float32]  # gray levels or light of pixels, (rows, columns)

SAMPLES_PER_S = 14e6  # samples that a core resamples and fits per second


class SearchBudget:
    """Work of the search for a screen in seconds of a core, counted rather than timed to be reproducible."""

    def __init__(self, share: float = 0.2, first_s: float = 1.0, debt_s: float = 0.5):
        # work per second of the film, initial and maximum work, and debt to give up an array that shows no header
        self.share, self.first_s, self.debt_s = share, first_s, debt_s
        self.fill()

    @property
    def is_left(self) -> bool:
        """True if work is left."""
        return self._left_s > 0

    @property
    def is_overdrawn(self) -> bool:
        """True if the debt is used up."""
        return self._left_s < -self.debt_s

    def fill(self) -> None:
        """Reset the work to the initial amount."""
        self._left_s = self.first_s

    def earn(self, film_s: float) -> None:
        """Add the work of some seconds of the film."""
        self._left_s = min(self._left_s + self.share * film_s, self.first_s)

    def spend(self, samples: float) -> None:
        """Subtract work in resampled and fitted samples."""
        self._left_s -= samples / SAMPLES_PER_S


RIM_CELLS = 1  # Width of the ring around the array in cells; the light of the ring leaks into the array
MAX_FINE_SIDE = 32  # cells a side with fine samples; more cells have fewer px each
PIXEL_SAMPLES = 0.05  # work of a pixel in samples


def samples_per_cell(side: int) -> int:
    """Return S: with 6, a blur of a third of a cell is represented to 1 %."""
    return 6 if side <= MAX_FINE_SIDE else 3


def fit_samples(side: int) -> int:
    """Return the number of samples of an array with the ring."""
    return ((side + 2 * RIM_CELLS) * samples_per_cell(side)) ** 2


@dataclass(frozen=True)
class ScreenParameters:
    """Parameters of the receiver "screen"."""

    # Fit: maximum misfit, 0.06 to 0.3 for the right place, 0.6 to 0.9 half a cell off
    max_misfit: float = 0.6
    # Ratio of the misfit to the usual misfit above which slips are tried; headers and smear have up to 1.5
    max_misfit_ratio: float = 1.8

    # Location: minimum mean change in thousandths of full scale; 2 patterns/s at 30 frames/s change by 20
    min_change: float = 4.0
    # Minimum side of an array in reduced px
    min_side: int = 9
    # Kept frames: 16 patterns of 60 patterns/s at 240 frames/s
    kept_frames: int = 64
    # Frames after which a doubtful array is accepted
    max_doubtful: int = 48
    # Numbers of recent frames for the changes: few for shaken cameras, many for slow patterns
    windows: tuple[int, ...] = (8, 16, 64)
    # Blurs in px to try
    blurs_px: tuple[float, ...] = (1.0, 0.6, 1.6, 2.4)
    # Misfit plus change of the ring above which a candidate is doubtful; 0.06 to 0.25 for the right place
    min_doubt: float = 0.3
    # Frames of a trial
    trial_frames: int = 8

    # Clock: groups of cells by sensor row that share a time, 4 ms of readout at most
    row_bins: int = 8
    # Closely compared rates, and refined clocks per rate
    best_rates: int = 4
    best_clocks: int = 2
    # Maximum unexplained part for a refinement; without a light 0.9 to 1.1 is unexplained
    max_rough_unexplained: float = 0.85
    # Maximum unexplained part of a clock: 0.003 to 0.1 for the right clock, 0.4 to 1 for others
    max_unexplained: float = 0.3
    # Unexplained part below which no other rates are tried
    certain_unexplained: float = 0.12
    # Maximum correlation of every other pattern with the next without inverses: 1 for pairs
    max_repetition: float = 0.6
    # Minimum number of patterns and of frames for a clock
    min_patterns: int = 10
    min_frames: int = 16

    # Packets: minimum correlation of a pair with a header, six standard deviations of random data of 8 x 8 cells
    min_correlation: float = 0.75

    # Seconds of a lost array before a new search
    max_lost_s: float = 1.0


PARAMETERS = ScreenParameters()


@dataclass(frozen=True)
class Place:
    """Place of an array in a frame."""

    # (3, 3) homography from cells, 0 to n, to px
    homography: Floats

    @classmethod
    def of(cls, corners: Floats, side: int) -> "Place":
        """Return the place of an array with four corners."""
        square = np.array([[0, 0], [side, 0], [side, side], [0, side]], np.float32)
        return cls(np.asarray(cv2.getPerspectiveTransform(square, np.asarray(corners, np.float32)), float))

    def at(self, points: Floats) -> Floats:
        """Convert points of the array to px."""
        h = self.homography
        out = points @ h[:, :2].T + h[:, 2]
        return out[..., :2] / out[..., 2:]

    def corners(self, side: int) -> Floats:
        """Return the corners in px, (4, 2)."""
        return self.at(np.array([[0, 0], [side, 0], [side, side], [0, side]], float))

    def moved(self, by: Floats) -> "Place":
        """Return the place shifted in the frame."""
        return Place(np.array([[1, 0, by[0]], [0, 1, by[1]], [0, 0, 1]]) @ self.homography)

    def shifted(self, right: float, down: float) -> "Place":
        """Return the place shifted by cells."""
        return Place(self.homography @ np.array([[1, 0, right], [0, 1, down], [0, 0, 1.0]]))

    def cell_px(self, side: int) -> float:
        """Return the mean side of a cell in px."""
        c = self.corners(side)
        return float(np.linalg.norm(np.roll(c, -1, axis=0) - c, axis=1).mean() / side)

    def is_inside(self, side: int, shape: tuple[int, ...]) -> bool:
        """Return True if the array lies completely in a frame."""
        corners = self.corners(side)
        w = np.array([[0, 0, 1], [side, 0, 1], [side, side, 1], [0, side, 1.0]]) @ self.homography[2]
        # both are False for corners that are not numbers
        return bool((corners > -1).all() and (corners < shape[::-1]).all() and (w > 0).all())

    def pose(self, side: int) -> Pose:
        """Return the affine pose at the middle of an array."""
        middle = np.array([side / 2, side / 2])
        x, y = self.at(middle).tolist()
        axes = np.column_stack([self.at(middle + d) - self.at(middle - d) for d in np.eye(2) / 2])
        return pose_of_axes((x, y), axes, blur=0.6)


@dataclass(frozen=True)
class Sample:
    """Cells of an array in a frame."""

    # Number of the frame
    index: int
    # Start of the exposure of the first row in camera time
    time_s: float
    # Fitted place
    place: Place
    # (n + 2, n + 2) light of the cells and of the ring in full scales
    cells: Floats
    # Rms of the residual, relative to the contrast of the picture or of data
    misfit: float

    @property
    def ring(self) -> Floats:
        """(4, n) light of the sides of the ring without the corners."""
        inner = slice(RIM_CELLS, -RIM_CELLS)
        return np.stack([self.cells[0, inner], self.cells[-1, inner], self.cells[inner, 0], self.cells[inner, -1]])

    @property
    def light(self) -> Floats:
        """(n, n) light of the cells in full scales."""
        return self.cells[RIM_CELLS:-RIM_CELLS, RIM_CELLS:-RIM_CELLS]

    @property
    def mean_light(self) -> float:
        """Mean light of the cells in full scales."""
        return float(self.light.mean())

    @cached_property
    def centres(self) -> Floats:
        """(n, n, 2) x and y of each cell in px."""
        middles = np.arange(len(self.light)) + 0.5
        return self.place.at(np.stack(np.meshgrid(middles, middles), axis=-1))


@lru_cache(maxsize=64)
def _spread(side: int, width: float) -> tuple[Pixels32, Pixels32, Pixels32, float]:
    """Return B, the derivative S of B by the place, the weights W of the least squares, and the visible part of S.

    Levels of cells fitted at a wrong place explain a part of the shift: (I - B W) S of S remains in the residual. Below
    0.4 neighbours of equal levels explain less.
    """
    cells, s = side + 2 * RIM_CELLS, samples_per_cell(side)
    at = (np.arange(cells * s) + 0.5) / s
    edge = np.arange(cells + 1.0)
    z = (at[:, None] - edge) / width
    b = ndtr(z[:, :-1]) - ndtr(z[:, 1:])
    bell = np.exp(-0.5 * z**2) / (np.sqrt(2 * np.pi) * width)
    # the light beyond the ring continues the ring
    b[:, 0] += ndtr(-z[:, 0])
    b[:, -1] += ndtr(z[:, -1])
    slope = bell[:, :-1] - bell[:, 1:]
    slope[:, 0], slope[:, -1] = -bell[:, 1], bell[:, -2]
    # loading: cells may be smaller than the blur
    gram = b.T @ b
    weights = np.linalg.solve(gram + 1e-3 * s * np.eye(cells), b.T)
    visible = float((((slope - b @ (weights @ slope)) ** 2).sum()) / (slope**2).sum())
    return b.astype(np.float32), slope.astype(np.float32), weights.astype(np.float32), max(visible, 0.4)


def _resample(part: Pixels32, homography: Floats, side: int) -> Pixels32:
    """Resample an array upright, with the ring, from a part of a frame."""
    cells, s = side + 2 * RIM_CELLS, samples_per_cell(side)
    # sample (i + 1/2) / s - RIM_CELLS cells
    to_cells = np.array([[1 / s, 0, 0.5 / s - RIM_CELLS], [0, 1 / s, 0.5 / s - RIM_CELLS], [0, 0, 1]])
    size = (cells * s, cells * s)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    warped = cv2.warpPerspective(part, homography @ to_cells, size, flags=flags, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(warped, np.float32)


def light_of(pixels: Pixels, light: Pixels32) -> Pixels32:
    """Convert gray levels to light by a table."""
    if pixels.dtype == np.uint8:
        return np.asarray(cv2.LUT(pixels, light), np.float32)
    return light[pixels]


def reduced(image: Pixels32, factor: int) -> Pixels32:
    """Reduce an image by an integer factor, less the rest of a pixel at the right and the low side."""
    size = image.shape[1] // factor, image.shape[0] // factor
    cut = image[: size[1] * factor, : size[0] * factor]
    return np.asarray(cv2.resize(cut, size, interpolation=cv2.INTER_AREA), np.float32)


def _step(
    samples: Pixels32, b: Pixels32, slope: Pixels32, x: Pixels32, visible: float, side: int, held: float
) -> Floats:
    """Return a small homography in cells to reduce the residual, (3, 3)."""
    s = samples_per_cell(side)
    # every other sample of many cells: eight values need no more
    core = slice(RIM_CELLS * s - s // 2, -(RIM_CELLS * s - s // 2), 1 if side <= MAX_FINE_SIDE else 2)
    light, leaned = b[core] @ x, slope[core] @ x
    residual = samples[core, core] - light @ b[core].T
    across, down = light @ slope[core].T, leaned @ b[core].T
    at = ((np.arange(b.shape[0], dtype=np.float32)[core] + 0.5) / s - RIM_CELLS) / side - 0.5
    u, v = np.meshgrid(at, at)
    # x' = x + a + b u + c v + g u^2 + h u v, y' = y + d + e u + f v + g u v + h v^2, in cells
    tilt = across * u + down * v
    terms = [across, across * u, across * v, down, down * u, down * v, tilt * u, tilt * v]
    rows = np.stack(terms).reshape(8, -1)
    gram = np.asarray(rows @ rows.T, np.float64)
    # weights of the shape of the array in the last frame
    hold = held * np.array([0, 0.03, 0.03, 0, 0.03, 0.03, 0.2, 0.2]) * (gram[0, 0] + gram[3, 3]) / 2
    # the image moves opposite to the place
    p = np.linalg.solve(gram + np.diag(hold) + 1e-12 * np.eye(8), -(rows @ residual.ravel())) / visible
    p = p / max(1.0, float(np.abs(p).max()) / 0.7)
    a, bb, c, d, e, f, g, h = p
    centred = np.array([[1 + bb / side, c / side, a], [e / side, 1 + f / side, d], [-g / side**2, -h / side**2, 1]])
    move = np.array([[1, 0, side / 2], [0, 1, side / 2], [0, 0, 1]])
    return move @ centred @ np.linalg.inv(move)


class CellTracker:
    """Fits the cells of an array and tracks the array from frame to frame."""

    def __init__(
        self, side: int, blur_px: float, light: Pixels32, budget: SearchBudget, place: Place, correct_slips: bool = True
    ):
        self._side, self._blur_px, self._light, self._budget = side, blur_px, light, budget
        self._place, self._correct_slips = place, correct_slips
        self._middle = np.array([side / 2] * 2)
        self._motion = np.zeros(2)
        # ring, misfit and place of the last good fits
        self._ring: Floats | None = None
        self._usual_misfit, self._last_good = PARAMETERS.max_misfit / PARAMETERS.max_misfit_ratio, place
        self._max_light = 0.0
        self.lost_since: float | None = None

    def fit(self, frame: Frame, place: Place, max_steps: int = 4, held: float = 1.0) -> Sample:
        """Fit the cells and the place in a frame, from a place on."""
        side, s = self._side, samples_per_cell(self._side)
        part, part_place = self._cut_out(frame.pixels, place)
        # blur of the lens, and of pixel and bilinear interpolation in px: sqrt(1/12 + 1/12)
        width = float(np.hypot(np.hypot(self._blur_px, 0.4) / place.cell_px(side), 0.35 / s))
        # sharper edges than 0.05 cells fall between samples
        b, slope, weights, visible = _spread(side, round(max(width, 0.05), 2))
        start = place
        for step in range(max_steps + 1):
            homography = part_place.homography @ np.linalg.solve(start.homography, place.homography)
            samples = _resample(part, homography, side)
            x = np.asarray(weights @ samples @ weights.T, np.float32)
            if step == max_steps:
                break
            delta = _step(samples, b, slope, x, visible, side, held)
            place = Place(place.homography @ delta)
            if np.abs(delta - np.eye(3))[:2].max() < 0.03:
                break
        # a step costs 3000 samples more
        self._budget.spend((step + 1) * (samples.size + 3000) + PIXEL_SAMPLES * part.size)
        core = slice(RIM_CELLS * s, -RIM_CELLS * s)
        inner, residual = samples[core, core], (samples - b @ x @ b.T)[core, core]
        # between a pattern and the inverse all cells are alike: data have half the mean as rms
        contrast = max(float(inner.std()), 0.5 * float(inner.mean()), TINY)
        misfit = float(np.sqrt(np.mean(residual**2))) / contrast
        return Sample(frame.index, frame.time_s, place, x.astype(np.float64), misfit)

    def fit_blocks(self, frame: Frame, place: Place) -> Place:
        """Fit blocks of 4 x 4 and of 2 x 2 of many cells: a fit corrects half a block."""
        for size in (4, 2) if self._side > MAX_FINE_SIDE else ():
            scale, side = np.diag([size, size, 1.0]), self._side // size
            blocks = Place(place.homography @ scale)
            tracker = CellTracker(side, 0.2 * blocks.cell_px(side), self._light, self._budget, blocks)
            place = Place(tracker.fit(frame, blocks, max_steps=10, held=0.1).place.homography @ np.linalg.inv(scale))
        return place

    def _cut_out(self, pixels: Pixels, place: Place) -> tuple[Pixels32, Place]:
        """Cut out the light around an array, reduced to cells of 10 to 20 px, with the place in the part."""
        corners, cell = place.corners(self._side), place.cell_px(self._side)
        rim = 2 * cell + 2
        low = np.maximum(np.floor(corners.min(0) - rim), 0).astype(int)
        high = np.minimum(np.ceil(corners.max(0) + rim).astype(int) + 1, pixels.shape[::-1])
        factor = max(1, int(cell / 10))
        part = reduced(light_of(pixels[low[1] : high[1], low[0] : high[0]], self._light), factor)
        # pixel i of the reduced part covers pixels factor i to factor (i + 1) - 1
        shift = (0.5 - low) / factor - 0.5
        move = np.array([[1 / factor, 0, shift[0]], [0, 1 / factor, shift[1]], [0, 0, 1]])
        return part, Place(move @ place.homography)

    def track(self, frame: Frame) -> Sample | None:
        """Find the array in the next frame; None for an invisible array."""
        # sway goes on, tremor turns back
        expected = self._place.moved(0.5 * self._motion)
        fit = self._checked_fit(frame, expected)
        if fit is not None and (not fit.misfit or fit.mean_light < 0.15 * self._max_light):
            return None  # a black frame, or the backlight was off
        if self._correct_slips and (fit is None or self._doubt(fit) > 1) and self._budget.is_left:
            # the shape of the last good fit
            shaped = self._last_good.moved(expected.at(self._middle) - self._last_good.at(self._middle))
            tried = [fit, *(self._checked_fit(frame, place) for place in self._places_around(frame, shaped))]
            fit = min((one for one in tried if one is not None), key=self._doubt, default=None)
        if fit is None:
            self._motion = np.zeros(2)
            if self.lost_since is None:
                self.lost_since = frame.time_s
            return None
        self.lost_since = None
        self._motion, self._place = fit.place.at(self._middle) - self._place.at(self._middle), fit.place
        if self._ring is None:
            self._ring, self._usual_misfit = fit.ring, fit.misfit
        if self._doubt(fit) < 1:
            self._ring = 0.95 * self._ring + 0.05 * fit.ring
            self._last_good = fit.place
        # at most 3 % per frame: cameras lose focus slowly
        self._max_light = max(fit.mean_light, self._max_light / 1.03)
        self._usual_misfit = float(np.clip(fit.misfit, self._usual_misfit / 1.03, self._usual_misfit * 1.03))
        return fit

    def _places_around(self, frame: Frame, place: Place) -> Iterator[Place]:
        """Yield places to start from after a slip, as a fit corrects half a cell."""
        if self._side > MAX_FINE_SIDE:
            yield self.fit_blocks(frame, place)
        elif self._ring is not None:
            yield from (place.shifted(*offset) for offset in product((0, -0.6, 0.6, -1.2, 1.2), repeat=2))

    def _doubt(self, fit: Sample) -> float:
        """Return the doubt about a fit; above 1 the fit may be a slip."""
        misfit = fit.misfit / (PARAMETERS.max_misfit_ratio * self._usual_misfit)
        if self._ring is None:
            return misfit
        # a slip changes two sides by 0.5 to 1 of the light, the largest change counts
        sides = np.sqrt(np.mean((fit.ring - self._ring) ** 2, axis=1))
        return max(misfit, float(sides.max()) / (0.3 * max(fit.mean_light, TINY)))

    def _checked_fit(self, frame: Frame, place: Place) -> Sample | None:
        """Fit the cells from a place on; None for a bad fit."""
        side, shape = self._side, frame.pixels.shape
        fit = self.fit(frame, place) if place.is_inside(side, shape) else None
        is_good = fit is not None and fit.misfit < PARAMETERS.max_misfit and fit.place.is_inside(side, shape)
        return fit if is_good else None
