"""When each cell of each frame was exposed to which pattern: the light's clock, found from the light alone.

A pair of patterns is 2 + d and 2 - d in levels, so that a cell shows

    y_i = g_i (c + sum_p d_p q(t_i + r y - 2 p T)),   q = w(t) - w(t - T)

w(t) is the mean of one pattern's light over an exposure that begins t after it, t_i the time of frame i, r y that of
the cell's row of pixels, T the pattern period and g_i the camera's gain. Given phase, row time, exposure and response
the d are linear least squares. What they leave unexplained judges the rest: variable projection. No header is needed
for it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from heliograph.base.arrays import Floats

RESPONSE_S = 0.005
"""Response of a display that a search begins with: 2 to 15 ms."""


@dataclass(frozen=True)
class Clock:
    """What decides which pattern a row sees."""

    # Time of a pair's start by the camera's clock
    start_s: float
    # Pattern period T by the camera's clock
    period_s: float
    # Time from a row of pixels to the next
    row_s: float
    # Exposure of each row of pixels
    exposure_s: float
    # Time constant of the display
    response_s: float = RESPONSE_S

    def pair_at(self, time_s: float) -> float:
        """Return the number of pairs from the start to a time."""
        return (time_s - self.start_s) / (2 * self.period_s)

    def begins(self, pair: float) -> float:
        """Return the time at which a pair begins."""
        return self.start_s + 2 * pair * self.period_s

    def design(self, times_s: Floats, pairs: Sequence[int]) -> Floats:
        """Return q for exposures that begin at some times, (..., pairs)."""
        t = times_s[..., None] - self.start_s - 2 * self.period_s * np.asarray(pairs)
        # q is the second difference of the integral of the step response
        edges = (t, t - self.period_s, t - 2 * self.period_s)
        a, b, c = (self._risen(one + self.exposure_s) - self._risen(one) for one in edges)
        return (a - 2 * b + c) / self.exposure_s

    def _risen(self, t: Floats) -> Floats:
        t, tau = np.maximum(t, 0), max(self.response_s, 1e-5)
        return t + tau * np.expm1(-t / tau)


def pairs_between(clock: Clock, first_s: float, last_s: float, late_s: float = 0.0) -> range:
    """Return the pairs that frames between two times show anything of."""
    first = int(np.floor(clock.pair_at(first_s - 3 * clock.response_s)))
    last = int(np.floor(clock.pair_at(last_s + late_s + clock.exposure_s)))
    return range(first, last + 1)
