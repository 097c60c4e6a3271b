"""What looking for a screen may cost: a film that shows none is gone through in less time than it lasts."""

from dataclasses import dataclass, replace

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
