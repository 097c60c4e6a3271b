"""How a film is exposed: its gray levels, and how many pixels are at full scale."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame

SAMPLED_FRAMES = 64
"""Frames of a film whose levels are counted, spread over it: a film's exposure hardly changes between them."""


@dataclass(frozen=True, slots=True)
class PileUp:
    """When pixels at the top of a region's gray levels count as overexposed."""

    # Levels, over the ceiling, by which noise and a codec smear one level
    width: float = 0.06
    # Most such levels over the range from the region's darkest level to its top: fewer than from level to level
    range_part: float = 0.15
    # Least part of the region's pixels: of random data 1/16 of the LEDs have the highest of five levels
    part: float = 0.3
    # Least ratio of the pixels at the top to those as many levels just below
    ratio: float = 3.0
    # Least top level over the ceiling
    level: float = 0.5


def overexposed_part(counts: NDArray[np.int64], ceiling: int, rule: PileUp = PileUp()) -> float:
    """Return the part of a region's pixels that are overexposed, whether their level is at full scale or below.

    Clipping, a tone curve or limited range ends the levels of a region at a level of its own, where pixels pile up.
    """
    total = max(int(counts.sum()), 1)
    clipped = float(counts[ceiling:].sum()) / total
    places = np.cumsum(counts)
    bottom, top = (int(np.searchsorted(places, part * total)) for part in (0.005, 0.995))
    width = max(round(min(rule.width * ceiling, rule.range_part * (top - bottom))), 1)
    begin = max(top - width, 0)
    piled, below = int(counts[begin + 1 :].sum()), int(counts[max(begin + 1 - width, 0) : begin + 1].sum())
    is_piled = top >= rule.level * ceiling and piled >= rule.part * total and piled >= rule.ratio * below
    return max(clipped, piled / total) if is_piled else clipped


@dataclass(frozen=True, slots=True)
class Levels:
    """Gray levels of a film.

    Attributes
    ----------
    full_scale
        Largest gray level that the film can hold.
    percentiles
        Gray level that a percentage of the pixels has at most, by that percentage.
    brightest
        Largest gray level seen.
    at_full_scale
        Fraction of the pixels with the largest gray level that the film can hold.
    at_zero
        Fraction of the pixels that are 0.
    ceiling
        Level at which the sensor is cut off: below full scale where the film has more bits than its levels.
    frames
        Frames that were counted.
    """

    full_scale: int
    percentiles: dict[int, float]
    brightest: int
    at_full_scale: float
    at_zero: float
    ceiling: int
    frames: int


class LevelWatch:
    """Counts the gray levels of some of a film's frames."""

    def __init__(self, frames: int | None):
        self._every = max(1, (frames or 16 * SAMPLED_FRAMES) // SAMPLED_FRAMES)
        self._seen = self._counted = 0
        self._counts: NDArray[np.int64] | None = None
        self._full_scale = 255

    def add(self, frame: Frame) -> None:
        """Take the next frame, and count its levels if it is one of those that are sampled."""
        self._seen += 1
        if (self._seen - 1) % self._every or not frame.pixels.size:
            return
        counts = np.bincount(frame.pixels.ravel(), minlength=frame.full_scale + 1).astype(np.int64)
        if self._counts is None:
            self._counts = np.zeros(frame.full_scale + 1, np.int64)
        self._counts += counts[: self._counts.size]
        self._full_scale, self._counted = frame.full_scale, self._counted + 1

    @property
    def ceiling(self) -> int:
        """Level at which the sensor is cut off, as far as the frames so far tell."""
        return self.levels().ceiling

    def levels(self) -> Levels:
        """The levels of the frames so far."""
        counts = np.zeros(self._full_scale + 1, np.int64) if self._counts is None else self._counts
        total = max(int(counts.sum()), 1)
        places = np.cumsum(counts) / total
        there = np.flatnonzero(counts)
        brightest = int(there[-1]) if there.size else 0
        ceiling = self._full_scale
        # fraction of the full scale below which such a level says that the film's bits are not those of its levels
        if 1 < brightest < 0.9 * self._full_scale and _piled(counts, brightest):
            ceiling = brightest
        # percentiles of the gray levels that are told
        return Levels(
            full_scale=self._full_scale,
            percentiles={p: float(np.searchsorted(places, p / 100)) for p in (1, 50, 99)},
            brightest=brightest,
            at_full_scale=float(counts[-1]) / total,
            at_zero=float(counts[0]) / total,
            ceiling=ceiling,
            frames=self._counted,
        )


def _piled(counts: NDArray[np.int64], level: int) -> bool:
    """Whether far more pixels have a level than one of those just below, as if what is brighter were cut off."""
    below = counts[max(level - 8, 0) : level]
    if 2 * counts[level] > counts.sum():
        # an even picture
        return False
    # How many times as many pixels have the largest level seen as one below: then the sensor is cut off there. Of light
    # that falls off towards bright levels fewer have the largest; noise alone makes it the rarest
    return bool(counts[level] > 20.0 * max(float(below.mean()), 1.0))
