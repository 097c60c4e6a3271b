"""What looking for a screen may cost: a film that shows none is gone through in less time than it lasts.

The cells of an array in one frame: their light by least squares, and their place by how well it fits.

The frame is drawn upright, S samples a cell, with a ring of one cell around. Drawn so it is B X B^T: X the light of the
cells and of the ring, B how a cell is spread over samples by the blur. Least squares give X; what is left, against the
derivatives of B X B^T by the place, moves the place.

An array of a screen followed from frame to frame: what each frame shows of its cells.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import TINY, Floats
from heliograph.base.frames import Frame, Pixels

SAMPLES_PER_S = 14e6
"""Samples of an array that a core draws and fits in a second, on the machine of `docs/performance.md`."""


@dataclass(frozen=True)
class SearchLimits:
    """Limits of the search, in seconds of a core."""

    # Seconds of search for each second of the film
    part: float = 0.2
    # Seconds that are there at first, and at most
    first_s: float = 1.0
    # Seconds beyond which an array without a header is given up
    debt_s: float = 0.5

    def for_light(self, period_s: float) -> "SearchLimits":
        """Limits of a light of a pattern period; a header of less than 10 patterns/s takes longer to be seen."""
        slower = max(1.0, 10 * period_s)
        return replace(self, first_s=slower * self.first_s, debt_s=slower * self.debt_s)


class SearchBudget:
    """Work that the search for a screen may do. It is counted and not timed: every machine reads a film alike."""

    def __init__(self, limits: SearchLimits | None = None):
        self._limits = limits or SearchLimits()
        self.fill()

    @property
    def lasts(self) -> bool:
        """True if there is work left."""
        return self._left_s > 0

    @property
    def is_overdrawn(self) -> bool:
        """True if more was done than an array without a header is worth."""
        return self._left_s < -self._limits.debt_s

    def fill(self) -> None:
        """Allow as much work as at first."""
        self._left_s = self._limits.first_s

    def earn(self, film_s: float) -> None:
        """Allow the work of some seconds of the film more."""
        self._left_s = min(self._left_s + self._limits.part * film_s, self._limits.first_s)

    def spend(self, samples: float) -> None:
        """Do work, in samples of an array that are drawn and fitted."""
        self._left_s -= samples / SAMPLES_PER_S


S = 6
"""Samples of a cell's side. Chosen: a blur of a third of a cell is drawn right to 1 %."""

RIM_CELLS = 1
"""Cells around the array that are drawn too: what shines there is spread into the array."""

CELL_LOADING = 1e-3
"""Loading of the least squares, by the weight of a cell: cells smaller than the blur would amplify noise without
bounds."""

CELL_PX = 10.0
"""Px a cell above which frames are reduced before they are drawn: S samples see them then without gaps."""

PLACE_STEPS = 4
"""Most steps of a place in a frame. Chosen: from frame to frame it moves by less than half a cell, and each step halves
the rest at least."""

ENOUGH = 0.01
"""Step in cells that ends the fit. A tolerance."""

BOX_PX = 0.4
"""Standard deviation of a pixel's box and of bilinear samples in px: sqrt(1/12 + 1/12)."""

SAMPLED = 0.35
"""The same of a sample in samples, rounded up for what is reduced."""

NARROWEST = 0.05
"""Least blur in cells: a sharper edge falls between samples."""

STEP_SAMPLES, PIXEL_SAMPLES = 3000, 0.05
"""Work of a step beside its samples, and of a pixel, in samples: 0.2 ms and 4 ns."""

SATURATED = 0.985
"""Light in full scales from which a sample counts as saturated: the highest levels of 8 bits, less a codec's error."""

EVEN = 0.5
"""Rms of random data about their mean, by that mean: levels of 0 to 4 have the standard deviation 1."""

FIRM = (0.0, 0.03, 0.03, 0.0, 0.03, 0.03, 0.2, 0.2)
"""Weight, as a part of the image's own, that holds the shape of the array from frame to frame: a hand turns a phone by
hundredths of a degree a frame."""


@dataclass(frozen=True)
class Place:
    """An array's place in a frame."""

    # (3, 3) map of the array's square, 0 to n in cells, to px
    homography: Floats

    @classmethod
    def of(cls, corners: Floats, side: int) -> "Place":
        """Return the place of an array with four corners."""
        square = np.array([[0, 0], [side, 0], [side, side], [0, side]], np.float32)
        found = cv2.getPerspectiveTransform(square, np.asarray(corners, np.float32))
        return cls(np.asarray(found, float))

    def at(self, points: Floats) -> Floats:
        """Return points of the array in px."""
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
class Seen:
    """What a frame shows of an array."""

    # Where it was, as least squares found it
    place: Place
    # (n + 2, n + 2) light of its cells, and of the ring around, in full scales
    cells: Floats
    # Rms of what the cells do not explain, as a part of the rms of the picture about its mean, or of data's
    misfit: float
    # Part of the array that is at full scale
    saturated: float

    @property
    def ring(self) -> Floats:
        """(4 n,) light of the ring's cells but for its corners."""
        inner = slice(RIM_CELLS, -RIM_CELLS)
        return np.concatenate(
            [self.cells[0, inner], self.cells[-1, inner], self.cells[inner, 0], self.cells[inner, -1]]
        )

    @property
    def light(self) -> Floats:
        """(n, n) light of its cells in full scales."""
        return self.cells[RIM_CELLS:-RIM_CELLS, RIM_CELLS:-RIM_CELLS]


@lru_cache(maxsize=64)
def _spread(side: int, width: float) -> tuple[Floats, Floats, Floats]:
    """B, its derivative by the place in cells, and the least squares' weights, for a blur in cells."""
    from scipy.special import ndtr

    cells = side + 2 * RIM_CELLS
    at = (np.arange(cells * S) + 0.5) / S
    edge = np.arange(cells + 1.0)
    z = (at[:, None] - edge) / width
    b = ndtr(z[:, :-1]) - ndtr(z[:, 1:])
    bell = np.exp(-0.5 * z**2) / (np.sqrt(2 * np.pi) * width)
    # what lies beyond the ring is as its rim
    b[:, 0] += ndtr(-z[:, 0])
    b[:, -1] += ndtr(z[:, -1])
    slope = bell[:, :-1] - bell[:, 1:]
    slope[:, 0], slope[:, -1] = -bell[:, 1], bell[:, -2]
    gram = b.T @ b
    weights = np.linalg.solve(gram + CELL_LOADING * S * np.eye(cells), b.T)
    return b, slope, weights


def _drawn(part: NDArray[np.float32], homography: Floats, side: int) -> Floats:
    """An array drawn upright, with its ring, of the light of a part of a frame and its place there."""
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
    """Look gray levels up in the light of each level."""
    if pixels.dtype == np.uint8:
        return np.asarray(cv2.LUT(pixels, light), np.float32)
    return light[pixels]


def inside(place: Place, side: int, shape: tuple[int, ...]) -> bool:
    """Whether all of an array lies in a frame."""
    corners = place.corners(side)
    w = np.array([[0, 0, 1], [side, 0, 1], [side, side, 1], [0, side, 1.0]]) @ place.homography[2]
    size = np.array(shape[::-1])
    return bool(np.isfinite(corners).all() and (w > 0).all() and (corners > -1).all() and (corners < size).all())


class Look:
    """Finds an array's cells and place in frames."""

    def __init__(self, side: int, blur_px: float, light: NDArray[np.float32], budget: SearchBudget | None = None):
        self.side, self.blur_px, self.light = side, blur_px, light
        self.budget = budget or SearchBudget()

    def __call__(self, pixels: Pixels, place: Place, steps: int = PLACE_STEPS) -> Seen:
        """Find the cells and the place in a frame."""
        side = self.side
        part, there = self._around(pixels, place)
        # a pixel's box, bilinear samples and the lens together
        width = float(np.hypot(np.hypot(self.blur_px, BOX_PX) / place.cell_px(side), SAMPLED / S))
        b, slope, weights = _spread(side, round(max(width, NARROWEST), 2))
        start = place
        for step in range(steps + 1):
            seen = _drawn(part, there.homography @ np.linalg.solve(start.homography, place.homography), side)
            x = weights @ seen @ weights.T
            left = seen - b @ x @ b.T
            if step == steps:
                break
            delta = _step(left, b, slope, x, side)
            place = Place(place.homography @ delta)
            if np.abs(delta - np.eye(3))[:2].max() < ENOUGH:
                break
        self.budget.spend((step + 1) * (seen.size + STEP_SAMPLES) + PIXEL_SAMPLES * part.size)
        core = slice(RIM_CELLS * S, -RIM_CELLS * S)
        inner = seen[core, core]
        # from a pattern to its inverse all cells are alike for a moment, and tell nothing
        contrast = max(float(inner.std()), EVEN * float(inner.mean()), TINY)
        misfit = float(np.sqrt(np.mean(left[core, core] ** 2))) / contrast
        return Seen(place, x, misfit, float(np.mean(inner > SATURATED)))

    def _around(self, pixels: Pixels, place: Place) -> tuple[NDArray[np.float32], Place]:
        """Light of the part of a frame about an array, reduced where its cells are large, and the place in it."""
        corners, cell = place.corners(self.side), place.cell_px(self.side)
        rim = 2 * cell + 2
        low = np.maximum(np.floor(corners.min(0) - rim), 0).astype(int)
        high = np.minimum(np.ceil(corners.max(0) + rim).astype(int) + 1, pixels.shape[::-1])
        part = light_of(pixels[low[1] : high[1], low[0] : high[0]], self.light)
        factor = max(1, int(cell / CELL_PX))
        if factor > 1:
            size = (part.shape[1] // factor, part.shape[0] // factor)
            part = part[: size[1] * factor, : size[0] * factor]
            part = np.asarray(cv2.resize(part, size, interpolation=cv2.INTER_AREA))
        # pixel i of the reduced part covers pixels factor i to factor (i + 1) - 1
        shift = (0.5 - low) / factor - 0.5
        move = np.array([[1 / factor, 0, shift[0]], [0, 1 / factor, shift[1]], [0, 0, 1]])
        return part, Place(move @ place.homography)


def _step(left: Floats, b: Floats, slope: Floats, x: Floats, side: int) -> Floats:
    """A small homography in cells that lessens what is left, (3, 3)."""
    core = slice(RIM_CELLS * S - S // 2, -(RIM_CELLS * S - S // 2))
    across, down = (b @ x @ slope.T)[core, core], (slope @ x @ b.T)[core, core]
    at = (np.arange(b.shape[0])[core] + 0.5) / S - RIM_CELLS - side / 2
    u, v = (one / side for one in np.meshgrid(at, at))
    # x' = x + a + b u + c v + g u^2 + h u v, y' = y + d + e u + f v + g u v + h v^2, in cells
    rows = np.stack(
        [
            across,
            across * u,
            across * v,
            down,
            down * u,
            down * v,
            (across * u + down * v) * u,
            (across * u + down * v) * v,
        ]
    )
    rows = rows.reshape(8, -1)
    gram = rows @ rows.T
    hold = np.array(FIRM) * (gram[0, 0] + gram[3, 3]) / 2
    # the image moves against the place
    p = np.linalg.solve(gram + np.diag(hold) + 1e-12 * np.eye(8), -(rows @ left[core, core].ravel()))
    p = p / max(1.0, float(np.abs(p).max()) / 0.7)
    n = side
    a, bb, c, d, e, f, g, h = p
    centred = np.array([[1 + bb / n, c / n, a], [e / n, 1 + f / n, d], [-g / n**2, -h / n**2, 1]])
    move = np.array([[1, 0, n / 2], [0, 1, n / 2], [0, 0, 1]])
    return move @ centred @ np.linalg.inv(move)


LARGEST_MISFIT = 0.6
"""Largest part of a picture that cells may leave unexplained, by its rms. Chosen: 0.06 to 0.3 is seen of an array in
its place, 0.6 to 0.9 of one that is half a cell off."""

FORGOTTEN = 0.5
"""Part of a motion that is expected to go on from frame to frame. Chosen: sway goes on, tremor turns back."""


STRANGE = 0.3
"""Rms by which a side of the ring around an array may differ from what it usually shows, by the array's light. Cells of
the array there, a cell off, differ by 0.5 to 1."""

DARK = 0.15
"""Light of an array by that of the brightest frames below which it tells nothing. Chosen: 2 % of the weight of
others."""

GROWTH = 1.03
"""Factor by which the usual misfit follows that of a frame. Chosen: in 30 frames it has doubled."""

USUAL = 0.05
"""Weight of a frame in what the ring usually shows. Chosen: the light beside a screen changes in seconds."""

SHIFTS = tuple((x, y) for x in (0, -0.6, 0.6, -1.2, 1.2) for y in (0, -0.6, 0.6, -1.2, 1.2))
"""Cells, right and down, by which a place may have slipped: the fit finds one that is half a cell off."""

POOR = 1.8
"""Misfit by the usual one from which a frame is tried from other places. Chosen: a frame of a header or one that is
smeared has up to 1.5."""


@dataclass(frozen=True)
class Sample:
    """What a frame shows of an array."""

    # Number of the frame
    index: int
    # Start of its first row's exposure by the camera's clock
    time_s: float
    # (n, n, 2) x and y of each cell in px
    at: Floats
    # The cells' light, and their place
    seen: Seen


class Follower:
    """Follows an array."""

    def __init__(self, look: Look, place: Place, firm: bool = True):
        self._look, self.place, self._firm = look, place, firm
        n = look.side
        self._middles = np.stack(np.meshgrid(np.arange(n) + 0.5, np.arange(n) + 0.5), axis=-1)
        self._motion = np.zeros(2)
        self._ring: Floats | None = None
        self._usual = LARGEST_MISFIT / POOR
        self._sure = place
        self._bright = 0.0
        self.lost_since: float | None = None

    @property
    def blur_px(self) -> float:
        """Standard deviation of the blur in px by which cells are found."""
        return self._look.blur_px

    def take(self, frame: Frame, steps: int = 4) -> Sample | None:
        """Find the array in the next frame; None where it is not seen."""
        expected = self.place.moved(FORGOTTEN * self._motion)
        seen = self._seen(frame, expected, steps)
        if seen is not None and float(seen.light.mean()) < DARK * self._bright:
            return None  # the backlight was off
        if self._firm and (seen is None or self._doubt(seen) > 1) and self._look.budget.lasts:
            seen = self._slipped(frame, expected, steps, seen)
        if seen is None:
            self._motion = np.zeros(2)
            if self.lost_since is None:
                self.lost_since = frame.time_s
            return None
        self.lost_since = None
        middle = np.array([self._look.side / 2] * 2)
        self._motion = seen.place.at(middle) - self.place.at(middle)
        self.place = seen.place
        self._learn(seen)
        return Sample(frame.index, frame.time_s, self.place.at(self._middles), seen)

    def _slipped(self, frame: Frame, place: Place, steps: int, seen: Seen | None) -> Seen | None:
        """The best that is seen about a place, of the shape that the array had when it was last seen well."""
        if self._ring is None:
            return seen
        middle = np.array([self._look.side / 2] * 2)
        shaped = self._sure.moved(place.at(middle) - self._sure.at(middle))
        tried = [self._seen(frame, one.shifted(*shift), steps) for one in (shaped,) for shift in SHIFTS]
        return min((one for one in (seen, *tried) if one is not None), key=self._doubt, default=None)

    def _doubt(self, seen: Seen) -> float:
        """How strange what is seen is; above 1 it may be a slip."""
        return max(seen.misfit / (POOR * self._usual), self._strangeness(seen) / STRANGE)

    def _strangeness(self, seen: Seen) -> float:
        """By how much the ring differs from what it usually shows, by the array's light."""
        if self._ring is None:
            return 0.0
        # a slip shows on two sides, and most on one
        sides = np.sqrt(np.mean((seen.ring - self._ring).reshape(4, -1) ** 2, axis=1))
        return float(sides.max() / max(float(seen.light.mean()), TINY))

    def _learn(self, seen: Seen) -> None:
        if self._ring is None:
            self._ring, self._usual = seen.ring, seen.misfit
        if self._doubt(seen) < 1:
            self._ring = (1 - USUAL) * self._ring + USUAL * seen.ring
            self._sure = seen.place
        self._bright = max(float(seen.light.mean()), self._bright / GROWTH)
        # a camera that loses focus is believed in the end
        self._usual = float(np.clip(seen.misfit, self._usual / GROWTH, self._usual * GROWTH))

    def _seen(self, frame: Frame, place: Place, steps: int) -> Seen | None:
        if not inside(place, self._look.side, frame.pixels.shape):
            return None
        seen = self._look(frame.pixels, place, steps)
        good = seen.misfit < LARGEST_MISFIT and inside(seen.place, self._look.side, frame.pixels.shape)
        return seen if good else None
