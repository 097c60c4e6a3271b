"""Gray levels and overexposure of a film."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from heliograph.base.frames import Frame

Counts = NDArray[np.int64]  # pixel count by gray level


def overexposed_part(counts: Counts, ceiling: int) -> float:
    """Return the overexposed part of a region's pixels, also for highlights that end below full scale.

    Clipping, a tone curve or limited range ends the levels of a region early, and the brightest pixels pile up there.
    """
    total = max(int(counts.sum()), 1)
    clipped = float(counts[ceiling:].sum()) / total
    cumulative = np.cumsum(counts)
    bottom, top = (int(np.searchsorted(cumulative, part * total)) for part in (0.005, 0.995))
    # noise and codecs smear a level over 6 % of the ceiling; a level of the light covers over 15 % of the range
    width = max(round(min(0.06 * ceiling, 0.15 * (top - bottom))), 1)
    begin = max(top - width, 0)
    piled, below = int(counts[begin + 1 :].sum()), int(counts[max(begin + 1 - width, 0) : begin + 1].sum())
    # of random data 1/16 of the LEDs have the highest of five levels; a header has as many dark LEDs as bright ones
    is_piled = top >= 0.5 * ceiling and piled >= max(0.3 * total, 3 * below, cumulative[bottom + width - 1])
    return max(clipped, piled / total) if is_piled else clipped


@dataclass(frozen=True, slots=True)
class Levels:
    """Gray levels of a film.

    Attributes
    ----------
    full_scale
        Highest gray level of the film's format.
    percentiles
        Gray level of the 1st, 50th and 99th percentile, by percentage.
    brightest
        Highest gray level in the film.
    at_full_scale, at_zero
        Fraction of the pixels at full scale, and at 0.
    ceiling
        Level at which the sensor clips; below full scale if the film has more bits than the sensor.
    """

    full_scale: int
    percentiles: dict[int, float]
    brightest: int
    at_full_scale: float
    at_zero: float
    ceiling: int


class LevelWatch:
    """Histogram of some 64 frames, spread over a film."""

    def __init__(self, frames: int | None):
        self._every = max(1, (frames or 1024) // 64)
        self._count = 0
        self._counts: Counts | None = None

    def add(self, frame: Frame) -> None:
        """Add the next frame."""
        if self._count % self._every == 0 and frame.pixels.size:
            counts = np.bincount(frame.pixels.ravel(), minlength=frame.full_scale + 1)[: frame.full_scale + 1]
            self._counts = counts if self._counts is None else self._counts + counts
        self._count += 1

    def levels(self) -> Levels:
        """Summarise the frames so far."""
        counts = np.zeros(256, np.int64) if self._counts is None else self._counts
        full_scale, total = counts.size - 1, max(int(counts.sum()), 1)
        cumulative = np.cumsum(counts) / total
        brightest = int(np.flatnonzero(counts)[-1]) if counts.any() else 0
        # unclipped light and noise make the highest level the rarest, except in a uniform image
        usual = max(float(counts[max(brightest - 8, 0) : brightest].mean()), 1.0) if brightest else 1.0
        is_clipped = 1 < brightest < 0.9 * full_scale and 20 * usual < counts[brightest] <= 0.5 * total
        return Levels(
            full_scale, {p: float(np.searchsorted(cumulative, p / 100)) for p in (1, 50, 99)}, brightest,
            float(counts[-1]) / total, float(counts[0]) / total, brightest if is_clipped else full_scale,
        )  # fmt: skip
