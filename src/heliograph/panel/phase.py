"""Grid of a panel by the phase of periodic waves: refinement of a position, and agreement with a picture.

In an upright image with one period per LED, the grid appears as a wave along rows and a wave along columns. At a
correct position, a lit LED has phase 0 in both waves. A shift of half a pitch, another number of LEDs or a wrong corner
rotates the phase in some part of the panel.
"""

from collections.abc import Sequence
from functools import cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import TINY, Floats
from heliograph.panel.place import UNIT, Levels, Shape, homographies, transform

Waves = NDArray[np.complex128]  # amplitudes of the waves at LEDs, (rows, columns)

PER_LED = 6  # samples per LED in the upright image; even
RIM = 3  # LEDs beyond the panel in the upright image
PATCHES = (4.0, 8.0)  # sides in LEDs of the patches for the comparison of phases


class Agreement(NamedTuple):
    """Agreement of a picture with a panel's grid at a position."""

    # (2,) coherent fraction of the waves' evidence in patches of each size, -1 to 1
    phases: Floats
    # Standard deviation of a corner if lit LEDs have the error 1: large if few LEDs are lit near a corner
    leverage: float
    # Sum of the LEDs' peaks in each row and column, the rim included; bright LEDs have 1
    rows: Floats
    columns: Floats


class GridView:
    """Upright image of a panel, and the waves of the LEDs."""

    def __init__(self, image: Levels, corners: Floats, shape: Shape):
        self.corners = corners
        self._shape, self._map = shape, homographies(corners)
        self._counts = np.array([shape.columns, shape.rows], np.float64)
        self._inner = (slice(RIM, -RIM), slice(RIM, -RIM))
        to_unit = np.diag([1 / shape.columns, 1 / shape.rows, 1.0])
        to_leds = np.array([[1 / PER_LED, 0, 0.5 / PER_LED - RIM], [0, 1 / PER_LED, 0.5 / PER_LED - RIM], [0, 0, 1]])
        size = (shape.columns + 2 * RIM) * PER_LED, (shape.rows + 2 * RIM) * PER_LED
        # antialiasing
        finer = shape.pitch(corners) / PER_LED
        smooth = cv2.GaussianBlur(image, (0, 0), 0.4 * finer) if finer > 1 else image
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        upright = cv2.warpPerspective(
            smooth, self._map @ to_unit @ to_leds, size, flags=flags, borderMode=cv2.BORDER_REPLICATE
        )
        self._image = _add_domes(np.asarray(upright))
        wave, across = _window(), _across()
        self.x = self._filter(wave.real, across) + 1j * self._filter(wave.imag, across)
        self.y = self._filter(across, wave.real) + 1j * self._filter(across, wave.imag)

    def agreement(self) -> Agreement:
        """Measure the agreement of the picture with the grid."""
        waves = self.x[self._inner], self.y[self._inner]
        phases = [min(_coherence(wave, side) for wave in waves) for side in PATCHES]
        peaks = self._peaks()
        lit = np.sort(peaks[self._inner], axis=None)
        bright = max(float(np.median(lit[-max(3, lit.size // 20) :])), TINY)
        # a peak needs about the right phase in both directions
        is_peak = (self.x.real > np.abs(self.x.imag)) & (self.y.real > np.abs(self.y.imag))
        peaks = np.where(is_peak & (peaks > 0.2 * bright), peaks / bright, 0.0).clip(0, 1)
        rows, columns = self._inner
        return Agreement(np.array(phases), self._leverage(), peaks[:, columns].sum(axis=1), peaks[rows].sum(axis=0))

    def _leverage(self) -> float:
        """Return the maximum standard deviation of a corner along x or y, for lit LEDs with the error 1."""
        rows, columns = self._shape.rows, self._shape.columns
        v, u = ((np.arange(n) + 0.5) / n - 0.5 for n in (rows, columns))
        power = np.zeros((8, 8))
        for wave, basis in zip((self.x, self.y), _move_basis(np.tile(u, rows), np.repeat(v, columns)), strict=True):
            size = np.abs(_limit(wave)[self._inner]).ravel()
            power += (basis * (size / max(float(size.max()), TINY)) ** 2) @ basis.T
        covariance = np.linalg.inv(power + 1e-3 * np.eye(8))
        corners = _move_basis(*(UNIT.T - 0.5))
        return float(np.sqrt(max(np.einsum("ik,ij,jk->k", basis, covariance, basis).max() for basis in corners)))

    def strength(self) -> float:
        """Return the coherent fraction of the waves' evidence in large patches."""
        return sum(abs(_coherence(wave[self._inner], PATCHES[1])) for wave in (self.x, self.y))

    def stretched(self) -> Floats:
        """Return corners (4, 2) with an affine correction by the strongest periods of the waves."""
        y, x = (np.arange(n) - RIM + 0.5 for n in self.x.shape)
        change, shift = np.eye(2), np.zeros(2)
        for axis, wave in enumerate((self.x, self.y)):
            along, down = period = _strongest_period(wave)
            change[axis] += period
            turn = np.exp(-2j * np.pi * (along * x + down * y[:, None]))
            shift[axis] = np.angle((_limit(wave) * turn).sum()) / (2 * np.pi)
        # LED k lies at change p + shift = k
        at = (UNIT * self._counts - shift) @ np.linalg.inv(change).T
        return transform(self._map, at / self._counts)

    def bent(self, window: float) -> Floats:
        """Return corners (4, 2) with a correction of the homography by the phases within windows."""
        y, x = np.mgrid[: self.x.shape[0], : self.x.shape[1]] - RIM + 0.5
        inside = slice(RIM - 1, 1 - RIM), slice(RIM - 1, 1 - RIM)
        u, v = x[inside].ravel() / self._counts[0] - 0.5, y[inside].ravel() / self._counts[1] - 0.5
        columns, moves = [], []
        for wave, basis, count in zip((self.x, self.y), _move_basis(u, v), self._counts, strict=True):
            smooth = _smooth(_limit(wave), window)[inside].ravel()
            weight = np.abs(smooth) / max(float(np.abs(smooth).max()), TINY)
            columns.append((basis * weight).T)
            moves.append(-np.angle(smooth) / (2 * np.pi) / count * weight)
        prior = 0.02 * u.size**0.5 * np.diag([0, 1, 1, 0, 1, 1, 3, 3])
        found = np.linalg.lstsq(np.vstack([*columns, prior]), np.concatenate([*moves, np.zeros(8)]), rcond=None)[0]
        moved = np.stack([found @ basis for basis in _move_basis(*(UNIT.T - 0.5))], axis=1)
        return transform(self._map, UNIT + moved)

    def shifted(self, columns: int, rows: int) -> Floats:
        """Return corners (4, 2) shifted by integer pitches."""
        return transform(self._map, UNIT + np.array([columns, rows]) / self._counts)

    def _filter(self, along_x: Floats, along_y: Floats) -> Floats:
        """Apply a separable filter, sampled at LED centres."""
        anchor = len(along_x) // 2, len(along_y) // 2
        x, y = np.ascontiguousarray(along_x), np.ascontiguousarray(along_y)
        out = cv2.sepFilter2D(self._image, cv2.CV_32F, x, y, anchor=anchor, borderType=cv2.BORDER_REPLICATE)
        return np.asarray(out[PER_LED // 2 :: PER_LED, PER_LED // 2 :: PER_LED], np.float64)

    def _peaks(self) -> Floats:
        """Return the light at LED centres minus the mean of the midpoints between neighbours."""
        box = cv2.blur(self._image, (3, 3))
        y, x = ((np.arange(n) + 0.5) * PER_LED - 0.5 for n in self.x.shape)

        def at(dx: float, dy: float) -> Floats:
            places = np.meshgrid((x + dx * PER_LED).astype(np.float32), (y + dy * PER_LED).astype(np.float32))
            return np.asarray(cv2.remap(box, *places, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.float64)

        return at(0, 0) - (at(0.5, 0) + at(-0.5, 0) + at(0, 0.5) + at(0, -0.5)) / 4


def refine(
    image: Levels,
    corners: Floats,
    shape: Shape,
    stretch: bool = True,
    windows: Sequence[float] = (4.0, 3.0, 2.0, 2.0, 1.5),
) -> Floats:
    """Return the corners (4, 2) of the nearest grid, up to integer pitches; the start if the refinement fails."""
    found = GridView(image, corners, shape).stretched() if stretch else corners
    for window in windows:
        if not shape.is_possible(found):
            return corners
        found = GridView(image, found, shape).bent(window)
    return found if shape.is_possible(found) else corners


def _add_domes(image: Levels) -> Levels:
    """Add a dome to clipped light, with the peak in the middle of the light."""
    edge = RIM * PER_LED
    high = float(image[edge:-edge, edge:-edge].max())
    clipped = (image >= 0.95 * high).astype(np.uint8)
    # full height from a depth of 0.7 LEDs on
    depth = cv2.distanceTransform(clipped, cv2.DIST_L2, 5) / (PER_LED * 0.7)
    return np.asarray(image + high * 2.0 * np.minimum(depth, 1), np.float32)


def _coherence(wave: Waves, side: float) -> float:
    """Return the fraction of the evidence in patches with phase 0."""
    counts = [max(1, round(n / side)) for n in wave.shape]
    patches = [part for line in np.array_split(wave, counts[0]) for part in np.array_split(line, counts[1], axis=1)]
    power = np.array([float((np.abs(part) ** 2).sum()) for part in patches])
    mean = np.array([float((np.abs(part) ** 2).mean()) for part in patches])
    evidence = np.array([part.sum() for part in patches]) / np.sqrt(np.maximum(power / 2, TINY))
    # patches with less than a tenth of the mean power have less weight
    evidence *= np.sqrt(np.minimum(mean / max(0.1 * float(mean.mean()), TINY), 1.0))
    size = np.abs(evidence)
    # a patch of noise has the evidence 2
    return float((evidence.real * size).sum() / ((size**2).sum() + 2.0 * len(patches)))


def _limit(wave: Waves) -> Waves:
    """Limit amplitudes to bright LEDs of the panel: clutter may be brighter."""
    size = np.abs(wave)
    high = max(float(np.quantile(size[RIM:-RIM, RIM:-RIM], 0.95)), TINY)
    return np.asarray(wave * np.minimum(1.0, high / np.maximum(size, TINY)))


def _strongest_period(wave: Waves) -> Floats:
    """Return the change (2,) of the frequencies along x and y, in periods per LED."""
    rows, columns = (1 << int(np.ceil(np.log2(2 * n))) for n in wave.shape)
    spectrum = np.abs(np.fft.fft2(_limit(wave), (rows, columns)))
    y, x = np.fft.fftfreq(rows)[:, None], np.fft.fftfreq(columns)
    # prefer the expected grid
    spectrum = np.where((np.abs(x) <= 0.25) & (np.abs(y) <= 0.25), spectrum * np.exp(-4 * (x**2 + y**2)), 0.0)
    i, j = np.unravel_index(int(np.argmax(spectrum)), spectrum.shape)
    return np.array([x[j], y[i, 0]])


def _move_basis(u: Floats, v: Floats) -> tuple[Floats, Floats]:
    """Return the moves (8, n) along x and y of points of the square about 0, by each coefficient of a homography."""
    one, none = np.ones(u.size), np.zeros(u.size)
    return (
        np.stack([one, u, v, none, none, none, u * u, u * v]),
        np.stack([none, none, none, one, u, v, u * v, v * v]),
    )


def _smooth(wave: Waves, window: float) -> Waves:
    both = np.stack([wave.real, wave.imag], -1)
    return np.asarray(cv2.GaussianBlur(both, (0, 0), window, borderType=cv2.BORDER_CONSTANT) @ [1, 1j])


@cache
def _window() -> Waves:
    """Return a windowed wave with the period of an LED, 3 LEDs long; uniform light gives 0."""
    along = (np.arange(3 * PER_LED) + 0.5) / PER_LED - 1.5
    return np.asarray(np.cos(np.pi * along / 3) ** 2 * np.exp(-2j * np.pi * along))


@cache
def _across() -> Floats:
    """Return the weights across a wave, with a standard deviation of 0.3 LEDs."""
    weights = np.exp(-0.5 * (((np.arange(2 * PER_LED) + 0.5) / PER_LED - 1) / 0.3) ** 2)
    return np.asarray(weights / weights.sum())
