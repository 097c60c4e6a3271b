"""When the light's clock is looked for, among which rates, and by which way of reading out."""

from dataclasses import replace

import numpy as np

from heliograph.receive.screen.budget import SearchBudget
from heliograph.receive.screen.clock import Clock
from heliograph.receive.screen.readout import Kept
from heliograph.receive.screen.samples import Bins
from heliograph.receive.screen.timing import refined, searched

RATES = (10.0, 15.0, 30.0, 60.0, 5.0, 20.0, 12.0, 7.5, 6.0, 4.0, 3.0, 2.0, 24.0, 1.0)
"""Patterns a second that are tried beside the nominal ones: those that divide a display's 60 Hz, and the commonest
rates of films."""

DISPLAY_RATES = (12.5, 16.7, 25.0, 50.0, 14.4, 18.0, 36.0, 72.0, 18.75, 37.5, 75.0, 10.3, 20.6, 27.5, 33.0, 22.5, 28.8)
"""Patterns a second of displays of 50, 72, 75, 90, 144 and 165 Hz, likewise."""

STEP = 0.03
"""Rates that are tried lie nearer to each other than this, as a fraction. Chosen: over ten patterns the ends are then
off by a sixth of one, from where the right rate is found."""

ANY_RATES = tuple(np.exp(np.arange(0.0, np.log(60.0), STEP)).tolist())
"""Patterns a second that are tried where no usual rate fits, of 1 to 60."""

SEARCH_PAUSE = 0.3
"""Part of the time for which nothing was found that passes to the next search. Chosen: a search takes one or two
seconds."""

MOST_UNEXPLAINED = 0.3
"""Largest part of what changes that a clock may leave unexplained. Of a right one it is 0.003 to 0.1, of a wrong one
0.4 to 1."""

SURELY_EXPLAINED = 0.12
"""The same below which no other rates are tried."""

ENOUGH_PATTERNS, ENOUGH_FRAMES = 10, 16
"""Least patterns and frames from which a clock is found. Chosen: the five numbers of a clock want some pairs of
data."""

LONGEST_SEARCH_S = 6.0
"""Seconds within which a clock is looked for: ten patterns at 2 a second last 5 s."""

BETTER = 0.8
"""Part of what is unexplained that another way of reading out must leave at most. Chosen: of a global shutter all are
alike."""


class ClockSearch:
    """Looks for the light's clock, the more rarely the longer it takes."""

    def __init__(self, period_s: float, row_s: float | None, fixed: bool, budget: SearchBudget):
        self._period_s, self._row_s, self._budget = period_s, row_s, budget
        usual = [1 / rate for rate in (*RATES, *DISPLAY_RATES) if abs(rate * period_s - 1) > STEP / 2]
        self._periods = [[period_s]] if fixed else [[period_s], usual, [1 / rate for rate in ANY_RATES]]
        self._next_s = -np.inf
        self._group = 0  # of rates with which the next search begins

    def again(self) -> None:
        """Look anew: the clock that was found was wrong."""
        self._next_s = -np.inf

    def find(self, kept: Kept, final: bool = False) -> Clock | None:
        """Return the clock, or None where none explains what is seen, or it is too early to look again."""
        now_s = kept.last.time_s
        length = now_s - kept.first.time_s
        if len(kept) < ENOUGH_FRAMES or ((now_s < self._next_s or not self._budget.lasts) and not final):
            return None
        self._next_s = now_s + max(SEARCH_PAUSE * length, 4 * kept.frame_s)
        # others explain a part of a slow light: its own rate has the first word
        waits = length < ENOUGH_PATTERNS * self._period_s and not final
        best: tuple[float, Clock, float] | None = None
        groups = [0] if waits else [*range(self._group, len(self._periods)), *range(self._group)]
        for group in groups:
            periods, self._group = self._periods[group], group
            if group != groups[0] and not self._budget.lasts:
                break
            fit = [p for p in periods if length >= ENOUGH_PATTERNS * p]
            found = self._among(fit, kept) if fit else None
            if found is not None and (best is None or found[0] < best[0]):
                best = found
            if best is not None and best[0] < SURELY_EXPLAINED:
                break
        else:
            self._group = 0
        if best is None:
            kept.drop_before(now_s - 2 * LONGEST_SEARCH_S)
            return None
        left, clock, longest = best
        return self._settled(left, clock, kept, now_s - longest, now_s)

    def _among(self, periods: list[float], kept: Kept) -> tuple[float, Clock, float] | None:
        """The best clock of some rates: what it leaves unexplained, itself, and the seconds by which it was found."""
        longest = max(2 * ENOUGH_PATTERNS * min(periods), ENOUGH_PATTERNS * max(periods)) * 1.2
        samples = kept.gathered(kept.last.time_s - longest, kept.last.time_s)
        samples = samples.evened(samples.light.mean((1, 2)))
        found = searched(samples, periods, kept.frame_s, kept.readout.length, self._row_s, self._budget)
        if not found or found[0][0] >= MOST_UNEXPLAINED:
            return None
        return *found[0], longest

    def _settled(self, left: float, clock: Clock, kept: Kept, start_s: float, end_s: float) -> Clock:
        """Take the way of reading out that explains most: phones film upright pictures with a sensor on its side."""
        first = kept.readout
        best = left, clock, first
        for one in kept.readouts:
            kept.readout = one
            samples = kept.gathered(start_s, end_s)
            bins = Bins(samples.evened(samples.light.mean((1, 2))), self._budget)
            begun = replace(clock, row_s=clock.row_s * first.length / one.length)
            least = best[0] if one is first else BETTER * best[0]
            now, refined_clock = refined(bins, begun, kept.frame_s, one.length, self._row_s)
            if now < least:
                best = now, refined_clock, one
        _, found, kept.readout = best
        return found
