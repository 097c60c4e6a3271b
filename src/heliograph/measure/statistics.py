"""Counted errors and their confidence intervals."""

from dataclasses import dataclass
from typing import Self


@dataclass(slots=True)
class Count:
    """Errors among trials."""

    # trials, errors: number of trials counted so far, and how many of them failed
    trials: int = 0
    errors: int = 0

    def add(self, trials: int, errors: int) -> None:
        """Count more."""
        self.trials += int(trials)
        self.errors += int(errors)

    def include(self, other: Self) -> None:
        """Count another's trials and errors as well."""
        self.trials += other.trials
        self.errors += other.errors

    @property
    def rate(self) -> float:
        """Errors by trial; NaN without trials."""
        return self.errors / self.trials if self.trials else float("nan")

    @property
    def bound(self) -> float:
        """Upper bound of the rate at 95 % where no error was counted: 3 / n, at most 1."""
        return 3 / max(self.trials, 3)

    def interval(self, confidence: float = 0.95) -> tuple[float, float]:
        """Clopper-Pearson interval of the rate."""
        return clopper_pearson(self.errors, self.trials, confidence)

    def text(self) -> str:
        """The rate as text: '1.2e-03', or an upper bound, 3 / n at 95 %, where no error was counted."""
        if not self.trials:
            return "no data"
        return f"{self.rate:.1e}" if self.errors else f"< {self.bound:.1e}"


@dataclass(slots=True)
class Clustered(Count):
    """Errors among trials that may fail together, as the bits of a packet do."""

    # Packets, or other units that fail together; of about equal numbers of trials
    clusters: int = 0
    # Sum of the squares of the clusters' errors
    squares: int = 0
    # The bound of the rate where no error was met, as the data then do not show whether errors come together. True: as
    # if they came singly, 3 / trials, as the raw errors of single LEDs do. False: as if a cluster failed as a whole, 3
    # / clusters, as a turbo decoder's codewords do
    scattered: bool = False

    def add(self, trials: int, errors: int) -> None:
        """Count a cluster; one without trials is none."""
        self.trials += int(trials)
        self.errors += int(errors)
        self.clusters += trials > 0
        self.squares += int(errors) ** 2

    def include(self, other: Self) -> None:
        """Count another's clusters as well."""
        self.trials += other.trials
        self.errors += other.errors
        self.clusters += other.clusters
        self.squares += other.squares

    @property
    def bound(self) -> float:
        """Upper bound of the rate at 95 % where no error was counted: 3 / n, at most 1, n as `scattered` says."""
        return 3 / max(self.trials if self.scattered else self.clusters, 3)

    @property
    def design_effect(self) -> float:
        """Variance of the clusters' errors over that of independent trials (Kish 1965).

        From 1, independent, to the trials of a cluster, all alike; the latter where it cannot be estimated, for one
        cluster or without errors.
        """
        clusters, rate = max(self.clusters, 1), self.rate
        size = self.trials / clusters
        if clusters == 1 or self.errors in (0, self.trials):
            return max(size, 1.0)
        seen = (self.squares - self.errors**2 / clusters) / (clusters - 1)
        return min(max(seen / (size * rate * (1 - rate)), 1.0), size)

    def interval(self, confidence: float = 0.95) -> tuple[float, float]:
        """Clopper-Pearson interval of the rate at the effective number of trials (Korn and Graubard 1998).

        That is trials / `design_effect`, and less for few clusters, from which the design effect is hardly known; never
        less than the clusters.
        """
        if self.scattered and not self.errors:
            return clopper_pearson(0, self.trials, confidence)
        if not self.trials:
            return 0.0, 1.0
        effective = self._effective_trials(confidence)
        return clopper_pearson(self.rate * effective, effective, confidence)

    def _effective_trials(self, confidence: float) -> float:
        from scipy.special import stdtrit

        clusters = float(max(self.clusters, 1))
        known = self.trials / self.design_effect
        if clusters > 1:
            tail = (1 - confidence) / 2
            known *= float((stdtrit(self.trials - 1, tail) / stdtrit(clusters - 1, tail)) ** 2)
        return max(known, clusters)


def clopper_pearson(errors: float, trials: float, confidence: float = 0.95) -> tuple[float, float]:
    """Exact confidence interval of a binomial rate (Clopper and Pearson 1934)."""
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
