"""Cells of a screen array: work budget of the search, fit of the cells in a frame, and tracking from frame to frame.

The array is resampled upright, S samples per cell, with a ring of one cell around. The samples are B X B^T, with the
light X of the cells and of the ring, and the spread B of a cell by the blur. Least squares give X; the residual,
projected on the derivatives of B X B^T, corrects the place.
"""

from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import TINY, Floats
from heliograph.base.frames import Frame, Pixels

SAMPLES_PER_S = 14e6
"""Samples that a core resamples and fits per second, on the machine of `docs/performance.md`."""


class SearchBudget:
    """Work of the search for a screen in seconds of a core, counted rather than timed to be reproducible."""

    def __init__(self, share: float = 0.2, first_s: float = 1.0, debt_s: float = 0.5):
        # work per second of the film, initial and maximum work, and debt to give up an array that shows no header
        self.share, self.first_s, self.debt_s = share, first_s, debt_s
        self.fill()

    @classmethod
    def for_light(cls, period_s: float) -> "SearchBudget":
        """Return the budget for a pattern period; headers below 10 patterns/s take longer."""
        budget, slower = cls(), max(1.0, 10 * period_s)
        return cls(budget.share, slower * budget.first_s, slower * budget.debt_s)

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


S = 6
"""Samples along the side of a cell: a blur of a third of a cell is represented to 1 %."""

RIM_CELLS = 1
"""Width of the ring around the array in cells; the light of the ring leaks into the array."""

PIXEL_SAMPLES = 0.05
"""Work of a pixel in samples."""


@dataclass(frozen=True)
class CellParameters:
    """Parameters of the fit of cells and of the tracking from frame to frame."""

    # Loading of the least squares, relative to the weight of a cell: cells may be smaller than the blur
    loading: float = 1e-3
    # Cell size in px above which frames are reduced
    max_cell_px: float = 10.0
    # Minimum step in cells to continue the fit, and maximum of a step
    min_step: float = 0.01
    max_step: float = 0.7
    # Standard deviation in px of a pixel and of bilinear interpolation: sqrt(1/12 + 1/12)
    pixel_px: float = 0.4
    # The same of a sample, in samples
    sample_width: float = 0.35
    # Minimum blur in cells: sharper edges fall between samples
    min_blur: float = 0.05
    # Work of a step in addition to the samples
    step_samples: int = 3000
    # Light in full scales of a saturated sample, within the error of a codec
    saturated: float = 0.985
    # Rms of random data about the mean, relative to the mean
    data_contrast: float = 0.5
    # Weights of the shape of the array in the last frame, relative to the weight of the image
    stiffness: tuple[float, ...] = (0.0, 0.03, 0.03, 0.0, 0.03, 0.03, 0.2, 0.2)
    # Maximum misfit: 0.06 to 0.3 for the right place, 0.6 to 0.9 half a cell off
    max_misfit: float = 0.6
    # Predicted fraction of the last motion: sway goes on, tremor turns back
    motion_share: float = 0.5
    # Maximum rms change of a side of the ring, relative to the light; a slip by a cell changes 0.5 to 1
    max_ring_change: float = 0.3
    # Minimum light, relative to the brightest frames
    min_light: float = 0.15
    # Maximum factor of the usual misfit per frame, and decay of the brightest light
    growth: float = 1.03
    # Weight of a frame in the usual ring
    ring_rate: float = 0.05
    # Offsets in cells, right and down, to try after a slip: a fit corrects half a cell
    slip_cells: tuple[float, ...] = (0, -0.6, 0.6, -1.2, 1.2)
    # Ratio of the misfit to the usual misfit above which slips are tried; headers and smear have up to 1.5
    max_misfit_ratio: float = 1.8


_PARAMETERS = CellParameters()


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

    def scaled(self, across: float, down: float, side: int) -> "Place":
        """Return the place of an array of another size about the same middle."""
        m = side / 2
        return Place(
            self.homography @ np.array([[across, 0, m * (1 - across)], [0, down, m * (1 - down)], [0, 0, 1.0]])
        )

    def shifted(self, right: float, down: float) -> "Place":
        """Return the place shifted by cells."""
        return Place(self.homography @ np.array([[1, 0, right], [0, 1, down], [0, 0, 1.0]]))

    def cell_px(self, side: int) -> float:
        """Return the mean side of a cell in px."""
        c = self.corners(side)
        return float(np.linalg.norm(np.roll(c, -1, axis=0) - c, axis=1).mean() / side)


@dataclass(frozen=True)
class CellFit:
    """Cells of an array in a frame."""

    # Fitted place
    place: Place
    # (n + 2, n + 2) light of the cells and of the ring in full scales
    cells: Floats
    # Rms of the residual, relative to the contrast of the picture or of data
    misfit: float
    # Saturated fraction of the array
    saturated: float

    @property
    def ring(self) -> Floats:
        """(4 n,) light of the ring without the corners."""
        inner = slice(RIM_CELLS, -RIM_CELLS)
        return np.concatenate(
            [self.cells[0, inner], self.cells[-1, inner], self.cells[inner, 0], self.cells[inner, -1]]
        )

    @property
    def light(self) -> Floats:
        """(n, n) light of the cells in full scales."""
        return self.cells[RIM_CELLS:-RIM_CELLS, RIM_CELLS:-RIM_CELLS]


@lru_cache(maxsize=64)
def _spread(side: int, width: float) -> tuple[Floats, Floats, Floats]:
    """Return B, the derivative of B by the place, and the weights of the least squares, for a blur in cells."""
    from scipy.special import ndtr

    cells = side + 2 * RIM_CELLS
    at = (np.arange(cells * S) + 0.5) / S
    edge = np.arange(cells + 1.0)
    z = (at[:, None] - edge) / width
    b = ndtr(z[:, :-1]) - ndtr(z[:, 1:])
    bell = np.exp(-0.5 * z**2) / (np.sqrt(2 * np.pi) * width)
    # the light beyond the ring continues the ring
    b[:, 0] += ndtr(-z[:, 0])
    b[:, -1] += ndtr(z[:, -1])
    slope = bell[:, :-1] - bell[:, 1:]
    slope[:, 0], slope[:, -1] = -bell[:, 1], bell[:, -2]
    gram = b.T @ b
    weights = np.linalg.solve(gram + _PARAMETERS.loading * S * np.eye(cells), b.T)
    return b, slope, weights


def _resample(part: NDArray[np.float32], homography: Floats, side: int) -> Floats:
    """Resample an array upright, with the ring, from a part of a frame."""
    cells = side + 2 * RIM_CELLS
    # sample (i + 1/2) / S - RIM_CELLS cells
    to_cells = np.array([[1 / S, 0, 0.5 / S - RIM_CELLS], [0, 1 / S, 0.5 / S - RIM_CELLS], [0, 0, 1]])
    size = (cells * S, cells * S)
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    return np.asarray(
        cv2.warpPerspective(part, homography @ to_cells, size, flags=flags, borderMode=cv2.BORDER_REPLICATE),
        np.float64,
    )


def light_of(pixels: Pixels, light: NDArray[np.float32]) -> NDArray[np.float32]:
    """Convert gray levels to light by a table."""
    if pixels.dtype == np.uint8:
        return np.asarray(cv2.LUT(pixels, light), np.float32)
    return light[pixels]


def is_inside(place: Place, side: int, shape: tuple[int, ...]) -> bool:
    """Return True if an array lies completely in a frame."""
    corners = place.corners(side)
    w = np.array([[0, 0, 1], [side, 0, 1], [side, side, 1], [0, side, 1.0]]) @ place.homography[2]
    size = np.array(shape[::-1])
    return bool(np.isfinite(corners).all() and (w > 0).all() and (corners > -1).all() and (corners < size).all())


class CellFitter:
    """Fits the cells and the place of an array in frames."""

    def __init__(self, side: int, blur_px: float, light: NDArray[np.float32], budget: SearchBudget | None = None):
        self.side, self.blur_px, self.light = side, blur_px, light
        self.budget = budget or SearchBudget()

    def __call__(self, pixels: Pixels, place: Place, max_steps: int = 4) -> CellFit:
        """Fit the cells and the place in a frame."""
        side = self.side
        part, part_place = self._cut_out(pixels, place)
        # blur of pixel, interpolation and lens
        width = float(
            np.hypot(np.hypot(self.blur_px, _PARAMETERS.pixel_px) / place.cell_px(side), _PARAMETERS.sample_width / S)
        )
        b, slope, weights = _spread(side, round(max(width, _PARAMETERS.min_blur), 2))
        start = place
        for step in range(max_steps + 1):
            homography = part_place.homography @ np.linalg.solve(start.homography, place.homography)
            samples = _resample(part, homography, side)
            x = weights @ samples @ weights.T
            residual = samples - b @ x @ b.T
            if step == max_steps:
                break
            delta = _step(residual, b, slope, x, side)
            place = Place(place.homography @ delta)
            if np.abs(delta - np.eye(3))[:2].max() < _PARAMETERS.min_step:
                break
        self.budget.spend((step + 1) * (samples.size + _PARAMETERS.step_samples) + PIXEL_SAMPLES * part.size)
        core = slice(RIM_CELLS * S, -RIM_CELLS * S)
        inner = samples[core, core]
        # between a pattern and the inverse all cells are alike
        contrast = max(float(inner.std()), _PARAMETERS.data_contrast * float(inner.mean()), TINY)
        misfit = float(np.sqrt(np.mean(residual[core, core] ** 2))) / contrast
        return CellFit(place, x, misfit, float(np.mean(inner > _PARAMETERS.saturated)))

    def _cut_out(self, pixels: Pixels, place: Place) -> tuple[NDArray[np.float32], Place]:
        """Cut out the light around an array, reduced for large cells, with the place in the part."""
        corners, cell = place.corners(self.side), place.cell_px(self.side)
        rim = 2 * cell + 2
        low = np.maximum(np.floor(corners.min(0) - rim), 0).astype(int)
        high = np.minimum(np.ceil(corners.max(0) + rim).astype(int) + 1, pixels.shape[::-1])
        part = light_of(pixels[low[1] : high[1], low[0] : high[0]], self.light)
        factor = max(1, int(cell / _PARAMETERS.max_cell_px))
        if factor > 1:
            size = (part.shape[1] // factor, part.shape[0] // factor)
            part = part[: size[1] * factor, : size[0] * factor]
            part = np.asarray(cv2.resize(part, size, interpolation=cv2.INTER_AREA))
        # pixel i of the reduced part covers pixels factor i to factor (i + 1) - 1
        shift = (0.5 - low) / factor - 0.5
        move = np.array([[1 / factor, 0, shift[0]], [0, 1 / factor, shift[1]], [0, 0, 1]])
        return part, Place(move @ place.homography)


def _step(residual: Floats, b: Floats, slope: Floats, x: Floats, side: int) -> Floats:
    """Return a small homography in cells to reduce the residual, (3, 3)."""
    core = slice(RIM_CELLS * S - S // 2, -(RIM_CELLS * S - S // 2))
    across, down = (b @ x @ slope.T)[core, core], (slope @ x @ b.T)[core, core]
    at = (np.arange(b.shape[0])[core] + 0.5) / S - RIM_CELLS - side / 2
    u, v = (axis / side for axis in np.meshgrid(at, at))
    # x' = x + a + b u + c v + g u^2 + h u v, y' = y + d + e u + f v + g u v + h v^2, in cells
    tilt = across * u + down * v
    terms = [across, across * u, across * v, down, down * u, down * v, tilt * u, tilt * v]
    rows = np.stack(terms).reshape(8, -1)
    gram = rows @ rows.T
    hold = np.array(_PARAMETERS.stiffness) * (gram[0, 0] + gram[3, 3]) / 2
    # the image moves opposite to the place
    p = np.linalg.solve(gram + np.diag(hold) + 1e-12 * np.eye(8), -(rows @ residual[core, core].ravel()))
    p = p / max(1.0, float(np.abs(p).max()) / _PARAMETERS.max_step)
    n = side
    a, bb, c, d, e, f, g, h = p
    centred = np.array([[1 + bb / n, c / n, a], [e / n, 1 + f / n, d], [-g / n**2, -h / n**2, 1]])
    move = np.array([[1, 0, n / 2], [0, 1, n / 2], [0, 0, 1]])
    return move @ centred @ np.linalg.inv(move)


@dataclass(frozen=True)
class Sample:
    """An array in a frame."""

    # Number of the frame
    index: int
    # Start of the exposure of the first row in camera time
    time_s: float
    # (n, n, 2) x and y of each cell in px
    at: Floats
    # Cells and place
    fit: CellFit


class CellTracker:
    """Tracks an array from frame to frame."""

    def __init__(self, fitter: CellFitter, place: Place, corrects_slips: bool = True):
        self._fitter, self.place, self._corrects_slips = fitter, place, corrects_slips
        n = fitter.side
        self._middle = np.array([n / 2] * 2)
        self._cell_centres = np.stack(np.meshgrid(np.arange(n) + 0.5, np.arange(n) + 0.5), axis=-1)
        self._motion = np.zeros(2)
        self._ring: Floats | None = None
        self._usual_misfit = _PARAMETERS.max_misfit / _PARAMETERS.max_misfit_ratio
        self._last_good = place
        self._max_light = 0.0
        self.lost_since: float | None = None

    @property
    def blur_px(self) -> float:
        """Standard deviation of the blur in px."""
        return self._fitter.blur_px

    def track(self, frame: Frame, max_steps: int = 4) -> Sample | None:
        """Find the array in the next frame; None for an invisible array."""
        expected = self.place.moved(_PARAMETERS.motion_share * self._motion)
        fit = self._fit(frame, expected, max_steps)
        if fit is not None and float(fit.light.mean()) < _PARAMETERS.min_light * self._max_light:
            return None  # the backlight was off
        if self._corrects_slips and (fit is None or self._doubt(fit) > 1) and self._fitter.budget.is_left:
            fit = self._correct_slip(frame, expected, max_steps, fit)
        if fit is None:
            self._motion = np.zeros(2)
            if self.lost_since is None:
                self.lost_since = frame.time_s
            return None
        self.lost_since = None
        self._motion = fit.place.at(self._middle) - self.place.at(self._middle)
        self.place = fit.place
        self._update(fit)
        return Sample(frame.index, frame.time_s, self.place.at(self._cell_centres), fit)

    def _correct_slip(self, frame: Frame, place: Place, max_steps: int, fit: CellFit | None) -> CellFit | None:
        """Return the best fit around a place, with the shape of the last good fit."""
        if self._ring is None:
            return fit
        shaped = self._last_good.moved(place.at(self._middle) - self._last_good.at(self._middle))
        offsets = product(_PARAMETERS.slip_cells, _PARAMETERS.slip_cells)
        fits = [fit, *(self._fit(frame, shaped.shifted(*offset), max_steps) for offset in offsets)]
        return min((candidate for candidate in fits if candidate is not None), key=self._doubt, default=None)

    def _doubt(self, fit: CellFit) -> float:
        """Return the doubt about a fit; above 1 the fit may be a slip."""
        misfit = fit.misfit / (_PARAMETERS.max_misfit_ratio * self._usual_misfit)
        if self._ring is None:
            return max(misfit, 0.0)
        # a slip changes two sides, the largest change counts
        sides = np.sqrt(np.mean((fit.ring - self._ring).reshape(4, -1) ** 2, axis=1))
        return max(misfit, float(sides.max() / max(float(fit.light.mean()), TINY)) / _PARAMETERS.max_ring_change)

    def _update(self, fit: CellFit) -> None:
        """Update the usual ring, light and misfit by a fit."""
        if self._ring is None:
            self._ring, self._usual_misfit = fit.ring, fit.misfit
        if self._doubt(fit) < 1:
            self._ring = (1 - _PARAMETERS.ring_rate) * self._ring + _PARAMETERS.ring_rate * fit.ring
            self._last_good = fit.place
        growth = _PARAMETERS.growth
        self._max_light = max(float(fit.light.mean()), self._max_light / growth)
        # the usual misfit follows slowly, for cameras that lose focus
        self._usual_misfit = float(np.clip(fit.misfit, self._usual_misfit / growth, self._usual_misfit * growth))

    def _fit(self, frame: Frame, place: Place, max_steps: int) -> CellFit | None:
        """Fit the cells from a place on; None for a bad fit."""
        if not is_inside(place, self._fitter.side, frame.pixels.shape):
            return None
        fit = self._fitter(frame.pixels, place, max_steps)
        is_good = fit.misfit < _PARAMETERS.max_misfit and is_inside(fit.place, self._fitter.side, frame.pixels.shape)
        return fit if is_good else None
