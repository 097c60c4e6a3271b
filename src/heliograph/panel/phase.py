"""A panel's place by the phase of its LEDs' grid: where the grid is beside what was expected, patch by patch.

An image drawn upright with one period an LED shows the grid as a wave along rows and along columns, whatever its LEDs
show. Of a patch the phase of the wave says by what part of a pitch the grid lies elsewhere. From patch to patch it
changes by less than half a period, so that scale, turn and perspective follow from all of them. What is left is a shift
by whole pitches: rows and columns beyond the panel's rim show no wave.
"""

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from heliograph.base.arrays import TINY, Floats
from heliograph.panel.lattice import Shape
from heliograph.panel.picture import Levels
from heliograph.panel.place import UNIT, homographies, is_convex, mapped

PER_LED = 6
"""Samples of an LED's width in the upright image. Chosen: two a period are needed."""

PATCH_LEDS = 4
"""Fewest LEDs of a patch's side: half of 16 LEDs are on, give or take an eighth."""

AFRESH, ONWARDS = (8, 8, 8), (1, 2, 4, 8)
"""Most patches a side, in turn.

With all of them at once corners may be off by pitches of their own. From a place like the right one few come first:
one patch is the whole panel, whose shift shows where the waves of an eighth of it do not.
"""

FARTHEST = 3
"""Whole pitches by which the grid may be shifted, along rows and along columns."""

Waves = NDArray[np.complex128]
"""Amplitudes of waves."""


class Phased(NamedTuple):
    """A panel's place by its grid's phase.

    Attributes
    ----------
    corners
        (4, 2) corners in px.
    strength
        How surely a grid shows there, in standard deviations of what an image without one shows.
    """

    corners: Floats
    strength: float


def phased(image: Levels, corners: Floats, shape: Shape, patches: Sequence[int] = AFRESH) -> Phased:
    """Find the grid of LEDs that lies nearest.

    Parameters
    ----------
    image
        (rows, columns) gray levels.
    corners
        (4, 2) corners in px to start from; each may be off by `FARTHEST` pitches.
    shape
        Rows and columns of the panel.
    patches
        Most patches a side of each step, `AFRESH` or `ONWARDS`.
    """
    for most in patches:
        found = _Waves(image, corners, shape).corrected(most)
        if not is_convex(found):
            return Phased(corners, 0.0)
        corners = found
    corners = _Waves(image, corners, shape).within_rim()
    return Phased(corners, strength(image, corners, shape))


def strength(image: Levels, corners: Floats, shape: Shape) -> float:
    """How surely a grid of LEDs shows at a place; see `Phased`.

    Parameters
    ----------
    image
        (rows, columns) gray levels.
    corners
        (4, 2) corners of the grid in px.
    shape
        Rows and columns of the panel.
    """
    return _Waves(image, corners, shape).strength if is_convex(corners) else 0.0


class _Waves:
    """Waves of a grid of LEDs along rows and columns of the image drawn upright, a little beyond its rim."""

    def __init__(self, image: Levels, corners: Floats, shape: Shape):
        self._shape, self._map = shape, homographies(corners)
        self._counts = shape.rows, shape.columns
        rows, columns = (count + 2 * FARTHEST for count in self._counts)
        # pixel i of the upright image covers i to i + 1 samples
        to_leds = np.array([[1 / PER_LED, 0, 0.5 / PER_LED - FARTHEST], [0, 1 / PER_LED, 0.5 / PER_LED - FARTHEST]])
        scale = np.diag([1 / shape.columns, 1 / shape.rows, 1.0])
        upright = self._map @ scale @ np.vstack([to_leds, [0, 0, 1]])
        flags, border = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP, cv2.BORDER_REPLICATE
        size = columns * PER_LED, rows * PER_LED
        seen = cv2.warpPerspective(image, upright, size, flags=flags, borderMode=border).astype(np.float64)
        # LED k lies at k + 1/2: there a wave is 1; what is even has none
        down, across = (-np.exp(-2j * np.pi * (np.arange(n) + 0.5) / PER_LED) for n in seen.shape)
        self._waves = [_summed(seen * wave) for wave in (down[:, None], across[None, :])]

    def corrected(self, most: int) -> Floats:
        """Corners of the grid whose waves these are, by so many patches a side at most, whole pitches left aside."""
        patches = [max(1, min(most, n // PATCH_LEDS)) for n in self._counts]
        edges = [np.rint(np.linspace(0, n, k + 1)).astype(int) for n, k in zip(self._counts, patches, strict=True)]
        y, x = (-_unwrapped(_patched(one, edges)) / (2 * np.pi) for one in self._waves)
        middle = [(one[1:] + one[:-1]) / 2 for one in edges]
        at = np.stack(np.meshgrid(middle[1], middle[0]), axis=-1).reshape(-1, 2) / self._counts[::-1]
        there = mapped(self._map, at + np.stack([x.ravel(), y.ravel()], axis=1) / self._counts[::-1])
        if min(y.shape) > 1:
            found, _ = cv2.findHomography(at, there, cv2.LMEDS if len(at) > len(UNIT) else 0)
            if found is not None:
                return mapped(np.asarray(found, np.float64), UNIT)
        return mapped(self._map, UNIT) + (there - mapped(self._map, at)).mean(axis=0)

    @property
    def strength(self) -> float:
        """Mean of the LEDs' waves over its standard deviation, of the weaker one."""
        inside = [one[FARTHEST:-FARTHEST, FARTHEST:-FARTHEST].real for one in self._waves]
        return float(min(one.mean() / max(one.std() / one.size**0.5, TINY) for one in inside))

    def within_rim(self) -> Floats:
        """Corners shifted by whole pitches, so that what shows waves lies within."""
        inside = slice(FARTHEST, -FARTHEST)
        move = np.zeros(2)
        # the rows of the panel show the wave along them, its columns that down them
        for axis, wave in ((1, self._waves[1][:, inside].sum(axis=1)), (0, self._waves[0][inside].sum(axis=0))):
            count = self._counts[1 - axis]
            shown = [float(np.real(wave[k : k + count]).sum()) for k in range(2 * FARTHEST + 1)]
            move[axis] = (int(np.argmax(shown)) - FARTHEST) / count
        return mapped(self._map, UNIT + move)


def _summed(values: Waves) -> Waves:
    """Sums over the samples of each LED."""
    rows, columns = (n // PER_LED for n in values.shape)
    return np.asarray(values.reshape(rows, PER_LED, columns, PER_LED).sum(axis=(1, 3)))


def _patched(leds: Waves, edges: list[NDArray[np.int_]]) -> Waves:
    """Sums over patches of the panel."""
    inside = leds[FARTHEST:-FARTHEST, FARTHEST:-FARTHEST]
    return np.asarray(np.add.reduceat(np.add.reduceat(inside, edges[0][:-1], axis=0), edges[1][:-1], axis=1))


def _unwrapped(waves: Waves) -> Floats:
    """Phases of patches, from the middle row and column on; the middle patch's is within half a period."""
    phases = np.angle(waves)
    i, j = (n // 2 for n in phases.shape)
    middle = _from_middle(phases[i], j)
    columns = np.stack([_from_middle(column, i) for column in phases.T], axis=1)
    # each column follows the middle row
    return np.asarray(columns + 2 * np.pi * np.rint((middle - columns[i]) / (2 * np.pi)))


def _from_middle(phases: Floats, middle: int) -> Floats:
    out = np.unwrap(phases)
    return np.asarray(out + phases[middle] - out[middle])
