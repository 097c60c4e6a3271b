"""Counted errors and their confidence intervals."""

from dataclasses import dataclass


@dataclass(slots=True)
class Count:
    """Errors among trials.

    Attributes
    ----------
    trials, errors
        Counted so far.
    """

    trials: int = 0
    errors: int = 0

    def add(self, trials: int, errors: int) -> None:
        """Count more."""
        self.trials += int(trials)
        self.errors += int(errors)

    @property
    def rate(self) -> float:
        """Errors by trial; NaN without trials."""
        return self.errors / self.trials if self.trials else float("nan")

    def interval(self, confidence: float = 0.95) -> tuple[float, float]:
        """Clopper-Pearson interval of the rate."""
        return clopper_pearson(self.errors, self.trials, confidence)

    def text(self) -> str:
        """The rate as text: '1.2e-03', or an upper bound, 3 / n at 95 %, where no error was counted."""
        if not self.trials:
            return "no data"
        return f"{self.rate:.1e}" if self.errors else f"< {3 / self.trials:.1e}"


def clopper_pearson(errors: int, trials: int, confidence: float = 0.95) -> tuple[float, float]:
    """Exact confidence interval of a binomial rate (Clopper and Pearson 1934).

    Parameters
    ----------
    errors, trials
        Counts, 0 <= errors <= trials.
    confidence
        Coverage of the two-sided interval; with no errors the whole risk lies above, so the bound is about 3 / n.
    """
    if not 0 <= errors <= trials:
        raise ValueError(f"errors must be 0 to {trials} (the trials), not {errors}")
    if trials == 0:
        return 0.0, 1.0
    from scipy.special import betaincinv

    tail = (1 - confidence) / (1 if errors in (0, trials) else 2)
    # lower: B(tail; k, n - k + 1); upper: B(1 - tail; k + 1, n - k)
    low = float(betaincinv(errors, trials - errors + 1, tail)) if errors else 0.0
    high = float(betaincinv(errors + 1, trials - errors, 1 - tail)) if errors < trials else 1.0
    return low, high
