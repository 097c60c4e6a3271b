"""When the light's clock is looked for, among which rates, and by which way of reading out."""

from dataclasses import replace

from heliograph.receive.screen.clock import Clock
from heliograph.receive.screen.readout import Kept
from heliograph.receive.screen.samples import Bins
from heliograph.receive.screen.timing import refined, searched

RATES = (10.0, 15.0, 30.0, 60.0, 5.0, 20.0, 12.0, 7.5, 6.0, 4.0, 3.0, 2.0, 24.0, 1.0)
"""Patterns a second that are tried beside the nominal ones: those that divide a display's 60 Hz, and the commonest
rates of films."""

MOST_UNEXPLAINED = 0.3
"""Largest part of what changes that a clock may leave unexplained. Of a right one it is 0.003 to 0.1, of a wrong one
0.4 to 1."""

ENOUGH_PATTERNS, ENOUGH_FRAMES = 10, 16
"""Least patterns and frames from which a clock is found. Chosen: the five numbers of a clock want some pairs of
data."""

LONGEST_SEARCH_S = 6.0
"""Seconds within which a clock is looked for: ten patterns at 2 a second last 5 s."""

BETTER = 0.8
"""Part of what is unexplained that another way of reading out must leave at most. Chosen: of a global shutter all are
alike."""


class ClockSearch:
    """Looks for the light's clock, the more rarely the longer it takes.

    Parameters
    ----------
    period_s
        Pattern period that is said.
    row_s
        Time from row to row; None to find it.
    fixed
        Whether the pattern period that is said is the only one.
    """

    def __init__(self, period_s: float, row_s: float | None, fixed: bool):
        self._period_s, self._row_s = period_s, row_s
        others = [] if fixed else [1 / rate for rate in RATES if abs(rate * period_s - 1) > 0.02]
        self._periods = [[period_s], others]
        self._tried_s = 0.0

    def again(self) -> None:
        """Look anew: the clock that was found was wrong."""
        self._tried_s = 0.0

    def find(self, kept: Kept, final: bool = False) -> Clock | None:
        """Return the clock, or None where none explains what is seen, or it is too early to look again.

        Parameters
        ----------
        kept
            What is seen; the way of reading out is set with the clock, and what is too old is dropped.
        final
            Whether nothing more comes.
        """
        length = kept.last.time_s - kept.first.time_s
        # the longer it takes the rarer it is tried
        if length < 1.3 * self._tried_s and not final:
            return None
        self._tried_s = max(length, 4 * kept.frame_s)
        # others explain a part of a slow light: its own rate has the first word
        waits = length < ENOUGH_PATTERNS * self._period_s and not final
        for periods in self._periods[: 1 if waits else 2]:
            fit = [p for p in periods if length >= ENOUGH_PATTERNS * p]
            if fit and len(kept) >= ENOUGH_FRAMES and (clock := self._among(fit, kept)) is not None:
                return clock
        if length > LONGEST_SEARCH_S * 2:
            kept.drop_before(kept.last.time_s - LONGEST_SEARCH_S)
            self._tried_s = 0.0
        return None

    def _among(self, periods: list[float], kept: Kept) -> Clock | None:
        longest = max(2 * ENOUGH_PATTERNS * min(periods), ENOUGH_PATTERNS * max(periods)) * 1.2
        start_s, end_s = kept.last.time_s - longest, kept.last.time_s
        samples = kept.gathered(start_s, end_s)
        samples = samples.evened(samples.light.mean((1, 2)))
        found = searched(samples, periods, kept.frame_s, kept.readout.length, self._row_s)
        if not found or found[0][0] >= MOST_UNEXPLAINED:
            return None
        return self._settled(*found[0], kept, start_s, end_s)

    def _settled(self, left: float, clock: Clock, kept: Kept, start_s: float, end_s: float) -> Clock:
        """Take the way of reading out that explains most: phones film upright pictures with a sensor on its side."""
        first = kept.readout
        best = left, clock, first
        for one in kept.readouts:
            kept.readout = one
            samples = kept.gathered(start_s, end_s)
            bins = Bins(samples.evened(samples.light.mean((1, 2))))
            begun = replace(clock, row_s=clock.row_s * first.length / one.length)
            least = best[0] if one is first else BETTER * best[0]
            now, refined_clock = refined(bins, begun, kept.frame_s, one.length, self._row_s)
            if now < least:
                best = now, refined_clock, one
        _, found, kept.readout = best
        return found
