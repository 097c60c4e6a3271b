"""A panel's grid by the phase of its LEDs' waves: refinement of a place, and its agreement with a picture.

An upright image with one period an LED shows the grid as a wave along rows and along columns. A lit LED has phase 0 in
both where the place is right. Half a pitch, another count of LEDs or a wrong corner turn the phase somewhere.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import TINY, Floats
from heliograph.panel.lattice import Shape
from heliograph.panel.place import UNIT, Levels, homographies, is_possible, mapped

Waves = NDArray[np.complex128]
"""Amplitudes of the waves of LEDs, (rows, columns)."""


@dataclass(frozen=True, slots=True)
class PhaseTuning:
    """How waves are measured and judged. Chosen by `python -m benchmarks.panel_places`."""

    # Samples of an LED's side in the upright image; even
    per_led: int = 6
    # LEDs beyond the panel that the upright image shows too
    rim: int = 3
    # Length in LEDs of the window of a wave
    window_leds: int = 3
    # Standard deviation in LEDs of the weights across a wave
    across_leds: float = 0.3
    # Level, as a fraction of the highest, from which light counts as clipped
    clipped: float = 0.95
    # Depth in LEDs at which the dome over clipped light reaches its full height
    dome_leds: float = 0.7
    # Height of the dome over clipped light, as a fraction of the highest level
    dome_height: float = 2.0
    # Standard deviations in LEDs of the windows within which waves are averaged, step by step
    windows_leds: tuple[float, ...] = (4.0, 3.0, 2.0, 2.0, 1.5)
    # Sides in LEDs of the patches whose phases are compared
    patch_leds: tuple[float, float] = (4.0, 8.0)
    # Evidence of each patch that counts as noise
    patch_noise: float = 2.0
    # Power of a patch, as a fraction of the mean, below which its evidence counts less
    faint: float = 0.1
    # Largest change of the period that the spectrum of waves corrects
    max_stretch: float = 0.25
    # Peak of an LED, as a fraction of the bright ones', below which it counts as dark
    faint_peak: float = 0.2


TUNING = PhaseTuning()


class Agreement(NamedTuple):
    """Agreement of a picture with a panel's grid at a place."""

    # (2,) coherent share of the waves' evidence in patches of each side of `PhaseTuning.patch_leds`, -1 to 1
    phases: Floats
    # Error of a corner where lit LEDs are off by 1 each: large where no LEDs are lit near a corner
    leverage: float
    # rows, columns: sum of the LEDs' peaks in each line of LEDs, lines beyond the panel included; 1 is the panel's
    # bright LEDs
    rows: Floats
    columns: Floats


class GridView:
    """An upright image of a panel, and the waves of its LEDs."""

    def __init__(self, image: Levels, corners: Floats, shape: Shape, tuning: PhaseTuning = TUNING):
        per, rim = tuning.per_led, tuning.rim
        self.corners = corners
        self._tuning, self._shape, self._map = tuning, shape, homographies(corners)
        to_unit = np.diag([1 / shape.columns, 1 / shape.rows, 1.0])
        to_leds = np.array([[1 / per, 0, 0.5 / per - rim], [0, 1 / per, 0.5 / per - rim], [0, 0, 1]])
        size = (shape.columns + 2 * rim) * per, (shape.rows + 2 * rim) * per
        # an image with more px than samples is smoothed to the samples' distance
        finer = shape.pitch(corners) / per
        smooth = cv2.GaussianBlur(image, (0, 0), 0.4 * finer) if finer > 1 else image
        upright = cv2.warpPerspective(
            smooth, self._map @ to_unit @ to_leds, size, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_REPLICATE,
        )  # fmt: skip
        self._image = self._domed(np.asarray(upright))
        wave, across = _window(per, tuning.window_leds), _across(per, tuning.across_leds)
        filtered = [self._filtered(along, across) for along in (wave.real, wave.imag)]
        turned = [self._filtered(across, along) for along in (wave.real, wave.imag)]
        self.x, self.y = filtered[0] + 1j * filtered[1], turned[0] + 1j * turned[1]

    def agreement(self) -> Agreement:
        """Agreement of the picture with the grid."""
        inner = slice(self._tuning.rim, -self._tuning.rim)
        waves = self.x[inner, inner], self.y[inner, inner]
        phases = [min(self._coherence(wave, side) for wave in waves) for side in self._tuning.patch_leds]
        peaks = self._peaks()
        lit = np.sort(peaks[inner, inner], axis=None)
        bright = max(float(np.median(lit[-max(3, lit.size // 20) :])), TINY)
        # an LED's peak has about the right phase in both directions
        is_peak = (self.x.real > np.abs(self.x.imag)) & (self.y.real > np.abs(self.y.imag))
        peaks = np.where(is_peak & (peaks > self._tuning.faint_peak * bright), peaks / bright, 0.0).clip(0, 1)
        return Agreement(np.array(phases), self._leverage(), peaks[:, inner].sum(axis=1), peaks[inner].sum(axis=0))

    def _leverage(self) -> float:
        """Largest standard deviation of a corner along x or y, for lit LEDs that are off by 1 each."""
        inner = slice(self._tuning.rim, -self._tuning.rim)
        rows, columns = self._shape.rows, self._shape.columns
        v, u = ((np.arange(n) + 0.5) / n - 0.5 for n in (rows, columns))
        ways = _moves(np.tile(u, rows), np.repeat(v, columns))
        power = np.full((8, 8), 0.0)
        for wave, way in zip((self.x, self.y), ways, strict=True):
            size = np.abs(self._even(wave)[inner, inner]).ravel()
            power += (way * (size / max(float(size.max()), TINY)) ** 2) @ way.T
        spread = np.linalg.inv(power + 1e-3 * np.eye(8))
        corners = _moves(*(UNIT.T - 0.5))
        return float(np.sqrt(max(np.einsum("ik,ij,jk->k", way, spread, way).max() for way in corners)))

    def strength(self) -> float:
        """Coherent share of the waves' evidence in wide patches."""
        inner = slice(self._tuning.rim, -self._tuning.rim)
        return sum(abs(self._coherence(wave[inner, inner], self._tuning.patch_leds[1])) for wave in (self.x, self.y))

    def stretched(self) -> Floats:
        """Corners (4, 2) after the affine change that the strongest periods of the waves ask for."""
        y, x = (np.arange(n) - self._tuning.rim + 0.5 for n in self.x.shape)
        change, shift = np.eye(2), np.zeros(2)
        for axis, wave in enumerate((self.x, self.y)):
            change[axis] += self._period(wave)
            along, down = change[axis] - np.eye(2)[axis]
            turn = np.exp(-2j * np.pi * (along * x + down * y[:, None]))
            shift[axis] = np.angle((self._even(wave) * turn).sum()) / (2 * np.pi)
        counts = np.array([self._shape.columns, self._shape.rows])
        # the LED k lies where change p + shift = k
        at = (UNIT * counts - shift) @ np.linalg.inv(change).T
        return mapped(self._map, at / counts)

    def bent(self, window: float) -> Floats:
        """Corners (4, 2) after the change of the homography that the phases within windows ask for."""
        counts = np.array([self._shape.columns, self._shape.rows], np.float64)
        rim = self._tuning.rim
        y, x = np.mgrid[: self.x.shape[0], : self.x.shape[1]] - rim + 0.5
        inside = slice(rim - 1, 1 - rim)
        u, v = x[inside, inside].ravel() / counts[0] - 0.5, y[inside, inside].ravel() / counts[1] - 0.5
        ways = _moves(u, v)
        columns, moves = [], []
        for wave, way, count in zip((self.x, self.y), ways, counts, strict=True):
            smooth = _smoothed(self._even(wave), window)[inside, inside].ravel()
            weight = np.abs(smooth) / max(float(np.abs(smooth).max()), TINY)
            columns.append((way * weight).T)
            moves.append(-np.angle(smooth) / (2 * np.pi) / count * weight)
        hold = 0.02 * u.size**0.5 * np.diag([0, 1, 1, 0, 1, 1, 3, 3])
        found = np.linalg.lstsq(np.vstack([*columns, hold]), np.concatenate([*moves, np.zeros(8)]), rcond=None)[0]
        moved = np.stack([found @ way for way in _moves(*(UNIT.T - 0.5))], axis=1)
        return mapped(self._map, UNIT + moved)

    def shifted(self, columns: int, rows: int) -> Floats:
        """Corners (4, 2) shifted by whole pitches."""
        return mapped(self._map, UNIT + np.array([columns / self._shape.columns, rows / self._shape.rows]))

    def _domed(self, image: Levels) -> Levels:
        """The image with a dome over clipped light: its peak then lies where the light's middle is."""
        tuning = self._tuning
        edge = tuning.rim * tuning.per_led
        high = float(image[edge:-edge, edge:-edge].max())
        clipped = (image >= tuning.clipped * high).astype(np.uint8)
        depth = cv2.distanceTransform(clipped, cv2.DIST_L2, 5) / (tuning.per_led * tuning.dome_leds)
        return np.asarray(image + high * tuning.dome_height * np.minimum(depth, 1), np.float32)

    def _filtered(self, along_x: Floats, along_y: Floats) -> Floats:
        half = self._tuning.per_led // 2
        anchor = len(along_x) // 2, len(along_y) // 2
        out = cv2.sepFilter2D(
            self._image, cv2.CV_32F, np.ascontiguousarray(along_x), np.ascontiguousarray(along_y), anchor=anchor,
            borderType=cv2.BORDER_REPLICATE,
        )  # fmt: skip
        return np.asarray(out[half :: 2 * half, half :: 2 * half], np.float64)

    def _peaks(self) -> Floats:
        """Light at each LED's centre less the mean of the middles between it and its neighbours."""
        per = self._tuning.per_led
        width = per // 3 + (per // 3 + 1) % 2
        box = cv2.blur(self._image, (width, width))
        rows, columns = self.x.shape
        y, x = ((np.arange(n) + 0.5) * per - 0.5 for n in (rows, columns))

        def at(dx: float, dy: float) -> Floats:
            places = np.meshgrid((x + dx * per).astype(np.float32), (y + dy * per).astype(np.float32))
            return np.asarray(cv2.remap(box, *places, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE), np.float64)

        return at(0, 0) - (at(0.5, 0) + at(-0.5, 0) + at(0, 0.5) + at(0, -0.5)) / 4

    def _coherence(self, wave: Waves, side: float) -> float:
        """Share of the evidence in patches that has phase 0."""
        counts = [max(1, round(n / side)) for n in wave.shape]
        patches = [part for line in np.array_split(wave, counts[0]) for part in np.array_split(line, counts[1], axis=1)]
        power = np.array([float((np.abs(part) ** 2).sum()) for part in patches])
        mean = np.array([float((np.abs(part) ** 2).mean()) for part in patches])
        sums = np.array([part.sum() for part in patches])
        evidence = sums / np.sqrt(np.maximum(power / 2, TINY))
        evidence *= np.sqrt(np.minimum(mean / max(self._tuning.faint * float(mean.mean()), TINY), 1.0))
        size = np.abs(evidence)
        return float((evidence.real * size).sum() / ((size**2).sum() + self._tuning.patch_noise * len(patches)))

    def _even(self, wave: Waves) -> Waves:
        """Waves whose strongest count no more than the bright LEDs' own: clutter may be brighter."""
        rim = self._tuning.rim
        size = np.abs(wave)
        high = max(float(np.quantile(size[rim:-rim, rim:-rim], 0.95)), TINY)
        return np.asarray(wave * np.minimum(1.0, high / np.maximum(size, TINY)))

    def _period(self, wave: Waves) -> Floats:
        """Change (2,) of the frequencies along x and y in periods an LED, of the strongest wave."""
        rows, columns = (1 << int(np.ceil(np.log2(2 * n))) for n in wave.shape)
        spectrum = np.abs(np.fft.fft2(self._even(wave), (rows, columns)))
        y, x = np.fft.fftfreq(rows)[:, None], np.fft.fftfreq(columns)
        near = (np.abs(x) <= self._tuning.max_stretch) & (np.abs(y) <= self._tuning.max_stretch)
        # the grid expected comes first where two are alike
        spectrum = np.where(near, spectrum * np.exp(-4 * (x**2 + y**2)), 0.0)
        i, j = np.unravel_index(int(np.argmax(spectrum)), spectrum.shape)
        return np.array([x[j], y[i, 0]])


def refined(
    image: Levels, corners: Floats, shape: Shape, stretch: bool = True, windows: Sequence[float] = TUNING.windows_leds
) -> Floats:
    """Corners (4, 2) of the grid that lies nearest, whole pitches left aside; the start where it goes astray."""
    found = GridView(image, corners, shape).stretched() if stretch else corners
    for window in windows:
        if not is_possible(found, shape.rows, shape.columns):
            return corners
        found = GridView(image, found, shape).bent(window)
    return found if is_possible(found, shape.rows, shape.columns) else corners


def _moves(u: Floats, v: Floats) -> tuple[Floats, Floats]:
    """Moves (8, n) along x and along y of points of the square about 0 by each coefficient of a homography."""
    one, none = np.ones(u.size), np.zeros(u.size)
    return (
        np.stack([one, u, v, none, none, none, u * u, u * v]),
        np.stack([none, none, none, one, u, v, u * v, v * v]),
    )


def _smoothed(wave: Waves, window: float) -> Waves:
    parts = [cv2.GaussianBlur(np.ascontiguousarray(part), (0, 0), window, borderType=cv2.BORDER_CONSTANT)
             for part in (wave.real, wave.imag)]  # fmt: skip
    return np.asarray(parts[0] + 1j * parts[1])


@cache
def _window(per_led: int, leds: int) -> Waves:
    """A wave of period one LED within a window; an even light gives 0."""
    along = (np.arange(leds * per_led) + 0.5) / per_led - leds / 2
    return np.asarray(np.cos(np.pi * along / leds) ** 2 * np.exp(-2j * np.pi * along))


@cache
def _across(per_led: int, sigma: float) -> Floats:
    along = (np.arange(2 * per_led) + 0.5) / per_led - 1
    weights = np.exp(-0.5 * (along / sigma) ** 2)
    return np.asarray(weights / weights.sum())
