"""Error counts and confidence intervals."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Self

from scipy.special import betaincinv, gammaincinv, stdtrit


@dataclass(slots=True)
class Count:
    """Errors among trials."""

    trials: int = 0
    errors: int = 0

    def add(self, trials: int, errors: int) -> None:
        """Add trials and errors."""
        self.trials += int(trials)
        self.errors += int(errors)

    def include(self, other: Self) -> None:
        """Add another count."""
        self.trials += other.trials
        self.errors += other.errors

    @property
    def rate(self) -> float:
        """Errors per trial; NaN for zero trials."""
        return self.errors / self.trials if self.trials else float("nan")

    @property
    def bound(self) -> float:
        """Upper bound of the rate at 95 % for zero errors: 3 / n, at most 1."""
        return 3 / max(self.trials, 3)

    def interval(self, confidence: float = 0.95) -> tuple[float, float]:
        """Return the Clopper-Pearson interval of the rate."""
        return clopper_pearson(self.errors, self.trials, confidence)

    def text(self) -> str:
        """Return the rate as text, '1.2e-03', or the upper bound for zero errors."""
        if not self.trials:
            return "no data"
        return f"{self.rate:.1e}" if self.errors else f"< {self.bound:.1e}"


@dataclass(slots=True)
class Clustered(Count):
    """Errors among trials with correlated failures, such as the bits of a packet."""

    # Number of correlated groups of about equal size, such as packets
    clusters: int = 0
    # Sum of squared errors per cluster
    squares: int = 0
    # Bound for zero errors: true for 3 / trials, for independent errors such as raw bits; false for 3 / clusters, for
    # errors of complete clusters such as turbo codewords
    scattered: bool = False

    def add(self, trials: int, errors: int) -> None:
        """Add a cluster; ignore clusters of zero trials."""
        Count.add(self, trials, errors)
        self.clusters += trials > 0
        self.squares += int(errors) ** 2

    def include(self, other: Self) -> None:
        """Add the clusters of another count."""
        Count.include(self, other)
        self.clusters += other.clusters
        self.squares += other.squares

    @property
    def bound(self) -> float:
        """Upper bound of the rate at 95 % for zero errors: 3 / n, at most 1, with n by `scattered`."""
        return 3 / max(self.trials if self.scattered else self.clusters, 3)

    @property
    def design_effect(self) -> float:
        """Variance of the cluster errors relative to independent trials (Kish 1965).

        The range is from 1 for independent trials to the cluster size, the default for a single cluster or zero errors.
        """
        clusters, rate = max(self.clusters, 1), self.rate
        size = self.trials / clusters
        if clusters == 1 or self.errors in (0, self.trials):
            return max(size, 1.0)
        variance = (self.squares - self.errors**2 / clusters) / (clusters - 1)
        return min(max(variance / (size * rate * (1 - rate)), 1.0), size)

    def interval(self, confidence: float = 0.95) -> tuple[float, float]:
        """Return the Clopper-Pearson interval at the effective number of trials (Korn and Graubard 1998).

        The effective number is trials / `design_effect`, reduced for few clusters, and at least the number of clusters.
        """
        if self.scattered and not self.errors:
            return clopper_pearson(0, self.trials, confidence)
        if not self.trials:
            return 0.0, 1.0
        effective = self._effective_trials(confidence)
        return clopper_pearson(self.rate * effective, effective, confidence)

    def _effective_trials(self, confidence: float) -> float:
        clusters = float(max(self.clusters, 1))
        effective = self.trials / self.design_effect
        if clusters > 1:
            tail = (1 - confidence) / 2
            effective *= float((stdtrit(self.trials - 1, tail) / stdtrit(clusters - 1, tail)) ** 2)
        return max(effective, clusters)


def clopper_pearson(errors: float, trials: float, confidence: float = 0.95) -> tuple[float, float]:
    """Return the exact confidence interval of a binomial rate (Clopper and Pearson 1934)."""
    if not 0 <= errors <= trials:
        raise ValueError(f"errors must be 0 to {trials} (the trials), not {errors}")
    if trials == 0:
        return 0.0, 1.0

    tail = (1 - confidence) / (1 if errors in (0, trials) else 2)
    # lower: B(tail; k, n - k + 1); upper: B(1 - tail; k + 1, n - k)
    low = float(betaincinv(errors, trials - errors + 1, tail)) if errors else 0.0
    high = float(betaincinv(errors + 1, trials - errors, 1 - tail)) if errors < trials else 1.0
    return low, high


def poisson_interval(events: int, confidence: float = 0.95) -> tuple[float, float]:
    """Return the exact confidence interval of an expected number of events (Garwood 1936); one-sided for zero."""
    tail = (1 - confidence) / (2 if events else 1)
    return float(gammaincinv(events, tail)) if events else 0.0, float(gammaincinv(events + 1, 1 - tail))


def quantile(histogram: Mapping[str, int], share: float, total: int | None = None) -> float:
    """Return the smallest value that a share of all values does not exceed; infinite if too few of `total` are known.

    The keys of the histogram are the values as texts.
    """
    rank, counted = share * (sum(histogram.values()) if total is None else total), 0
    for value in sorted(histogram, key=float):
        counted += histogram[value]
        if counted >= rank:
            return float(value)
    return math.inf


def range_m(points: Sequence[tuple[float, float]], limit: float) -> float:
    """Return the distance in m at which an error rate first exceeds a limit, by log-linear interpolation.

    The result is 0 if the rate at the nearest point exceeds the limit, infinite if no rate does, and NaN if a nearer
    rate is NaN. Points are distance in m and rate, near first.
    """
    before: tuple[float, float] | None = None
    for distance_m, rate in points:
        if math.isnan(rate):
            return math.nan
        log = math.log10(max(rate, 1e-12))
        if log > math.log10(limit):
            if before is None:
                return 0.0
            fraction = (math.log10(limit) - before[1]) / (log - before[1])
            return before[0] + fraction * (distance_m - before[0])
        before = distance_m, log
    return math.inf
